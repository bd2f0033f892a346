//! One replay: a sender, two links and a receiver in simulated time.
//!
//! The sender publishes the recording as a server publishes a free-running scene: scene events before packets,
//! watermarks in silence, refreshes after loss reports. Bytes count when they are sent, whether or not they arrive.
//! Both ends know the initial bodies, which cost nothing. The receiver is the product's; the round trip is a known
//! constant instead of a measurement.
//!
//! The range coder is part of the wire format, so nothing can be sent without it: the size in plain codes can only be
//! counted. FEC and budgets act on the coded packets.

use std::collections::VecDeque;
use std::fmt;
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_netsim::{Lane, Link};
use rhumb_protocol::message::{SceneEvent, ServerMessage};
use rhumb_protocol::packet::{
    Datagram, Head, LargestPacket, PacketKind, StreamId, SymbolCounts, UpdatePacket,
};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    Budget, ObservationHistory, PredictionParameters, Recipient, StreamConfig, StreamReceiver,
    StreamSender, StreamStart, Subscriber, WatermarkPolicy,
};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Integrator, Rate, Tick, Tolerance, Track};
use rhumb_transport::Clock;

use super::config::ReplayConfig;
use crate::drive::compare::ReplayJudge;
use crate::machine;
use crate::record::{
    CapturedPacket, Change, Changes, Frame, JoinCost, PacketDirection, Placed, Run,
};
use crate::recording::{Recording, first_track};

/// Reason why a replay failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayError {
    /// The recording exceeds a stream's limit of bodies or kinds of damping, or removes an unknown body.
    Limits(Tick),
    /// The losses require a new snapshot, which a replay does not have.
    OutOfSync(Tick),
    /// A checksum differs from that of the copy: a fault of the publisher or of the subscriber.
    ChecksumMismatch(Tick),
    /// The publish interval is longer than the recording.
    IntervalTooLong(Tick),
    /// The stream did not complete the last tick within ten seconds after it.
    NoEnd,
}

impl fmt::Display for ReplayError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Limits(tick) => {
                write!(f, "the recording exceeds the limits of a stream at {tick}")
            }
            Self::OutOfSync(tick) => write!(f, "the losses until {tick} require a new snapshot"),
            Self::ChecksumMismatch(tick) => {
                write!(f, "a checksum at {tick} differs from that of the copy")
            }
            Self::IntervalTooLong(last) => {
                write!(
                    f,
                    "no tick would be published: the recording ends at {last}"
                )
            }
            Self::NoEnd => {
                f.write_str("the client did not complete the last tick within ten seconds")
            }
        }
    }
}

impl std::error::Error for ReplayError {}

/// Bytes that QUIC adds to a datagram: a short header without connection id and with two bytes of packet number (3),
/// the frame's type and length (3), the tag (16). Acknowledgements and keep-alives are not counted.
const QUIC_BYTES: u64 = 22;

/// Time limit after the last tick for the client to complete it: ten seconds.
const END: Span = Span::from_millis(10_000);

const STREAM: StreamId = StreamId(0);

/// Id of the only subscriber.
const SUBSCRIBER: u64 = 0;

/// Replays a recording, and calls `progress` after each tick.
///
/// # Errors
///
/// [`ReplayError`] when the replay fails; it then has no partial result.
pub fn run(
    recording: &Recording,
    config: &ReplayConfig,
    progress: &mut dyn FnMut(Tick),
) -> Result<Run, ReplayError> {
    if config.publish_interval.get() > recording.ticks() {
        let last = u64::from(recording.ticks());
        return Err(ReplayError::IntervalTooLong(Tick::new(last)));
    }
    let mut session = ReplaySession::new(recording, config);
    session.place_first()?;
    session
        .client
        .receiver
        .subscriber_mut()
        .handle_snapshot_end();
    let rate = recording.integrator.rate;
    let last = u64::from(recording.ticks());
    for number in 1..=last + u64::from(config.lookahead.count()) {
        let tick = Tick::new(number);
        let at = moment(rate, tick);
        session.pass_until(at)?;
        session.apply_changes(tick)?;
        session.publish(at, tick);
        session.pass_until(at)?;
        progress(tick);
    }
    session.end(Tick::new(u64::from(recording.ticks())))?;
    Ok(session.into_run())
}

/// The stream at its source, without bodies yet.
fn sender(start: &StreamSetup, config: &ReplayConfig) -> StreamSender {
    let stream = StreamConfig {
        tolerance: start.tolerance,
        integrator: start.integrator,
        publish_interval: start.publish_interval,
        largest_packet: start.largest_packet,
        gravity: start.gravity,
        features: config.features.publisher,
    };
    let policy = WatermarkPolicy::free_running(start.integrator.rate, start.publish_interval);
    StreamSender::reckoned(start.stream, &stream, config.budget, policy, Tick::ZERO)
}

