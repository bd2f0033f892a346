//! Waiting datagrams: one queue for each address, served in turn.
//!
//! Sends nothing and reads no clock. Each address has its own pace: a busy address delays no other. A datagram takes the
//! place of an older one about the same subject, so that a queue holds one for each subject, and a subject keeps its turn.
//! Each queue is bounded: a full one drops what would leave last, which is about the subject that was sent most recently.
//! Of datagrams without a subject it drops the oldest.

use core::net::SocketAddr;
use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use rhumb_transport::PIECE_COST_BYTES;
use tokio::time::Instant;

use super::datagram_pace::DatagramPace;
use crate::server::{AppDatagram, DatagramSubject, Urgency};

/// The queues of all addresses.
#[derive(Debug)]
pub(super) struct DatagramQueues {
    datagram_queues: BTreeMap<SocketAddr, AddressQueue>,
    /// The address of each queue, once; the next one to be served is in front.
    turns: VecDeque<SocketAddr>,
    /// Pace of each queue; without one, datagrams leave at once.
    datagrams_per_ms: Option<u32>,
}

/// Queue of one address. It stays as long as its pace is in use.
#[derive(Debug)]
struct AddressQueue {
    waiting: BTreeMap<Place, (Option<DatagramSubject>, Bytes)>,
    /// Place of each subject that waits.
    places: BTreeMap<DatagramSubject, Place>,
    last_sent: LastSent,
    /// Counts what happens, as a clock of this queue.
    count: u64,
    waiting_bytes: usize,
    pace: Option<DatagramPace>,
}

/// Place in a queue: resting actors first, then what was sent longest ago, then by time. So each subject has its turn,
/// although a frame names all of them in one order.
type Place = (Urgency, u64, u64);

/// The counts at which subjects were last sent.
#[derive(Debug, Default)]
struct LastSent {
    by_subject: BTreeMap<DatagramSubject, u64>,
    by_count: BTreeMap<u64, DatagramSubject>,
}

/// Subjects whose last datagram is remembered, at most. One beyond them counts as never sent, which puts it first.
const LAST_SENT_MAX: usize = 16_384;

impl LastSent {
    /// Zero for a subject that was not sent lately.
    fn of(&self, subject: DatagramSubject) -> u64 {
        self.by_subject.get(&subject).copied().unwrap_or(0)
    }

    fn note(&mut self, subject: DatagramSubject, count: u64) {
        if let Some(earlier) = self.by_subject.insert(subject, count) {
            self.by_count.remove(&earlier);
        }
        self.by_count.insert(count, subject);
        if self.by_count.len() > LAST_SENT_MAX
            && let Some((_, oldest)) = self.by_count.pop_first()
        {
            self.by_subject.remove(&oldest);
        }
    }
}

/// Result of appending a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PushOutcome {
    /// True if the queue was empty.
    pub(super) is_first: bool,
    /// True if an older datagram about the subject was replaced.
    pub(super) is_newer: bool,
    /// The number of datagrams of the address that were dropped, this one included.
    pub(super) dropped: u64,
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

/// Queued bytes of one address, at most: more than the states of ten thousand bodies.
const QUEUE_BYTES_MAX: usize = 2 << 20;

impl DatagramQueues {
    pub(super) const fn new(datagrams_per_ms: Option<u32>) -> Self {
        Self {
            datagram_queues: BTreeMap::new(),
            turns: VecDeque::new(),
            datagrams_per_ms,
        }
    }

