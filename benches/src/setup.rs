//! The work that `rhumb-bench cost` and the Criterion benches measure.
//!
//! Both take their setups from here, so that they cannot disagree about what is measured. A setup is made once, and its
//! work is then done repeatedly. Equal arguments make equal setups, to the bit. Work whose instructions `compare_builds.py`
//! counts is never inlined, so that callgrind finds it by name.
//!
//! Whole sessions are here: the hand-over of a tick, joining, adding bodies. A server and its clients share the calling
//! thread, without sockets and without waiting. The hand-over is that of one small body whose full state each member
//! receives at every tick, so that the engine and the publisher take little of it.
//!
//! The real engine steps each scene once. Its observations are then published repeatedly, as one stream of 5 cm and as
//! four of 5 mm, 2 cm, 5 cm and 20 cm. Three scenes: balls in free flight; the ball pit while its balls burst apart,
//! the worst case; the ball pit after it calms down to rolling and jitter. A scene reads moved bodies within its step.
//! Here every body is read once more to measure observing separately, so that figure is rather too high.

pub mod decoding;

use std::hint::black_box;
use std::time::Duration;

use bytes::Bytes;
use glam::{Quat, Vec3};
use rhumb_client::scene::BodyBuilder;
use rhumb_client::{
    Client, ClientError, JoinMode, JoinOptions, LocalServer, OpenError, PipelineDepth,
    ServerConnection,
};
use rhumb_netsim::{LinkConfig, SimNetwork};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Material, PublishSchedule, SceneConfig, Shape, ShapeId, Sleep,
    Stepping,
};
use rhumb_protocol::session::{ClientSession, Event};
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    StreamConfig,
};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Damping, Metres, Predictor, Tick, Tolerance, Track,
};
use rhumb_scene::{Limits, Scene, SceneRouter, SceneSettings};
use rhumb_sims::{BallPit, Script};

use crate::machine::time_of;

/// Name of every scene here.
const SCENE: &str = "bench";
/// Duration of a tick.
const TICK: Span = Span::from_nanos(1_000_000_000 / 60);
/// Time after which everything sent over a perfect link has been answered.
const ROUND: Span = Span::from_millis(200);
/// Distance between neighbouring balls, metres: none touches another.
const APART: f32 = 3.0;

/// A free-running scene of one ball, and members that receive its state at every tick.
pub struct HandOverLoad {
    network: SimNetwork<SceneRouter, ClientSession>,
}

impl HandOverLoad {
    /// A scene with `members` members.
    ///
    /// # Panics
    ///
    /// If the server admits fewer.
    #[must_use]
    pub fn new(members: usize) -> Self {
        let limits = Limits {
            members_per_scene: members as u64,
            ..Limits::default()
        };
        let scenes = SceneRouter::new(SceneSettings {
            limits,
            ..SceneSettings::new(|| Instant::ZERO)
        });
        let mut load = Self {
            network: SimNetwork::new(scenes, LinkConfig::PERFECT, 1),
        };
        for member in 0..members {
            load.enter(member == 0);
        }
        load.tick();
        load
    }

    /// Connects a member. The first one creates the scene and adds the ball.
    fn enter(&mut self, is_first: bool) {
        let name = SCENE.parse().expect("a valid scene name");
        let index = self.network.connect(ClientSession::new(name));
        self.pass(ROUND);
        let session = self.network.client_mut(index);
        if is_first {
            session
                .create(config())
                .expect("a client may create a scene");
            self.pass(ROUND);
        }
        let session = self.network.client_mut(index);
        session
            .join(StreamChoice::Full)
            .expect("a client in the lobby may join");
        self.pass(ROUND);
        if is_first {
            let session = self.network.client_mut(index);
            for command in ball() {
                session.command(command).expect("a member may command");
            }
            self.pass(ROUND);
        }
    }

    /// Lets time pass, and drops the events of all members.
    fn pass(&mut self, time: Span) {
        self.network.run_until(self.network.now() + time);
        for index in 0..self.network.clients() {
            while let Some(event) = self.network.client_mut(index).poll_event() {
                let denied = matches!(event, Event::Denied(_) | Event::Refused { .. });
                assert!(!denied, "the scene admits members and a ball: {event:?}");
            }
        }
    }

    /// The next tick: a step, its state, its way through the server's sessions and those of all members.
    pub fn tick(&mut self) {
        self.pass(TICK);
    }