fn moment(rate: Rate, tick: Tick) -> Instant {
    Instant::from_nanos(tick.value() * rate.step_ns())
}

/// A lost packet, and the bodies that still lack a newer update.
#[derive(Debug)]
struct LostPacket {
    at: Instant,
    tick: Tick,
    bodies: Vec<BodyId>,
}

#[derive(Debug)]
struct ReplaySession<'a> {
    recording: &'a Recording,
    config: &'a ReplayConfig,
    sender: StreamSender,
    observation_history: ObservationHistory,
    client: ReplayClient,
    judge: ReplayJudge<'a>,
    down: Link,
    up: Link,
    changes: Changes<'a>,
    scene_events: u64,
    lost: Vec<LostPacket>,
    recoveries: Vec<Span>,
    clock: Clock,
    publish_ns: u64,
    frames: Vec<Frame>,
    captured: Vec<CapturedPacket>,
    /// Traffic since the last frame.
    sent: Frame,
    updates: u64,
}

impl<'a> ReplaySession<'a> {
    fn new(recording: &'a Recording, config: &'a ReplayConfig) -> Self {
        let start = StreamSetup {
            stream: STREAM,
            tolerance: config.tolerance,
            integrator: recording.integrator,
            gravity: recording.gravity,
            publish_interval: config.publish_interval,
            largest_packet: config.largest_packet,
        };
        let link = config.link;
        let round_trip_ns = 2 * (link.delay.as_nanos() + link.jitter.as_nanos());
        Self {
            recording,
            config,
            sender: sender(&start, config),
            observation_history: ObservationHistory::new(PublishSchedule {
                publish_interval: config.publish_interval,
                lookahead: config.lookahead,
            }),
            client: ReplayClient::new(&start, Span::from_nanos(round_trip_ns), config.budget),
            judge: ReplayJudge::new(&recording.truth),
            down: Link::new(link, config.seed),
            up: Link::new(link, !config.seed),
            changes: recording.truth.changes(),
            scene_events: 0,
            lost: Vec::new(),
            recoveries: Vec::new(),
            clock: Clock::start(),
            publish_ns: 0,
            frames: Vec::new(),
            captured: Vec::new(),
            sent: Frame::default(),
            updates: 0,
        }
    }

    /// Both ends place the bodies of tick 0 without a scene event.
    fn place_first(&mut self) -> Result<(), ReplayError> {
        while let Some(placed) = self.changes.first() {
            let (parameters, track, mut fits) = self.place(placed);
            let subscriber = self.client.receiver.subscriber_mut();
            fits &= subscriber.place(placed.desc.id, &parameters, track);
            if !fits {
                return Err(ReplayError::Limits(Tick::ZERO));
            }
        }
        Ok(())
    }

    /// Places and removes bodies before the step to a tick.
    fn apply_changes(&mut self, tick: Tick) -> Result<(), ReplayError> {
        let before = Tick::new(tick.value().saturating_sub(1));
        while let Some(change) = self.changes.until(before) {
            let (scene_event, pending) = match change {
                Change::Placed(_, placed) => {
                    let (parameters, track, fits) = self.place(placed);
                    if !fits {
                        return Err(ReplayError::Limits(tick));
                    }
                    let scene_event = SceneEvent::BodyPlaced {
                        desc: placed.desc,
                        inertia: parameters.inertia,
                        track,
                        alias: None,
                    };
                    let pending = PendingEvent::Placed(placed.desc.id, parameters, track);
                    (scene_event, pending)
                }
                Change::Removed(id) => {
                    self.sender.remove(id);
                    let cause = rhumb_protocol::message::RemovalCause::Command;
                    (
                        SceneEvent::BodyRemoved { id, cause },
                        PendingEvent::Removed(id),
                    )
                }
            };
            self.send_event(tick, scene_event, pending);
        }
        Ok(())
    }

    /// Places a body at the sender; false if it does not fit.
    fn place(&mut self, placed: &Placed) -> (PredictionParameters, Track, bool) {
        let parameters = self.recording.parameters(placed);
        let track = first_track(placed, &parameters);
        let motion = placed.observation.motion;
        let fits = self
            .sender
            .place(placed.desc.id, &parameters, track, motion);
        (parameters, track, fits)
    }

