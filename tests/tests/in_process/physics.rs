//! Properties of bodies, joints and shapes over the wire.
//!
//! One session sends commands, and a local scene gets the same ones: it is the truth. After every tick the session's copy
//! is within its bounds of the truth, whatever was changed, and both scenes have had the same states to the bit.

mod bodies;
mod characters;
mod file_joints;
mod joints;
mod vehicles;

use glam::Vec3;
use rhumb_protocol::Peer;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, Command, CommandError, Joint, JointId, SceneConfig, Shape, ShapeId,
};
use rhumb_protocol::session::Event;
use rhumb_protocol::stream::ErrorBound;
use rhumb_reckoning::{BodyId, Tick, Tolerance};
use rhumb_scene::Scene;
use rhumb_tests::fuzzing::random_commands;
use rhumb_tests::{Dice, Table, seed};

const VALID: &str = "the test makes it valid";
const MEMBER: &str = "the session is a member";
const G: f32 = 10.0;

/// A scene on a server, its member, and the same scene here.
struct Remote {
    table: Table,
    peer: Peer,
    truth: Scene,
    bodies: u32,
}

impl Remote {
    fn new() -> Self {
        let config = SceneConfig {
            gravity: Vec3::new(0.0, -G, 0.0),
            ..SceneConfig::default()
        };
        let mut table = Table::default();
        let peer = table.connect("physics");
        let session = table.session(peer);
        session.create(config).expect("the session is in the lobby");
        session
            .join(StreamChoice::Within(Tolerance::FINE))
            .expect("the session is in the lobby");
        table.run_until_idle();
        Self {
            table,
            peer,
            truth: Scene::new(config).expect(VALID),
            bodies: 0,
        }
    }

    /// Sends a command, which both scenes must answer alike.
    fn send(&mut self, command: &Command) -> Result<(), CommandError> {
        let answer = self.truth.apply(command);
        self.events();
        let session = self.table.session(self.peer);
        session.command(command.clone()).expect(MEMBER);
        self.table.run_until_idle();
        let refused = self.events().into_iter().find_map(|event| match event {
            Event::Refused { error, .. } => Some(error),
            _ => None,
        });
        assert_eq!(refused, answer.err(), "{command:?}");
        answer
    }

    fn done(&mut self, command: &Command) {
        self.send(command).expect(VALID);
    }

    fn events(&mut self) -> Vec<Event> {
        let session = self.table.session(self.peer);
        core::iter::from_fn(|| session.poll_event()).collect()
    }

    /// Adds a body with a shape of its own.
    fn add(&mut self, body: &BodyBuilder) -> BodyId {
        let (id, shape) = (BodyId::new(self.bodies, 0), ShapeId(self.bodies));
        self.bodies += 1;
        self.done(&Command::AddShape {
            id: shape,
            shape: body.shape().clone(),
        });
        self.done(&Command::AddBody {
            desc: body.desc(id, shape),
            motion: body.state().expect(VALID),
        });
        id
    }

    /// Replaces the description of a body.
    fn change(&mut self, id: BodyId, change: impl FnOnce(&mut BodyDesc)) {
        let mut desc = *self.truth.body(id).expect("it lives");
        change(&mut desc);
        self.done(&Command::ChangeBody { desc });
        let copy = self.table.session(self.peer).replica().expect(MEMBER);
        assert_eq!(copy.body(id), Some(desc), "the copy knows the change");
    }

    fn join(&mut self, id: u32, joint: Joint) {
        let id = JointId(id);
        self.done(&Command::AddJoint {
            id,
            joint: joint.into(),
        });
    }

    /// Steps both scenes; after each tick every body of the copy is within its bound of the truth.
    fn steps(&mut self, ticks: u64) {
        for _ in 0..ticks {
            let next = Tick::new(self.truth.tick().value() + 1);
            self.truth.step().expect("the engine does not fail");
            let now = self.table.now();
            let session = self.table.session(self.peer);
            session.advance(now, next).expect(MEMBER);
            self.table.run_until_idle();
            self.check(next);
        }
    }

    fn check(&mut self, tick: Tick) {
        let mut truth = Vec::new();
        self.truth.observe_all(&mut truth);
        let copy = self.table.session(self.peer).replica().expect(MEMBER);
        for observation in truth {
            let id = observation.id;
            let Some(ErrorBound::Within(bound)) = copy.stream().bound_at(id, tick) else {
                panic!("{id} has no bound at {tick:?}");
            };
            let motion = copy.stream().predicted_motion(id, tick).expect("a body");
            let away = motion.pose().position - observation.motion.motion().pose().position;
            assert!(
                away.length() <= bound.metres(),
                "{id} is {away} from the truth at {tick:?}"
            );
        }
        assert_eq!(copy.stream().statistics().mismatches, 0);
        let local: Vec<_> = self.truth.joints().iter().collect();
        let copied: Vec<_> = copy.joints().iter().collect();
        assert_eq!(copied, local, "the copy has the joints of the scene");
    }

    fn position(&self, id: BodyId) -> Vec3 {
        let observation = self.truth.observation(id).expect("it lives");
        Vec3::from_array(observation.motion.position())
    }

    fn velocity(&self, id: BodyId) -> Vec3 {
        let parts = self.truth.observation(id).expect("it lives").motion.parts();
        Vec3::new(parts[7], parts[8], parts[9])
    }

    fn spin(&self, id: BodyId) -> Vec3 {
        let parts = self.truth.observation(id).expect("it lives").motion.parts();
        Vec3::new(parts[10], parts[11], parts[12])
    }
}

/// At the end the server has had the same states as the local scene, to the bit.
impl Drop for Remote {
    fn drop(&mut self) {
        if std::thread::panicking() {
            return;
        }
        let session = self.table.session(self.peer);
        session.inspect().expect(MEMBER);
        self.table.run_until_idle();
        let truth = self.events().into_iter().find_map(|event| match event {
            Event::Inspected(inspection) => Some(inspection.truth),
            _ => None,
        });
        assert_eq!(truth, Some(self.truth.digest().value()));
    }
}

fn ball() -> BodyBuilder {
    BodyDesc::dynamic(Shape::ball(0.5))
}

fn floor() -> BodyBuilder {
    BodyDesc::fixed(Shape::HalfSpace { normal: Vec3::Y })
}

fn near(value: f32, expected: f32, slack: f32) {
    assert!((value - expected).abs() <= slack, "{value}, not {expected}");
}

#[test]
fn random_commands_have_the_same_effect_over_the_wire() {
    let mut dice = Dice::new(seed(7));
    let bodies: Vec<_> = (0..6).map(|index| BodyId::new(index, 0)).collect();
    let mut sent = 0;
    for _ in 0..120 {
        let data: Vec<u8> = (0..3_000).map(|_| dice.below(256) as u8).collect();
        let mut remote = Remote::new();
        for command in random_commands(&data, &bodies) {
            // A session sends no command with an invalid number.
            if command.check().is_ok() {
                sent += u32::from(remote.send(&command).is_ok());
                if dice.below(3) == 0 {
                    remote.steps(1);
                }
            }
        }
        remote.steps(30);
    }
    assert!(sent > 2_000, "{sent}");
}
