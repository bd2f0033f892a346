//! Topics of one run: its frames, its packets, its copy as a scene.

use std::io::{Seek, Write};

use mcap::McapError;
use rhumb_trace::{
    Color, DrawnTopics, GridHistory, PoseBase, Poses, Schema, Topic, TraceFile, TraceSink,
};

use super::bodies::{Bodies, Body, CopiedBodies};
use super::figures::{breach_message, packet_message, stats_message};
use super::names::direction_name;
use super::options::TraceOptions;
use super::time::Time;
use crate::record::{Frame, Load, Mode, PacketDirection, Run};

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