    fn send_event(&mut self, tick: Tick, scene_event: SceneEvent, change: PendingEvent) {
        let at = moment(self.recording.integrator.rate, tick);
        self.scene_events += 1;
        self.client.pending.push_back(change);
        let mut bytes = Vec::new();
        ServerMessage::SceneEvent(scene_event).encode(&mut bytes);
        self.send_down(at, Bytes::from(bytes), Lane::Control);
    }

    /// Processor time of this thread so far; wall time where the system does not report it.
    fn work_ns(&self) -> u64 {
        let wall_ns = || self.clock.now().since(Instant::ZERO).as_nanos();
        machine::work_ns().unwrap_or_else(wall_ns)
    }

    /// One tick of the server: observes, publishes, sends.
    fn publish(&mut self, now: Instant, tick: Tick) {
        // With lookahead the last ticks are published after the recording's end.
        let row = self.recording.truth.ticks.get(tick.value() as usize - 1);
        let begun_ns = self.work_ns();
        self.observation_history
            .observe(tick, row.map_or(&[][..], |row| &row[..]));
        let published = self
            .sender
            .publish(&self.observation_history, self.scene_events);
        self.publish_ns += self.work_ns() - begun_ns;
        if !published {
            return;
        }
        let lost = |session: &Self| session.down.counts(Lane::State).lost.pieces;
        let datagrams: Vec<Bytes> = self.sender.datagrams(SUBSCRIBER).cloned().collect();
        let mut lost_updates = false;
        for datagram in datagrams {
            let before = lost(self);
            let updates = holds_updates(&datagram);
            self.send_down(now, datagram, Lane::State);
            lost_updates |= updates && lost(self) > before;
        }
        if lost_updates {
            self.record_loss(now);
        }
    }

    /// Records the loss of a packet of the published tick, with all bodies of that tick's packets.
    fn record_loss(&mut self, now: Instant) {
        let published = self.sender.tick();
        let tracks = self.sender.tracks().into_iter();
        let lost = tracks.filter(|(_, track)| track.origin == published);
        let bodies = lost.map(|(id, _)| id).collect();
        self.lost.push(LostPacket {
            at: now,
            tick: published,
            bodies,
        });
    }

    fn send_down(&mut self, now: Instant, bytes: Bytes, lane: Lane) {
        let counted = if self.config.features.coder || lane == Lane::Control {
            bytes.len() as u64
        } else {
            plain_len(&bytes)
        };
        self.sent.wire_bytes_down += counted + QUIC_BYTES;
        self.sent.wire_datagrams_down += 1;
        let direction = match lane {
            Lane::Control => PacketDirection::ControlDown,
            Lane::State => PacketDirection::StateDown,
        };
        self.keep(direction, &bytes, counted);
        self.down.push(now, bytes, lane);
    }

    fn keep(&mut self, direction: PacketDirection, bytes: &Bytes, counted: u64) {
        let frame = self.frames.len() as u32;
        let captured = CapturedPacket::new(frame, direction, bytes.clone());
        self.captured.push(CapturedPacket {
            counted,
            ..captured
        });
    }

    /// Runs the links and the client until a moment.
    fn pass_until(&mut self, until: Instant) -> Result<(), ReplayError> {
        loop {
            let arrivals = [self.down.next_at(), self.up.next_at()];
            let next = arrivals
                .into_iter()
                .flatten()
                .fold(self.client.due(), Instant::min);
            if next > until {
                return Ok(());
            }
            self.pass(next)?;
        }
    }

    fn pass(&mut self, now: Instant) -> Result<(), ReplayError> {
        while let Some((lane, bytes)) = self.down.pop(now) {
            match lane {
                Lane::State => self.client.receive(now, &bytes),
                Lane::Control if self.client.receive_event(now) => {}
                Lane::Control => return Err(ReplayError::Limits(self.sender.tick())),
            }
        }
        if self.client.subscriber().has_mismatched() {
            return Err(ReplayError::ChecksumMismatch(self.sender.tick()));
        }
        if self.client.subscriber().has_lost_sync() {
            return Err(ReplayError::OutOfSync(self.sender.tick()));
        }
        self.recover(now);
        self.judge();
        for report in self.client.report(now) {
            let counted = report.len() as u64;
            self.sent.wire_bytes_up += counted + QUIC_BYTES;
            self.sent.wire_datagrams_up += 1;
            self.keep(PacketDirection::StateUp, &report, counted);
            self.up.push(now, report, Lane::State);
        }
        while let Some((_, bytes)) = self.up.pop(now) {
            self.answer(now, &bytes);
        }
        Ok(())
    }