    /// Appends a datagram to the queue of its address, or puts it in the place of an older one.
    pub(super) fn push(&mut self, datagram: AppDatagram) -> PushOutcome {
        let to = datagram.to;
        let address_queue = self.datagram_queues.entry(to).or_insert_with(|| {
            self.turns.push_back(to);
            AddressQueue {
                waiting: BTreeMap::new(),
                places: BTreeMap::new(),
                last_sent: LastSent::default(),
                count: 0,
                waiting_bytes: 0,
                pace: self.datagrams_per_ms.map(DatagramPace::new),
            }
        });
        address_queue.push(datagram)
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
    fn push(&mut self, datagram: AppDatagram) -> PushOutcome {
        let is_first = self.waiting.is_empty();
        // Without a pace, all leave in their order: nothing waits for long.
        let (subject, urgency) = match self.pace {
            Some(_) => (datagram.subject, datagram.urgency),
            None => (None, Urgency::default()),
        };
        // A replaced datagram leaves its place to the newer one, unless that is more urgent.
        let old = subject.and_then(|subject| self.places.get(&subject).copied());
        self.count += 1;
        let sent = subject.map_or(self.count, |subject| self.last_sent.of(subject));
        let next = (urgency, sent, self.count);
        let place = old.map_or(next, |old| old.min(next));
        if let Some(old) = old {
            self.remove(old);
        }
        self.waiting_bytes += cost(&datagram.bytes);
        self.waiting.insert(place, (subject, datagram.bytes));
        if let Some(subject) = subject {
            self.places.insert(subject, place);
        }
        PushOutcome {
            is_first,
            is_newer: old.is_some(),
            dropped: self.drop_beyond_bound(),
        }
    }

    /// Drops datagrams beyond the bound, those first that would leave last; returns their number.
    fn drop_beyond_bound(&mut self) -> u64 {
        let mut dropped = 0;
        while self.waiting_bytes > QUEUE_BYTES_MAX {
            let Some((last, (subject, _))) = self.waiting.last_key_value() else {
                break;
            };
            // The subject has its turn later. Without one, later datagrams tell more than earlier ones.
            let place = match subject {
                Some(_) => *last,
                None => self.oldest_without_subject().unwrap_or(*last),
            };
            self.remove(place);
            dropped += 1;
        }
        dropped
    }

    /// The place of the oldest datagram without a subject.
    fn oldest_without_subject(&self) -> Option<Place> {
        let mut waiting = self.waiting.iter();
        let oldest = waiting.find(|(_, (subject, _))| subject.is_none());
        oldest.map(|(place, _)| *place)
    }

    fn remove(&mut self, place: Place) -> Option<Bytes> {
        let (subject, bytes) = self.waiting.remove(&place)?;
        if let Some(subject) = subject {
            self.places.remove(&subject);
        }
        self.waiting_bytes -= cost(&bytes);
        Some(bytes)
    }

    /// The first datagram, if one is queued, or the moment from which on it may leave.
    fn take(&mut self, now: Instant) -> Result<Option<Bytes>, Instant> {
        let Some((place, _)) = self.waiting.first_key_value() else {
            return Ok(None);
        };
        let place = *place;
        if let Some(pace) = &mut self.pace {
            pace.try_pass(now)?;
        }
        if let Some((Some(subject), _)) = self.waiting.get(&place) {
            self.count += 1;
            self.last_sent.note(*subject, self.count);
        }
        Ok(self.remove(place))
    }

    /// True if the queue can be removed: it is empty and its pace as new.
    fn is_over(&self, now: Instant) -> bool {
        let pace = self.pace.as_ref();
        self.waiting.is_empty() && pace.is_none_or(|pace| pace.is_over(now))
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

    fn bytes(number: usize) -> Bytes {
        Bytes::copy_from_slice(&number.to_be_bytes())
    }

    fn plain(port: u16, number: usize) -> AppDatagram {
        AppDatagram {
            to: address(port),
            bytes: bytes(number),
            subject: None,
            urgency: Urgency::Moving,
        }
    }

    fn about(actor: u32, urgency: Urgency, number: usize) -> AppDatagram {
        AppDatagram {
            subject: Some(DatagramSubject::Actor(actor)),
            urgency,
            ..plain(1, number)
        }
    }

    /// A state of which seven fit into a queue: it costs more than an eighth of the bound.
    fn large(actor: u8) -> AppDatagram {
        AppDatagram {
            bytes: Bytes::from(vec![actor; QUEUE_BYTES_MAX / 8]),
            ..about(actor.into(), Urgency::Moving, 0)
        }
    }

    fn sent(datagram_queues: &mut DatagramQueues, now: Instant) -> Vec<Bytes> {
        let next = std::iter::from_fn(|| match datagram_queues.take(now) {
            NextDatagram::Datagram(_, bytes) => Some(bytes),
            NextDatagram::NotBefore(_) | NextDatagram::Nothing => None,
        });
        next.collect()
    }

    #[test]
    fn queues_take_turns() {
        let mut datagram_queues = DatagramQueues::new(None);
        for number in 0..100 {
            datagram_queues.push(plain(1, number));
        }
        datagram_queues.push(plain(2, 0));
        datagram_queues.push(plain(3, 0));
        let now = Instant::now();
        let first: Vec<_> = (0..4).map(|_| datagram_queues.take(now)).collect();
        let of = |port, number| NextDatagram::Datagram(address(port), bytes(number));
        assert_eq!(first, [of(1, 0), of(2, 0), of(3, 0), of(1, 1)]);
    }

    #[test]
    fn a_newer_state_takes_the_place_of_the_one_that_waits() {
        let mut datagram_queues = DatagramQueues::new(Some(1_000));
        let moving = |actor, number| about(actor, Urgency::Moving, number);
        for (actor, number) in [(1, 10), (2, 20), (3, 30)] {
            assert!(!datagram_queues.push(moving(actor, number)).is_newer);
        }
        for (actor, number) in [(3, 31), (1, 11), (1, 12)] {
            assert!(datagram_queues.push(moving(actor, number)).is_newer);
        }
        let expected = [12, 20, 31].map(bytes);
        assert_eq!(sent(&mut datagram_queues, Instant::now()), expected);
        // Nothing of it is left, so the next state is a new one.
        assert!(!datagram_queues.push(moving(1, 13)).is_newer);
    }

    #[test]
    fn resting_actors_come_first_and_no_older_state_follows() {
        let mut datagram_queues = DatagramQueues::new(Some(1_000));
        for actor in 1..=3 {
            datagram_queues.push(about(actor, Urgency::Moving, actor as usize));
        }
        datagram_queues.push(about(3, Urgency::Resting, 33));
        datagram_queues.push(about(2, Urgency::Resting, 22));
        // An actor that wakes keeps the better place.
        datagram_queues.push(about(2, Urgency::Moving, 23));
        let expected = [33, 23, 1].map(bytes);
        assert_eq!(sent(&mut datagram_queues, Instant::now()), expected);
    }

    #[test]
    fn without_a_pace_every_state_leaves_in_its_order() {
        let mut datagram_queues = DatagramQueues::new(None);
        for (number, urgency) in [
            (1, Urgency::Moving),
            (2, Urgency::Resting),
            (3, Urgency::Moving),
        ] {
            datagram_queues.push(about(1, urgency, number));
        }
        let expected = [1, 2, 3].map(bytes);
        assert_eq!(sent(&mut datagram_queues, Instant::now()), expected);
    }

    #[test]
    fn a_full_queue_drops_its_own_oldest_and_keeps_resting_actors() {
        let mut datagram_queues = DatagramQueues::new(Some(1_000));
        datagram_queues.push(plain(2, 7));
        datagram_queues.push(about(9, Urgency::Resting, 99));
        let fit = QUEUE_BYTES_MAX / cost(&bytes(0)) - 1;
        let dropped = (0..fit + 3).map(|number| datagram_queues.push(plain(1, number)).dropped);
        assert_eq!(dropped.sum::<u64>(), 3);
        let now = Instant::now();
        let next: Vec<_> = (0..3).map(|_| datagram_queues.take(now)).collect();
        let of = |port, number| NextDatagram::Datagram(address(port), bytes(number));
        assert_eq!(next, [of(2, 7), of(1, 99), of(1, 3)]);
    }

    #[test]
    fn each_of_more_actors_than_fit_has_its_turn() {
        let mut datagram_queues = DatagramQueues::new(Some(1_000));
        let now = Instant::now();
        let (mut dropped, mut left) = (0, Vec::new());
        for _ in 0..12 {
            for actor in 0..8 {
                dropped += datagram_queues.push(large(actor)).dropped;
            }
            for _ in 0..2 {
                if let NextDatagram::Datagram(_, bytes) = datagram_queues.take(now) {
                    left.push(bytes[0]);
                }
            }
        }
        assert_eq!(dropped, 12, "one in each frame");
        assert_eq!(left, [0, 1, 2, 3, 4, 5, 6, 7].repeat(3));
    }

    #[test]
    fn a_new_actor_leaves_a_full_queue_before_those_that_were_sent() {
        let mut datagram_queues = DatagramQueues::new(Some(1_000));
        let now = Instant::now();
        let actors = |left: Vec<Bytes>| left.iter().map(|bytes| bytes[0]).collect::<Vec<_>>();
        (0..7).for_each(|actor| assert_eq!(datagram_queues.push(large(actor)).dropped, 0));
        assert_eq!(
            actors(sent(&mut datagram_queues, now)),
            [0, 1, 2, 3, 4, 5, 6]
        );
        (0..7).for_each(|actor| assert_eq!(datagram_queues.push(large(actor)).dropped, 0));
        assert_eq!(datagram_queues.push(large(7)).dropped, 1);
        assert_eq!(
            actors(sent(&mut datagram_queues, now)),
            [7, 0, 1, 2, 3, 4, 5]
        );
    }

    #[test]
    fn an_idle_address_is_forgotten() {
        let mut datagram_queues = DatagramQueues::new(Some(1));
        let now = Instant::now();
        assert!(datagram_queues.push(plain(1, 0)).is_first);
        assert_eq!(sent(&mut datagram_queues, now), [bytes(0)]);
        assert!(!datagram_queues.datagram_queues.is_empty());
        let later = now + Duration::from_millis(1);
        assert_eq!(datagram_queues.take(later), NextDatagram::Nothing);
        assert!(datagram_queues.datagram_queues.is_empty() && datagram_queues.turns.is_empty());
    }
}
