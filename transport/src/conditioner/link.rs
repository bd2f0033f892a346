//! One direction of a simulated link: delay, copies, reordering, loss.
//!
//! No clock and no socket; `next_at` returns the time of the next step. The control lane is reliable and ordered: the
//! link sends a lost piece again, under the configuration of that time. Random draws are seeded and in whole numbers,
//! so that equal seeds and calls give equal results to the bit on every platform. Pieces and bytes are counted as
//! pushed: no headers are added.

use std::cmp::Ordering;
use std::collections::{BTreeMap, BinaryHeap, VecDeque};
use std::ops::AddAssign;

use bytes::Bytes;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use rhumb_protocol::{Instant, Span};

use super::config::{LinkConfig, Probability};

/// Reliability of a piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Lane {
    /// Every piece arrives, in order.
    Control,
    /// A piece arrives whole, late or not at all.
    State,
}

/// One direction of a link.
#[derive(Clone, Debug)]
pub struct Link {
    config: LinkConfig,
    rng: SimRng,
    burst_state: BurstState,
    /// Moment at which the bytes pushed so far have passed the rate limit.
    free_at: Instant,
    /// Earliest moment at which the next piece may arrive in order.
    latest_state: Instant,
    in_flight_packets: BinaryHeap<Packet>,
    departed: u64,
    control_pushed: u64,
    control_popped: u64,
    control_arrived: BTreeMap<u64, Bytes>,
    out: VecDeque<(Lane, Bytes)>,
    counts: [LinkCounts; 2],
}

/// The state of a burst of losses. Source: Gilbert (1960) and Elliott (1963), where the bad state loses
/// everything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum BurstState {
    Good,
    Bad,
}

/// A piece in transit, ordered so that the heap yields the earliest one, and of equal ones the first pushed.
#[derive(Clone, Debug)]
struct Packet {
    at: Instant,
    number: u64,
    payload: Payload,
}

#[derive(Clone, Debug)]
enum Payload {
    State(Bytes),
    Control {
        place: u64,
        bytes: Bytes,
    },
    Retry {
        place: u64,
        attempt: u32,
        bytes: Bytes,
    },
}

/// Greatest delay of a reordered packet: some packets at any tick rate.
const HOLD_BACK: Span = Span::from_millis(20);

/// Time beyond a round trip before a sender repeats control bytes. Source: RFC 9002, section 6.2.1 (max_ack_delay).
const ACK_DELAY: Span = Span::from_millis(25);

/// Greatest exponent of the retry delay: it doubles up to 2⁶ times the first, as a probe timeout backs off.
const BACKOFF_MAX: u32 = 6;

/// Size of the packets of control bytes; losses are per packet.
const CONTROL_PACKET_BYTES: usize = 1_200;

impl Link {
    /// A link whose random numbers follow from the seed.
    #[must_use]
    pub fn new(config: LinkConfig, seed: u64) -> Self {
        Self {
            config,
            rng: SimRng::new(seed),
            burst_state: BurstState::Good,
            free_at: Instant::ZERO,
            latest_state: Instant::ZERO,
            in_flight_packets: BinaryHeap::new(),
            departed: 0,
            control_pushed: 0,
            control_popped: 0,
            control_arrived: BTreeMap::new(),
            out: VecDeque::new(),
            counts: [LinkCounts::default(); 2],
        }
    }

    /// Changes the configuration for pieces that are pushed, or sent again, from now on.
    pub fn set_config(&mut self, config: LinkConfig) {
        self.config = config;
    }

    /// Sends a piece into the link.
    pub fn push(&mut self, now: Instant, bytes: Bytes, lane: Lane) {
        self.counts_mut(lane).pushed.add(&bytes);
        match lane {
            Lane::State => self.push_state(now, bytes),
            Lane::Control => {
                let place = self.control_pushed;
                self.control_pushed += 1;
                self.push_control(
                    now,
                    Payload::Retry {
                        place,
                        attempt: 0,
                        bytes,
                    },
                );
            }
        }
    }

    /// Bytes that are queued before the rate limit.
    #[must_use]
    pub fn waiting_bytes(&self, now: Instant) -> u64 {
        let rate_bytes = u128::from(self.config.rate_bytes.unwrap_or(0));
        let wait_ns = u128::from(self.free_at.since(now).as_nanos());
        u64::try_from(wait_ns * rate_bytes / NS_PER_SECOND).unwrap_or(u64::MAX)
    }

    /// Takes the next piece that has arrived by now.
    pub fn pop(&mut self, now: Instant) -> Option<(Lane, Bytes)> {
        self.advance(now);
        let (lane, bytes) = self.out.pop_front()?;
        self.counts_mut(lane).delivered.add(&bytes);
        Some((lane, bytes))
    }

