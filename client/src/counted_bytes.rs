//! Bytes of a client that count until its server has used them.
//!
//! Each client counts its own, so that one that floods takes nothing from the others. Invariant: the count is that of the
//! bytes that exist.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use bytes::Bytes;

/// Cost of a waiting input beside its bytes.
const INPUT_COST_BYTES: usize = 64;

fn cost(bytes: &Bytes) -> usize {
    INPUT_COST_BYTES + bytes.len()
}

/// Bytes of a client that count until the server has used them, wherever they wait.
pub(crate) struct CountedBytes {
    bytes: Bytes,
    waiting: Arc<AtomicUsize>,
}

impl CountedBytes {
    /// Counts bytes; `None` if the client has more of them waiting than it may.
    pub(crate) fn within(most: usize, waiting: &Arc<AtomicUsize>, bytes: Bytes) -> Option<Self> {
        if waiting.load(Ordering::Relaxed) + cost(&bytes) > most {
            return None;
        }
        waiting.fetch_add(cost(&bytes), Ordering::Relaxed);
        let waiting = Arc::clone(waiting);
        Some(Self { bytes, waiting })
    }
}

impl AsRef<[u8]> for CountedBytes {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for CountedBytes {
    fn drop(&mut self) {
        self.waiting.fetch_sub(cost(&self.bytes), Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_count_as_long_as_they_exist_up_to_a_bound() {
        let waiting: Arc<AtomicUsize> = Arc::default();
        let count = || waiting.load(Ordering::Relaxed);
        let piece = Bytes::from(vec![0; 100]);
        let most = 2 * cost(&piece);
        let take = || CountedBytes::within(most, &waiting, piece.clone());
        let kept = [take(), take()];
        assert!(take().is_none(), "a third one is beyond the bound");
        assert_eq!(count(), most);
        drop(kept);
        assert_eq!(count(), 0);
        assert!(take().is_some_and(|bytes| bytes.as_ref() == &piece[..]));
    }
}
