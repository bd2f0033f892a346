//! One scene: the contacts and the stays in sensors between two steps.

use rhumb_protocol::scene::{ActiveEvents, BodyKind};
use rhumb_reckoning::{BodyId, BodyState};

use super::*;

const SENSOR: BodyId = BodyId::new(0, 0);
const BALL: BodyId = BodyId::new(1, 0);
const FLOOR: BodyId = BodyId::new(2, 0);

fn report(id: BodyId, contacts: bool, sensors: bool) -> Command {
    let events = ActiveEvents {
        contacts,
        sensors,
        ..ActiveEvents::NONE
    };
    Command::SetEvents { id, events }
}

/// A ball that lies on a floor and in a sensor, which reports it; the ball reports the floor.
fn standing() -> Scene {
    let mut scene = Scene::new(SceneConfig::default()).unwrap();
    let bodies = [
        (SENSOR, BodyKind::Fixed, Shape::cuboid(1.0, 1.0, 1.0), 0.5),
        (BALL, BodyKind::Dynamic, Shape::ball(0.5), 0.5),
        (FLOOR, BodyKind::Fixed, Shape::cuboid(9.0, 0.5, 9.0), -0.5),
    ];
    for (body, kind, shape, height) in bodies {
        let id = ShapeId(body.index());
        scene.apply(&Command::AddShape { id, shape }).unwrap();
        let desc = BodyDesc {
            sensor: body == SENSOR,
            ..BodyDesc::plain(body, kind, id)
        };
        let at = [0.0, height, 0.0];
        let motion = BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).unwrap();
        scene.apply(&Command::AddBody { desc, motion }).unwrap();
    }
    scene.apply(&report(SENSOR, false, true)).unwrap();
    scene.apply(&report(BALL, true, false)).unwrap();
    (0..10).for_each(|_| drop(scene.step().unwrap()));
    scene
}

/// The pairs that stand: those that touch, then sensors with bodies.
fn pairs(scene: &Scene) -> [Vec<(BodyId, BodyId)>; 2] {
    let mut pairs = [Vec::new(), Vec::new()];
    for event in scene.standing_events() {
        match event {
            BodyEvent::ContactBegan { body, contact } => pairs[0].push((body, contact.with)),
            BodyEvent::SensorEntered { sensor, body } => pairs[1].push((sensor, body)),
            other => panic!("{other:?}"),
        }
    }
    pairs
}

#[test]
fn what_stands_between_two_steps_is_of_bodies_that_exist_and_of_those_that_report() {
    let (touch, inside) = (vec![(BALL, FLOOR)], vec![(SENSOR, BALL)]);
    let mut scene = standing();
    assert_eq!(pairs(&scene), [touch.clone(), inside.clone()]);
    scene.apply(&report(SENSOR, false, false)).unwrap();
    assert_eq!(pairs(&scene), [touch, vec![]]);
    let mut scene = standing();
    scene.apply(&Command::RemoveBody { id: FLOOR }).unwrap();
    assert_eq!(pairs(&scene), [vec![], inside]);
    for gone in [SENSOR, BALL] {
        let mut scene = standing();
        scene.apply(&Command::RemoveBody { id: gone }).unwrap();
        assert_eq!(pairs(&scene)[1], []);
    }
    let mut scene = standing();
    scene.apply(&Command::RemoveBody { id: BALL }).unwrap();
    assert_eq!(pairs(&scene), [vec![], vec![]]);
}

fn observation(x: f32) -> Observation {
    let motion = BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    Observation {
        id: BodyId::new(7, 1),
        motion: motion.unwrap(),
        activity: Activity::Awake,
    }
}

fn digest(tick: u64, observations: &[Observation]) -> u64 {
    let mut digest = Digest::START;
    digest.fold_tick(Tick::new(tick), observations);
    digest.value()
}

#[test]
fn every_word_changes_the_digest() {
    let one = digest(1, &[observation(1.0)]);
    assert_ne!(one, digest(2, &[observation(1.0)]));
    assert_ne!(one, digest(1, &[observation(-1.0)]));
    assert_ne!(
        digest(1, &[observation(0.0)]),
        digest(1, &[observation(-0.0)])
    );
    let asleep = Observation {
        activity: Activity::Asleep,
        ..observation(1.0)
    };
    assert_ne!(one, digest(1, &[asleep]));
    assert_ne!(digest(1, &[]), digest(2, &[]));
}

#[test]
fn the_digest_equals_its_definition() {
    // Computed by another program from the definition above.
    assert_eq!(digest(1, &[]), 0x4c6d_e8a6_4caa_b305);
    assert_eq!(digest(1, &[observation(1.0)]), 0xc837_96b8_99c9_1bed);
}
