//! A scene from a checkpoint runs to the same bits; damage is never read.

use rhumb_protocol::scene::Stepping;
use rhumb_protocol::{Endpoint, Instant, Peer, Span};
use rhumb_reckoning::Tick;
use rhumb_scene::{Checkpoint, CheckpointError, Limits, Scene, StepThreads};
use rhumb_sims::{NAMES, Script, by_name};

use crate::links::Links;

/// A script and the scene that it commands.
struct Run {
    script: Box<dyn Script>,
    scene: Scene,
}

impl Run {
    fn new(name: &str) -> Self {
        let script = by_name(name, 40, 6).expect("an existing script");
        let scene = Scene::new(script.config()).expect("a valid configuration");
        Self { script, scene }
    }

    /// Steps it, and others that get the same commands; they must observe and report the same.
    fn step(&mut self, others: &mut [Scene]) {
        let mut commands = Vec::new();
        self.script.commands(self.scene.tick(), &mut commands);
        for command in &commands {
            let applied = self.scene.apply(command);
            for other in &mut *others {
                assert_eq!(other.apply(command), applied, "{command:?}");
            }
        }
        let stepped = self.scene.step().expect("the engine does not fail");
        for other in others {
            assert_eq!(
                other.step().expect("the engine does not fail"),
                stepped,
                "{} at {}",
                self.script.name(),
                self.scene.tick()
            );
            assert_eq!(other.digest(), self.scene.digest());
        }
    }
}

#[test]
fn every_scene_continues_from_its_bytes_to_the_same_bits_for_1000_ticks() {
    for name in NAMES {
        let mut run = Run::new(name);
        for _ in 0..150 {
            run.step(&mut []);
        }
        let saved = run.scene.save().expect("a step was the last change");
        let bytes = saved.to_bytes();
        let read = Checkpoint::from_bytes(&bytes).expect("whole bytes");
        assert_eq!(read, saved, "{name}");
        assert_eq!(
            (read.tick(), read.digest()),
            (Tick::new(150), run.scene.digest())
        );
        let fork = || read.scene(&StepThreads::default()).expect("it continues");
        let mut forks = [fork(), fork()];
        for _ in 0..1_000 {
            run.step(&mut forks);
        }
        let again = forks[0].save().expect("a step was the last change");
        assert_eq!(
            again,
            run.scene.save().expect("a step was the last change"),
            "{name}: the engines' memory differs"
        );
    }
}

#[test]
fn no_byte_of_a_checkpoint_is_read_otherwise() {
    let mut run = Run::new(NAMES[0]);
    run.step(&mut []);
    let bytes = run
        .scene
        .save()
        .expect("a step was the last change")
        .to_bytes();
    for place in (0..300).chain((300..bytes.len()).step_by(97)) {
        let mut flipped = bytes.clone();
        flipped[place] ^= 1 << (place % 8);
        assert_eq!(
            Checkpoint::from_bytes(&flipped),
            Err(CheckpointError::Damaged),
            "byte {place}"
        );
    }
    for length in (0..bytes.len()).step_by(97) {
        assert_eq!(
            Checkpoint::from_bytes(&bytes[..length]),
            Err(CheckpointError::Damaged),
            "cut to {length}"
        );
    }
}

#[test]
fn a_checkpoint_of_another_version_says_which() {
    let scene = Scene::new(rhumb_scene::SceneConfig::default()).expect("a valid configuration");
    let mut bytes = scene.save().expect("nothing has changed").to_bytes();
    let place = bytes
        .windows(6)
        .position(|part| part == b"0.36.1")
        .expect("its engine's version");
    bytes[place] = b'9';
    let code = bytes.len() - 4;
    let checksum = crc32fast::hash(&bytes[..code]);
    bytes[code..].copy_from_slice(&checksum.to_le_bytes());
    let refused = Checkpoint::from_bytes(&bytes).expect_err("another version");
    assert!(refused.to_string().contains("9.36.1"), "{refused}");
}

#[test]
fn a_scene_that_was_changed_since_its_step_is_not_saved_without_what_changed_it() {
    let mut run = Run::new(NAMES[0]);
    run.step(&mut []);
    let (body, place) = {
        let desc = run.scene.bodies().next().expect("a body");
        (desc.id, glam::Vec3::new(0.0, 3.0, 0.0))
    };
    let moved = rhumb_scene::Command::SetPose {
        id: body,
        position: place,
        rotation: glam::Quat::IDENTITY,
    };
    run.scene.apply(&moved).expect("a valid command");
    assert_eq!(run.scene.save(), Err(CheckpointError::Changed));
}

#[test]
fn a_scene_that_is_restored_late_waits_as_long_for_members_as_any() {
    let mut links = Links::with_limits(Limits::default());
    links.begin(Peer(1), Stepping::Lockstep);
    let saved = links.server.save(&"attacked".parse().expect("a name"));
    let saved = saved.expect("the scene is there");
    let (late, name) = (Instant::from_nanos(3_600_000_000_000), "restored".parse());
    let name = name.expect("a name");
    let restored = links.server.restore(late, &name, &saved);
    restored.expect("a free name");
    let empty = Span::from_millis(1_000 * Limits::default().empty_scene_seconds);
    for (after, is_there) in [(Span::from_millis(1), true), (empty, false)] {
        links.server.handle_timeout(late + after);
        assert_eq!(links.server.save(&name).is_ok(), is_there, "{after:?}");
    }
}