    /// State packets that the last member has received.
    #[must_use]
    pub fn received(&self) -> u64 {
        let last = self.network.client(self.network.clients() - 1);
        let replica = last.replica();
        replica.map_or(0, |replica| replica.stream().statistics().packets)
    }
}

/// A scene without gravity, in which a moving ball never comes to rest.
fn config() -> SceneConfig {
    SceneConfig {
        gravity: Vec3::ZERO,
        stepping: Stepping::FreeRunning,
        ..SceneConfig::default()
    }
}

/// The commands that add a ball at 1 m/s.
fn ball() -> [Command; 2] {
    let motion = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0; 3]);
    [
        Command::AddShape {
            id: ShapeId(0),
            shape: Shape::Ball { radius: 0.5 },
        },
        Command::AddBody {
            desc: BodyDesc::plain(BodyId::new(0, 0), BodyKind::Dynamic, ShapeId(0)),
            motion: motion.expect("these numbers are finite"),
        },
    ]
}

/// A client in a new scene, and the bodies that it adds.
pub struct AddLoad {
    client: Client,
    bodies: Vec<BodyBuilder>,
}

impl AddLoad {
    /// A client that will add `bodies` balls.
    ///
    /// # Errors
    ///
    /// The server's refusal.
    pub fn new(bodies: u32) -> Result<Self, OpenError> {
        Self::over(LocalServer::new().connect(), bodies)
    }

    fn over(connection: ServerConnection, bodies: u32) -> Result<Self, OpenError> {
        let options = JoinOptions {
            mode: JoinMode::Create(SceneConfig::default()),
            ..JoinOptions::default()
        };
        Ok(Self {
            client: connection.join_with(SCENE, options)?,
            bodies: (0..bodies).map(placed_ball).collect(),
        })
    }

    /// Adds all bodies, and steps until they are in the view; returns the number of bodies in it.
    ///
    /// # Errors
    ///
    /// The client's.
    pub fn add(&mut self) -> Result<usize, ClientError> {
        self.client.add_bodies(self.bodies.drain(..))?;
        self.client.advance(PipelineDepth::LOCKSTEP)?;
        Ok(self.client.view().ids().len())
    }
}

/// A scene with many bodies, which clients join.
pub struct JoinLoad {
    server: LocalServer,
    /// The scene steps only when its owner advances it.
    _owner: AddLoad,
}

impl JoinLoad {
    /// A scene of `bodies` balls.
    ///
    /// # Errors
    ///
    /// The server's refusal, as text.
    pub fn new(bodies: u32) -> Result<Self, String> {
        let server = LocalServer::new();
        let owner = AddLoad::over(server.connect(), bodies);
        let mut owner = owner.map_err(|error| error.to_string())?;
        owner.add().map_err(|error| error.to_string())?;
        Ok(Self {
            server,
            _owner: owner,
        })
    }

    /// Joins the scene; returns when the copy of it is complete.
    ///
    /// # Errors
    ///
    /// The server's refusal.
    pub fn join(&self) -> Result<Client, OpenError> {
        let options = JoinOptions {
            mode: JoinMode::Join,
            ..JoinOptions::default()
        };
        self.server.connect().join_with(SCENE, options)
    }
}

fn placed_ball(index: u32) -> BodyBuilder {
    let (x, z) = ((index % 100) as f32, (index / 100) as f32);
    BodyDesc::dynamic(Shape::ball(0.5)).at(x * APART, 100.0, z * APART)
}

