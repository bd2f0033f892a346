//! A free-running scene, subscribed to in real time over the configured link.
//!
//! A second client with a direct link receives the full stream: every state of every tick, bit exact. This is the
//! truth. The measured client shows whole ticks without smoothing, so its errors are those of the prediction alone.

use std::collections::BTreeMap;
use std::time::Duration;

use rhumb_netsim::LinkConfig;
use rhumb_protocol::packet::{FullPacket, Head, PacketKind};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Shape, ShapeId, Stepping};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, BodyState, Metres, Tick, Ticks, Tolerance};
use rhumb_sims::Script;
use rhumb_trace::SceneFacts;
use rhumb_transport::Clock;

use super::compare::{RecentTruth, TrueBody};
use super::remote::{Remote, Setup};
use super::side_by_side::Plan;
use super::{DriveError, ServerProcess};
use crate::record::{CapturedPacket, Load, Mode, PacketDirection, Placed, Run, Truth};

/// Bodies as the script created them, by index.
#[derive(Debug, Default)]
struct ScriptedBodies {
    shapes: BTreeMap<ShapeId, Shape>,
    bodies: BTreeMap<u32, (BodyDesc, Shape)>,
}

impl ScriptedBodies {
    fn track(&mut self, command: &Command, tick: Tick, truth: &mut Truth) {
        match *command {
            Command::AddShape { id, ref shape } => {
                self.shapes.insert(id, shape.clone());
            }
            Command::AddBody { desc, motion } => {
                if let Some(shape) = self.shapes.get(&desc.shape).cloned() {
                    self.bodies.insert(desc.id.index(), (desc, shape.clone()));
                    let observation = Observation {
                        id: desc.id,
                        motion,
                        activity: Activity::Awake,
                    };
                    truth.placed.push(Placed {
                        tick,
                        desc,
                        shape,
                        observation,
                        inertia: None,
                    });
                }
            }
            Command::RemoveBody { id } => {
                self.bodies.remove(&id.index());
                truth.removed.push((tick, id));
            }
            _ => {}
        }
    }
}

/// The truth as decoded from the full stream.
#[derive(Debug, Default)]
struct TruthStream {
    states: BTreeMap<u32, BodyState>,
    /// States changed so far in the tick being received; one tick may arrive in several packets.
    changed: BTreeMap<u32, Observation>,
    tick: u64,
    recent: RecentTruth,
}

impl TruthStream {
    /// Decodes the datagrams of the full stream, tick by tick. Calls `known` after each complete tick.
    fn receive(
        &mut self,
        captured: &[CapturedPacket],
        scripted: &ScriptedBodies,
        truth: &mut Truth,
        known: &mut dyn FnMut(&RecentTruth),
    ) {
        for datagram in captured
            .iter()
            .filter(|captured| captured.direction == PacketDirection::StateDown)
        {
            let mut reader = Reader::new(&datagram.bytes);
            let ends_tick = match Head::decode(&mut reader) {
                Ok(Head {
                    kind: PacketKind::Full,
                    ..
                }) => false,
                Ok(Head {
                    kind: PacketKind::FullEnd,
                    ..
                }) => true,
                _ => continue,
            };
            let Ok(packet) = FullPacket::decode(ends_tick, reader) else {
                continue;
            };
            for record in &packet.records {
                let before = self.states.insert(record.index, record.motion);
                if let Some((desc, _)) = scripted.bodies.get(&record.index)
                    && before != Some(record.motion)
                {
                    let observation = Observation {
                        id: desc.id,
                        motion: record.motion,
                        activity: activity(desc, &record.motion),
                    };
                    self.changed.insert(record.index, observation);
                }
            }
            if ends_tick {
                self.tick = packet.tick.expand(self.tick);
                self.end_tick(scripted, truth);
                known(&self.recent);
            }
        }
    }

    fn end_tick(&mut self, scripted: &ScriptedBodies, truth: &mut Truth) {
        let rows = self.tick as usize;
        truth.ticks.resize(rows.max(truth.ticks.len()), Vec::new());
        if let Some(row) = rows
            .checked_sub(1)
            .and_then(|place| truth.ticks.get_mut(place))
        {
            row.extend(std::mem::take(&mut self.changed).into_values());
        }
        let known = scripted.bodies.values().map(|(desc, shape)| {
            let motion = *self.states.get(&desc.id.index())?;
            Some(known(desc.id, motion, shape.bounding_radius(), desc))
        });
        self.recent.push(Tick::new(self.tick), known);
    }
}

