//! Queued datagrams: one queue for each address, served in turn.
//!
//! Sends nothing and reads no clock. Each address has its own rate limiter: a busy address delays no other. Each queue
//! is bounded: when it is full, its oldest datagrams are dropped, which newer ones supersede.

use core::net::SocketAddr;
use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use rhumb_transport::PIECE_COST_BYTES;
use tokio::time::Instant;

use super::rate_limiter::{self, RateLimiter};

/// The queues of all addresses.
#[derive(Debug)]
pub(super) struct DatagramQueues {
    datagram_queues: BTreeMap<SocketAddr, AddressQueue>,
    /// The address of each queue, once; the next one to be served is in front.
    turns: VecDeque<SocketAddr>,
    /// Rate of each queue; without one, datagrams leave at once.
    datagrams_per_ms: Option<u32>,
}

/// Queue of one address. It stays as long as its rate limiter has budget in use.
#[derive(Debug)]
struct AddressQueue {
    waiting: VecDeque<Bytes>,
    waiting_bytes: usize,
    rate_limiter: Option<RateLimiter>,
}

/// Result of appending a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PushOutcome {
    /// True if the queue was empty.
    pub(super) is_first: bool,
    /// The number of older datagrams of the address that were dropped.
    pub(super) dropped: usize,
}

/// The next step of the sender.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum NextDatagram {
    /// Send this datagram.
    Datagram(SocketAddr, Bytes),
    /// Datagrams are queued, and none may leave before this moment.
    NotBefore(Instant),
    Nothing,
}

/// Queued bytes of one address, at most: more than a frame of ten thousand bodies.
const QUEUE_BYTES_MAX: usize = 2 << 20;

impl DatagramQueues {
    pub(super) const fn new(datagrams_per_ms: Option<u32>) -> Self {
        Self {
            datagram_queues: BTreeMap::new(),
            turns: VecDeque::new(),
            datagrams_per_ms,
        }
    }

    /// Appends a datagram to the queue of its address.
    pub(super) fn push(&mut self, to: SocketAddr, bytes: Bytes) -> PushOutcome {
        let address_queue = self.datagram_queues.entry(to).or_insert_with(|| {
            self.turns.push_back(to);
            AddressQueue {
                waiting: VecDeque::new(),
                waiting_bytes: 0,
                rate_limiter: self.datagrams_per_ms.map(rate_limiter::of_datagrams),
            }
        });
        let is_first = address_queue.waiting.is_empty();
        let dropped = address_queue.push(bytes);
        PushOutcome { is_first, dropped }
    }

    /// Takes the next datagram that may leave now.
    pub(super) fn take(&mut self, now: Instant) -> NextDatagram {
        let mut soonest: Option<Instant> = None;
        for _ in 0..self.turns.len() {
            let Some(to) = self.turns.pop_front() else {
                break;
            };
            let Some(address_queue) = self.datagram_queues.get_mut(&to) else {
                continue;
            };
            if address_queue.is_over(now) {
                self.datagram_queues.remove(&to);
                continue;
            }
            self.turns.push_back(to);
            match address_queue.take(now) {
                Ok(Some(bytes)) => return NextDatagram::Datagram(to, bytes),
                Ok(None) => {}
                Err(at) => soonest = Some(soonest.map_or(at, |soonest| soonest.min(at))),
            }
        }
        soonest.map_or(NextDatagram::Nothing, NextDatagram::NotBefore)
    }
}

impl AddressQueue {
    /// Appends a datagram, and returns how many were dropped for it.
    fn push(&mut self, bytes: Bytes) -> usize {
        self.waiting_bytes += cost(&bytes);
        let mut dropped = 0;
        while self.waiting_bytes > QUEUE_BYTES_MAX
            && let Some(oldest) = self.waiting.pop_front()
        {
            self.waiting_bytes -= cost(&oldest);
            dropped += 1;
        }
        self.waiting.push_back(bytes);
        dropped
    }

    /// The oldest datagram, if one is queued, or the moment from which on it may leave.
    fn take(&mut self, now: Instant) -> Result<Option<Bytes>, Instant> {
        if self.waiting.is_empty() {
            return Ok(None);
        }
        if let Some(rate_limiter) = &mut self.rate_limiter {
            rate_limiter.try_spend(now, 1)?;
        }
        let oldest = self.waiting.pop_front();
        self.waiting_bytes -= oldest.as_ref().map_or(0, cost);
        Ok(oldest)
    }

    /// True if the queue can be removed: it is empty and its rate limiter idle.
    fn is_over(&self, now: Instant) -> bool {
        self.waiting.is_empty()
            && self
                .rate_limiter
                .as_ref()
                .is_none_or(|rate_limiter| rate_limiter.is_over(now))
    }
}

fn cost(bytes: &Bytes) -> usize {
    bytes.len() + PIECE_COST_BYTES
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn address(port: u16) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], port))
    }

    fn datagram(number: usize) -> Bytes {
        Bytes::copy_from_slice(&number.to_be_bytes())
    }

    #[test]
    fn queues_take_turns() {
        let mut datagram_queues = DatagramQueues::new(None);
        for number in 0..100 {
            datagram_queues.push(address(1), datagram(number));
        }
        datagram_queues.push(address(2), datagram(0));
        datagram_queues.push(address(3), datagram(0));
        let now = Instant::now();
        let first: Vec<_> = (0..4).map(|_| datagram_queues.take(now)).collect();
        let of = |port, number| NextDatagram::Datagram(address(port), datagram(number));
        assert_eq!(first, [of(1, 0), of(2, 0), of(3, 0), of(1, 1)]);
    }

    #[test]
    fn a_full_queue_drops_its_own_oldest() {
        let mut datagram_queues = DatagramQueues::new(Some(1));
        datagram_queues.push(address(2), datagram(7));
        let fit = QUEUE_BYTES_MAX / cost(&datagram(0));
        let outcome = (0..fit + 3).map(|number| datagram_queues.push(address(1), datagram(number)));
        assert_eq!(outcome.map(|outcome| outcome.dropped).sum::<usize>(), 3);
        let now = Instant::now();
        assert_eq!(
            datagram_queues.take(now),
            NextDatagram::Datagram(address(2), datagram(7))
        );
        assert_eq!(
            datagram_queues.take(now),
            NextDatagram::Datagram(address(1), datagram(3))
        );
    }

    #[test]
    fn an_idle_address_is_forgotten() {
        let mut datagram_queues = DatagramQueues::new(Some(1));
        let now = Instant::now();
        let outcome = datagram_queues.push(address(1), datagram(0));
        assert!(outcome.is_first);
        assert_eq!(
            datagram_queues.take(now),
            NextDatagram::Datagram(address(1), datagram(0))
        );
        assert_eq!(datagram_queues.take(now), NextDatagram::Nothing);
        assert!(datagram_queues.push(address(1), datagram(1)).is_first);
        let later = now + Duration::from_millis(1);
        assert_eq!(datagram_queues.take(now), NextDatagram::NotBefore(later));
        assert_eq!(
            datagram_queues.take(later),
            NextDatagram::Datagram(address(1), datagram(1))
        );
        let latest = later + Duration::from_millis(1);
        assert_eq!(datagram_queues.take(latest), NextDatagram::Nothing);
        assert!(datagram_queues.datagram_queues.is_empty() && datagram_queues.turns.is_empty());
    }
}
