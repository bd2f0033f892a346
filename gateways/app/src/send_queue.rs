//! Queued messages to one APP client, cut for its reader; subjects, and paces.
//!
//! The published plug-in loses messages that its own read cuts, and reads 64 KiB every 30 ms. Bytes for TCP leave in
//! pieces of whole messages that fit a segment. A datagram has one message, unless a measurement packs them. A newer
//! datagram replaces a waiting one about the same subject.
//!
//! Bytes of a connection have a budget for each span of time; datagrams to an address leave one
//! in each interval, after a burst that makes a late timer cost nothing.

use core::net::SocketAddr;
use std::collections::VecDeque;
use std::time::Duration;

use bytes::Bytes;
use tokio::time::{Instant, sleep_until};

use crate::gateway::Datagrams;
use crate::message::Message;

/// Queued messages of one client.
#[derive(Debug, Default)]
pub(super) struct SendQueue {
    /// Counter of messages, as the protocol has it: sixteen bits in the upper half of the index.
    counter: u16,
    piece: Vec<u8>,
    pieces: VecDeque<Bytes>,
    pieces_bytes: usize,
    /// Last reported count of bytes in the connection's queue.
    connection_bytes: usize,
    datagram: Vec<u8>,
    datagrams: VecDeque<AppDatagram>,
}

/// Bytes of a piece: fits a segment of an Ethernet.
const PIECE_BYTES_MAX: usize = 1_400;
/// Bytes of a packed datagram: fits a packet of an Ethernet.
const DATAGRAM_BYTES_MAX: usize = 1_472;
/// Queued bytes for TCP, here and in the connection, beyond which no supersedable message is added: a seventh of a
/// second at the connection's rate.
const PASSING_WAIT_MAX: usize = 64 << 10;

impl SendQueue {
    fn index(&mut self) -> u32 {
        let index = u32::from(self.counter) << 16;
        self.counter = self.counter.wrapping_add(1);
        index
    }

    /// Takes the count of bytes in the connection's queue.
    pub(super) const fn note_connection_bytes(&mut self, bytes: usize) {
        self.connection_bytes = bytes;
    }

    /// Bytes of supersedable messages that TCP still takes.
    pub(super) fn capacity(&self) -> usize {
        let waiting = self.connection_bytes + self.pieces_bytes + self.piece.len();
        PASSING_WAIT_MAX.saturating_sub(waiting)
    }

    /// Queues a message that must arrive, in order.
    pub(super) fn lasting(&mut self, message: &Message) {
        let start = self.piece.len();
        let index = self.index();
        message.encode(index, &mut self.piece);
        if self.piece.len() > PIECE_BYTES_MAX && start > 0 {
            let last = self.piece.split_off(start);
            self.close_piece();
            self.piece = last;
        }
    }

    /// Queues a message that newer ones supersede.
    pub(super) fn passing(
        &mut self,
        message: &Message,
        to: Option<SocketAddr>,
        datagrams: Datagrams,
    ) {
        let Some(to) = to else {
            if self.capacity() > 0 {
                self.lasting(message);
            }
            return;
        };
        let start = self.datagram.len();
        let index = self.index();
        message.encode(index, &mut self.datagram);
        match datagrams {
            Datagrams::Single => {
                self.close_datagram(to, CoalescingKey::of(message), Urgency::of(message));
            }
            Datagrams::Packed if self.datagram.len() > DATAGRAM_BYTES_MAX && start > 0 => {
                let last = self.datagram.split_off(start);
                self.close_datagram(to, None, Urgency::Moving);
                self.datagram = last;
            }
            Datagrams::Packed => {}
        }
    }

    fn close_piece(&mut self) {
        if !self.piece.is_empty() {
            let piece = Bytes::from(std::mem::take(&mut self.piece));
            self.pieces_bytes += piece.len();
            self.pieces.push_back(piece);
        }
    }

    fn close_datagram(&mut self, to: SocketAddr, subject: Option<CoalescingKey>, urgency: Urgency) {
        if !self.datagram.is_empty() {
            let bytes = Bytes::copy_from_slice(&self.datagram);
            self.datagram.clear();
            self.datagrams.push_back(AppDatagram {
                to,
                bytes,
                subject,
                urgency,
            });
        }
    }

