//! Datagrams to APP clients: a queue for each address, sent at its pace.
//!
//! Sending never blocks. One task takes each datagram when it may leave. Datagrams that did not leave are logged once
//! a second.
//!
//! The queues send nothing and read no clock. A busy address delays no other. A datagram takes the place of an older
//! one about the same subject, so that a queue holds one for each subject, and a subject keeps its turn. Each queue is
//! bounded: a full one drops the datagram that would leave last, which is about the subject that was sent most
//! recently. Of datagrams without a subject it drops the oldest.
//!
//! The published client takes datagrams out of its socket every 10 ms, and its buffer holds 277 of them; those that
//! come when it is full are lost. A pace lets a burst leave at once, so that a late timer costs nothing, and then one
//! datagram in each interval.

use core::net::SocketAddr;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use bytes::Bytes;
use rhumb_link::PIECE_COST_BYTES;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until};

use crate::send_queue::{AppDatagram, CoalescingKey, DatagramPace, Urgency};

/// The queues between the two threads.
#[derive(Debug)]
pub(super) struct DatagramSender {
    queues: Mutex<CountedQueues>,
    /// Signals a datagram for an address whose queue was empty.
    news: Notify,
}

/// The queues, and what did not leave them.
#[derive(Debug)]
struct CountedQueues {
    datagram_queues: DatagramQueues,
    unsent: Unsent,
}

/// Datagrams that were not sent, since the last line of the log.
#[derive(Debug, Default, PartialEq, Eq)]
struct Unsent {
    /// Datagrams that a newer one replaced.
    replaced: u64,
    /// Datagrams that a full queue dropped.
    dropped: u64,
    /// The moment of the last line.
    logged: Option<Instant>,
}

/// Least time between two lines of the log.
const LOG_PERIOD: Duration = Duration::from_secs(1);

impl DatagramSender {
    /// `datagrams_per_ms`: pace to each address; `None` for no limit.
    pub(super) fn new(datagrams_per_ms: Option<u32>) -> Self {
        let queues = CountedQueues {
            datagram_queues: DatagramQueues::new(datagrams_per_ms),
            unsent: Unsent::default(),
        };
        Self {
            queues: Mutex::new(queues),
            news: Notify::new(),
        }
    }

    /// Queues a datagram.
    pub(super) fn send(&self, datagram: AppDatagram) {
        let (outcome, line) = {
            let mut queues = self.lock();
            let outcome = queues.datagram_queues.push(datagram);
            (outcome, queues.unsent.add(&outcome, Instant::now()))
        };
        if let Some((replaced, dropped)) = line {
            tracing::debug!(
                replaced,
                dropped,
                "datagrams were not sent: app clients take in fewer than there are"
            );
        }
        // The writing task already knows of a queue that was not empty.
        if outcome.is_first {
            self.news.notify_one();
        }
    }

    /// Waits for the next datagram that may leave, and takes it.
    pub(super) async fn next(&self) -> (SocketAddr, Bytes) {
        loop {
            let next = self.lock().datagram_queues.take(Instant::now());
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

    fn lock(&self) -> MutexGuard<'_, CountedQueues> {
        self.queues
            .lock()
            .expect("nothing panics while the queues are locked")
    }
}

impl Unsent {
    /// Counts an outcome; returns what the log is to say now, if anything: replaced and dropped datagrams.
    fn add(&mut self, outcome: &PushOutcome, now: Instant) -> Option<(u64, u64)> {
        self.replaced += u64::from(outcome.is_newer);
        self.dropped += outcome.dropped;
        let is_due = self.logged.is_none_or(|logged| now >= logged + LOG_PERIOD);
        if !is_due || (self.replaced, self.dropped) == (0, 0) {
            return None;
        }
        let counted = (self.replaced, self.dropped);
        *self = Self {
            logged: Some(now),
            ..Self::default()
        };
        Some(counted)
    }
}

/// The queues of all addresses.
#[derive(Debug)]
struct DatagramQueues {
    datagram_queues: BTreeMap<SocketAddr, AddressQueue>,
    /// The address of each queue, once; the next one to be served is in front.
    turns: VecDeque<SocketAddr>,
    /// Pace of each queue; without one, datagrams leave at once.
    datagrams_per_ms: Option<u32>,
}

/// Queue of one address. It stays as long as its pace is in use.
#[derive(Debug)]
struct AddressQueue {
    waiting: BTreeMap<Place, (Option<CoalescingKey>, Bytes)>,
    /// Place of each subject that waits.
    places: BTreeMap<CoalescingKey, Place>,
    last_sent: LastSent,
    /// Number of events so far, the clock of this queue.
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
    by_subject: BTreeMap<CoalescingKey, u64>,
    by_count: BTreeMap<u64, CoalescingKey>,
}

/// Subjects whose last datagram is remembered, at most. One beyond them counts as never sent, which puts it first.
const LAST_SENT_MAX: usize = 16_384;

impl LastSent {
    /// Zero for a subject that was not sent lately.
    fn of(&self, subject: CoalescingKey) -> u64 {
        self.by_subject.get(&subject).copied().unwrap_or(0)
    }

