//! Fuzzes a scene with arbitrary commands and steps.
//!
//! Promises: a command is decoded as it was encoded. A refused command changes nothing. The engine can step whatever
//! was accepted, and every body stays at a valid place. The same script gives the same result.

use rhumb_protocol::scene::{Command, Material, SceneConfig, SleepConfig, Stepping};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_reckoning::BodyId;
use rhumb_server::Scene;

use super::commands::command;
use super::script::Script;
use super::subscriber::assert_is_motion;

/// Number of commands and steps of one script, so that it ends soon.
const ACTS_MAX: usize = 60;
/// Indices of bodies are below this.
const BODIES: u32 = 6;

/// A script of commands and steps.
pub fn scene_commands(data: &[u8]) {
    let once = played(&mut Script::new(data));
    let again = played(&mut Script::new(data));
    assert_eq!(once, again, "the same script gives the same result");
}

/// The configuration of a scene in which bodies fall asleep soon.
pub(super) fn scene_config(stepping: Stepping) -> SceneConfig {
    SceneConfig {
        gravity: glam::Vec3::new(0.0, -9.8, 0.0),
        stepping,
        material: Material {
            friction: 0.5,
            restitution: 0.2,
            density: 1_000.0,
        },
        sleep: Some(SleepConfig {
            speed: 0.5,
            seconds: 0.1,
        }),
        ..SceneConfig::default()
    }
}

/// Checksum of the result of a script.
fn played(script: &mut Script<'_>) -> u64 {
    let mut bodies: Vec<_> = (0..BODIES).map(|index| BodyId::new(index, 0)).collect();
    bodies.extend([BodyId::new(0, 1), BodyId::new(1, 1)]);
    let mut scene = Scene::new(scene_config(Stepping::Lockstep)).expect("a valid configuration");
    for _ in 0..ACTS_MAX {
        if !script.goes_on() {
            break;
        }
        if script.below(4) == 0 {
            step(&mut scene);
            continue;
        }
        let command = command(script, &bodies);
        assert_read_as_written(&command);
        let before = state(&scene);
        if let Err(error) = scene.apply(&command) {
            assert_eq!(state(&scene), before, "{command:?} was refused: {error}");
        }
    }
    for _ in 0..5 {
        step(&mut scene);
    }
    scene.digest().value()
}

fn step(scene: &mut Scene) {
    scene
        .step()
        .expect("a scene of accepted commands can be stepped");
    let ids = scene.bodies().map(|desc| desc.id);
    for id in ids.collect::<Vec<_>>() {
        let observation = scene.observation(id).expect("an existing body has a state");
        assert_is_motion(&observation.motion.motion());
    }
}

/// All state that a refused command must not change.
fn state(scene: &Scene) -> impl PartialEq + std::fmt::Debug + use<> {
    let mut all = Vec::new();
    scene.observe_all(&mut all);
    let bodies: Vec<_> = scene.bodies().copied().collect();
    let shapes: Vec<_> = scene
        .shapes()
        .map(|(id, shape)| (id, shape.clone()))
        .collect();
    let joints: Vec<_> = scene
        .joints()
        .iter()
        .map(|(id, joint)| (id, *joint))
        .collect();
    (
        scene.digest().value(),
        scene.gravity(),
        all,
        bodies,
        shapes,
        joints,
    )
}

/// An invalid command may fail to decode, but it is never decoded as another.
pub(super) fn assert_read_as_written(command: &Command) {
    let mut to = Writer::new();
    command.encode(&mut to);
    let bytes = to.into_bytes();
    let mut reader = Reader::new(&bytes);
    let read = Command::decode(&mut reader);
    if command.check().is_ok() {
        assert_eq!(read.as_ref(), Ok(command));
    }
    if let Ok(read) = read {
        let mut to = Writer::new();
        read.encode(&mut to);
        assert_eq!(to.into_bytes(), bytes);
    }
}
