//! Bound on a connection's control bytes that wait for the server.

use std::sync::{Arc, Condvar, Mutex, MutexGuard};

use bytes::Bytes;

/// Waiting bytes beyond which a socket is not read.
const WAITING_MAX: usize = 256 << 10;

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
    /// Waits until the bound allows more bytes.
    pub(super) fn admit(self: &Arc<Self>, bytes: Bytes) -> WaitingBytes {
        let waiting = self.lock();
        let over = |waiting: &mut usize| *waiting > WAITING_MAX;
        *self.freed.wait_while(waiting, over).expect(LOCK) += bytes.len();
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
