//! A free-running scene, followed in real time over the asked-for link.
//!
//! The truth comes from a second client without a link between, which takes the full stream: every state of every tick,
//! to the bit. The judged client shows whole ticks without glides, so that what is judged is the reckoning.

use std::collections::BTreeMap;
use std::time::Duration;

use rhumb_protocol::packet::{FullPacket, Head, PacketKind};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Shape, ShapeId, Stepping};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, BodyState, Metres, Tick, Ticks, Tolerance};
use rhumb_sims::Script;
use rhumb_transport::{Clock, LinkConfig};

use super::compare::{RecentTruth, TrueBody};
use super::remote::{Remote, Setup};
use super::side_by_side::Plan;
use super::{DriveError, ServerProcess};
use crate::record::{CapturedPacket, Load, Mode, PacketDirection, Placed, Run, Truth};

/// Bodies as the script made them, by index.
#[derive(Debug, Default)]
struct ScriptedBodies {
    shapes: BTreeMap<ShapeId, Shape>,
    bodies: BTreeMap<u32, (BodyDesc, Shape)>,
}

impl ScriptedBodies {
    fn note(&mut self, command: &Command, tick: Tick, truth: &mut Truth) {
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

/// The truth as the full stream tells it.
#[derive(Debug, Default)]
struct TruthStream {
    states: BTreeMap<u32, BodyState>,
    /// What the tick that is being heard of changed so far: it may come in several pieces.
    changed: BTreeMap<u32, Observation>,
    tick: u64,
    recent: RecentTruth,
}

impl TruthStream {
    /// Takes in the datagrams of the full stream, tick by tick.
    ///
    /// `known` is called after each tick that is whole.
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

/// A full stream does not say who sleeps; but an engine stills what it puts to sleep, and what it moves is hardly ever still
/// to the bit before.
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

/// A client of the free-running server that is judged.
struct JudgedClient {
    mode: Mode,
    remote: Remote,
    tolerance: Option<Tolerance>,
}

/// Follows a free-running scene for as long as the plan's ticks take, by every free-running mode of the plan.
///
/// # Errors
///
/// [`DriveError`] names what did not work; nothing is kept of a run that does not end.
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
    let mut judged = Vec::new();
    for mode in plan.modes.iter().filter(|mode| mode.is_free()) {
        let mut remote = Remote::join(&process, &setup(*mode, &*script))?;
        if judged.is_empty() {
            remote.reserve(&commands)?;
        }
        judged.push(JudgedClient {
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
        judged,
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
    free_run.switch_when_caught_up()?;
    free_run.into_load(plan, clean.config.integrator.rate.step().seconds())
}

/// A free-running server's clients: those that are judged, and the one that tells the truth.
struct FreeRun {
    /// The first gives the script's commands.
    judged: Vec<JudgedClient>,
    truth_client: Remote,
    truth_stream: TruthStream,
    scripted: ScriptedBodies,
    truth: Truth,
}

impl FreeRun {
    /// The commands before the first frame; what was so far counts as joining.
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        for command in commands {
            self.scripted.note(command, Tick::ZERO, &mut self.truth);
        }
        if let Some((first, others)) = self.judged.split_first_mut() {
            first.remote.prepare(commands)?;
            for copy in others {
                copy.remote.begin()?;
            }
        }
        Ok(())
    }

    /// One frame of every copy, when it is time for it.
    fn frame(
        &mut self,
        script: &mut dyn Script,
        number: u64,
        patience: Duration,
    ) -> Result<(), DriveError> {
        let mut commands = Vec::new();
        script.commands(Tick::new(number + 1), &mut commands);
        for (place, copy) in self.judged.iter_mut().enumerate() {
            if place == 0 {
                copy.remote.client().idle(patience)?;
            }
            let tick = copy.remote.follow()?;
            copy.remote.keep();
            for command in commands.drain(..) {
                self.scripted.note(&command, tick, &mut self.truth);
                copy.remote.client().command(command)?;
            }
        }
        self.listen()?;
        Ok(())
    }

    /// Hears what the engine did and judges what can be judged by now; returns how many frames are left.
    fn listen(&mut self) -> Result<usize, DriveError> {
        self.truth_client.client().idle(Duration::from_millis(1))?;
        self.truth_client.follow()?;
        self.truth_client.frames.clear();
        let captured = std::mem::take(&mut self.truth_client.captured);
        let (judged, mut left) = (&mut self.judged, 0);
        let mut judge = |recent: &RecentTruth| {
            let kept = judged
                .iter_mut()
                .map(|copy| copy.remote.judge_kept(recent, copy.tolerance));
            left = kept.sum();
        };
        self.truth_stream
            .receive(&captured, &self.scripted, &mut self.truth, &mut judge);
        Ok(left)
    }

    /// Waits until the truth of the last frames is known.
    fn switch_when_caught_up(&mut self) -> Result<(), DriveError> {
        for _ in 0..CATCH_UP_MS {
            if self.listen()? == 0 && self.judged.iter().all(|copy| copy.remote.is_judged()) {
                break;
            }
        }
        Ok(())
    }

    fn into_load(mut self, plan: &Plan, step_s: f64) -> Result<Load, DriveError> {
        let mut runs = Vec::new();
        for copy in &mut self.judged {
            let remote = &mut copy.remote;
            let inspection = remote.inspect()?;
            // The scene goes on between two inspections: all of them saw one engine.
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
            truth: self.truth,
            runs,
            unfinished: Vec::new(),
        })
    }
}

/// How long the truth of the last frames is waited for, a millisecond each time.
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

    /// Caught: what was heard of a tick before its end was missing in the truth if the look fell between.
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
        let places = truth.ticks[0].iter().map(|seen| seen.id.index());
        assert_eq!(places.collect::<Vec<_>>(), [0, 1]);
    }
}
