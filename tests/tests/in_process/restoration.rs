//! A scene whose engine fails continues without the commands that broke it.
//!
//! Real sessions command a scene whose engine panics where the test wants it. A parallel scene with the same commands,
//! less those that must be left out, is the truth: its digest must equal the server's, and every copy must have its
//! bodies, shapes and joints.

use glam::Vec3;
use rhumb_protocol::Peer;
use rhumb_protocol::message::{FaultCause, Inspection, StreamChoice};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, Joint, JointFrame, JointId, JointKind, SceneConfig,
    Shape, ShapeId,
};
use rhumb_protocol::session::Event;
use rhumb_reckoning::{BodyId, BodyState, Divergence, Tick, Tolerance};
use rhumb_scene::Scene;
use rhumb_tests::{FailingEngine, Fails, Table, failing_body};

const BALL: ShapeId = ShapeId(0);
const CHOICE: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// A lockstep scene with two members, and the truth beside it.
struct Restored {
    table: Table,
    first: Peer,
    second: Peer,
    truth: Scene,
    /// Events of the first member that were polled with an inspection.
    kept: Vec<Event>,
}

impl Restored {
    fn new() -> Self {
        let config = SceneConfig::default();
        let mut table = Table::with_engines(FailingEngine::engines());
        let first = table.create("failing", config, CHOICE);
        let second = table.connect("failing");
        table.session(second).join(CHOICE).expect("in the lobby");
        table.run_until_idle();
        let truth = Scene::new(config).expect("a valid configuration");
        let mut restored = Self {
            table,
            first,
            second,
            truth,
            kept: Vec::new(),
        };
        let shape = Shape::ball(0.5);
        restored.both(Command::AddShape { id: BALL, shape });
        for index in 0..10 {
            restored.both(add(plain(index), index));
        }
        restored.step();
        restored.events(restored.first);
        restored.events(restored.second);
        restored
    }

    /// Commands the scene only.
    fn command(&mut self, command: Command) -> u64 {
        let session = self.table.session(self.first);
        session.command(command).expect("a member")
    }

    /// Commands the scene and the truth.
    fn both(&mut self, command: Command) -> u64 {
        self.truth.apply(&command).expect("a valid command");
        self.command(command)
    }

    fn advance(&mut self) {
        self.table.run_until_idle();
        let to = self.truth.tick().next();
        self.truth.step().expect("the true engine does not fail");
        let now = self.table.now();
        let session = self.table.session(self.first);
        session.advance(now, to).expect("a member");
        self.table.run_until_idle();
    }

    /// Steps both, and compares everything.
    fn step(&mut self) {
        self.advance();
        assert_eq!(self.inspect().truth, self.truth.digest().value());
        for peer in [self.first, self.second] {
            self.assert_copy(peer);
        }
    }

    fn assert_copy(&mut self, peer: Peer) {
        let tick = self.truth.tick();
        let replica = self.table.session(peer).replica().expect("a member");
        assert_eq!(replica.stream().complete(), tick);
        let bodies: Vec<BodyDesc> = replica.bodies().collect();
        let true_bodies: Vec<BodyDesc> = self.truth.bodies().copied().collect();
        assert_eq!(bodies, true_bodies);
        let joints = |joints: &rhumb_protocol::scene::Joints| -> Vec<(JointId, Joint)> {
            joints.iter().map(|(id, joint)| (id, *joint)).collect()
        };
        assert_eq!(joints(replica.joints()), joints(self.truth.joints()));
        for id in (0..4).map(ShapeId) {
            assert_eq!(replica.shape(id), self.truth.shape(id));
        }
        for desc in self.truth.bodies() {
            let truth = self.truth.observation(desc.id).expect("it exists");
            let copied = replica.stream().predicted_motion(desc.id, tick);
            let copied = copied.expect("the copy has the body");
            let apart = Divergence::between(&truth.motion.motion().pose(), &copied.pose());
            let radius = self.truth.bounding_radius(desc.id).expect("it has a shape");
            assert!(Tolerance::NORMAL.share(&apart, radius) <= 1.0, "{desc:?}");
        }
    }

    fn inspect(&mut self) -> Inspection {
        let session = self.table.session(self.first);
        session.inspect().expect("a member");
        self.table.run_until_idle();
        let mut found = None;
        let session = self.table.session(self.first);
        let mut others = Vec::new();
        while let Some(event) = session.poll_event() {
            match event {
                Event::Inspected(inspection) => found = Some(inspection),
                other => others.push(other),
            }
        }
        self.kept.extend(others);
        found.expect("the server answers")
    }

    /// The faults and refusals that a member received since the last call.
    fn events(&mut self, peer: Peer) -> Vec<Event> {
        let mut events = Vec::new();
        if peer == self.first {
            events.append(&mut self.kept);
        }
        let session = self.table.session(peer);
        events.extend(std::iter::from_fn(|| session.poll_event()));
        events.retain(|event| {
            matches!(
                event,
                Event::Refused { .. }
                    | Event::SceneRestored(_)
                    | Event::SceneFaulted { .. }
                    | Event::ChecksumMismatch
                    | Event::Ended(_)
            )
        });
        events
    }
}

