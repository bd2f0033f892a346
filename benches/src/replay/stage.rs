//! One replay: a publisher, two links and a listener in simulated time.
//!
//! The recording is published as a server publishes a free-running scene: notices before packets, vouching in silence,
//! repairs when asked. Bytes are counted as the server sends them, whether or not they arrive. The bodies that are there
//! at the beginning are known at both ends and cost nothing.

use std::fmt;

use bytes::Bytes;
use rhumb_protocol::message::{Notice, ServerMessage};
use rhumb_protocol::packet::{Echo, Head, Kind, StreamId};
use rhumb_protocol::scene::{BodyKind, Cadence};
use rhumb_protocol::stream::{Activity, Losses, Manner, Publisher, StreamTerms, Witness};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{Anchor, BodyId, Predictor, Rate, Tick, Ticks, Track};
use rhumb_transport::{Clock, Lane, Link};

use super::judge::Judge;
use super::listener::{Change, Listener, Start};
use super::plain::plain_len;
use super::terms::ReplayTerms;
use crate::record::{Frame, JoinCost, Passed, Placed, Run, Way};
use crate::recording::Recording;

/// Why a replay did not come to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReplayError {
    /// The recording has more bodies or kinds of damping than a stream can have, or removes one that is not there.
    Limits(Tick),
    /// So much was lost that a member would have to take a new snapshot, which a replay has none of.
    LostTouch(Tick),
    /// It is spoken of more seldom than once in the whole recording.
    TooSeldom(Tick),
    /// The stream did not vouch for the last tick within ten seconds after it.
    NoEnd,
}

impl fmt::Display for ReplayError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Limits(tick) => {
                write!(f, "a stream cannot have the recording's bodies at {tick}")
            }
            Self::LostTouch(tick) => write!(f, "so much was lost by {tick} that no repair helps"),
            Self::TooSeldom(last) => {
                write!(f, "nothing would be said: the recording ends at {last}")
            }
            Self::NoEnd => f.write_str("the last tick was not heard of within ten seconds"),
        }
    }
}

impl std::error::Error for ReplayError {}

/// What QUIC adds to a datagram of ours: a short header without connection id and with two bytes of packet number (3),
/// the frame's type and length (3), the tag (16). Acknowledgements and heartbeats are not counted.
const QUIC_BYTES: u64 = 22;

/// A silent stream vouches at least so often, as a server's (PROTOCOL 6.4).
const SILENCE_MS_MAX: u32 = 2_500;

/// Echoes that follow each other faster are not answered, as a server's (PROTOCOL 6.4).
const ECHO_PAUSE: Span = Span::from_millis(2);

/// How long after the last tick a replay goes on at most: ten seconds.
const END: Span = Span::from_millis(10_000);

const STREAM: StreamId = StreamId(0);

/// The only listener.
const LISTENER: u64 = 0;

/// Replays a recording; `progress` is called after each tick.
///
/// # Errors
///
/// [`ReplayError`]; nothing is kept of a replay that does not end.
pub fn run(
    recording: &Recording,
    terms: &ReplayTerms,
    progress: &mut dyn FnMut(Tick),
) -> Result<Run, ReplayError> {
    if terms.every.get() > recording.ticks() {
        let last = u64::from(recording.ticks());
        return Err(ReplayError::TooSeldom(Tick::new(last)));
    }
    let mut stage = Stage::new(recording, terms);
    stage.come_and_go(Tick::ZERO)?;
    stage.listener.subscriber.handle_snapshot_end();
    let rate = recording.integrator.rate;
    let last = u64::from(recording.ticks());
    for number in 1..=last + u64::from(terms.hindsight.count()) {
        let tick = Tick::new(number);
        let at = moment(rate, tick);
        stage.pass_until(at)?;
        stage.come_and_go(tick)?;
        stage.publish(at, tick);
        stage.pass_until(at)?;
        progress(tick);
    }
    stage.end(Tick::new(u64::from(recording.ticks())))?;
    Ok(stage.into_run())
}

/// The stream at its source, without bodies yet.
fn publisher(start: &Start, terms: &ReplayTerms) -> Publisher {
    let stream = StreamTerms {
        tolerance: start.tolerance,
        integrator: start.integrator,
        every: start.every,
        gravity: start.gravity,
        features: terms.means.publisher,
    };
    let mut publisher = Publisher::new(start.stream, &stream, Tick::ZERO);
    if let Some(budget) = terms.budget {
        publisher.limit(budget);
    }
    publisher
}

fn moment(rate: Rate, tick: Tick) -> Instant {
    Instant::from_nanos(tick.value() * rate.step_ns())
}

