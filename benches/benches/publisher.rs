//! What publishing ten thousand awake bodies costs, as a share of the step
//!
//! The real engine steps each scene once; its observations are then published again and again, as one stream of 5 cm and
//! as four of 5 mm, 2 cm, 5 cm and 20 cm. Three scenes: balls in free flight; the ball pit while its balls burst apart,
//! the worst case; the same when it has settled but for rolling and jitter, its balls still awake. Standard error gets a
//! table: per tick, milliseconds of the step (which includes looking at what moved, and the digest), of the witness, of
//! publishing; both as a share of the step; and the updates of a tick.

use std::cell::LazyCell;
use std::hint::black_box;
use std::time::{Duration, Instant};

use bytes::Bytes;
use criterion::{Criterion, criterion_group, criterion_main};
use glam::Quat;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{
    BodyKind, BodyTerms, Cadence, Command, Material, Pace, SceneTerms, Shape, ShapeId,
};
use rhumb_protocol::stream::{
    Activity, Features, Manner, Observation, Publisher, StreamTerms, Witness,
};
use rhumb_reckoning::{Anchor, BodyId, Damping, Predictor, Tick, Tolerance, Track, Verbatim};
use rhumb_server::Scene;
use rhumb_sims::{BallPit, Script};

const BODIES: u32 = 10_000;
/// Ticks that are published before the clock runs, so that tracks are what they are in the middle of a run.
const WARM_UP: usize = 30;
/// Ticks that are measured.
const MEASURED: usize = 30;

/// The tiers of one stream, and of four.
const TIERS: [(&str, &[Tolerance]); 2] = [
    ("one stream", &[Tolerance::NORMAL]),
    (
        "four tiers",
        &[
            Tolerance::EXACT,
            Tolerance::FINE,
            Tolerance::NORMAL,
            Tolerance::COARSE,
        ],
    ),
];

/// Balls that fly apart from each other and touch nothing.
struct Flight;