/// A full stream carries no sleep flag. The engine sets the velocity of a sleeping body to exactly zero, and an awake
/// body almost never has exactly zero velocity.
fn activity(desc: &BodyDesc, motion: &BodyState) -> Activity {
    match desc.kind {
        BodyKind::Dynamic if *motion == motion.stilled() => Activity::Asleep,
        _ => Activity::Awake,
    }
}

fn known(id: BodyId, motion: BodyState, radius: Metres, desc: &BodyDesc) -> TrueBody {
    TrueBody {
        id,
        motion,
        radius,
        kind: desc.kind,
        tolerance_scale: desc.tolerance_scale,
    }
}

/// A measured client of the free-running server.
struct MeasuredClient {
    mode: Mode,
    remote: Remote,
    tolerance: Option<Tolerance>,
}

/// Runs all free-running modes of a plan in real time, for as long as the plan's ticks take.
///
/// # Errors
///
/// [`DriveError`] names the failure; a run that fails leaves no results.
pub fn run_free(plan: &Plan, progress: &mut dyn FnMut(Tick)) -> Result<Load, DriveError> {
    let mut script = plan.script()?;
    let setup = |mode, script: &dyn Script| {
        let mut setup = plan.setup(mode, script);
        (setup.config.stepping, setup.config.publish_schedule) =
            (Stepping::FreeRunning, plan.publish_schedule);
        setup
    };
    let clean = Setup {
        link: &LinkConfig::PERFECT,
        delay: Ticks::ZERO,
        ..setup(Mode::NaiveFree, &*script)
    };
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    let process = ServerProcess::start(&clean.cpu, clean.controller_script.as_ref())?;
    let mut measured = Vec::new();
    for mode in plan.modes.iter().filter(|mode| mode.is_free()) {
        let mut remote = Remote::join(&process, &setup(*mode, &*script))?;
        if measured.is_empty() {
            remote.reserve(&commands)?;
        }
        measured.push(MeasuredClient {
            mode: *mode,
            remote,
            tolerance: (*mode == Mode::RhumbFree).then_some(plan.tolerance),
        });
    }
    let mut free_run = FreeRun {
        truth_client: Remote::join(&process, &clean)?,
        truth_stream: TruthStream::default(),
        scripted: ScriptedBodies::default(),
        truth: Truth::default(),
        measured,
    };
    free_run.prepare(&commands)?;
    let step = Span::from_nanos(clean.config.integrator.rate.step_ns());
    let clock = Clock::start();
    let mut due = clock.now();
    for number in 0..u64::from(plan.ticks) {
        free_run.frame(&mut *script, number, until(&clock, due))?;
        progress(Tick::new(number));
        due = due + step;
    }
    free_run.catch_up()?;
    free_run.into_load(plan, clean.config.integrator.rate.step().seconds())
}

/// The clients of a free-running server: the measured ones and the one that records the truth.
struct FreeRun {
    /// The first one sends the script's commands.
    measured: Vec<MeasuredClient>,
    truth_client: Remote,
    truth_stream: TruthStream,
    scripted: ScriptedBodies,
    truth: Truth,
}

