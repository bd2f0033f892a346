//! Topics of one run: its frames, packets and bodies, its copy as a scene.
//!
//! Log time is tick times step, from zero, so truth and all modes align. Poses at each tick, in the engine and in a client's
//! copy, come from replaying the record forward, one tick or frame at a time.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use bytes::Bytes;
use glam::{DQuat, DVec3};
use mcap::McapError;
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, Divergence, Pose, Rate, Tick};
use rhumb_trace::{
    BreachMessage, Color, DrawnBody, DrawnTopics, GridHistory, Packet, PoseBase, Poses, Schema,
    TickStats, Topic, TraceFile, TraceSink, log_time_ns,
};

use crate::numbers::rank;
use crate::record::{
    Breach, CapturedPacket, Cause, Change, Changes, Frame, Load, Mode, PacketDirection, Placed,
    Run, Truth,
};

/// A body at one tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body<'a> {
    /// Its placement.
    pub(super) placed: &'a Placed,
    /// Centre of mass, world frame, metres.
    pub(super) position: [f32; 3],
    /// Quaternion x, y, z, w.
    pub(super) rotation: [f32; 4],
    /// True if the body is at rest.
    pub(super) still: bool,
}

impl<'a> Body<'a> {
    fn begin(placed: &'a Placed) -> Self {
        Self {
            placed,
            position: placed.observation.motion.position(),
            rotation: placed.observation.motion.rotation(),
            still: placed.observation.activity == Activity::Asleep,
        }
    }

    /// The body as it is drawn.
    pub(super) const fn drawn(&self) -> DrawnBody<'a> {
        DrawnBody {
            id: self.id(),
            shape: &self.placed.shape,
            position: self.position,
            rotation: self.rotation,
            still: self.still,
        }
    }

    pub(super) const fn id(&self) -> BodyId {
        self.placed.desc.id
    }

    pub(super) fn is_static(&self) -> bool {
        self.placed.desc.kind == BodyKind::Fixed
    }

    /// Upper bound of the distance between any surface point and the same point of `other`, metres.
    pub(super) fn surface_error_m(&self, other: &Self) -> f64 {
        let divergence = Divergence::between(&self.pose(), &other.pose());
        divergence
            .surface_error(self.placed.shape.bounding_radius())
            .metres()
    }

    fn pose(&self) -> Pose {
        Pose {
            position: DVec3::from_array(self.position.map(f64::from)),
            rotation: DQuat::from_array(self.rotation.map(f64::from)).normalize(),
        }
    }
}

/// Bodies by index.
#[derive(Clone, Debug, Default)]
pub(super) struct Bodies<'a> {
    slots: Vec<Option<Body<'a>>>,
}

impl<'a> Bodies<'a> {
    pub(super) fn iter(&self) -> impl Iterator<Item = &Body<'a>> {
        self.slots.iter().flatten()
    }

    pub(super) fn find(&self, id: BodyId) -> Option<&Body<'a>> {
        let body = self.slots.get(id.index() as usize)?.as_ref()?;
        (body.id() == id).then_some(body)
    }

    fn find_mut(&mut self, id: BodyId) -> Option<&mut Body<'a>> {
        let body = self.slots.get_mut(id.index() as usize)?.as_mut()?;
        (body.id() == id).then_some(body)
    }

    fn place(&mut self, placed: &'a Placed) {
        let index = placed.desc.id.index() as usize;
        if index >= self.slots.len() {
            self.slots.resize(index + 1, None);
        }
        self.slots[index] = Some(Body::begin(placed));
    }

    fn remove(&mut self, id: BodyId) {
        if self.find(id).is_some() {
            self.slots[id.index() as usize] = None;
        }
    }
}

/// The engine's bodies.
#[derive(Debug)]
pub(super) struct TruthBodies<'a> {
    truth: &'a Truth,
    pub(super) bodies: Bodies<'a>,
    placed: usize,
    removed: usize,
    /// Those that are not applied yet.
    changes: Changes<'a>,
}

