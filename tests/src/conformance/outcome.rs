//! What came of a case: its behaviour, and apart from that how it closed.
//!
//! Judges nothing by itself; the words are those of reports.

use std::fmt;
use std::time::Duration;

/// What a case's function returns.
pub type CaseResult = Result<(), Stop>;

/// Why a case did not come to its good end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Stop {
    /// The peer broke a promise.
    Fail(String),
    /// The peer does otherwise than a SHOULD asks.
    Lax(String),
    /// The peer says that it does not have what this tries, in the way that the protocol has for it.
    Unsupported(String),
    /// The runner could not try it.
    Inconclusive(String),
}

/// The word for how a case went.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Verdict {
    /// As it must.
    Pass,
    /// As it may, and not as it should.
    Lax,
    /// The peer said that it cannot, and did nothing of it.
    Unsupported,
    /// Nobody knows.
    Inconclusive,
    /// As it must not.
    Fail,
}

/// How the connection closed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Closing {
    /// The case does not close, or does so itself.
    NotJudged,
    /// With the code that the document has for it.
    Clean,
    /// With another one.
    WrongCode {
        /// Those that would have done.
        wanted: Vec<u64>,
        /// The one that came.
        seen: u64,
    },
    /// Without a code.
    Unclean(String),
}

/// What came of a case.
#[derive(Clone, Debug)]
pub struct CaseOutcome {
    /// How it went.
    pub verdict: Verdict,
    /// Why, unless it passed.
    pub why: String,
    /// How it closed.
    pub closing: Closing,
    /// How long it took.
    pub took: Duration,
    /// What was said and heard, unless it passed.
    pub trace: Vec<String>,
}

impl Verdict {
    /// All, from the best to the worst.
    pub const ALL: [Self; 5] = [
        Self::Pass,
        Self::Lax,
        Self::Unsupported,
        Self::Inconclusive,
        Self::Fail,
    ];

    /// The word for it.
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
    /// The word for it.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        match self {
            Self::NotJudged => "",
            Self::Clean => "clean",
            Self::WrongCode { .. } => "wrong code",
            Self::Unclean(_) => "unclean",
        }
    }

    /// Whether it is as it must be.
    #[must_use]
    pub const fn is_good(&self) -> bool {
        matches!(self, Self::NotJudged | Self::Clean)
    }
}

impl CaseOutcome {
    /// Whether nothing is wrong with it; `strict` asks for what should be too.
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
    /// The word for it.
    #[must_use]
    pub const fn verdict(&self) -> Verdict {
        match self {
            Self::Fail(_) => Verdict::Fail,
            Self::Lax(_) => Verdict::Lax,
            Self::Unsupported(_) => Verdict::Unsupported,
            Self::Inconclusive(_) => Verdict::Inconclusive,
        }
    }

    /// What it says.
    #[must_use]
    pub fn why(&self) -> &str {
        match self {
            Self::Fail(why) | Self::Lax(why) | Self::Unsupported(why) | Self::Inconclusive(why) => {
                why
            }
        }
    }

    /// A broken promise.
    pub fn fail<T>(why: impl Into<String>) -> Result<T, Self> {
        Err(Self::Fail(why.into()))
    }
}

/// Passes if the promise, which is said in words, was kept.
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

/// Passes if what SHOULD be is.
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
            Self::WrongCode { wanted, seen } => {
                let wanted: Vec<_> = wanted.iter().map(ToString::to_string).collect();
                write!(f, "wrong code: {seen} and not {}", wanted.join(" or "))
            }
            Self::Unclean(how) => write!(f, "unclean: {how}"),
            Self::NotJudged | Self::Clean => f.write_str(self.word()),
        }
    }
}
