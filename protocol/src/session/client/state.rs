//! The state of a connection as the client knows it.

use crate::session::misuse::Misuse;

/// The state of the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ClientState {
    Unconnected,
    Greeting,
    Lobby,
    Member,
    Ended,
}

impl ClientState {
    /// Refuses a call of the application in any other state.
    pub(super) fn must_be(self, state: Self) -> Result<(), Misuse> {
        if self == state {
            Ok(())
        } else {
            Err(Misuse::NotNow)
        }
    }

    /// True while messages may come.
    pub(super) const fn is_open(self) -> bool {
        !matches!(self, Self::Unconnected | Self::Ended)
    }
}
