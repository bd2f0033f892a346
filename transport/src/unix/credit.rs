//! Bound on a connection's control bytes that wait for the server.

use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;

use bytes::Bytes;

/// Waiting bytes beyond which a socket is not read.
const WAITING_MAX: usize = 256 << 10;
/// Interval of the checks whether a connection that is not read has ended.
const END_CHECK: Duration = Duration::from_millis(100);

/// The waiting bytes of one connection.
#[derive(Debug, Default)]
pub(super) struct Credit {
    waiting: Mutex<usize>,
    freed: Condvar,
}

/// Waiting bytes, which hold their share of the bound until they are dropped.
#[derive(Debug)]
pub(super) struct WaitingBytes {
    bytes: Bytes,
    credit: Arc<Credit>,
}

impl Credit {
    /// Waits until the bound allows more bytes, or until their connection has ended.
    ///
    /// The server holds bytes back until it learns of the end, which comes after the last of them. What has arrived
    /// before the end is what a socket's buffer takes at most, and needs no other bound.
    pub(super) fn admit(
        self: &Arc<Self>,
        bytes: Bytes,
        has_ended: impl Fn() -> bool,
    ) -> WaitingBytes {
        let mut waiting = self.lock();
        while *waiting > WAITING_MAX && !has_ended() {
            (waiting, _) = self.freed.wait_timeout(waiting, END_CHECK).expect(LOCK);
        }
        *waiting += bytes.len();
        let credit = Arc::clone(self);
        WaitingBytes { bytes, credit }
    }

    fn lock(&self) -> MutexGuard<'_, usize> {
        self.waiting.lock().expect(LOCK)
    }
}

impl AsRef<[u8]> for WaitingBytes {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for WaitingBytes {
    fn drop(&mut self) {
        *self.credit.lock() -= self.bytes.len();
        self.credit.freed.notify_one();
    }
}

const LOCK: &str = "nothing panics while a number is locked";