impl FreeRun {
    /// Sends the commands before the first frame; all traffic so far counts as joining.
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        for command in commands {
            self.scripted.track(command, Tick::ZERO, &mut self.truth);
        }
        if let Some((first, others)) = self.measured.split_first_mut() {
            first.remote.prepare(commands)?;
            for copy in others {
                copy.remote.begin()?;
            }
        }
        Ok(())
    }

    /// Waits until `due`, then takes one frame of every measured client.
    fn frame(
        &mut self,
        script: &mut dyn Script,
        number: u64,
        timeout: Duration,
    ) -> Result<(), DriveError> {
        let mut commands = Vec::new();
        script.commands(Tick::new(number + 1), &mut commands);
        for (place, copy) in self.measured.iter_mut().enumerate() {
            if place == 0 {
                copy.remote.client().idle(timeout)?;
            }
            let tick = copy.remote.update_view()?;
            copy.remote.keep();
            for command in commands.drain(..) {
                self.scripted.track(&command, tick, &mut self.truth);
                copy.remote.client().command(command)?;
            }
        }
        self.receive_truth()?;
        Ok(())
    }

    /// Receives new truth and computes the errors it allows; returns the number of frames still pending.
    fn receive_truth(&mut self) -> Result<usize, DriveError> {
        self.truth_client.client().idle(Duration::from_millis(1))?;
        self.truth_client.update_view()?;
        self.truth_client.frames.clear();
        let captured = std::mem::take(&mut self.truth_client.captured);
        let (measured, mut left) = (&mut self.measured, 0);
        let mut record_errors = |recent: &RecentTruth| {
            let kept = measured
                .iter_mut()
                .map(|copy| copy.remote.record_pending_errors(recent, copy.tolerance));
            left = kept.sum();
        };
        self.truth_stream.receive(
            &captured,
            &self.scripted,
            &mut self.truth,
            &mut record_errors,
        );
        Ok(left)
    }

    /// Waits until the truth of the last frames is known.
    fn catch_up(&mut self) -> Result<(), DriveError> {
        for _ in 0..CATCH_UP_MS {
            if self.receive_truth()? == 0
                && self
                    .measured
                    .iter()
                    .all(|copy| copy.remote.has_no_pending())
            {
                break;
            }
        }
        Ok(())
    }

    fn into_load(mut self, plan: &Plan, step_s: f64) -> Result<Load, DriveError> {
        let mut runs = Vec::new();
        for copy in &mut self.measured {
            let remote = &mut copy.remote;
            let inspection = remote.inspect()?;
            // The scene runs on between two inspections, but all clients share one engine: the first digest serves for
            // all.
            if runs.is_empty() {
                self.truth.digest = inspection.truth;
            }
            runs.push(Run {
                config: plan.run_config(copy.mode, step_s),
                truth_checksum: self.truth.digest,
                frames: std::mem::take(&mut remote.frames),
                captured: std::mem::take(&mut remote.captured),
                join: remote.join,
                breaches: std::mem::take(&mut remote.breaches),
                recoveries: Vec::new(),
                step_ns_p50: inspection.times.step_median,
                step_ns_p99: inspection.times.step_p99,
                step_ns_total: inspection.times.step_total,
                publish_ns_total: inspection.times.publish_total + inspection.times.observe_total,
                mismatches: remote.mismatches(),
            });
        }
        Ok(Load {
            facts: SceneFacts::of(&plan.script()?.config()),
            truth: self.truth,
            runs,
            unfinished: Vec::new(),
        })
    }
}

/// Longest wait for the truth of the last frames, in milliseconds.
const CATCH_UP_MS: u32 = 5_000;

fn until(clock: &Clock, due: Instant) -> Duration {
    Duration::from_nanos(due.since(clock.now()).as_nanos())
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::packet::{FullRecord, Low16, StreamId};
    use rhumb_protocol::scene::BodyKind;

    use super::*;

    fn motion(x: f32) -> BodyState {
        BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
            .expect("these numbers are finite")
    }

    fn packet(tick: u64, body: u32, ends_tick: bool) -> CapturedPacket {
        let packet = FullPacket {
            number: Low16::of(tick),
            tick: Low16::of(tick),
            scene_events: Low16::of(0),
            ends_tick,
            records: vec![FullRecord {
                index: body,
                motion: motion(tick as f32),
            }],
        };
        let datagram = packet.encode(StreamId(0));
        CapturedPacket::new(0, PacketDirection::StateDown, datagram.into())
    }

    /// Regression test: states received before the end of their tick were missing when a read fell in between.
    #[test]
    fn a_tick_received_in_pieces_is_complete() {
        let (mut truth_stream, mut scripted, mut truth) = (
            TruthStream::default(),
            ScriptedBodies::default(),
            Truth::default(),
        );
        let shape = Shape::Ball { radius: 0.5 };
        for body in 0..2 {
            let id = BodyId::new(body, 0);
            let desc = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0));
            scripted.bodies.insert(body, (desc, shape.clone()));
        }
        for piece in [packet(1, 0, false), packet(1, 1, true)] {
            truth_stream.receive(&[piece], &scripted, &mut truth, &mut |_| ());
        }
        let places = truth.ticks[0]
            .iter()
            .map(|observation| observation.id.index());
        assert_eq!(places.collect::<Vec<_>>(), [0, 1]);
    }
}