    /// Time at which the next piece may arrive; `None` if nothing is in transit. The piece may still be lost then.
    #[must_use]
    pub fn next_at(&self) -> Option<Instant> {
        let waiting = (!self.out.is_empty()).then_some(Instant::ZERO);
        waiting.or_else(|| self.in_flight_packets.peek().map(|flight| flight.at))
    }

    /// The present configuration.
    #[must_use]
    pub fn config(&self) -> LinkConfig {
        self.config
    }

    /// The counters of a lane.
    #[must_use]
    pub fn counts(&self, lane: Lane) -> LinkCounts {
        self.counts[lane as usize]
    }

    /// True if a piece of this lane is in transit.
    #[must_use]
    pub fn carries(&self, lane: Lane) -> bool {
        let under_way = |flight: &Packet| flight.payload.lane() == lane;
        self.in_flight_packets.iter().any(under_way) || self.out.iter().any(|(of, _)| *of == lane)
    }

    fn push_state(&mut self, now: Instant, bytes: Bytes) {
        let Some(sent) = self.pass_rate(now, bytes.len()) else {
            self.counts_mut(Lane::State).overflowed.add(&bytes);
            return;
        };
        if self.loses() {
            self.counts_mut(Lane::State).lost.add(&bytes);
            return;
        }
        if self.rng.happens(Odds::of(self.config.duplicates)) {
            self.counts_mut(Lane::State).duplicated.add(&bytes);
            let at = self.state_arrival(sent);
            self.fly(at, Payload::State(bytes.clone()));
        }
        let at = self.state_arrival(sent);
        self.fly(at, Payload::State(bytes));
    }

    /// Sends control bytes, for the first time or again: they are in transit, or scheduled for a retry.
    fn push_control(&mut self, now: Instant, retry: Payload) {
        let Payload::Retry {
            place,
            attempt,
            bytes,
        } = retry
        else {
            return;
        };
        let Some(sent) = self.pass_rate(now, bytes.len()) else {
            self.counts_mut(Lane::Control).overflowed.add(&bytes);
            return self.retry(now, place, attempt, bytes);
        };
        let mut lost = 0;
        for _ in 0..bytes.len().div_ceil(CONTROL_PACKET_BYTES).max(1) {
            lost += u32::from(self.loses());
        }
        if lost > 0 {
            self.counts_mut(Lane::Control).lost.add(&bytes);
            return self.retry(sent, place, attempt, bytes);
        }
        let at = sent + self.config.delay + self.rng.span(self.config.jitter);
        self.fly(at, Payload::Control { place, bytes });
    }

    fn retry(&mut self, sent: Instant, place: u64, attempt: u32, bytes: Bytes) {
        let round_trip_ns = 2 * (self.config.delay.as_nanos() + self.config.jitter.as_nanos());
        let wait_ns = (round_trip_ns + ACK_DELAY.as_nanos()) << attempt.min(BACKOFF_MAX);
        let attempt = attempt.saturating_add(1);
        self.fly(
            sent + Span::from_nanos(wait_ns),
            Payload::Retry {
                place,
                attempt,
                bytes,
            },
        );
    }

    /// Time at which these bytes have passed the rate limit; `None` if its queue is full.
    fn pass_rate(&mut self, now: Instant, bytes_len: usize) -> Option<Instant> {
        let Some(rate_bytes) = self.config.rate_bytes else {
            return Some(now);
        };
        let rate_bytes = u128::from(rate_bytes.max(1));
        let wait_ns = u128::from(self.free_at.since(now).as_nanos());
        let queued_bytes = wait_ns * rate_bytes / NS_PER_SECOND;
        if queued_bytes + bytes_len as u128 > u128::from(self.config.queue_bytes) {
            return None;
        }
        let pass_ns = bytes_len as u128 * NS_PER_SECOND / rate_bytes;
        let pass = Span::from_nanos(u64::try_from(pass_ns).unwrap_or(u64::MAX));
        self.free_at = self.free_at.max(now) + pass;
        Some(self.free_at)
    }

    fn state_arrival(&mut self, sent: Instant) -> Instant {
        let at = sent + self.config.delay + self.rng.span(self.config.jitter);
        if self.rng.happens(Odds::of(self.config.reorder)) {
            return at + self.rng.span(HOLD_BACK);
        }
        self.latest_state = self.latest_state.max(at);
        self.latest_state
    }