fn plain(index: u32) -> BodyDesc {
    BodyDesc::plain(BodyId::new(index, 0), BodyKind::Dynamic, BALL)
}

fn add(desc: BodyDesc, place: u32) -> Command {
    let at = [place as f32 * 2.0, 10.0, 0.0];
    let motion = BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    Command::AddBody {
        desc,
        motion: motion.expect("finite"),
    }
}

fn fails(index: u32, fails: Fails) -> Command {
    add(failing_body(BodyId::new(index, 0), BALL, fails), index)
}

fn push(index: u32) -> Command {
    Command::Impulse {
        id: BodyId::new(index, 0),
        impulse: Vec3::new(900.0, 0.0, 300.0),
    }
}

fn joint(bodies: [u32; 2]) -> Joint {
    let frames = [1.0, -1.0].map(|x| JointFrame::at(Vec3::X * x));
    let bodies = bodies.map(|index| BodyId::new(index, 0));
    Joint::plain(JointKind::Fixed, bodies, frames)
}

fn refused(number: u64) -> Event {
    let error = CommandError::EngineFailed;
    Event::Refused { number, error }
}

#[test]
fn a_command_on_which_the_engine_fails_is_refused_and_nothing_else_changes() {
    let mut restored = Restored::new();
    restored.both(push(1));
    let culprit = restored.command(fails(10, Fails::Adding));
    restored.both(push(2));
    restored.step();
    let tick = Event::SceneRestored(Tick::new(1));
    let events = restored.events(restored.first);
    assert!(events.contains(&refused(culprit)) && events.contains(&tick));
    assert_eq!(events.len(), 2, "{events:?}");
    assert_eq!(restored.events(restored.second), [tick]);
    for _ in 0..30 {
        restored.step();
    }
}

#[test]
fn of_the_commands_before_a_failed_step_only_the_culprit_is_undone() {
    let mut restored = Restored::new();
    for _ in 0..20 {
        restored.step();
    }
    restored.both(push(1));
    restored.both(Command::RemoveBody {
        id: BodyId::new(3, 0),
    });
    let culprit = restored.command(fails(10, Fails::Step(1)));
    restored.both(add(plain(11), 11));
    // A command that needs the culprit goes with it.
    let dependent = restored.command(push(10));
    restored.both(push(2));
    restored.step();
    let tick = Event::SceneRestored(Tick::new(21));
    let events = restored.events(restored.first);
    for expected in [&refused(culprit), &refused(dependent), &tick] {
        assert!(events.contains(expected), "{events:?}");
    }
    assert_eq!(events.len(), 3, "{events:?}");
    assert_eq!(restored.events(restored.second), [tick]);
    for _ in 0..30 {
        restored.step();
    }
    // The index of the culprit is free, and its generation was never used.
    restored.both(add(plain(10), 10));
    restored.step();
    assert_eq!(restored.events(restored.first), []);
}

#[test]
fn every_kind_of_change_is_undone_with_the_commands_of_a_tick() {
    let mut restored = Restored::new();
    restored.both(Command::AddShape {
        id: ShapeId(1),
        shape: Shape::ball(0.2),
    });
    restored.both(Command::AddJoint {
        id: JointId(0),
        joint: Box::new(joint([0, 1])),
    });
    restored.both(Command::AddJoint {
        id: JointId(1),
        joint: Box::new(joint([8, 9])),
    });
    restored.step();
    // More culprits than are looked for: all commands of the tick are left out.
    for index in 20..25 {
        restored.command(fails(index, Fails::Step(1)));
    }
    for command in [
        Command::RemoveJoint { id: JointId(0) },
        Command::AddJoint {
            id: JointId(2),
            joint: Box::new(joint([4, 5])),
        },
        Command::RemoveBody {
            id: BodyId::new(9, 0),
        },
        Command::RemoveShape { id: ShapeId(1) },
        Command::AddShape {
            id: ShapeId(1),
            shape: Shape::cuboid(0.5, 0.5, 0.5),
        },
        Command::AddShape {
            id: ShapeId(2),
            shape: Shape::ball(0.1),
        },
        Command::ChangeBody {
            desc: BodyDesc {
                shape: ShapeId(2),
                ..plain(7)
            },
        },
        Command::SetGravity { gravity: Vec3::X },
        add(plain(12), 12),
    ] {
        restored.command(command);
    }
    restored.step();
    let events = restored.events(restored.first);
    assert_eq!(events.len(), 15, "14 commands and the notice: {events:?}");
    for _ in 0..30 {
        restored.step();
    }
    assert_eq!(restored.table.closed(restored.first), None);
}