/// Changes of the engine's bodies in one tick.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TickChanges<'a> {
    /// Observations made by the tick's step.
    pub(super) observed: &'a [Observation],
    /// Placed after the step: present from the next tick on.
    pub(super) placed: &'a [Placed],
    /// Removed after the step: absent from the next tick on.
    pub(super) removed: &'a [(Tick, BodyId)],
    /// True if a static body was placed or removed since the tick before.
    pub(super) statics_changed: bool,
}

impl<'a> TruthBodies<'a> {
    pub(super) fn new(truth: &'a Truth) -> Self {
        Self {
            truth,
            bodies: Bodies::default(),
            placed: 0,
            removed: 0,
            changes: truth.changes(),
        }
    }

    /// Advances to `tick`, which must be the next one.
    pub(super) fn step(&mut self, tick: Tick) -> TickChanges<'a> {
        let truth = self.truth;
        let before = tick.value().checked_sub(1).map(Tick::new);
        let mut statics_changed = before.is_some_and(|before| self.apply_changes(before));
        let row = tick
            .value()
            .checked_sub(1)
            .and_then(|row| truth.ticks.get(row as usize));
        let observed = row.map_or(&[][..], Vec::as_slice);
        for observation in observed {
            if let Some(body) = self.bodies.find_mut(observation.id) {
                body.position = observation.motion.position();
                body.rotation = observation.motion.rotation();
                body.still = observation.activity == Activity::Asleep;
            }
        }
        let removed = &truth.removed[self.removed..];
        let removed = &removed[..removed.partition_point(|(when, _)| *when <= tick)];
        let placed = &truth.placed[self.placed..];
        let placed = &placed[..placed.partition_point(|placed| placed.tick <= tick)];
        self.removed += removed.len();
        self.placed += placed.len();
        if tick == Tick::ZERO {
            // Bodies placed before the first step are present at tick 0.
            statics_changed |= self.apply_changes(tick);
        }
        TickChanges {
            observed,
            placed,
            removed,
            statics_changed,
        }
    }

    /// Applies placements and removals up to a tick; returns whether one of them was static.
    fn apply_changes(&mut self, until: Tick) -> bool {
        let mut statics = false;
        while let Some(change) = self.changes.until(until) {
            match change {
                Change::Placed(_, placed) => {
                    statics |= placed.desc.kind == BodyKind::Fixed;
                    self.bodies.place(placed);
                }
                Change::Removed(id) => {
                    statics |= self.bodies.find(id).is_some_and(Body::is_static);
                    self.bodies.remove(id);
                }
            }
        }
        statics
    }
}

/// A client's copy of the bodies.
#[derive(Debug)]
struct CopiedBodies<'a> {
    truth: &'a Truth,
    placed_by_id: BTreeMap<BodyId, &'a Placed>,
    bodies: Bodies<'a>,
    placed: usize,
}

impl<'a> CopiedBodies<'a> {
    fn new(truth: &'a Truth) -> Self {
        Self {
            truth,
            placed_by_id: truth
                .placed
                .iter()
                .map(|placed| (placed.desc.id, placed))
                .collect(),
            bodies: Bodies::default(),
            placed: 0,
        }
    }

    /// Applies a frame. A body that was placed at tick 0 or before the frame's tick, and that no frame mentions,
    /// stands at its placement.
    fn show(&mut self, frame: &Frame) {
        let truth = self.truth;
        let placed = &truth.placed[self.placed..];
        let placed = &placed[..placed
            .partition_point(|placed| placed.tick == Tick::ZERO || placed.tick < frame.tick)];
        self.placed += placed.len();
        for placed in placed {
            self.bodies.place(placed);
        }
        for id in &frame.removed {
            self.bodies.remove(*id);
        }
        for pose in &frame.changed {
            if self.bodies.find(pose.id).is_none()
                && let Some(placed) = self.placed_by_id.get(&pose.id)
            {
                self.bodies.place(placed);
            }
            if let Some(body) = self.bodies.find_mut(pose.id) {
                body.position = pose.position;
                body.rotation = pose.rotation;
                body.still = pose.resting;
            }
        }
    }
}

