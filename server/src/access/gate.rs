//! Admits connections: by their tokens, or all of them.

use std::fmt;
use std::sync::Arc;

use rhumb_protocol::Span;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;

use super::keys::TokenKeys;
use super::permit::Permit;

/// Seconds since 1970, by the system's clock.
type WallClock = Arc<dyn Fn() -> i64 + Send + Sync>;

/// Decides which connections are admitted.
#[derive(Clone)]
pub(crate) enum Gate {
    /// Every client may do everything.
    Open,
    /// A client may do what its token says.
    Tokens { keys: TokenKeys, clock: WallClock },
}

/// The admission of one connection.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Admission {
    pub(crate) permit: Arc<Permit>,
    /// For how long; `None` without an end.
    pub(crate) valid_for: Option<Span>,
}

/// Longest validity that a timer holds: a hundred years.
const SECONDS_MAX: u64 = 100 * 366 * 86_400;

impl Gate {
    /// Admits a connection to a scene, or names the reason to close it.
    pub(crate) fn admit(
        &self,
        token: Option<&[u8]>,
        scene: &SceneName,
    ) -> Result<Admission, CloseCode> {
        let Self::Tokens { keys, clock } = self else {
            return Ok(Admission {
                permit: Arc::new(Permit::OPEN),
                valid_for: None,
            });
        };
        let token = token.ok_or(CloseCode::TOKEN_MISSING)?;
        let claims = keys.verify(token).ok_or(CloseCode::TOKEN_INVALID)?;
        let (permit, seconds) = claims.permit(&keys.audience, scene, clock())?;
        Ok(Admission {
            permit: Arc::new(permit),
            valid_for: Some(Span::from_millis(seconds.min(SECONDS_MAX) * 1_000)),
        })
    }
}

impl fmt::Debug for Gate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Open => "Gate::Open",
            Self::Tokens { .. } => "Gate::Tokens",
        })
    }
}
