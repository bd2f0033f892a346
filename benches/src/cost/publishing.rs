//! Measures publishing of awake bodies, as a share of the step.
//!
//! The real engine steps each scene once. Its observations are then published repeatedly, as one stream of 5 cm and as
//! four of 5 mm, 2 cm, 5 cm and 20 cm. Three scenes: balls in free flight; the ball pit while its balls burst apart,
//! the worst case; the ball pit after it calms down to rolling and jitter. A scene reads moved bodies within its step.
//! Here every body is read once more to measure observing separately, so that figure is rather too high.

use std::hint::black_box;
use std::time::Duration;

use bytes::Bytes;
use glam::Quat;
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Material, PublishSchedule, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    StreamConfig,
};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Damping, Metres, Predictor, Tick, Tolerance, Track,
};
use rhumb_server::Scene;
use rhumb_sims::{BallPit, Script};
use serde::{Deserialize, Serialize};

use super::median::median;
use crate::processor::time_of;

/// Ticks published before the measurement, so that tracks are as in mid-run.
const WARM_UP: usize = 30;
/// Ticks measured.
const MEASURED: usize = 30;
/// Ticks with all bodies asleep, measured as one block.
const SILENT: u32 = 1_000;

/// The tiers of one stream and of four streams.
const TIERS: [&[Tolerance]; 2] = [
    &[Tolerance::NORMAL],
    &[
        Tolerance::EXACT,
        Tolerance::FINE,
        Tolerance::NORMAL,
        Tolerance::COARSE,
    ],
];

/// Balls that fly apart without contacts.
struct FlightScript {
    bodies: u32,
}

impl Script for FlightScript {
    fn name(&self) -> &'static str {
        "flight"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            material: Material {
                friction: 0.5,
                restitution: 0.0,
                density: 1_000.0,
            },
            stepping: Stepping::Lockstep,
            sleep: None,
            publish_schedule: PublishSchedule::EACH_TICK,
            damping: Damping::default(),
            ..BallPit::paper(1).config()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        out.push(Command::AddShape {
            id: ShapeId(0),
            shape: Shape::Ball { radius: 0.5 },
        });
        for index in 0..self.bodies {
            let (x, z) = ((index % 100) as f32, (index / 100) as f32);
            // Various spins and speeds, by irrational steps.
            let part = |step: f32| (index as f32 * step).fract() - 0.5;
            let motion = BodyState::new(
                [x * 3.0, 100.0, z * 3.0],
                Quat::IDENTITY.to_array(),
                [part(0.618_034), 20.0 * part(0.414_214), part(0.732_051)],
                [
                    8.0 * part(0.236_068),
                    8.0 * part(0.302_776),
                    part(0.162_278),
                ],
            )
            .expect("these numbers are finite");
            let desc = BodyDesc::plain(BodyId::new(index, 0), BodyKind::Dynamic, ShapeId(0));
            out.push(Command::AddBody { desc, motion });
        }
    }
}

/// A run of the engine: observations and step times.
struct ObservedRun {
    config: SceneConfig,
    bodies: Vec<(BodyId, PredictionParameters, Track)>,
    first: Tick,
    ticks: Vec<Vec<Observation>>,
    step: Duration,
    observe: Duration,
}

impl ObservedRun {
    /// Steps a scene to its first tick, then through warm-up and measurement.
    fn record(
        scenario: &Scenario,
        bodies: u32,
        progress: &mut dyn FnMut(),
    ) -> Result<Self, String> {
        let mut script = (scenario.script)(bodies);
        let config = script.config();
        let wrong = |what: &dyn std::fmt::Display| format!("scene {}: {what}", scenario.name);
        let mut scene = Scene::new(config).map_err(|refusal| wrong(&refusal))?;
        let mut commands = Vec::new();
        let mut advance = |scene: &mut Scene| {
            commands.clear();
            script.commands(scene.tick(), &mut commands);
            for command in &commands {
                scene.apply(command).map_err(|refusal| wrong(&refusal))?;
            }
            let (took, stepped) = time_of(|| scene.step());
            stepped.map_err(|error| wrong(&error))?;
            progress();
            Ok::<_, String>(took)
        };
        let first = Tick::new(scenario.first);
        while scene.tick() < first {
            advance(&mut scene)?;
        }
        let mut all = Vec::new();
        scene.observe_all(&mut all);
        let bodies = all
            .iter()
            .filter_map(|observation| placed(&scene, observation))
            .collect();
        let (mut ticks, mut step, mut observe) = (Vec::new(), Duration::ZERO, Duration::ZERO);
        for place in 0..WARM_UP + MEASURED {
            let took = advance(&mut scene)?;
            if place >= WARM_UP {
                all.clear();
                observe += time_of(|| scene.observe_all(&mut all)).0;
                step += took;
            }
            ticks.push(scene.observations().to_vec());
        }
        Ok(Self {
            config,
            bodies,
            first,
            ticks,
            step: step / MEASURED as u32,
            observe: observe / MEASURED as u32,
        })
    }