/// A run that is being written.
pub(super) struct RunTopics<'a> {
    run: &'a Run,
    time: Time,
    stats: Topic,
    breaches: Topic,
    poses: Topic,
    wire: [(PacketDirection, Topic); 4],
    scene: Option<DrawnTopics>,
    /// The last poses of the topic `seen`.
    history: GridHistory,
    copy: CopiedBodies<'a>,
    reference_m: f64,
    /// True if the stream has a tolerance: one without is the truth once more, and so are its packets.
    has_tolerance: bool,
    frames: usize,
    captured: usize,
    breached: usize,
    drawn: Option<u64>,
}

impl<'a> RunTopics<'a> {
    pub(super) fn new(prefix: &str, load: &'a Load, run: &'a Run, options: &TraceOptions) -> Self {
        let time = Time::of(load.facts.integrator.rate, options);
        let topic = |name: &str, schema| Topic::new(format!("{prefix}/{name}"), schema);
        let drawn = run.config.mode != Mode::Integrated && options.draws(load);
        let directions = [
            PacketDirection::StateDown,
            PacketDirection::StateUp,
            PacketDirection::ControlDown,
            PacketDirection::ControlUp,
        ];
        Self {
            run,
            time,
            stats: topic("stats", Schema::Own("rhumb.TickStats")),
            breaches: topic("breaches", Schema::Own("rhumb.Breach")),
            poses: topic("seen", Schema::Own("rhumb.Poses")),
            wire: directions.map(|direction| {
                let name = format!("wire/{}", direction_name(direction));
                (direction, topic(&name, Schema::Wire("rhumb.Packet")))
            }),
            scene: drawn.then(|| DrawnTopics::new(prefix, time.rest_delay_ticks())),
            history: GridHistory::default(),
            copy: CopiedBodies::new(&load.truth),
            has_tolerance: run.config.tolerance_m.is_some(),
            reference_m: run.config.tolerance_m.unwrap_or(REFERENCE_M),
            frames: 0,
            captured: 0,
            breached: 0,
            drawn: None,
        }
    }

    /// Writes all frames that show `tick` or an earlier tick; `truth` is the engine's at `tick`.
    pub(super) fn write_through<W: Write + Seek>(
        &mut self,
        file: &mut TraceFile<W>,
        tick: u64,
        truth: &Bodies<'_>,
    ) -> Result<(), McapError> {
        while let Some(frame) = self.run.frames.get(self.frames)
            && frame.tick.value() <= tick
        {
            self.write_frame(file, frame, truth)?;
            self.frames += 1;
        }
        while let Some(breach) = self.run.breaches.get(self.breached)
            && breach.tick.value() <= tick
        {
            let at_ns = self.time.at_ns(breach.tick.value());
            file.put(&mut self.breaches, at_ns, &breach_message(breach))?;
            self.breached += 1;
        }
        Ok(())
    }

    /// Writes the packets captured after the last frame.
    pub(super) fn end<W: Write + Seek>(
        &mut self,
        file: &mut TraceFile<W>,
    ) -> Result<(), McapError> {
        if let Some(last) = self.run.frames.last() {
            self.write_captured(file, u32::MAX, last)?;
        }
        Ok(())
    }

    fn write_frame<W: Write + Seek>(
        &mut self,
        file: &mut TraceFile<W>,
        frame: &Frame,
        truth: &Bodies<'_>,
    ) -> Result<(), McapError> {
        let number = self.frames as u32;
        let tick = frame.tick.value();
        let at_ns = self.time.at_ns(tick);
        let payload = self.write_captured(file, number, frame)?;
        file.put(
            &mut self.stats,
            at_ns,
            &stats_message(number, frame, payload),
        )?;
        if !frame.changed.is_empty() || !frame.removed.is_empty() {
            let poses = self.seen(number, frame, truth);
            file.put(&mut self.poses, at_ns, &poses)?;
        }
        if let Some(scene) = &mut self.scene {
            self.copy.show(frame);
            let last = self.frames + 1 == self.run.frames.len();
            if self
                .drawn
                .is_none_or(|drawn| self.time.draws_after(drawn, tick))
                || last
            {
                self.drawn = Some(tick);
                let bodies = with_errors(&self.copy.bodies, truth);
                let painted: Vec<_> = bodies
                    .iter()
                    .map(|(body, error_m)| (body.drawn(), error_color(error_m / self.reference_m)))
                    .collect();
                scene.draw(file, (tick, at_ns), &painted)?;
            }
        }
        Ok(())
    }

