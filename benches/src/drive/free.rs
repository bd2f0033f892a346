//! A free-running scene, followed in real time over the asked-for link.
//!
//! The truth comes from a second client without a link between, which takes the full stream: every state of every tick,
//! to the bit. The judged client shows whole ticks without glides, so that what is judged is the reckoning.

use std::collections::BTreeMap;
use std::time::Duration;

use rhumb_client::StreamChoice;
use rhumb_protocol::packet::{FullPacket, Head, Kind};
use rhumb_protocol::scene::{BodyTerms, Command, Pace, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Metres, Tick, Verbatim};
use rhumb_transport::{Clock, LinkTerms};

use super::compare::{Known, RecentTruth};
use super::remote::Remote;
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
    tick: u64,
    recent: RecentTruth,
}

impl Witness {
    /// Takes in the datagrams of the full stream, tick by tick.
    fn hear(&mut self, passed: &[Passed], cast: &Cast, truth: &mut Truth) {
        let mut changed: BTreeMap<u32, Observation> = BTreeMap::new();
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
                        activity: Activity::Awake,
                    };
                    changed.insert(record.index, observation);
                }
            }
            if ends_tick {
                self.tick = packet.tick.expand(self.tick);
                self.end_tick(&mut changed, cast, truth);
            }
        }
    }

    fn end_tick(
        &mut self,
        changed: &mut BTreeMap<u32, Observation>,
        cast: &Cast,
        truth: &mut Truth,
    ) {
        let rows = self.tick as usize;
        truth.ticks.resize(rows.max(truth.ticks.len()), Vec::new());
        if let Some(row) = rows
            .checked_sub(1)
            .and_then(|place| truth.ticks.get_mut(place))
        {
            row.extend(std::mem::take(changed).into_values());
        }
        let known = cast.bodies.values().map(|(terms, shape)| {
            let motion = *self.states.get(&terms.id.index())?;
            Some(known(terms.id, motion, shape.bounding_radius(), terms))
        });
        self.recent.push(Tick::new(self.tick), known);
    }
}

fn known(id: BodyId, motion: Verbatim, radius: Metres, terms: &BodyTerms) -> Known {
    Known {
        id,
        motion,
        radius,
        kind: terms.kind,
    }
}

/// Follows a free-running scene for as long as the plan's ticks take.
///
/// # Errors
///
/// [`DriveError`] names what did not work; nothing is kept of a run that does not end.
pub fn run_free(plan: &Plan, progress: &mut dyn FnMut(Tick)) -> Result<Load, DriveError> {
    let mut script = plan.script()?;
    let mut setup = plan.setup(Mode::RhumbFree, &*script);
    setup.terms.pace = Pace::FreeRunning;
    let process = ServerProcess::start(setup.core, setup.beside.as_ref())?;
    let mut copy = Remote::join(&process, &setup)?;
    let mut clean = setup.clone();
    (clean.stream, clean.link) = (StreamChoice::Full, &LinkTerms::PERFECT);
    let mut witness_client = Remote::join(&process, &clean)?;
    let (mut truth, mut cast, mut witness) =
        (Truth::default(), Cast::default(), Witness::default());
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    for command in &commands {
        cast.note(command, Tick::ZERO, &mut truth);
    }
    copy.prepare(&commands)?;
    let step = Span::from_nanos(setup.terms.integrator.rate.step_ns());
    let clock = Clock::start();
    let mut due = clock.now();
    for number in 0..plan.ticks {
        copy.client().idle(until(&clock, due))?;
        let tick = copy.follow()?;
        commands.clear();
        script.commands(Tick::new(u64::from(number) + 1), &mut commands);
        for command in &commands {
            cast.note(command, tick, &mut truth);
            copy.client().command(command.clone())?;
        }
        // The truth of the tick that was shown is at the server already, and soon here.
        for _ in 0..WITNESS_TURNS {
            witness_client.client().idle(Duration::from_millis(1))?;
            witness_client.follow()?;
            let passed = std::mem::take(&mut witness_client.passed);
            witness.hear(&passed, &cast, &mut truth);
            if witness.tick >= tick.value() {
                break;
            }
        }
        witness_client.frames.clear();
        copy.judge(&witness.recent, Some(plan.tolerance));
        progress(Tick::new(u64::from(number)));
        due = due + step;
    }
    let inspection = copy.inspect()?;
    truth.digest = inspection.truth;
    let run = Run {
        terms: plan.run_terms(
            Mode::RhumbFree,
            setup.terms.integrator.rate.step().seconds(),
        ),
        truth_digest: inspection.truth,
        frames: std::mem::take(&mut copy.frames),
        passed: std::mem::take(&mut copy.passed),
        join: copy.join,
        breaches: std::mem::take(&mut copy.breaches),
        recoveries: Vec::new(),
        step_ns_p50: inspection.times.step_median,
        step_ns_p99: inspection.times.step_p99,
        step_ns_total: inspection.times.step_total,
        publish_ns_total: inspection.times.publish_total + inspection.times.observe_total,
    };
    Ok(Load {
        truth,
        runs: vec![run],
    })
}

/// How often the witness is asked, a millisecond each, for a tick that was shown.
const WITNESS_TURNS: u32 = 8;

fn until(clock: &Clock, due: Instant) -> Duration {
    Duration::from_nanos(due.since(clock.now()).as_nanos())
}