    /// Closes the piece and the datagram in progress.
    pub(super) fn flush(&mut self, to: Option<SocketAddr>) {
        self.close_piece();
        if let Some(to) = to {
            self.close_datagram(to, None, Urgency::Moving);
        }
    }

    /// The next bytes for TCP: whole messages.
    pub(super) fn poll_bytes(&mut self) -> Option<Bytes> {
        if self.pieces.is_empty() {
            self.close_piece();
        }
        let piece = self.pieces.pop_front()?;
        self.pieces_bytes -= piece.len();
        Some(piece)
    }

    /// The next datagram.
    pub(super) fn poll_datagram(&mut self) -> Option<AppDatagram> {
        self.datagrams.pop_front()
    }
}

/// A datagram to an APP client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AppDatagram {
    /// The destination.
    pub to: SocketAddr,
    /// The whole datagram.
    pub bytes: Bytes,
    /// While it waits, a newer one about the same subject takes its place; `None`: none does.
    pub subject: Option<CoalescingKey>,
    /// The most urgent one leaves first.
    pub urgency: Urgency,
}

/// A transmission to an APP client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AppTransmit {
    /// Whole messages for its connection, written at once, so that no read cuts one.
    Bytes(Bytes),
    /// A datagram.
    Datagram(AppDatagram),
    /// Sends the queued bytes, then ends the connection.
    Close,
}

/// The subject of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CoalescingKey {
    /// The state of an actor.
    Actor(u32),
    /// A contact of two actors.
    Pair(u32, u32),
}

/// Order of waiting datagrams: the least first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Urgency {
    /// The state of an actor that rests, which no later one would correct.
    Resting,
    /// Everything else.
    #[default]
    Moving,
}

impl CoalescingKey {
    /// The subject of a message; `None` for one that no newer one replaces.
    pub(super) const fn of(message: &Message) -> Option<Self> {
        match message {
            Message::SetDynamicActor(motion) => Some(Self::Actor(motion.actor.object)),
            Message::ActorsCollided(contact) => Some(Self::Pair(
                contact.colliding.object,
                contact.collided.object,
            )),
            _ => None,
        }
    }
}

impl Urgency {
    /// The urgency of a message.
    pub(super) fn of(message: &Message) -> Self {
        match message {
            // An engine puts a body to sleep with no velocity at all.
            Message::SetDynamicActor(motion)
                if motion.linear == glam::Vec3::ZERO && motion.angular == glam::Vec3::ZERO =>
            {
                Self::Resting
            }
            _ => Self::Moving,
        }
    }
}

/// A budget for each span of time.
#[derive(Clone, Debug)]
pub(super) struct RateLimiter {
    span: Duration,
    most: usize,
    /// End of the span in which budget was last spent.
    until: Option<Instant>,
    spent: usize,
}

/// Limit of a TCP connection: one read takes a whole span, which fills a quarter of it.
pub(super) const fn limiter_of_bytes() -> RateLimiter {
    RateLimiter::new(Duration::from_millis(35), 16 << 10)
}

impl RateLimiter {
    const fn new(span: Duration, most: usize) -> Self {
        Self {
            span,
            most,
            until: None,
            spent: 0,
        }
    }

    /// Spends an amount at a moment.
    ///
    /// # Errors
    ///
    /// The moment from which on it can be spent. An amount above the budget of a span gets a span of its own.
    fn try_spend(&mut self, now: Instant, amount: usize) -> Result<(), Instant> {
        match self.until {
            Some(until) if now < until => {
                if self.spent + amount > self.most {
                    return Err(until);
                }
            }
            _ => {
                self.until = Some(now + self.span);
                self.spent = 0;
            }
        }
        self.spent += amount;
        Ok(())
    }

    /// Waits until the amount can be spent, and spends it.
    pub(super) async fn spend(&mut self, amount: usize) {
        while let Err(at) = self.try_spend(Instant::now(), amount) {
            sleep_until(at).await;
        }
    }
}

/// A pace, and what it has let pass.
#[derive(Clone, Debug)]
pub(super) struct DatagramPace {
    /// Time of one datagram.
    interval: Duration,
    /// Datagrams may be earlier than their moments by this.
    slack: Duration,
    /// The moment of the next datagram, at an even pace.
    due: Option<Instant>,
}