    /// The poses that changed in a frame.
    fn seen(&mut self, number: u32, frame: &Frame, truth: &Bodies<'_>) -> Poses {
        let changed = frame.changed.iter();
        let changed: Vec<_> = changed
            .map(|pose| (pose.id, pose.position, pose.rotation, pose.resting))
            .collect();
        let real = |id| truth.find(id).map(|body| (body.position, body.rotation));
        let base = if self.has_tolerance {
            PoseBase::History(&mut self.history)
        } else {
            PoseBase::Truth(&real)
        };
        Poses {
            tick: frame.tick.value(),
            frame: number,
            gone_index: frame.removed.iter().map(|id| id.index()).collect(),
            gone_generation: (frame.removed.iter())
                .map(|id| id.generation().into())
                .collect(),
            ..Poses::of(&changed, base)
        }
    }

    /// Writes the packets captured up to and including a frame; returns their counted bytes down.
    fn write_captured<W: Write + Seek>(
        &mut self,
        file: &mut TraceFile<W>,
        number: u32,
        frame: &Frame,
    ) -> Result<u64, McapError> {
        let mut down = 0;
        let at_ns = self.time.at_ns(frame.tick.value());
        while let Some(captured) = self.run.captured.get(self.captured)
            && captured.frame <= number
        {
            self.captured += 1;
            if matches!(
                captured.direction,
                PacketDirection::StateDown | PacketDirection::ControlDown
            ) {
                down += captured.counted;
            }
            for (direction, topic) in &mut self.wire {
                if *direction == captured.direction {
                    let keeps = *direction != PacketDirection::StateDown || self.has_tolerance;
                    let packet = packet_message(frame.tick, captured, keeps);
                    file.put(topic, at_ns, &packet)?;
                }
            }
        }
        Ok(down)
    }
}

/// Reference for colouring errors of a run without a tolerance, metres.
const REFERENCE_M: f64 = 0.05;

/// The copy's non-static bodies with their errors in metres. A body counts as still only if it is still in both
/// worlds.
fn with_errors<'a>(copy: &Bodies<'a>, truth: &Bodies<'_>) -> Vec<(Body<'a>, f64)> {
    let moving = copy.iter().filter(|body| !body.is_static());
    moving
        .map(|body| {
            let real = truth.find(body.id());
            let error_m = real.map_or(0.0, |real| body.surface_error_m(real));
            let still = body.still && real.is_some_and(|real| real.still);
            (Body { still, ..*body }, error_m)
        })
        .collect()
}

/// Steps of the colour up to the tolerance.
const COLORS: f64 = 32.0;

/// Blue at no error, yellow at half the tolerance, red at the tolerance, violet beyond.
fn error_color(share: f64) -> Color {
    // An eye tells some thirty-two colours apart, and equal ones take few bytes.
    let share = (share * COLORS).ceil() / COLORS;
    const NONE: [f64; 3] = [0.20, 0.55, 0.85];
    const HALF: [f64; 3] = [0.95, 0.78, 0.15];
    const FULL: [f64; 3] = [0.88, 0.15, 0.12];
    const OVER: [f64; 3] = [0.75, 0.10, 0.85];
    let mix = |from: [f64; 3], to: [f64; 3], part: f64| {
        let [r, g, b] = std::array::from_fn(|i| from[i] + (to[i] - from[i]) * part);
        Color { r, g, b, a: 1.0 }
    };
    match share {
        share if share > 1.0 => mix(OVER, OVER, 0.0),
        share if share > 0.5 => mix(HALF, FULL, share * 2.0 - 1.0),
        share => mix(NONE, HALF, share * 2.0),
    }
}

