//! The cases of clients, by level: each is played by a server of bytes.

mod l1_session;

use super::case::Case;

/// All of them.
pub(super) fn cases() -> Vec<Case> {
    [l1_session::cases()].into_iter().flatten().collect()
}
