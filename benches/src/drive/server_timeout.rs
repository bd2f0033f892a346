//! The longest silence of a server before a run fails.

use std::time::Duration;

/// Longest silence of a server before a run fails. An engine may take over half a minute for the first frame of a
/// hundred thousand bodies. A server that ends is noticed at once, because its connection closes.
pub(super) const SERVER_TIMEOUT: Duration = Duration::from_secs(300);