/// Ticks published before the measurement, so that tracks are as in mid-run.
pub const WARM_UP: usize = 30;
/// Ticks measured.
pub const MEASURED: usize = 30;
/// The tiers of one stream and of four streams.
pub const TIERS: [&[Tolerance]; 2] = [
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
            sleep: Sleep::Settled,
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
#[derive(Clone, Debug)]
pub struct ObservedRun {
    config: SceneConfig,
    bodies: Vec<(BodyId, PredictionParameters, Track)>,
    first: Tick,
    ticks: Vec<Vec<Observation>>,
    /// Mean step of the engine.
    pub step: Duration,
    /// Mean time to read every body.
    pub observe: Duration,
}

impl ObservedRun {
    /// Steps a scene to its first tick, then through warm-up and measurement. `progress` is called at each step.
    ///
    /// # Errors
    ///
    /// The refusal of the engine or its scene, as text.
    pub fn record(
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
    #[inline(never)]
    #[must_use]
    pub fn publish(&self, tiers: &[Tolerance]) -> PublishCost {
        self.work_through(tiers, |publisher, history, out| {
            let before = publisher.statistics().updates;
            publisher.publish(history, 0, out);
            publisher.statistics().updates - before
        })
    }

    /// Chooses the updates of the run once, and encodes nothing.
    #[must_use]
    pub fn choose(&self, tiers: &[Tolerance]) -> PublishCost {
        self.work_through(tiers, |publisher, history, _| {
            publisher.choose(history) as u64
        })
    }

    /// Calls `work` for each tick and publisher; it returns the number of updates.
    fn work_through(
        &self,
        tiers: &[Tolerance],
        mut work: impl FnMut(&mut Publisher, &ObservationHistory, &mut Vec<Bytes>) -> u64,
    ) -> PublishCost {
        let mut publishers = self.publishers(tiers);
        let mut observation_history = ObservationHistory::new(self.config.publish_schedule);
        let mut out: Vec<Bytes> = Vec::new();
        let (mut took, mut updates) = (Duration::ZERO, 0);
        let mut tick = self.first;
        for (place, observations) in self.ticks.iter().enumerate() {
            if place == WARM_UP {
                (took, updates) = (Duration::ZERO, 0);
            }
            tick = tick.next();
            let publish = || {
                observation_history.observe(tick, observations);
                for publisher in &mut publishers {
                    updates += work(publisher, &observation_history, &mut out);
                }
            };
            took += time_of(publish).0;
            black_box(&out);
            out.clear();
        }
        PublishCost {
            tick: took / MEASURED as u32,
            updates,
        }
    }

    /// Bodies awake in the last tick.
    #[must_use]
    pub fn awake(&self) -> usize {
        let awake = |observation: &&Observation| observation.activity == Activity::Awake;
        self.ticks
            .last()
            .map_or(0, |observations| observations.iter().filter(awake).count())
    }
}

/// Cost of publishing the measured ticks.
#[derive(Clone, Copy, Debug)]
pub struct PublishCost {
    /// Mean time of the observation history and the publishers in a tick.
    pub tick: Duration,
    /// Updates of all streams in all measured ticks.
    pub updates: u64,
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
#[derive(Clone, Copy, Debug)]
pub struct Scenario {
    /// Name of the scene and its stage.
    pub name: &'static str,
    script: fn(u32) -> Box<dyn Script>,
    first: u64,
}

impl Scenario {
    /// Steps of the engine in a run.
    #[must_use]
    pub const fn steps(&self) -> u64 {
        self.first + (WARM_UP + MEASURED) as u64
    }
}

/// The scenes that are published.
pub const SCENARIOS: [Scenario; 3] = [
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
        name: "pile",
        script: |bodies| Box::new(BallPit::new(bodies, 1, 1)),
        first: 1_200,
    },
];

/// A stream whose bodies all sleep.
#[derive(Debug)]
pub struct SleepLoad {
    publisher: Publisher,
    observation_history: ObservationHistory,
    out: Vec<Bytes>,
    tick: Tick,
}

impl SleepLoad {
    /// A stream of `bodies` sleeping bodies.
    #[must_use]
    pub fn new(bodies: u32) -> Self {
        let config = FlightScript { bodies }.config();
        let config = stream(&config, Tolerance::NORMAL);
        let mut publisher = Publisher::new(StreamId(0), &config, Tick::ZERO);
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
        Self {
            publisher,
            observation_history: ObservationHistory::new(PublishSchedule::EACH_TICK),
            out: Vec::new(),
            tick: Tick::ZERO,
        }
    }

    /// Publishes the next tick.
    pub fn publish(&mut self) {
        self.tick = self.tick.next();
        self.observation_history.observe(self.tick, &[]);
        self.publisher
            .publish(&self.observation_history, 0, &mut self.out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_tick_is_handed_over_to_the_last_member() {
        let mut load = HandOverLoad::new(3);
        let before = load.received();
        for _ in 0..60 {
            load.tick();
        }
        assert!(load.received().abs_diff(before + 60) <= 1);
    }

    #[test]
    fn as_many_updates_are_chosen_as_published() {
        let burst = &SCENARIOS[1];
        let run = ObservedRun::record(burst, 50, &mut || ()).expect("the scene runs");
        for tiers in TIERS {
            let (chosen, published) = (run.choose(tiers).updates, run.publish(tiers).updates);
            assert!(published > 100, "balls burst apart: {published}");
            assert_eq!(chosen, published);
        }
    }
}