    fn publishers(&self, tiers: &[Tolerance]) -> Vec<Publisher> {
        let publisher = |(number, tolerance): (usize, &Tolerance)| {
            let config = stream(&self.config, *tolerance);
            let mut publisher = Publisher::new(StreamId(number as u32), &config, self.first);
            for (id, parameters, track) in &self.bodies {
                assert!(publisher.place(*id, parameters, *track));
            }
            publisher
        };
        tiers.iter().enumerate().map(publisher).collect()
    }

    /// Publishes the run once.
    fn publish(&self, tiers: &[Tolerance]) -> PublishCost {
        let mut publishers = self.publishers(tiers);
        let mut observation_history = ObservationHistory::new(self.config.publish_schedule);
        let mut out: Vec<Bytes> = Vec::new();
        let (mut took, mut before) = (Duration::ZERO, 0);
        let updates = |publishers: &[Publisher]| {
            let each = publishers.iter().map(|one| one.statistics().updates);
            each.sum::<u64>()
        };
        let mut tick = self.first;
        for (place, observations) in self.ticks.iter().enumerate() {
            if place == WARM_UP {
                (took, before) = (Duration::ZERO, updates(&publishers));
            }
            tick = tick.next();
            let publish = || {
                observation_history.observe(tick, observations);
                for publisher in &mut publishers {
                    publisher.publish(&observation_history, 0, &mut out);
                }
            };
            took += time_of(publish).0;
            black_box(&out);
            out.clear();
        }
        PublishCost {
            publish: took / MEASURED as u32,
            updates: updates(&publishers) - before,
        }
    }

    fn awake(&self) -> usize {
        let awake = |observation: &&Observation| observation.activity == Activity::Awake;
        self.ticks
            .last()
            .map_or(0, |observations| observations.iter().filter(awake).count())
    }
}

/// Cost of publishing the measured ticks.
#[derive(Clone, Copy)]
struct PublishCost {
    /// Time of the observation history and the publishers.
    publish: Duration,
    updates: u64,
}

/// Config of a stream of a scene.
fn stream(config: &SceneConfig, tolerance: Tolerance) -> StreamConfig {
    StreamConfig {
        tolerance,
        integrator: config.integrator,
        publish_interval: config.publish_schedule.publish_interval,
        largest_packet: LargestPacket::DEFAULT,
        gravity: config.gravity,
        features: Features::ALL,
    }
}

/// Parameters with which a body is added to a stream.
fn placed(
    scene: &Scene,
    observation: &Observation,
) -> Option<(BodyId, PredictionParameters, Track)> {
    let id = observation.id;
    let (desc, shape) = (scene.body(id)?, scene.shape_of(id)?);
    let parameters =
        PredictionParameters::of(desc, shape, scene.config().damping, scene.inertia(id));
    let moves = desc.kind == BodyKind::Dynamic;
    let track = Track {
        origin: scene.tick(),
        predictor: if moves {
            Predictor::Ballistic
        } else {
            Predictor::Rest
        },
        anchor: Anchor::Exact(if moves {
            observation.motion
        } else {
            observation.motion.stilled()
        }),
        parent: None,
    };
    Some((id, parameters, track))
}

/// A scene and the tick at which its warm-up starts.
struct Scenario {
    name: &'static str,
    script: fn(u32) -> Box<dyn Script>,
    first: u64,
}

