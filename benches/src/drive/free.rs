//! A free-running scene, followed in real time over the asked-for link.
//!
//! The truth comes from a second client without a link between, which takes the full stream: every state of every tick,
//! to the bit. The judged client shows whole ticks without glides, so that what is judged is the reckoning.

use std::collections::BTreeMap;
use std::time::Duration;

use rhumb_protocol::packet::{FullPacket, Head, Kind};
use rhumb_protocol::scene::{BodyKind, BodyTerms, Command, Pace, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Metres, Tick, Ticks, Tolerance, Verbatim};
use rhumb_sims::Script;
use rhumb_transport::{Clock, LinkTerms};

use super::compare::{Known, RecentTruth};
use super::remote::{Remote, Setup};
use super::side_by_side::Plan;
use super::{DriveError, ServerProcess};
use crate::record::{Load, Mode, Passed, Placed, Run, Truth, Way};

/// Bodies as the script made them, by index.
#[derive(Debug, Default)]
struct Cast {
    shapes: BTreeMap<ShapeId, Shape>,
    bodies: BTreeMap<u32, (BodyTerms, Shape)>,
}

impl Cast {
    fn note(&mut self, command: &Command, tick: Tick, truth: &mut Truth) {
        match *command {
            Command::AddShape { id, ref shape } => {
                self.shapes.insert(id, shape.clone());
            }
            Command::AddBody { terms, motion } => {
                if let Some(shape) = self.shapes.get(&terms.shape).cloned() {
                    self.bodies.insert(terms.id.index(), (terms, shape.clone()));
                    let observation = Observation {
                        id: terms.id,
                        motion,
                        activity: Activity::Awake,
                    };
                    truth.placed.push(Placed {
                        tick,
                        terms,
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
struct Witness {
    states: BTreeMap<u32, Verbatim>,
    /// What the tick that is being heard of changed so far: it may come in several pieces.
    changed: BTreeMap<u32, Observation>,
    tick: u64,
    recent: RecentTruth,
}

impl Witness {
    /// Takes in the datagrams of the full stream, tick by tick.
    ///
    /// `known` is called after each tick that is whole.
    fn hear(
        &mut self,
        passed: &[Passed],
        cast: &Cast,
        truth: &mut Truth,
        known: &mut dyn FnMut(&RecentTruth),
    ) {
        for datagram in passed.iter().filter(|passed| passed.way == Way::StateDown) {
            let mut reader = Reader::new(&datagram.bytes);
            let ends_tick = match Head::decode(&mut reader) {
                Ok(Head {
                    kind: Kind::Full, ..
                }) => false,
                Ok(Head {
                    kind: Kind::FullEnd,
                    ..
                }) => true,
                _ => continue,
            };
            let Ok(packet) = FullPacket::decode(ends_tick, reader) else {
                continue;
            };
            for record in &packet.records {
                let before = self.states.insert(record.index, record.motion);
                if let Some((terms, _)) = cast.bodies.get(&record.index)
                    && before != Some(record.motion)
                {
                    let observation = Observation {
                        id: terms.id,
                        motion: record.motion,
                        activity: activity(terms, &record.motion),
                    };
                    self.changed.insert(record.index, observation);
                }
            }
            if ends_tick {
                self.tick = packet.tick.expand(self.tick);
                self.end_tick(cast, truth);
                known(&self.recent);
            }
        }
    }

    fn end_tick(&mut self, cast: &Cast, truth: &mut Truth) {
        let rows = self.tick as usize;
        truth.ticks.resize(rows.max(truth.ticks.len()), Vec::new());
        if let Some(row) = rows
            .checked_sub(1)
            .and_then(|place| truth.ticks.get_mut(place))
        {
            row.extend(std::mem::take(&mut self.changed).into_values());
        }
        let known = cast.bodies.values().map(|(terms, shape)| {
            let motion = *self.states.get(&terms.id.index())?;
            Some(known(terms.id, motion, shape.bounding_radius(), terms))
        });
        self.recent.push(Tick::new(self.tick), known);
    }
}

/// A full stream does not say who sleeps; but an engine stills what it puts to sleep, and what it moves is hardly ever still
/// to the bit before.
fn activity(terms: &BodyTerms, motion: &Verbatim) -> Activity {
    match terms.kind {
        BodyKind::Dynamic if *motion == motion.stilled() => Activity::Asleep,
        _ => Activity::Awake,
    }
}

fn known(id: BodyId, motion: Verbatim, radius: Metres, terms: &BodyTerms) -> Known {
    Known {
        id,
        motion,
        radius,
        kind: terms.kind,
        class: terms.class,
    }
}

/// A client of the free-running server that is judged.
struct Copy {
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
        (setup.terms.pace, setup.terms.cadence) = (Pace::FreeRunning, plan.cadence);
        setup
    };
    let clean = Setup {
        link: &LinkTerms::PERFECT,
        delay: Ticks::ZERO,
        ..setup(Mode::NaiveFree, &*script)
    };
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    let process = ServerProcess::start(&clean.housing, clean.beside.as_ref())?;
    let mut copies = Vec::new();
    for mode in plan.modes.iter().filter(|mode| mode.is_free()) {
        let mut remote = Remote::join(&process, &setup(*mode, &*script))?;
        if copies.is_empty() {
            remote.reserve(&commands)?;
        }
        copies.push(Copy {
            mode: *mode,
            remote,
            tolerance: (*mode == Mode::RhumbFree).then_some(plan.tolerance),
        });
    }
    let mut stage = Stage {
        witness_client: Remote::join(&process, &clean)?,
        witness: Witness::default(),
        cast: Cast::default(),
        truth: Truth::default(),
        copies,
    };
    stage.prepare(&commands)?;
    let step = Span::from_nanos(clean.terms.integrator.rate.step_ns());
    let clock = Clock::start();
    let mut due = clock.now();
    for number in 0..u64::from(plan.ticks) {
        stage.frame(&mut *script, number, until(&clock, due))?;
        progress(Tick::new(number));
        due = due + step;
    }
    stage.catch_up()?;
    stage.into_load(plan, clean.terms.integrator.rate.step().seconds())
}

/// A free-running server's clients: those that are judged, and the one that tells the truth.
struct Stage {
    /// The first gives the script's commands.
    copies: Vec<Copy>,
    witness_client: Remote,
    witness: Witness,
    cast: Cast,
    truth: Truth,
}

impl Stage {
    /// The commands before the first frame; what was so far counts as joining.
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        for command in commands {
            self.cast.note(command, Tick::ZERO, &mut self.truth);
        }
        if let Some((first, others)) = self.copies.split_first_mut() {
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
        for (place, copy) in self.copies.iter_mut().enumerate() {
            if place == 0 {
                copy.remote.client().idle(patience)?;
            }
            let tick = copy.remote.follow()?;
            copy.remote.keep();
            for command in commands.drain(..) {
                self.cast.note(&command, tick, &mut self.truth);
                copy.remote.client().command(command)?;
            }
        }
        self.listen()?;
        Ok(())
    }

    /// Hears what the engine did and judges what can be judged by now; returns how many frames are left.
    fn listen(&mut self) -> Result<usize, DriveError> {
        self.witness_client
            .client()
            .idle(Duration::from_millis(1))?;
        self.witness_client.follow()?;
        self.witness_client.frames.clear();
        let passed = std::mem::take(&mut self.witness_client.passed);
        let (copies, mut left) = (&mut self.copies, 0);
        let mut judge = |recent: &RecentTruth| {
            let kept = copies
                .iter_mut()
                .map(|copy| copy.remote.judge_kept(recent, copy.tolerance));
            left = kept.sum();
        };
        self.witness
            .hear(&passed, &self.cast, &mut self.truth, &mut judge);
        Ok(left)
    }

    /// Waits until the truth of the last frames is known.
    fn catch_up(&mut self) -> Result<(), DriveError> {
        for _ in 0..CATCH_UP_MS {
            if self.listen()? == 0 && self.copies.iter().all(|copy| copy.remote.is_judged()) {
                break;
            }
        }
        Ok(())
    }

    fn into_load(mut self, plan: &Plan, step_s: f64) -> Result<Load, DriveError> {
        let mut runs = Vec::new();
        for copy in &mut self.copies {
            let remote = &mut copy.remote;
            let inspection = remote.inspect()?;
            // The scene goes on between two inspections: all of them saw one engine.
            if runs.is_empty() {
                self.truth.digest = inspection.truth;
            }
            runs.push(Run {
                terms: plan.run_terms(copy.mode, step_s),
                truth_digest: self.truth.digest,
                frames: std::mem::take(&mut remote.frames),
                passed: std::mem::take(&mut remote.passed),
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
            unended: Vec::new(),
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

    fn motion(x: f32) -> Verbatim {
        Verbatim::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
            .expect("these numbers are finite")
    }

    fn packet(tick: u64, body: u32, ends_tick: bool) -> Passed {
        let packet = FullPacket {
            number: Low16::of(tick),
            tick: Low16::of(tick),
            notices: Low16::of(0),
            ends_tick,
            records: vec![FullRecord {
                index: body,
                motion: motion(tick as f32),
            }],
        };
        let datagram = packet.encode(StreamId(0));
        Passed::new(0, Way::StateDown, datagram.into())
    }

    /// Caught: what was heard of a tick before its end was missing in the truth if the look fell between.
    #[test]
    fn a_tick_that_is_heard_of_in_pieces_is_whole() {
        let (mut witness, mut cast, mut truth) =
            (Witness::default(), Cast::default(), Truth::default());
        let shape = Shape::Ball { radius: 0.5 };
        for body in 0..2 {
            let id = BodyId::new(body, 0);
            let terms = BodyTerms::plain(id, BodyKind::Dynamic, ShapeId(0));
            cast.bodies.insert(body, (terms, shape.clone()));
        }
        for piece in [packet(1, 0, false), packet(1, 1, true)] {
            witness.hear(&[piece], &cast, &mut truth, &mut |_| ());
        }
        let places = truth.ticks[0].iter().map(|seen| seen.id.index());
        assert_eq!(places.collect::<Vec<_>>(), [0, 1]);
    }
}
