//! The timeouts after which a client requests a new snapshot.

use crate::time::Span;

/// The pause between two requests for a snapshot, unless the stream converged meanwhile. It doubles, so that snapshots
/// do not fill a link that is too weak for the scene.
pub(super) const RESYNC_AGAIN: Span = Span::from_millis(1_000);
/// The longest pause between two requests for a snapshot.
pub(super) const RESYNC_MOST: Span = Span::from_millis(16_000);
