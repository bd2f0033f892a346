//! The outcome of a case: behaviour and, separately, the connection's close.
//!
//! Contains no checks of its own; the words are those of the reports.

use std::fmt;
use std::time::Duration;

use rhumb_protocol::scene::{Command, CommandError, Shape};

/// The result of a case's function.
pub type CaseResult = Result<(), Stop>;

/// The reason of an early end of a case.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The peer broke a promise.
    Fail(String),
    /// The peer ignores a SHOULD.
    Lax(String),
    /// The peer declares, by the protocol's means, that it lacks the tested feature.
    Unsupported(String),
    /// The runner could not run the case.
    Inconclusive(String),
}

/// The verdict about the peer's behaviour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Verdict {
    /// As required.
    Pass,
    /// Allowed, but not as recommended.
    Lax,
    /// The peer declared that it lacks the feature, and did nothing of it.
    Unsupported,
    /// Unknown.
    Inconclusive,
    /// A requirement is violated.
    Fail,
}

/// The close of the connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Closing {
    /// The case does not close the connection, or the suite closes it.
    NotJudged,
    /// With the code that the document requires.
    Clean,
    /// With another code.
    WrongCode {
        /// The acceptable codes.
        wanted: Vec<u64>,
        /// The received code.
        received: u64,
    },
    /// Without a code.
    Unclean(String),
}

/// The outcome of a case.
#[derive(Clone, Debug)]
pub struct CaseOutcome {
    /// The verdict.
    pub verdict: Verdict,
    /// The reason, unless it passed.
    pub why: String,
    /// The close of the connection.
    pub closing: Closing,
    /// The duration of the case.
    pub took: Duration,
    /// The log of sent and received data, unless the case passed.
    pub trace: Vec<String>,
}

impl Verdict {
    /// All verdicts, from the best to the worst.
    pub const ALL: [Self; 5] = [
        Self::Pass,
        Self::Lax,
        Self::Unsupported,
        Self::Inconclusive,
        Self::Fail,
    ];

    /// The verdict as one word.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Lax => "non-strict",
            Self::Unsupported => "unsupported",
            Self::Inconclusive => "inconclusive",
            Self::Fail => "fail",
        }
    }
}

impl Closing {
    /// The closing as one or two words.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        match self {
            Self::NotJudged => "",
            Self::Clean => "clean",
            Self::WrongCode { .. } => "wrong code",
            Self::Unclean(_) => "unclean",
        }
    }

    /// True if the connection closed as required.
    #[must_use]
    pub const fn is_good(&self) -> bool {
        matches!(self, Self::NotJudged | Self::Clean)
    }
}

impl CaseOutcome {
    /// True if the outcome is good; with `strict`, SHOULD counts as MUST.
    #[must_use]
    pub fn is_good(&self, strict: bool) -> bool {
        let behaved = match self.verdict {
            Verdict::Pass | Verdict::Unsupported => true,
            Verdict::Lax => !strict,
            Verdict::Inconclusive | Verdict::Fail => false,
        };
        behaved && self.closing.is_good()
    }
}

impl Stop {
    /// The verdict that this stop leads to.
    #[must_use]
    pub const fn verdict(&self) -> Verdict {
        match self {
            Self::Fail(_) => Verdict::Fail,
            Self::Lax(_) => Verdict::Lax,
            Self::Unsupported(_) => Verdict::Unsupported,
            Self::Inconclusive(_) => Verdict::Inconclusive,
        }
    }

    /// The reason.
    #[must_use]
    pub fn why(&self) -> &str {
        match self {
            Self::Fail(why) | Self::Lax(why) | Self::Unsupported(why) | Self::Inconclusive(why) => {
                why
            }
        }
    }

    /// The verdict on a refused command that had to be accepted: an engine may lack what it needs (PROTOCOL 4.5-6).
    #[must_use]
    pub fn refused(command: &Command, error: &CommandError) -> Self {
        let may_lack = match command {
            Command::AddShape { shape, .. } => {
                !matches!(shape, Shape::Ball { .. } | Shape::Cuboid { .. })
            }
            Command::AddBody { .. }
            | Command::ChangeBody { .. }
            | Command::AddJoint { .. }
            | Command::ChangeJoint { .. }
            | Command::SetLocomotion { .. } => true,
            _ => false,
        };
        let why = format!("{command:?} is refused: {error}");
        match error {
            CommandError::Unsupported if may_lack => Self::Unsupported(why),
            _ => Self::Fail(why),
        }
    }

    /// A failure with this reason.
    pub fn fail<T>(why: impl Into<String>) -> Result<T, Self> {
        Err(Self::Fail(why.into()))
    }
}

/// Passes if the promise was kept; `promise` states it in words.
///
/// # Errors
///
/// [`Stop::Fail`] otherwise.
pub fn ensure(kept: bool, promise: impl Into<String>) -> CaseResult {
    if kept {
        Ok(())
    } else {
        Stop::fail(format!("not so: {}", promise.into()))
    }
}

/// Passes if a SHOULD is followed.
///
/// # Errors
///
/// [`Stop::Lax`] otherwise.
pub fn should(kept: bool, promise: impl Into<String>) -> CaseResult {
    if kept {
        Ok(())
    } else {
        Err(Stop::Lax(format!("not so: {}", promise.into())))
    }
}

impl fmt::Display for Closing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::WrongCode { wanted, received } => {
                let wanted: Vec<_> = wanted.iter().map(ToString::to_string).collect();
                write!(
                    f,
                    "wrong code: {received} instead of {}",
                    wanted.join(" or ")
                )
            }
            Self::Unclean(how) => write!(f, "unclean: {how}"),
            Self::NotJudged | Self::Clean => f.write_str(self.word()),
        }
    }
}