/// The figures of a frame.
fn stats_message(number: u32, frame: &Frame, payload_bytes_down: u64) -> TickStats {
    let exact = frame.exact as usize;
    let count = exact + frame.errors_m.len();
    let error = |percent| {
        let place = rank(percent, count)?.checked_sub(exact)?;
        frame.errors_m.get(place).copied().map(f64::from)
    };
    TickStats {
        tick: frame.tick.value(),
        frame: number,
        frame_ns: frame.frame_ns,
        wire_bytes_down: frame.wire_bytes_down,
        wire_bytes_up: frame.wire_bytes_up,
        wire_datagrams_down: frame.wire_datagrams_down,
        wire_datagrams_up: frame.wire_datagrams_up,
        payload_bytes_down,
        updates: frame.updates,
        body_ticks: count as u64,
        error_m_p50: error(50).unwrap_or(0.0),
        error_m_p99: error(99).unwrap_or(0.0),
        error_m_max: error(100).unwrap_or(0.0),
    }
}

fn breach_message(breach: &Breach) -> BreachMessage {
    BreachMessage {
        tick: breach.tick.value(),
        index: breach.id.index(),
        generation: u32::from(breach.id.generation()),
        error_m: breach.error_m,
        tolerance_m: breach.tolerance_m,
        cause: match breach.cause {
            Cause::Loss => 1,
            Cause::Late => 2,
            Cause::Fault => 3,
            Cause::Budget => 4,
        },
    }
}

/// A packet with its bytes, or with their number alone.
fn packet_message(tick: Tick, captured: &CapturedPacket, keeps_bytes: bool) -> Packet {
    Packet {
        tick: tick.value(),
        frame: captured.frame,
        direction: match captured.direction {
            PacketDirection::StateDown => 1,
            PacketDirection::StateUp => 2,
            PacketDirection::ControlDown => 3,
            PacketDirection::ControlUp => 4,
        },
        data: if keeps_bytes {
            captured.bytes.clone()
        } else {
            Bytes::new()
        },
        length: captured.bytes.len() as u32,
    }
}

/// The parts of a trace that are drawn for viewers; the data topics are always complete.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TraceOptions {
    /// Scenes drawn per simulated second.
    pub scene_hz: f64,
    /// Seconds that a body lies still before it is drawn on the `resting` topic.
    pub resting_after_s: f64,
    /// Loads with more bodies are not drawn: a drawn body takes about 20 bytes each time.
    pub scene_bodies_max: u32,
}

impl Default for TraceOptions {
    fn default() -> Self {
        Self {
            scene_hz: 30.0,
            resting_after_s: 0.5,
            scene_bodies_max: 1_000,
        }
    }
}

impl TraceOptions {
    pub(super) fn draws(&self, load: &Load) -> bool {
        load.runs
            .first()
            .is_some_and(|run| run.config.bodies <= self.scene_bodies_max)
    }
}

/// Maps a load's ticks to log times and selects the ticks to draw.
#[derive(Clone, Copy, Debug)]
pub(super) struct Time {
    rate: Rate,
    stride: u64,
    rest_delay_s: f64,
}

impl Time {
    pub(super) fn of(rate: Rate, options: &TraceOptions) -> Self {
        let step_s = rate.step().seconds();
        Self {
            rate,
            stride: (1.0 / (step_s * options.scene_hz)).round().max(1.0) as u64,
            rest_delay_s: options.resting_after_s,
        }
    }

    /// Log time of a tick, nanoseconds.
    pub(super) fn at_ns(&self, tick: u64) -> u64 {
        log_time_ns(self.rate, tick)
    }

    /// True if a tick is to be drawn if `drawn` was the last drawn one.
    pub(super) const fn draws_after(&self, drawn: u64, tick: u64) -> bool {
        tick / self.stride > drawn / self.stride
    }

    /// Ticks that a body lies still before it is drawn on `resting`.
    pub(super) fn rest_delay_ticks(&self) -> u64 {
        (self.rest_delay_s / self.rate.step().seconds()).round() as u64
    }
}

/// Last part of the topic name for packets of one direction.
const fn direction_name(direction: PacketDirection) -> &'static str {
    match direction {
        PacketDirection::StateDown => "state-down",
        PacketDirection::StateUp => "state-up",
        PacketDirection::ControlDown => "control-down",
        PacketDirection::ControlUp => "control-up",
    }
}
