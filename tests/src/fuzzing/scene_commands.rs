//! Fuzzes a scene with arbitrary commands and steps.
//!
//! Promises: a command is decoded as it was encoded. A refused command changes nothing. The engine can step whatever
//! was accepted, and every body stays at a valid place. The same script gives the same result.

use rhumb_protocol::message::QueryError;
use rhumb_protocol::scene::{
    ActiveEvents, Answer, Command, Material, Query, QueryFilter, SceneConfig, Shape, Sleep,
    SleepThresholds, Stepping,
};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_reckoning::BodyId;
use rhumb_scene::Scene;

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
        sleep: Sleep::Below(SleepThresholds::by_speed(0.5, 0.1)),
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
        if script.below(8) == 0 {
            ask(&scene, script, &bodies);
            continue;
        }
        let command = match script.below(8) {
            0 => events(script, &bodies),
            _ => command(script, &bodies),
        };
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

/// A command about the events of one of these bodies.
fn events(script: &mut Script<'_>, bodies: &[BodyId]) -> Command {
    Command::SetEvents {
        id: script.one_of(bodies),
        events: ActiveEvents {
            contacts: script.any(),
            force: script.any::<bool>().then(|| script.number(1e4)),
            sensors: script.any(),
            sleep: script.any(),
        },
    }
}

/// Asks about a random place. The answer is none only if the query is invalid, and else finds living bodies.
fn ask(scene: &Scene, script: &mut Script<'_>, bodies: &[BodyId]) {
    let (at, rotation, way) = (script.vector(10.0), script.rotation(), script.vector(20.0));
    let size = script.sane(2.0).abs() + 0.01;
    let shape = script.one_of(&[
        Shape::ball(size),
        Shape::cuboid(size, 0.5, 1.0),
        Shape::capsule(size, 0.3),
        Shape::cylinder(size, 0.3),
    ]);
    let query = match script.below(5) {
        0 => Query::ray(at, way),
        1 => Query::shape_cast(shape, at, rotation, way),
        2 => Query::projection(at, way.x),
        3 => Query::contacts(script.one_of(bodies)),
        _ => Query::overlap(shape, at, rotation),
    };
    let filter = QueryFilter {
        except: script.any::<bool>().then(|| script.one_of(bodies)),
        with_fixed: script.any(),
        ..QueryFilter::DEFAULT
    };
    let query = query.among(filter).finding(4);
    let answers = scene.query(std::slice::from_ref(&query));
    match query.check() {
        Ok(()) => assert_are_living(scene, &answers.expect("an engine can answer")),
        Err(invalid) => assert_eq!(answers, Err(QueryError::Invalid(invalid))),
    }
}

fn assert_are_living(scene: &Scene, answers: &[Answer]) {
    for answer in answers {
        let found: Vec<_> = match answer {
            Answer::Hits(hits) => hits.iter().map(|hit| hit.body).collect(),
            Answer::Bodies(bodies) => bodies.clone(),
        };
        for id in found {
            assert!(scene.body(id).is_some(), "{id} is gone");
        }
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