    /// Decides one packet's loss and updates the burst state for the next.
    ///
    /// A run of losses ends with probability 1/b: its mean length is b. It begins with probability p/(b(1−p)): the
    /// share of lost packets is p.
    fn loses(&mut self) -> bool {
        let (lost, kept) = (
            self.config.loss.as_millionths(),
            self.config.loss.rest().as_millionths(),
        );
        if self.config.burst < 2 || kept == 0 {
            return self.rng.happens(Odds::of(self.config.loss));
        }
        let burst = u64::from(self.config.burst);
        self.burst_state = match self.burst_state {
            BurstState::Bad if self.rng.happens(Odds::ratio(1, burst)) => BurstState::Good,
            BurstState::Good
                if self
                    .rng
                    .happens(Odds::ratio(lost.into(), burst * u64::from(kept))) =>
            {
                BurstState::Bad
            }
            same => same,
        };
        self.burst_state == BurstState::Bad && lost > 0
    }

    fn fly(&mut self, at: Instant, payload: Payload) {
        let number = self.departed;
        self.departed += 1;
        self.in_flight_packets.push(Packet {
            at,
            number,
            payload,
        });
    }

    /// Delivers the pieces that have arrived by now and sends due control bytes again.
    fn advance(&mut self, now: Instant) {
        while self
            .in_flight_packets
            .peek()
            .is_some_and(|flight| flight.at <= now)
        {
            let Some(flight) = self.in_flight_packets.pop() else {
                return;
            };
            match flight.payload {
                Payload::State(bytes) => self.out.push_back((Lane::State, bytes)),
                Payload::Control { place, bytes } => {
                    self.control_arrived.insert(place, bytes);
                    while let Some(bytes) = self.control_arrived.remove(&self.control_popped) {
                        self.control_popped += 1;
                        self.out.push_back((Lane::Control, bytes));
                    }
                }
                retry @ Payload::Retry { .. } => self.push_control(flight.at, retry),
            }
        }
    }

    fn counts_mut(&mut self, lane: Lane) -> &mut LinkCounts {
        &mut self.counts[lane as usize]
    }
}

const NS_PER_SECOND: u128 = 1_000_000_000;

impl Payload {
    fn lane(&self) -> Lane {
        match self {
            Self::State(_) => Lane::State,
            Self::Control { .. } | Self::Retry { .. } => Lane::Control,
        }
    }
}

impl Ord for Packet {
    fn cmp(&self, other: &Self) -> Ordering {
        (other.at, other.number).cmp(&(self.at, self.number))
    }
}

impl PartialOrd for Packet {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Packet {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Packet {}

/// Counters of one lane of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkCounts {
    /// Pushed into the link.
    pub pushed: Tally,
    /// Lost; a lost piece of the control lane is sent again.
    pub lost: Tally,
    /// Lost by a full queue before the rate limit; a lost piece of the control lane is sent again.
    pub overflowed: Tally,
    /// Duplicates that the link made.
    pub duplicated: Tally,
    /// Delivered by the link, duplicates included.
    pub delivered: Tally,
}

/// Count of pieces, and of their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Pieces.
    pub pieces: u64,
    /// Bytes, as pushed, without headers.
    pub bytes: u64,
}

impl Tally {
    pub(super) fn add(&mut self, bytes: &Bytes) {
        self.pieces += 1;
        self.bytes += bytes.len() as u64;
    }
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.pieces += other.pieces;
        self.bytes += other.bytes;
    }
}

impl AddAssign for LinkCounts {
    fn add_assign(&mut self, other: Self) {
        self.pushed += other.pushed;
        self.lost += other.lost;
        self.overflowed += other.overflowed;
        self.duplicated += other.duplicated;
        self.delivered += other.delivered;
    }
}

/// A generator of decisions that depend on the seed alone.
#[derive(Clone, Debug)]
struct SimRng {
    draws: Pcg32,
}

/// A probability as a count of 2⁻³², in [0, 2³²].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Odds(u64);

impl Odds {
    pub(super) fn of(share: Probability) -> Self {
        Self::ratio(share.as_millionths().into(), 1_000_000)
    }

    /// `part / whole`, at most 1; `whole` is not zero.
    fn ratio(part: u64, whole: u64) -> Self {
        let ratio = (u128::from(part) << 32) / u128::from(whole);
        Self(u64::try_from(ratio).unwrap_or(u64::MAX).min(1 << 32))
    }
}

impl SimRng {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            draws: Pcg32::new(seed, STREAM),
        }
    }

    fn happens(&mut self, odds: Odds) -> bool {
        u64::from(self.draws.next_u32()) < odds.0
    }

    /// A uniform span in [0, `span_max`].
    pub(super) fn span(&mut self, span_max: Span) -> Span {
        let choices = u128::from(span_max.as_nanos()) + 1;
        let ns = (u128::from(self.draws.next_u64()) * choices) >> 64;
        Span::from_nanos(u64::try_from(ns).expect("at most the greatest span"))
    }
}

/// Stream number of the generator. Any odd constant is valid; this one is PCG's example.
const STREAM: u64 = 0x0a02_bdbf_7bb3_c0a7;