    /// The server answers a loss report.
    fn answer(&mut self, now: Instant, datagram: &[u8]) {
        let Ok(datagram) = Datagram::open(datagram) else {
            return;
        };
        // A server does not measure round trips either.
        let from = Recipient {
            id: SUBSCRIBER,
            round_trip: Span::ZERO,
        };
        let mut answers = Vec::new();
        self.sender
            .handle_datagram(now, from, &datagram, self.scene_events, &mut answers);
        for answer in answers {
            self.send_down(now, answer, Lane::State);
        }
    }

    /// Records the recovered losses: each body has an update of the lost tick or a later one, or is removed.
    fn recover(&mut self, now: Instant) {
        let copy = self.client.subscriber();
        let recoveries = &mut self.recoveries;
        self.lost.retain_mut(|lost| {
            let tick = lost.tick;
            let behind = |id: &BodyId| copy.track(*id).is_some_and(|track| track.origin < tick);
            lost.bodies.retain(behind);
            if lost.bodies.is_empty() {
                recoveries.push(now.since(lost.at));
            }
            !lost.bodies.is_empty()
        });
    }

    /// Judges every published tick that the watermark has reached by now.
    fn judge(&mut self) {
        let copy = self.client.subscriber();
        let publish_interval = u64::from(self.config.publish_interval.get());
        while self.judge.tick() < copy.watermark_tick() && self.judge.step() {
            let tick = self.judge.tick().value();
            if !tick.is_multiple_of(publish_interval) {
                continue;
            }
            let mut frame = self.judge.frame(copy, self.config.tolerance);
            let updates = copy.statistics().updates;
            let sent = std::mem::take(&mut self.sent);
            frame.updates = updates - std::mem::replace(&mut self.updates, updates);
            add_wire(&mut frame, &sent);
            self.frames.push(frame);
        }
    }

    /// Sends watermarks after the last tick until the client completes it.
    fn end(&mut self, last: Tick) -> Result<(), ReplayError> {
        let rate = self.recording.integrator.rate;
        let begun = moment(rate, last);
        let publish_interval = u64::from(self.config.publish_interval.get());
        let due = Tick::new(last.value() / publish_interval * publish_interval);
        let mut now = begun;
        while self.judge.tick() < due || !self.lost.is_empty() {
            now = now + Span::from_nanos(4 * rate.step_ns());
            if now > begun + END {
                return Err(ReplayError::NoEnd);
            }
            self.pass_until(now)?;
            let watermark = self.sender.watermark(self.scene_events);
            self.send_down(now, watermark, Lane::State);
            self.pass_until(now)?;
        }
        let sent = std::mem::take(&mut self.sent);
        if let Some(frame) = self.frames.last_mut() {
            add_wire(frame, &sent);
        }
        Ok(())
    }

    fn into_run(self) -> Run {
        Run {
            config: self.config.run_config(self.recording),
            truth_checksum: self.recording.truth.digest,
            frames: self.frames,
            captured: self.captured,
            join: JoinCost::default(),
            breaches: self.judge.breaches,
            recoveries: self.recoveries,
            step_ns_p50: 0,
            step_ns_p99: 0,
            step_ns_total: 0,
            publish_ns_total: self.publish_ns,
            mismatches: self.client.subscriber().statistics().mismatches,
        }
    }
}

/// True if a datagram is a packet of updates.
fn holds_updates(datagram: &[u8]) -> bool {
    let updates = |kind| {
        matches!(
            kind,
            PacketKind::Updates | PacketKind::UpdatesEnd | PacketKind::UpdatesOverBudget
        )
    };
    Datagram::open(datagram).is_ok_and(|datagram| updates(datagram.head().kind))
}

fn add_wire(frame: &mut Frame, sent: &Frame) {
    frame.wire_bytes_down += sent.wire_bytes_down;
    frame.wire_bytes_up += sent.wire_bytes_up;
    frame.wire_datagrams_down += sent.wire_datagrams_down;
    frame.wire_datagrams_up += sent.wire_datagrams_up;
}

/// Change by a scene event in transit.
#[derive(Clone, Debug)]
enum PendingEvent {
    Placed(BodyId, PredictionParameters, Track),
    Removed(BodyId),
}

/// Client of a replay.
#[derive(Debug)]
struct ReplayClient {
    pub(super) receiver: StreamReceiver,
    /// The changes by scene events in transit, in order.
    pub(super) pending: VecDeque<PendingEvent>,
    /// Least time between two reports of one loss.
    min_delay: Span,
}

/// Configuration that both ends of a replay know at its start.
#[derive(Clone, Copy, Debug)]
struct StreamSetup {
    pub(super) stream: StreamId,
    pub(super) tolerance: Tolerance,
    pub(super) integrator: Integrator,
    pub(super) gravity: Vec3,
    pub(super) publish_interval: NonZeroU32,
    pub(super) largest_packet: LargestPacket,
}