#[test]
fn a_fault_that_comes_late_is_undone_too() {
    let mut restored = Restored::new();
    for _ in 0..5 {
        restored.step();
    }
    let culprit = restored.command(fails(10, Fails::Step(4)));
    // The truth takes no part in the ticks in which the culprit was there: only the copies are compared.
    for _ in 0..3 {
        restored.advance();
        assert_eq!(restored.events(restored.first), []);
    }
    restored.advance();
    let events = restored.events(restored.first);
    assert!(events.contains(&refused(culprit)), "{events:?}");
    assert!(events.contains(&Event::SceneRestored(Tick::new(9))));
    for _ in 0..30 {
        restored.step();
    }
    assert_eq!(
        restored.events(restored.second),
        [Event::SceneRestored(Tick::new(9))]
    );
}

#[test]
fn an_engine_that_fails_without_a_command_ends_the_scene_with_a_reason() {
    let engines = FailingEngine::engines_that_fail_after(Some(7));
    let mut table = Table::with_engines(engines);
    let peer = table.create("failing", SceneConfig::default(), CHOICE);
    let now = table.now();
    let to = Tick::new(9);
    table.session(peer).advance(now, to).expect("a member");
    table.run_until_idle();
    let session = table.session(peer);
    let events: Vec<_> = std::iter::from_fn(|| session.poll_event()).collect();
    let (tick, cause) = (Tick::new(7), FaultCause::FailedAgain);
    assert!(
        events.contains(&Event::SceneFaulted { tick, cause }),
        "{events:?}"
    );
}

#[test]
fn a_scene_is_not_restored_for_ever() {
    let mut restored = Restored::new();
    for _ in 0..3 {
        restored.command(fails(10, Fails::Step(1)));
        restored.step();
        let events = restored.events(restored.first);
        assert_eq!(events.len(), 2, "{events:?}");
    }
    restored.command(fails(10, Fails::Step(1)));
    restored.advance();
    let (tick, cause) = (Tick::new(4), FaultCause::TooOften);
    let faulted = Event::SceneFaulted { tick, cause };
    assert_eq!(restored.events(restored.second).last(), Some(&faulted));
}

/// A step of the sequences below.
#[derive(Clone, Copy, Debug)]
enum Act {
    Join(u32, u32),
    /// Removes the joints of a body.
    Free(u32),
    Remove(u32),
    Disable(u32),
    Kinematic(u32),
    Fixed(u32),
    Step,
}

/// Sequences that panic in the engine with its own joints of a multibody, or with joints between disabled bodies.
fn fatal_sequences() -> [Vec<Act>; 9] {
    use Act::{Disable, Fixed, Free, Join, Kinematic, Remove, Step};
    [
        vec![Join(1, 2), Join(0, 2), Free(2)],
        vec![Join(4, 0), Remove(4), Join(0, 3), Free(0)],
        vec![Join(3, 0), Remove(3), Join(0, 1), Free(0), Join(0, 4)],
        vec![Join(4, 2), Remove(4), Join(2, 1), Free(2), Remove(1)],
        vec![
            Join(0, 3),
            Join(4, 0),
            Join(2, 0),
            Join(4, 2),
            Remove(0),
            Remove(2),
        ],
        vec![Join(4, 3), Kinematic(3)],
        vec![
            Fixed(1),
            Join(0, 4),
            Join(1, 0),
            Step,
            Step,
            Step,
            Join(1, 2),
        ],
        vec![Join(2, 4), Join(4, 0), Step, Disable(2)],
        vec![Disable(1), Disable(0), Step, Join(1, 0)],
    ]
}

fn commands_of(act: Act, scene: &Scene, next: &mut u32) -> Vec<Command> {
    let changed = |index: u32, change: fn(&mut BodyDesc)| {
        let mut desc = plain(index);
        change(&mut desc);
        vec![Command::ChangeBody { desc }]
    };
    match act {
        Act::Join(first, second) => {
            *next += 1;
            let joint = Box::new(joint([first, second]));
            vec![Command::AddJoint {
                id: JointId(*next),
                joint,
            }]
        }
        Act::Free(index) => {
            let id = BodyId::new(index, 0);
            let joints = scene.joints().of_body(id);
            joints.map(|(id, _)| Command::RemoveJoint { id }).collect()
        }
        Act::Remove(index) => vec![Command::RemoveBody {
            id: BodyId::new(index, 0),
        }],
        Act::Disable(index) => changed(index, |desc| desc.enabled = false),
        Act::Kinematic(index) => changed(index, |desc| desc.kind = BodyKind::Kinematic),
        Act::Fixed(index) => changed(index, |desc| desc.kind = BodyKind::Fixed),
        Act::Step => Vec::new(),
    }
}

#[test]
fn sequences_that_are_fatal_to_the_engine_are_harmless_from_a_client() {
    for sequence in fatal_sequences() {
        let mut restored = Restored::new();
        let mut joints = 0;
        for act in &sequence {
            for command in commands_of(*act, &restored.truth, &mut joints) {
                // The server refuses the same commands as the parallel scene.
                if restored.truth.apply(&command).is_ok() {
                    restored.command(command);
                }
            }
            if matches!(act, Act::Step) {
                restored.step();
            }
        }
        for _ in 0..10 {
            restored.step();
        }
        assert_eq!(restored.events(restored.second), [], "{sequence:?}");
    }
}