/// A packet that was lost, and who must be heard of again.
#[derive(Debug)]
struct Lost {
    at: Instant,
    tick: Tick,
    bodies: Vec<BodyId>,
}

#[derive(Debug)]
struct Stage<'a> {
    recording: &'a Recording,
    terms: &'a ReplayTerms,
    publisher: Publisher,
    witness: Witness,
    listener: Listener,
    judge: Judge<'a>,
    down: Link,
    up: Link,
    placed: usize,
    removed: usize,
    notices: u64,
    silent: u32,
    /// When the sum over all tracks was said last, and which.
    summed_up: (Tick, u64),
    losses: Losses,
    echoed: Option<Instant>,
    lost: Vec<Lost>,
    recoveries: Vec<Span>,
    clock: Clock,
    publish_ns: u64,
    frames: Vec<Frame>,
    passed: Vec<Passed>,
    /// What was sent since the last frame.
    sent: Frame,
    updates: u64,
}

impl<'a> Stage<'a> {
    fn new(recording: &'a Recording, terms: &'a ReplayTerms) -> Self {
        let start = Start {
            stream: STREAM,
            tolerance: terms.tolerance,
            integrator: recording.integrator,
            gravity: recording.gravity,
            every: terms.every,
        };
        let link = terms.link;
        let round_trip_ns = 2 * (link.delay.as_nanos() + link.jitter.as_nanos());
        Self {
            recording,
            terms,
            publisher: publisher(&start, terms),
            witness: Witness::new(Cadence {
                every: terms.every,
                hindsight: terms.hindsight,
            }),
            listener: Listener::new(&start, Span::from_nanos(round_trip_ns), terms.budget),
            judge: Judge::new(&recording.truth),
            down: Link::new(link, terms.seed),
            up: Link::new(link, !terms.seed),
            placed: 0,
            removed: 0,
            notices: 0,
            silent: 0,
            summed_up: (Tick::ZERO, 0),
            losses: Losses::default(),
            echoed: None,
            lost: Vec::new(),
            recoveries: Vec::new(),
            clock: Clock::start(),
            publish_ns: 0,
            frames: Vec::new(),
            passed: Vec::new(),
            sent: Frame::default(),
            updates: 0,
        }
    }

    /// Tells of what came and went before the step that leads to a tick; at tick 0 both ends know.
    fn come_and_go(&mut self, tick: Tick) -> Result<(), ReplayError> {
        let truth = &self.recording.truth;
        while let Some((when, id)) = truth.removed.get(self.removed)
            && *when < tick
        {
            self.removed += 1;
            self.publisher.remove(*id);
            let cause = rhumb_protocol::message::RemovalCause::Command;
            let notice = Notice::BodyRemoved { id: *id, cause };
            self.tell(tick, notice, Change::Removed(*id));
        }
        while let Some(placed) = truth.placed.get(self.placed)
            && (placed.tick < tick || tick == Tick::ZERO && placed.tick == tick)
        {
            self.placed += 1;
            let manner = self.recording.manner(placed);
            let track = first_track(placed, &manner);
            let id = placed.terms.id;
            let mut fits = self.publisher.place(id, &manner, track);
            if tick == Tick::ZERO {
                fits &= self.listener.subscriber.place(id, &manner, track);
            } else {
                let terms = placed.terms;
                let notice = Notice::BodyPlaced {
                    terms,
                    inertia: manner.inertia,
                    track,
                    seat: None,
                };
                self.tell(tick, notice, Change::Placed(id, manner, track));
            }
            if !fits {
                return Err(ReplayError::Limits(tick));
            }
        }
        Ok(())
    }

    fn tell(&mut self, tick: Tick, notice: Notice, change: Change) {
        let at = moment(self.recording.integrator.rate, tick);
        self.notices += 1;
        self.listener.told.push_back(change);
        let mut bytes = Vec::new();
        ServerMessage::Notice(notice).encode(&mut bytes);
        self.send_down(at, Bytes::from(bytes), Lane::Control);
    }