const SCENARIOS: [Scenario; 3] = [
    Scenario {
        name: "flight",
        script: |bodies| Box::new(FlightScript { bodies }),
        first: 10,
    },
    Scenario {
        name: "burst",
        script: |bodies| Box::new(BallPit::new(bodies, 1, 1)),
        first: 60,
    },
    Scenario {
        name: "still",
        script: |bodies| Box::new(BallPit::new(bodies, 1, 1)),
        first: 1_200,
    },
];

/// Cost of publishing a scene, per tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Publishing {
    /// Scene and stage.
    pub scene: String,
    /// Number of streams, one tier each.
    pub streams: usize,
    /// Bodies awake in the last tick.
    pub awake: usize,
    /// Mean step of the engine, milliseconds.
    pub step_ms: f64,
    /// Mean time to read every body, milliseconds.
    pub observe_ms: f64,
    /// Mean time of selection and encoding for all streams, milliseconds.
    pub publish_ms: f64,
    /// Observing and publishing as a share of the step.
    pub of_step: f64,
    /// Updates per tick over all streams.
    pub updates_per_tick: f64,
}

/// Cost of publishing where nothing moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sleeping {
    /// Bodies of the stream, all asleep.
    pub bodies: u32,
    /// One tick of one stream, microseconds.
    pub publish_us: f64,
}

/// Number of progress calls for `repeats`.
pub(super) fn steps(repeats: u32) -> u64 {
    let ticks = SCENARIOS
        .iter()
        .map(|scenario| scenario.first + (WARM_UP + MEASURED) as u64);
    ticks.sum::<u64>() + SCENARIOS.len() as u64 * TIERS.len() as u64 * u64::from(repeats)
}

/// Measures each scene, as one stream and as four.
///
/// # Errors
///
/// The refusal of the engine or its scene, as text.
pub(super) fn publishing(
    bodies: u32,
    repeats: u32,
    progress: &mut dyn FnMut(),
) -> Result<Vec<Publishing>, String> {
    let mut all = Vec::new();
    for scenario in &SCENARIOS {
        let run = ObservedRun::record(scenario, bodies, progress)?;
        for tiers in TIERS {
            let measured = (0..repeats).map(|_| {
                let cost = run.publish(tiers);
                progress();
                cost
            });
            let costs: Vec<PublishCost> = measured.collect();
            let ms = |time: Duration| time.as_secs_f64() * 1e3;
            let publish_ms = ms(median(costs.iter().map(|cost| cost.publish)));
            let observe_ms = ms(run.observe);
            let step_ms = ms(run.step);
            // All repeats encode the same updates.
            let updates = costs.first().map_or(0, |cost| cost.updates);
            all.push(Publishing {
                scene: scenario.name.to_owned(),
                streams: tiers.len(),
                awake: run.awake(),
                step_ms,
                publish_ms,
                observe_ms,
                of_step: (observe_ms + publish_ms) / step_ms,
                updates_per_tick: updates as f64 / MEASURED as f64,
            });
        }
    }
    Ok(all)
}

/// Measures a stream of `bodies` sleeping bodies.
pub(super) fn sleeping(bodies: u32, repeats: u32) -> Sleeping {
    let config = FlightScript { bodies }.config();
    let mut publisher =
        Publisher::new(StreamId(0), &stream(&config, Tolerance::NORMAL), Tick::ZERO);
    for index in 0..bodies {
        let motion = BodyState::new(
            [index as f32, 0.0, 0.0],
            Quat::IDENTITY.to_array(),
            [0.0; 3],
            [0.0; 3],
        );
        let motion = motion.expect("these numbers are finite");
        let track = Track::resting(Tick::ZERO, motion);
        let parameters = PredictionParameters::plain(Metres::new(0.5));
        assert!(publisher.place(BodyId::new(index, 0), &parameters, track));
    }
    let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    let mut out = Vec::new();
    let mut tick = Tick::ZERO;
    let mut silence = || {
        let publish = || {
            for _ in 0..SILENT {
                tick = tick.next();
                observation_history.observe(tick, &[]);
                publisher.publish(&observation_history, 0, &mut out);
            }
        };
        time_of(publish).0
    };
    silence();
    let took = median((0..repeats).map(|_| silence()));
    Sleeping {
        bodies,
        publish_us: took.as_secs_f64() * 1e6 / f64::from(SILENT),
    }
}