    fn note(&mut self, subject: CoalescingKey, count: u64) {
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
struct PushOutcome {
    /// True if the queue was empty.
    is_first: bool,
    /// True if an older datagram about the subject was replaced.
    is_newer: bool,
    /// The number of datagrams of the address that were dropped, this one included.
    dropped: u64,
}

/// The next step of the sender.
#[derive(Clone, Debug, PartialEq, Eq)]
enum NextDatagram {
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
    mod datagram_sender {
        use std::collections::{BTreeMap, VecDeque};
        use std::sync::Arc;

        use super::super::*;
        use crate::send_queue::{CoalescingKey, Urgency};

        fn address(port: u16) -> SocketAddr {
            SocketAddr::from(([127, 0, 0, 1], port))
        }

        fn datagram(port: u16) -> AppDatagram {
            AppDatagram {
                to: address(port),
                bytes: Bytes::from_static(b"state"),
                subject: None,
                urgency: Urgency::Moving,
            }
        }

        /// The state of an actor in a frame.
        fn state(actor: u32, frame: u32, urgency: Urgency) -> AppDatagram {
            let bytes = [actor.to_be_bytes(), frame.to_be_bytes()].concat();
            AppDatagram {
                bytes: Bytes::from(bytes),
                subject: Some(CoalescingKey::Actor(actor)),
                urgency,
                ..datagram(1)
            }
        }

        #[tokio::test(start_paused = true)]
        async fn each_address_has_its_own_pace() {
            let datagram_sender = DatagramSender::new(Some(10));
            for port in [1, 2, 3] {
                (0..100).for_each(|_| datagram_sender.send(datagram(port)));
            }
            let begun = Instant::now();
            let mut moments = Vec::new();
            for _ in 0..300 {
                datagram_sender.next().await;
                moments.push(begun.elapsed().as_millis());
            }
            // A burst of three milliseconds' datagrams, then ten in each.
            let in_millisecond = |at| moments.iter().filter(|moment| **moment == at).count();
            assert_eq!(in_millisecond(0), 90);
            for at in 1..8 {
                assert_eq!(in_millisecond(at), 30, "in millisecond {at}");
            }
        }

        #[tokio::test(start_paused = true)]
        async fn a_busy_address_delays_no_other() {
            let datagram_sender = Arc::new(DatagramSender::new(Some(10)));
            (0..10_000).for_each(|_| datagram_sender.send(datagram(1)));
            let begun = Instant::now();
            // The first address has had its burst, and the task waits.
            for _ in 0..30 {
                datagram_sender.next().await;
            }
            let waits = tokio::spawn({
                let datagram_sender = Arc::clone(&datagram_sender);
                async move { datagram_sender.next().await }
            });
            tokio::task::yield_now().await;
            datagram_sender.send(datagram(2));
            let (to, _) = waits.await.expect("it does not panic");
            assert_eq!((to, begun.elapsed().as_millis()), (address(2), 0));
            // Nothing of the first address was dropped.
            for _ in 30..10_000 {
                assert_eq!(datagram_sender.next().await.0, address(1));
            }
            assert_eq!(begun.elapsed().as_millis(), 997);
        }

        /// A client that empties its buffer in each poll, as the published one does, and loses what does not fit.
        struct Polling {
            buffer: VecDeque<Bytes>,
            lost: usize,
            /// The newest frame of each actor, and how many of its states were read.
            read: BTreeMap<u32, (u32, usize)>,
        }

        /// Datagrams that the client's buffer holds.
        const BUFFER: usize = 277;
        /// Time between two polls of the client.
        const POLL: Duration = Duration::from_millis(10);
        /// Duration of a frame of the client.
        const FRAME: Duration = Duration::from_millis(89);

        impl Polling {
            fn receive(&mut self, bytes: Bytes) {
                match self.buffer.len() < BUFFER {
                    true => self.buffer.push_back(bytes),
                    false => self.lost += 1,
                }
            }

            fn poll(&mut self) {
                for bytes in self.buffer.drain(..) {
                    let number =
                        |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
                    let (actor, frame) = (number(0), number(4));
                    let known = self.read.entry(actor).or_insert((frame, 0));
                    assert!(known.0 <= frame, "an older state of {actor} came later");
                    *known = (frame, known.1 + 1);
                }
            }
        }

        /// Sends frames of this number of falling balls to a polling client, of which the last thousand rest from frame
        /// 50 on.
        async fn fall(balls: u32, frames: u32) -> Polling {
            let datagram_sender = DatagramSender::new(Some(20));
            let mut client = Polling {
                buffer: VecDeque::new(),
                lost: 0,
                read: BTreeMap::new(),
            };
            let begun = Instant::now();
            let (mut frame, mut polls) = (0, 0);
            // Polls and frames do not begin together.
            let poll_at = |polls: u32| begun + POLL * polls + Duration::from_micros(3_700);
            while frame < frames {
                let (next_frame, next_poll) = (begun + FRAME * frame, poll_at(polls));
                tokio::select! {
                    biased;
                    () = sleep_until(next_poll) => {
                        client.poll();
                        polls += 1;
                    }
                    () = sleep_until(next_frame) => {
                        for actor in 0..balls {
                            let rests = actor >= balls - 1_000 && frame >= 50;
                            match (rests, frame) {
                                (false, _) => datagram_sender.send(state(actor, frame, Urgency::Moving)),
                                (true, 50) => datagram_sender.send(state(actor, frame, Urgency::Resting)),
                                (true, _) => {}
                            }
                        }
                        frame += 1;
                    }
                    (_, bytes) = datagram_sender.next() => client.receive(bytes),
                }
            }
            client.poll();
            client
        }

        #[tokio::test(start_paused = true)]
        async fn a_polling_client_reads_as_many_states_as_its_polls_take_and_loses_none() {
            for balls in [3_000, 5_000] {
                let frames = 80;
                let client = fall(balls, frames).await;
                assert_eq!(client.lost, 0, "{balls} balls");
                let read: usize = client.read.values().map(|(_, count)| count).sum();
                let polls = (FRAME * frames).as_millis() / POLL.as_millis();
                let most = usize::try_from(polls).expect("few polls") * BUFFER;
                // The rest is the margin for late timers and late polls.
                assert!(read * 10 >= most * 7, "{balls} balls: {read} of {most}");
                // Each ball gets its turn: no two differ by more than a state or two while they fall.
                let falling = client
                    .read
                    .iter()
                    .filter(|(actor, _)| **actor < balls - 1_000);
                let counts: Vec<usize> = falling.map(|(_, (_, count))| *count).collect();
                let (least, greatest) = (counts.iter().min(), counts.iter().max());
                let (least, greatest) = least.zip(greatest).expect("balls fall");
                assert!(
                    greatest - least <= 2,
                    "{balls} balls: {least} to {greatest}"
                );
                // Resting states came first, and the newest is what was read last.
                let resting = client
                    .read
                    .iter()
                    .filter(|(actor, _)| **actor >= balls - 1_000);
                assert!(
                    resting
                        .map(|(_, (frame, _))| *frame)
                        .all(|frame| frame == 50)
                );
            }
        }

        #[test]
        fn the_log_has_one_line_a_second_with_all_that_was_not_sent() {
            let mut unsent = Unsent::default();
            let begun = Instant::now();
            let outcome = |is_newer, dropped| PushOutcome {
                is_first: false,
                is_newer,
                dropped,
            };
            assert_eq!(unsent.add(&outcome(false, 0), begun), None);
            assert_eq!(unsent.add(&outcome(true, 0), begun), Some((1, 0)));
            for _ in 0..1_000 {
                assert_eq!(unsent.add(&outcome(true, 2), begun), None);
            }
            let later = begun + LOG_PERIOD;
            assert_eq!(unsent.add(&outcome(false, 0), later), Some((1_000, 2_000)));
            assert_eq!(unsent.add(&outcome(false, 0), later), None);
        }
    }

    mod datagram_queues {
        use std::time::Duration;

        use super::super::*;

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
                subject: Some(CoalescingKey::Actor(actor)),
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
}