    /// One tick of the server: truth, belief, words.
    fn publish(&mut self, now: Instant, tick: Tick) {
        // With hindsight the last ticks are spoken of after the recording's end.
        let row = self.recording.truth.ticks.get(tick.value() as usize - 1);
        let mut packets = Vec::new();
        let begun = self.clock.now();
        self.witness
            .observe(tick, row.map_or(&[][..], |row| &row[..]));
        self.publisher
            .publish(&self.witness, self.notices, &mut packets);
        self.publish_ns += self.clock.now().since(begun).as_nanos();
        if self.witness.present().is_none() {
            return;
        }
        let losses = self.down.counts(Lane::State).lost.pieces;
        if packets.is_empty() {
            self.silent += 1;
            if self.vouches() {
                // A digest vouches too.
                let digest = self.due_digest(true);
                let vouch = digest.unwrap_or_else(|| self.publisher.vouch(self.notices));
                self.send_down(now, vouch, Lane::State);
            }
        } else {
            self.silent = 0;
            for packet in packets {
                self.send_down(now, packet, Lane::State);
            }
            self.note_lost(now, tick, losses);
            if let Some(digest) = self.due_digest(false) {
                self.send_down(now, digest, Lane::State);
            }
        }
        let redundancy = self.losses.redundancy(1, self.publisher.next_number());
        let mut parities = Vec::new();
        self.publisher.say_parities(redundancy, &mut parities);
        for parity in parities {
            self.send_down(now, parity, Lane::State);
        }
    }

    /// What says the sum over all tracks, as a server says it: each second, if it is another.
    fn due_digest(&mut self, silent: bool) -> Option<Bytes> {
        let publisher = &self.publisher;
        let (last, sum) = self.summed_up;
        let age = publisher.tick().since(last)?;
        let rate = self.recording.integrator.rate;
        let second = Ticks::new((rate.ticks() / rate.seconds()).max(1));
        // A digest states nothing of a budget's arrears: silence is vouched for by what does.
        let states_nothing = silent && self.terms.budget.is_some();
        if age < second || publisher.agreement() == sum || states_nothing {
            return None;
        }
        self.summed_up = (publisher.tick(), publisher.agreement());
        let digest = publisher.digest(self.notices);
        self.publisher.pay(digest.len());
        Some(digest)
    }

    /// Notes of which bodies nothing arrives that was just said, if more was lost than before.
    fn note_lost(&mut self, now: Instant, tick: Tick, losses: u64) {
        if self.down.counts(Lane::State).lost.pieces > losses {
            let said = self.publisher.tracks();
            let spoken = self.publisher.tick();
            let said = said.filter(|(_, track)| track.origin == spoken);
            let bodies = said.map(|(id, _)| id).collect();
            self.lost.push(Lost {
                at: now,
                tick,
                bodies,
            });
        }
    }

    /// Whether a stream that was silent for so long vouches: ever more rarely, within bounds.
    fn vouches(&self) -> bool {
        let rate = self.recording.integrator.rate;
        let within = rate.ticks() * SILENCE_MS_MAX / (1_000 * rate.seconds());
        let within = (within / self.terms.every).max(1);
        let doubled = self.silent.is_power_of_two() && self.silent < within;
        doubled || self.silent.is_multiple_of(within)
    }

    fn send_down(&mut self, now: Instant, bytes: Bytes, lane: Lane) {
        let counted = if self.terms.means.coder || lane == Lane::Control {
            bytes.len() as u64
        } else {
            plain_len(&bytes)
        };
        self.sent.wire_bytes_down += counted + QUIC_BYTES;
        self.sent.wire_datagrams_down += 1;
        let way = match lane {
            Lane::Control => Way::ControlDown,
            Lane::State => Way::StateDown,
        };
        self.keep(way, &bytes, counted);
        self.down.push(now, bytes, lane);
    }

    fn keep(&mut self, way: Way, bytes: &Bytes, counted: u64) {
        let frame = self.frames.len() as u32;
        let passed = Passed::new(frame, way, bytes.clone());
        self.passed.push(Passed { counted, ..passed });
    }

    /// Everything that the links and the listener do up to a moment.
    fn pass_until(&mut self, until: Instant) -> Result<(), ReplayError> {
        loop {
            let arrivals = [self.down.next_at(), self.up.next_at()];
            let next = arrivals
                .into_iter()
                .flatten()
                .fold(self.listener.due(), Instant::min);
            if next > until {
                return Ok(());
            }
            self.pass(next)?;
        }
    }

    fn pass(&mut self, now: Instant) -> Result<(), ReplayError> {
        while let Some((lane, bytes)) = self.down.pop(now) {
            match lane {
                Lane::State => self.listener.hear(now, &bytes),
                Lane::Control if self.listener.hear_notice(now) => {}
                Lane::Control => return Err(ReplayError::Limits(self.publisher.tick())),
            }
        }
        if self.listener.subscriber.has_lost_touch() {
            return Err(ReplayError::LostTouch(self.publisher.tick()));
        }
        self.recover(now);
        self.judge();
        if let Some(echo) = self.listener.ask(now) {
            let counted = echo.len() as u64;
            self.sent.wire_bytes_up += counted + QUIC_BYTES;
            self.sent.wire_datagrams_up += 1;
            self.keep(Way::StateUp, &echo, counted);
            self.up.push(now, echo, Lane::State);
        }
        while let Some((_, bytes)) = self.up.pop(now) {
            self.answer(now, &bytes);
        }
        Ok(())
    }

