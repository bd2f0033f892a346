//! Passes datagrams from the server thread to the APP listener's socket.
//!
//! Sending never blocks. One task takes each datagram when it may leave.

use core::net::SocketAddr;
use std::sync::{Mutex, MutexGuard};

use bytes::Bytes;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until};

use super::datagram_queues::{DatagramQueues, NextDatagram};

/// The queues between the two threads.
#[derive(Debug)]
pub(super) struct DatagramSender {
    datagram_queues: Mutex<DatagramQueues>,
    /// Signals a datagram for an address whose queue was empty.
    news: Notify,
}

impl DatagramSender {
    /// `datagrams_per_ms`: rate to each address; `None` for no limit.
    pub(super) fn new(datagrams_per_ms: Option<u32>) -> Self {
        Self {
            datagram_queues: Mutex::new(DatagramQueues::new(datagrams_per_ms)),
            news: Notify::new(),
        }
    }

    /// Queues a datagram.
    pub(super) fn send(&self, to: SocketAddr, bytes: Bytes) {
        let outcome = self.lock().push(to, bytes);
        if outcome.dropped > 0 {
            let dropped = outcome.dropped;
            tracing::debug!(%to, dropped, "datagrams were dropped: too many wait");
        }
        // The writing task already knows of a queue that was not empty.
        if outcome.is_first {
            self.news.notify_one();
        }
    }

    /// Waits for the next datagram that may leave, and takes it.
    pub(super) async fn next(&self) -> (SocketAddr, Bytes) {
        loop {
            let next = self.lock().take(Instant::now());
            match next {
                NextDatagram::Datagram(to, bytes) => return (to, bytes),
                NextDatagram::NotBefore(at) => tokio::select! {
                    () = sleep_until(at) => {}
                    () = self.news.notified() => {}
                },
                NextDatagram::Nothing => self.news.notified().await,
            }
        }
    }

    fn lock(&self) -> MutexGuard<'_, DatagramQueues> {
        self.datagram_queues
            .lock()
            .expect("nothing panics while the queues are locked")
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;

    fn address(port: u16) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], port))
    }

    fn datagram() -> Bytes {
        Bytes::from_static(b"state")
    }

    #[tokio::test(start_paused = true)]
    async fn each_address_has_its_own_rate_limit() {
        let datagram_sender = DatagramSender::new(Some(10));
        for port in [1, 2, 3] {
            (0..100).for_each(|_| datagram_sender.send(address(port), datagram()));
        }
        let begun = Instant::now();
        let mut moments = Vec::new();
        for _ in 0..300 {
            datagram_sender.next().await;
            moments.push(begun.elapsed().as_millis());
        }
        for millisecond in 0..10 {
            let of = moments.iter().filter(|moment| **moment == millisecond);
            assert_eq!(of.count(), 30, "in millisecond {millisecond}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn a_busy_address_delays_no_other() {
        let datagram_sender = Arc::new(DatagramSender::new(Some(10)));
        (0..10_000).for_each(|_| datagram_sender.send(address(1), datagram()));
        let begun = Instant::now();
        // The first address has used its budget, and the task waits.
        for _ in 0..10 {
            datagram_sender.next().await;
        }
        let waits = tokio::spawn({
            let datagram_sender = Arc::clone(&datagram_sender);
            async move { datagram_sender.next().await }
        });
        tokio::task::yield_now().await;
        datagram_sender.send(address(2), datagram());
        let (to, _) = waits.await.expect("it does not panic");
        assert_eq!((to, begun.elapsed().as_millis()), (address(2), 0));
        // Nothing of the first address was dropped.
        for _ in 10..10_000 {
            assert_eq!(datagram_sender.next().await.0, address(1));
        }
        assert_eq!(begun.elapsed().as_millis(), 999);
    }
}