/// Time whose datagrams may leave at once: that of a late timer.
const BURST: Duration = Duration::from_millis(3);

impl DatagramPace {
    /// A pace of this number of datagrams in a millisecond, at least one.
    pub(super) fn new(per_millisecond: u32) -> Self {
        let interval = Duration::from_millis(1) / per_millisecond.max(1);
        Self {
            interval,
            slack: BURST.saturating_sub(interval),
            due: None,
        }
    }

    /// Lets a datagram pass.
    ///
    /// # Errors
    ///
    /// The moment from which on it may pass.
    pub(super) fn try_pass(&mut self, now: Instant) -> Result<(), Instant> {
        let due = self.due.map_or(now, |due| due.max(now));
        if due > now + self.slack {
            return Err(due - self.slack);
        }
        self.due = Some(due + self.interval);
        Ok(())
    }

    /// True if the pace equals a new one.
    pub(super) fn is_over(&self, now: Instant) -> bool {
        self.due.is_none_or(|due| due <= now)
    }
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};

    use super::*;
    use crate::codec::Id;
    use crate::message::Motion;

    fn drain(send_queue: &mut SendQueue) -> (Vec<usize>, Vec<usize>) {
        let pieces = std::iter::from_fn(|| send_queue.poll_bytes()).map(|b| b.len());
        let pieces: Vec<_> = pieces.collect();
        let datagrams = std::iter::from_fn(|| send_queue.poll_datagram()).map(|d| d.bytes.len());
        (pieces, datagrams.collect())
    }

    #[test]
    fn pieces_hold_whole_messages_and_fit_a_segment() {
        let mut send_queue = SendQueue::default();
        for _ in 0..120 {
            send_queue.lasting(&Message::TimeAdvanced(7));
        }
        let (pieces, _) = drain(&mut send_queue);
        assert_eq!(pieces.iter().sum::<usize>(), 120 * 28);
        assert!(
            pieces
                .iter()
                .all(|bytes| *bytes <= PIECE_BYTES_MAX && bytes % 28 == 0)
        );
    }

    #[test]
    fn a_datagram_holds_one_message_or_as_many_as_fit() {
        let to = Some(SocketAddr::from(([127, 0, 0, 1], 9)));
        for (datagrams, expected) in [
            (Datagrams::Single, vec![28; 60]),
            (Datagrams::Packed, vec![28 * 52, 28 * 8]),
        ] {
            let mut send_queue = SendQueue::default();
            for _ in 0..60 {
                send_queue.passing(&Message::TimeAdvanced(7), to, datagrams);
            }
            send_queue.flush(to);
            assert_eq!(drain(&mut send_queue), (vec![], expected));
        }
    }

    #[test]
    fn a_datagram_names_its_subject_unless_it_packs_several() {
        let to = SocketAddr::from(([127, 0, 0, 1], 9));
        let moving = |linear| {
            Message::SetDynamicActor(Motion {
                actor: Id {
                    simulation: 7,
                    object: 5,
                },
                position: Vec3::ZERO,
                rotation: Quat::IDENTITY,
                gravity_modifier: 1.0,
                linear,
                angular: Vec3::ZERO,
            })
        };
        let mut send_queue = SendQueue::default();
        let messages = [
            moving(Vec3::X),
            moving(Vec3::ZERO),
            Message::TimeAdvanced(7),
        ];
        for datagrams in [Datagrams::Single, Datagrams::Packed] {
            for message in &messages {
                send_queue.passing(message, Some(to), datagrams);
            }
        }
        send_queue.flush(Some(to));
        let datagrams = std::iter::from_fn(|| send_queue.poll_datagram());
        let subjects: Vec<_> = datagrams.map(|d| (d.subject, d.urgency)).collect();
        let actor = Some(CoalescingKey::Actor(5));
        let expected = [
            (actor, Urgency::Moving),
            (actor, Urgency::Resting),
            (None, Urgency::Moving),
            (None, Urgency::Moving),
        ];
        assert_eq!(subjects, expected);
    }

    #[test]
    fn without_a_datagram_address_messages_go_over_tcp() {
        let mut send_queue = SendQueue::default();
        for _ in 0..10_000 {
            send_queue.passing(&Message::TimeAdvanced(7), None, Datagrams::Single);
        }
        let (pieces, datagrams) = drain(&mut send_queue);
        assert!(pieces.iter().sum::<usize>() < PASSING_WAIT_MAX + 2 * PIECE_BYTES_MAX);
        assert!(datagrams.is_empty());
    }

    #[test]
    fn queued_bytes_hold_back_only_supersedable_messages() {
        let mut send_queue = SendQueue::default();
        send_queue.note_connection_bytes(PASSING_WAIT_MAX);
        assert_eq!(send_queue.capacity(), 0);
        send_queue.passing(&Message::TimeAdvanced(7), None, Datagrams::Single);
        assert_eq!(drain(&mut send_queue), (vec![], vec![]));
        send_queue.lasting(&Message::TimeAdvanced(7));
        assert_eq!(drain(&mut send_queue), (vec![28], vec![]));
        send_queue.note_connection_bytes(PASSING_WAIT_MAX - 1);
        for _ in 0..2 {
            send_queue.passing(&Message::TimeAdvanced(7), None, Datagrams::Single);
        }
        assert_eq!(drain(&mut send_queue), (vec![28], vec![]));
    }

    #[tokio::test(start_paused = true)]
    async fn each_span_has_the_full_budget() {
        let begun = Instant::now();
        let mut rate_limiter = limiter_of_bytes();
        let mut moments = Vec::new();
        for _ in 0..25 {
            rate_limiter.spend(1_400).await;
            moments.push(begun.elapsed().as_millis());
        }
        let expected = [vec![0; 11], vec![35; 11], vec![70; 3]];
        assert_eq!(moments, expected.concat());
    }

    #[tokio::test(start_paused = true)]
    async fn an_amount_above_the_budget_gets_its_own_span() {
        let begun = Instant::now();
        let mut rate_limiter = limiter_of_bytes();
        rate_limiter.spend(1).await;
        rate_limiter.spend(1 << 20).await;
        assert_eq!(begun.elapsed().as_millis(), 35);
        rate_limiter.spend(1).await;
        assert_eq!(begun.elapsed().as_millis(), 70);
    }

    /// Moments at which datagrams pass when as many as may pass do so in each span.
    fn passed(pace: &mut DatagramPace, begun: Instant, spans_ms: &[u64]) -> Vec<u64> {
        let mut moments = Vec::new();
        let mut now = begun;
        for span in spans_ms {
            while pace.try_pass(now).is_ok() {
                moments.push((now - begun).as_millis() as u64);
            }
            now += Duration::from_millis(*span);
        }
        moments
    }

    #[test]
    fn no_ten_milliseconds_have_more_than_the_buffer_of_the_client_holds() {
        // Whenever the timer fires, and however the polls lie to it.
        for spans in [
            vec![1; 200],
            vec![2; 100],
            [1, 3, 1, 7].repeat(25),
            vec![40; 5],
        ] {
            let mut pace = DatagramPace::new(20);
            let moments = passed(&mut pace, Instant::now(), &spans);
            let most = moments.iter().map(|first| {
                let within = moments
                    .iter()
                    .filter(|at| (*first..first + 10).contains(*at));
                within.count()
            });
            assert!(most.max() <= Some(277), "{spans:?}");
        }
    }

    #[test]
    fn a_late_timer_costs_nothing_up_to_three_milliseconds() {
        for (span, spans) in [(1, 300), (2, 150), (3, 100)] {
            let mut pace = DatagramPace::new(20);
            let moments = passed(&mut pace, Instant::now(), &vec![span; spans]);
            assert!(moments.len() >= 299 * 20, "{span}: {}", moments.len());
        }
    }

    #[test]
    fn a_pace_is_as_new_after_its_last_moment() {
        let (mut pace, now) = (DatagramPace::new(1), Instant::now());
        assert!(pace.is_over(now));
        assert_eq!(pace.try_pass(now), Ok(()));
        assert!(!pace.is_over(now));
        assert!(pace.is_over(now + Duration::from_millis(1)));
    }
}