    /// The server answers an echo: repairs what was lost and vouches for what could not be known of.
    fn answer(&mut self, now: Instant, datagram: &[u8]) {
        if self.echoed.is_some_and(|last| now < last + ECHO_PAUSE) {
            return;
        }
        self.echoed = Some(now);
        let mut reader = Reader::new(datagram);
        let is_echo = Head::decode(&mut reader).is_ok_and(|head| head.kind == Kind::Echo);
        let echo = Echo::decode(reader).ok().filter(|_| is_echo);
        let mut datagrams = Vec::new();
        if let Some(echo) = echo {
            self.losses
                .hear(LISTENER, &echo, self.publisher.next_number());
            for number in self.publisher.answer(&echo, &mut datagrams) {
                datagrams.extend(
                    self.publisher
                        .repair(number, self.notices)
                        .unwrap_or_default(),
                );
            }
        }
        for datagram in datagrams {
            self.send_down(now, datagram, Lane::State);
        }
        let vouch = self.publisher.vouch(self.notices);
        self.send_down(now, vouch, Lane::State);
    }

    /// Notes which losses are made good by now: all of their bodies were heard of as of their tick or later, or went.
    fn recover(&mut self, now: Instant) {
        let copy = &self.listener.subscriber;
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

    /// Judges every tick that the stream has vouched for by now, and that was published.
    fn judge(&mut self) {
        let copy = &self.listener.subscriber;
        let every = u64::from(self.terms.every.get());
        while self.judge.tick() < copy.vouched() && self.judge.step() {
            let tick = self.judge.tick().value();
            if !tick.is_multiple_of(every) {
                continue;
            }
            let mut frame = self.judge.frame(copy, self.terms.tolerance);
            let updates = copy.statistics().updates;
            let sent = std::mem::take(&mut self.sent);
            frame.updates = updates - std::mem::replace(&mut self.updates, updates);
            add_wire(&mut frame, &sent);
            self.frames.push(frame);
        }
    }

    /// After the last tick: vouches until it was heard of.
    fn end(&mut self, last: Tick) -> Result<(), ReplayError> {
        let rate = self.recording.integrator.rate;
        let begun = moment(rate, last);
        let every = u64::from(self.terms.every.get());
        let due = Tick::new(last.value() / every * every);
        let mut now = begun;
        while self.judge.tick() < due || !self.lost.is_empty() {
            now = now + Span::from_nanos(4 * rate.step_ns());
            if now > begun + END {
                return Err(ReplayError::NoEnd);
            }
            self.pass_until(now)?;
            let vouch = self.publisher.vouch(self.notices);
            self.send_down(now, vouch, Lane::State);
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
            terms: self.terms.run_terms(self.recording),
            truth_digest: self.recording.truth.digest,
            frames: self.frames,
            passed: self.passed,
            join: JoinCost::default(),
            breaches: self.judge.breaches,
            recoveries: self.recoveries,
            step_ns_p50: 0,
            step_ns_p99: 0,
            step_ns_total: 0,
            publish_ns_total: self.publish_ns,
            mismatches: self.listener.subscriber.statistics().mismatches,
        }
    }
}

fn add_wire(frame: &mut Frame, sent: &Frame) {
    frame.wire_bytes_down += sent.wire_bytes_down;
    frame.wire_bytes_up += sent.wire_bytes_up;
    frame.wire_datagrams_down += sent.wire_datagrams_down;
    frame.wire_datagrams_up += sent.wire_datagrams_up;
}

/// What is believed of a body before anything was said of it, as a server's scene has it.
pub(crate) fn first_track(placed: &Placed, manner: &Manner) -> Track {
    let tumbles = manner.inertia.is_some();
    let predictor = match (placed.observation.activity, placed.terms.kind) {
        (Activity::Asleep, _) | (_, BodyKind::Static) => Predictor::Rest,
        (Activity::Awake, BodyKind::Dynamic) if tumbles => Predictor::Thrown,
        (Activity::Awake, BodyKind::Dynamic) => Predictor::Ballistic,
        (Activity::Awake, BodyKind::Kinematic) => Predictor::Uniform,
    };
    let motion = placed.observation.motion;
    let resting = predictor == Predictor::Rest;
    Track {
        origin: placed.tick,
        predictor,
        anchor: Anchor::Verbatim(if resting { motion.stilled() } else { motion }),
        carrier: None,
    }
}
