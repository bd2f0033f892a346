//! Passes datagrams from the server thread to the APP listener's socket.
//!
//! Sending never blocks. One task takes each datagram when it may leave. What did not leave is logged once a second.

use core::net::SocketAddr;
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use bytes::Bytes;
use tokio::sync::Notify;
use tokio::time::{Instant, sleep_until};

use super::datagram_queues::{DatagramQueues, NextDatagram, PushOutcome};
use crate::server::AppDatagram;

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
    /// Those in whose place a newer one was sent.
    replaced: u64,
    /// Those for which the queue was full.
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

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, VecDeque};
    use std::sync::Arc;

    use super::*;
    use crate::server::{DatagramSubject, Urgency};

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
            subject: Some(DatagramSubject::Actor(actor)),
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
                let number = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
                let (actor, frame) = (number(0), number(4));
                let known = self.read.entry(actor).or_insert((frame, 0));
                assert!(known.0 <= frame, "an older state of {actor} came later");
                *known = (frame, known.1 + 1);
            }
        }
    }

    /// Sends frames of so many falling balls to a polling client, of which the last thousand rest from frame 50 on.
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
