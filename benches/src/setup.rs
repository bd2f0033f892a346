//! The work that `rhumb-bench cost` and the Criterion benches measure.
//!
//! Both take their setups from here, so that they cannot disagree about what is measured. A setup is made once, and its
//! work is then done repeatedly. Equal arguments make equal setups, to the bit.
//!
//! Whole sessions are here: the hand-over of a tick, joining, adding bodies. A server and its clients share the calling
//! thread, without sockets and without waiting. The hand-over is that of one small body whose full state each member
//! receives at every tick, so that the engine and the publisher take little of it.

pub mod decoding;
pub mod publishing;

use glam::Vec3;
use rhumb_client::scene::BodyBuilder;
use rhumb_client::{
    Client, ClientError, JoinMode, JoinOptions, LocalServer, OpenError, PipelineDepth,
    ServerConnection,
};
use rhumb_netsim::{LinkConfig, SimNetwork};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId, Stepping};
use rhumb_protocol::session::{ClientSession, Event};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, BodyState};
use rhumb_scene::{Limits, SceneRouter, SceneSettings};

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
}