impl Script for Flight {
    fn name(&self) -> &'static str {
        "flight"
    }

    fn terms(&self) -> SceneTerms {
        SceneTerms {
            material: Material {
                friction: 0.5,
                restitution: 0.0,
                density: 1_000.0,
            },
            pace: Pace::Lockstep,
            sleep: None,
            cadence: Cadence::EACH_TICK,
            damping: Damping::default(),
            ..BallPit::paper(1).terms()
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
        for index in 0..BODIES {
            let (x, z) = ((index % 100) as f32, (index / 100) as f32);
            // Spins and speeds of many sizes, by irrational steps.
            let part = |step: f32| (index as f32 * step).fract() - 0.5;
            let motion = Verbatim::new(
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
            let terms = BodyTerms::plain(BodyId::new(index, 0), BodyKind::Dynamic, ShapeId(0));
            out.push(Command::AddBody { terms, motion });
        }
    }
}

/// A run of the engine: what it saw, and how long its steps took.
struct Run {
    name: &'static str,
    terms: SceneTerms,
    bodies: Vec<(BodyId, Manner, Track)>,
    first: Tick,
    ticks: Vec<Vec<Observation>>,
    step: Duration,
}

impl Run {
    /// Steps `script` up to `first`, and then what is warmed up and measured.
    fn record(name: &'static str, script: &mut dyn Script, first: u64) -> Self {
        let terms = script.terms();
        let mut scene = Scene::new(terms).expect("a script's terms are lawful");
        let mut commands = Vec::new();
        let mut advance = |scene: &mut Scene| {
            commands.clear();
            script.commands(scene.tick(), &mut commands);
            for command in &commands {
                scene
                    .apply(command)
                    .expect("a script's commands are lawful");
            }
            let begun = Instant::now();
            scene.step().expect("the engine steps");
            begun.elapsed()
        };
        while scene.tick() < Tick::new(first) {
            advance(&mut scene);
        }
        let mut all = Vec::new();
        scene.observe_all(&mut all);
        let bodies = all.iter().filter_map(|seen| placed(&scene, seen)).collect();
        let (mut ticks, mut step) = (Vec::new(), Duration::ZERO);
        for place in 0..WARM_UP + MEASURED {
            let took = advance(&mut scene);
            if place >= WARM_UP {
                step += took;
            }
            ticks.push(scene.observations().to_vec());
        }
        Self {
            name,
            terms,
            bodies,
            first: Tick::new(first),
            ticks,
            step: step / MEASURED as u32,
        }
    }

    fn publishers(&self, tiers: &[Tolerance]) -> Vec<Publisher> {
        let publisher = |(number, tolerance): (usize, &Tolerance)| {
            let terms = StreamTerms {
                tolerance: *tolerance,
                integrator: self.terms.integrator,
                every: self.terms.cadence.every,
                gravity: self.terms.gravity,
                features: Features::ALL,
            };
            let mut publisher = Publisher::new(StreamId(number as u32), &terms, self.first);
            for (id, manner, track) in &self.bodies {
                assert!(publisher.place(*id, manner, *track));
            }
            publisher
        };
        tiers.iter().enumerate().map(publisher).collect()
    }

    /// Publishes the run once: what its witness took, and its publishers, in a tick; and how many updates that was.
    fn publish(&self, tiers: &[Tolerance]) -> Cost {
        let mut publishers = self.publishers(tiers);
        let mut witness = Witness::new(self.terms.cadence);
        let mut out: Vec<Bytes> = Vec::new();
        let (mut saw, mut said, mut before) = (Duration::ZERO, Duration::ZERO, 0);
        let updates = |publishers: &[Publisher]| {
            publishers
                .iter()
                .map(|p| p.statistics().updates)
                .sum::<u64>()
        };
        let mut tick = self.first;
        for (place, observations) in self.ticks.iter().enumerate() {
            if place == WARM_UP {
                (saw, said, before) = (Duration::ZERO, Duration::ZERO, updates(&publishers));
            }
            tick = tick.next();
            let begun = Instant::now();
            witness.observe(tick, observations);
            let seen = Instant::now();
            for publisher in &mut publishers {
                publisher.publish(&witness, 0, &mut out);
            }
            saw += seen - begun;
            said += seen.elapsed();
            black_box(&out);
            out.clear();
        }
        let per_tick = |all: Duration| all / MEASURED as u32;
        let updates = (updates(&publishers) - before) / MEASURED as u64;
        Cost {
            witness: per_tick(saw),
            publish: per_tick(said),
            updates,
        }
    }

    fn awake(&self) -> usize {
        let awake = |seen: &&Observation| seen.activity == Activity::Awake;
        self.ticks
            .last()
            .map_or(0, |seen| seen.iter().filter(awake).count())
    }
}

/// What a tick cost.
#[derive(Clone, Copy)]
struct Cost {
    witness: Duration,
    publish: Duration,
    updates: u64,
}

impl Cost {
    fn all(&self) -> Duration {
        self.witness + self.publish
    }
}

/// A body as a stream is told of it.
fn placed(scene: &Scene, seen: &Observation) -> Option<(BodyId, Manner, Track)> {
    let id = seen.id;
    let (terms, shape) = (scene.body(id)?, scene.shape_of(id)?);
    let manner = Manner::of(terms, shape, scene.terms().damping, scene.inertia(id));
    let moves = terms.kind == BodyKind::Dynamic;
    let track = Track {
        origin: scene.tick(),
        predictor: if moves {
            Predictor::Ballistic
        } else {
            Predictor::Rest
        },
        anchor: Anchor::Verbatim(if moves {
            seen.motion
        } else {
            seen.motion.stilled()
        }),
        carrier: None,
    };
    Some((id, manner, track))
}

/// Steps a scene, when it is asked for.
struct Play {
    name: &'static str,
    record: fn(&'static str) -> Run,
}

const PLAYS: [Play; 3] = [
    Play {
        name: "flight",
        record: |name| Run::record(name, &mut Flight, 10),
    },
    Play {
        name: "burst",
        record: |name| Run::record(name, &mut BallPit::new(BODIES, 1, 1), 60),
    },
    Play {
        name: "settled",
        record: |name| Run::record(name, &mut BallPit::new(BODIES, 1, 1), 1_200),
    },
];

fn shares(criterion: &mut Criterion) {
    for play in &PLAYS {
        let mut group = criterion.benchmark_group(play.name);
        group
            .sample_size(10)
            .warm_up_time(Duration::from_millis(100));
        let run = LazyCell::new(|| (play.record)(play.name));
        for (name, tiers) in TIERS {
            let mut least: Option<Cost> = None;
            group.bench_function(name, |bencher| {
                let run = &*run;
                bencher.iter_custom(|times| {
                    let mut sum = Duration::ZERO;
                    for _ in 0..times {
                        let cost = run.publish(tiers);
                        sum += cost.all();
                        least = least
                            .filter(|least| least.all() <= cost.all())
                            .or(Some(cost));
                    }
                    sum
                });
            });
            // What was filtered out was not measured.
            if let Some(least) = least {
                report(&run, name, &least);
            }
        }
        group.finish();
    }
}

fn report(run: &Run, tiers: &str, cost: &Cost) {
    let ms = |time: Duration| time.as_secs_f64() * 1e3;
    let share = 100.0 * ms(cost.all()) / ms(run.step);
    eprintln!(
        "{:8} {tiers}: {} awake; step {:.2} ms, witness {:.3} ms, publish {:.3} ms: {share:.2} % of it; {} updates",
        run.name,
        run.awake(),
        ms(run.step),
        ms(cost.witness),
        ms(cost.publish),
        cost.updates,
    );
}

criterion_group!(benches, shares);
criterion_main!(benches);