impl ReplayClient {
    /// `budget`: the budget of a capped stream.
    pub(super) fn new(start: &StreamSetup, round_trip: Span, budget: Option<Budget>) -> Self {
        let begin = match budget {
            Some(_) => Subscriber::limited,
            None => Subscriber::new,
        };
        let subscriber = begin(&StreamStart {
            stream: start.stream,
            tolerance: start.tolerance,
            integrator: start.integrator,
            publish_interval: start.publish_interval,
            largest_packet: start.largest_packet,
            gravity: start.gravity,
            tick: Tick::ZERO,
            next: 0,
            scene_events: 0,
        });
        let mut receiver = StreamReceiver::new(subscriber);
        receiver.expect_watermark(Instant::ZERO);
        Self {
            receiver,
            pending: VecDeque::new(),
            min_delay: Span::from_nanos(round_trip.as_nanos() * 5 / 4),
        }
    }

    /// Applies the next scene event; `false` when its change breaks a limit.
    #[must_use]
    fn receive_event(&mut self, now: Instant) -> bool {
        let subscriber = self.receiver.subscriber_mut();
        let done = match self.pending.pop_front() {
            Some(PendingEvent::Placed(id, parameters, track)) => {
                subscriber.place(id, &parameters, track)
            }
            Some(PendingEvent::Removed(id)) => subscriber.remove(id),
            None => false,
        };
        subscriber.apply_scene_event();
        self.watch(now);
        done
    }

    /// Handles a received datagram.
    pub(super) fn receive(&mut self, now: Instant, datagram: &[u8]) {
        self.receiver.subscriber_mut().handle_datagram(datagram);
        self.watch(now);
    }

    fn watch(&mut self, now: Instant) {
        self.receiver.update_timers(now);
        self.receiver.expect_watermark(now);
    }

    /// The copy.
    pub(super) const fn subscriber(&self) -> &Subscriber {
        self.receiver.subscriber()
    }

    /// Time of the next report if nothing arrives before. There always is one, because a watermark is expected.
    pub(super) fn due(&self) -> Instant {
        self.receiver.due().map_or(Instant::ZERO, |wake| wake.at)
    }

    /// The loss reports that are due now.
    pub(super) fn report(&mut self, now: Instant) -> Vec<Bytes> {
        let mut reports = Vec::new();
        self.receiver.report(now, self.min_delay, &mut reports);
        reports
    }
}

/// Bits that distinguish all forms.
const FORM_BITS: u64 = SymbolCounts::CODES[1].next_power_of_two().ilog2() as u64;

/// Forms and numbers of a datagram, if it holds updates.
pub(crate) fn tally(datagram: &[u8]) -> Option<SymbolCounts> {
    let mut reader = Reader::new(datagram);
    let head = Head::decode(&mut reader).ok()?;
    let packet = match head.kind {
        PacketKind::Updates => UpdatePacket::decode(false, reader),
        PacketKind::UpdatesEnd => UpdatePacket::decode(true, reader),
        PacketKind::UpdatesOverBudget => UpdatePacket::decode_over_budget(reader),
        _ => return None,
    };
    let packet = packet.ok()?;
    let mut updates = Vec::new();
    packet.updates(&mut updates).ok()?;
    Some(SymbolCounts::of(&updates))
}

/// Size of a datagram, bytes, if each form took a fixed-length code and each number an Exp-Golomb code. Signs, ids and
/// keyframes are plain bits in either case.
fn plain_len(datagram: &[u8]) -> u64 {
    let length = datagram.len() as u64;
    let Some(tally) = tally(datagram) else {
        return length;
    };
    let numbers = tally.numbers.iter().map(|(_, number)| exp_golomb(*number));
    let plain = tally.codes.len() as u64 * FORM_BITS + numbers.sum::<u64>();
    (length * 8 + plain)
        .saturating_sub(tally.coded() / 256)
        .div_ceil(8)
}

/// Bits of a number's Exp-Golomb code of order 0.
fn exp_golomb(number: u32) -> u64 {
    u64::from(2 * (u64::from(number) + 1).ilog2() + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_golomb_codes_have_their_defined_length() {
        let lengths = [0, 1, 2, 3, 6, 7, u32::MAX].map(exp_golomb);
        assert_eq!(lengths, [1, 3, 3, 5, 5, 7, 65]);
    }

    #[test]
    fn other_datagrams_keep_their_length() {
        assert_eq!(plain_len(b"no packet at all"), 16);
        assert_eq!(plain_len(&[]), 0);
    }
}
