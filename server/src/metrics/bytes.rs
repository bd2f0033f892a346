//! Bytes that the members of a scene send and receive.
//!
//! They count what the server hands to the links and takes from them: control streams and datagrams, without the headers
//! of QUIC. A count is an addition to a number; nothing waits.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Bytes of one scene; all clones are one.
#[derive(Clone, Debug, Default)]
pub(crate) struct ByteCounts(Arc<Counts>);

#[derive(Debug, Default)]
struct Counts {
    received: AtomicU64,
    sent: AtomicU64,
}

impl ByteCounts {
    pub(crate) fn add_received(&self, bytes: usize) {
        self.0.received.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    pub(crate) fn add_sent(&self, bytes: usize) {
        self.0.sent.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    pub(super) fn received(&self) -> &AtomicU64 {
        &self.0.received
    }

    pub(super) fn sent(&self) -> &AtomicU64 {
        &self.0.sent
    }
}
