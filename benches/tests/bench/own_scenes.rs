//! Recorded scenes of Foxglove are read as their entities come, change and go.

use foxglove::messages::{
    ArrowPrimitive, CubePrimitive, Duration, ModelPrimitive, Pose, PoseInFrame, SceneEntity,
    SceneEntityDeletion, SceneUpdate, SpherePrimitive,
};
use glam::{DQuat, DVec3, Vec3};
use rhumb_protocol::scene::Shape;
use rhumb_reckoning::{BodyId, Tick};

use crate::own_recording::{
    compare, drawn, keeps_its_tolerance, mcap_of, moments, plain, quaternion, stamp, stays, vector,
};

#[test]
fn scenes_and_single_poses_of_foxglove_are_bodies_with_their_sizes() {
    let times = moments(60.0, 90);
    let scene: Vec<_> = times
        .iter()
        .map(|(at_ns, t)| {
            let entity = |body| SceneEntity {
                timestamp: stamp(*at_ns),
                id: format!("box{body}"),
                cubes: vec![CubePrimitive {
                    pose: Some(drawn(body, *t)),
                    size: vector(DVec3::new(0.4, 0.2, 0.6)),
                    ..CubePrimitive::default()
                }],
                ..SceneEntity::default()
            };
            let message = SceneUpdate {
                entities: (0..2).map(entity).collect(),
                ..SceneUpdate::default()
            };
            (*at_ns, message)
        })
        .collect();
    let recording = plain("scene.mcap", &mcap_of("/scene", &scene));
    compare(&recording, 60.0, 90);
    let half_extents = Vec3::new(0.2, 0.1, 0.3);
    assert_eq!(
        recording.truth.placed[0].shape,
        Shape::Cuboid { half_extents }
    );

    let single: Vec<_> = times
        .iter()
        .map(|(at_ns, t)| {
            let message = PoseInFrame {
                timestamp: stamp(*at_ns),
                frame_id: "world".to_owned(),
                pose: Some(drawn(0, *t)),
            };
            (*at_ns, message)
        })
        .collect();
    let one = plain("pose.mcap", &mcap_of("/hand", &single));
    assert_eq!((one.truth.placed.len(), one.ticks()), (1, 89));
}

#[test]
fn a_deleted_entity_is_gone_and_a_missing_one_stays() {
    let times = moments(60.0, 30);
    let messages: Vec<_> = times
        .iter()
        .enumerate()
        .map(|(frame, (at_ns, t))| {
            let entity = |body| SceneEntity {
                timestamp: stamp(*at_ns),
                id: format!("box{body}"),
                cubes: vec![CubePrimitive {
                    pose: Some(drawn(body, *t)),
                    size: vector(DVec3::ONE),
                    ..CubePrimitive::default()
                }],
                ..SceneEntity::default()
            };
            let deletion = SceneEntityDeletion {
                timestamp: stamp(*at_ns),
                id: "box1".to_owned(),
                ..SceneEntityDeletion::default()
            };
            let message = SceneUpdate {
                deletions: (frame == 20).then_some(deletion).into_iter().collect(),
                // Box 0 stands still from frame 10 to 19.
                entities: (0..2)
                    .filter(|body| match body {
                        0 => !(10..20).contains(&frame),
                        _ => frame < 20,
                    })
                    .map(entity)
                    .collect(),
            };
            (*at_ns, message)
        })
        .collect();
    let recording = plain("deleted.mcap", &mcap_of("/scene", &messages));
    assert_eq!(recording.truth.placed.len(), 2);
    assert_eq!(
        recording.truth.removed,
        [(Tick::new(19), BodyId::new(1, 0))]
    );
    assert!(
        recording.truth.ticks[14]
            .iter()
            .all(|of| of.id.index() != 0),
        "it stands still"
    );
    keeps_its_tolerance(&recording);
}

/// A scene of a ball: an entity of this id at x.
fn ball(id: &str, at_ns: u64, x: f64) -> SceneEntity {
    SceneEntity {
        timestamp: stamp(at_ns),
        id: id.to_owned(),
        spheres: vec![SpherePrimitive {
            pose: Some(Pose {
                position: vector(DVec3::X * x),
                orientation: quaternion(DQuat::IDENTITY),
            }),
            size: vector(DVec3::splat(0.2)),
            ..SpherePrimitive::default()
        }],
        ..SceneEntity::default()
    }
}

/// A deletion of an entity, or of all.
fn deletion(id: Option<&str>, at_ns: u64) -> SceneEntityDeletion {
    SceneEntityDeletion {
        timestamp: stamp(at_ns),
        r#type: i32::from(id.is_none()),
        id: id.unwrap_or_default().to_owned(),
    }
}

/// Scenes of twenty frames of 10 ms: what each has is said by its frame and moment.
fn scenes(of: impl Fn(u64, u64) -> (Vec<SceneEntity>, Vec<SceneEntityDeletion>)) -> Vec<u8> {
    let message = |frame: u64| {
        let at_ns = 1_000_000_000 + frame * 10_000_000;
        let (entities, deletions) = of(frame, at_ns);
        let update = SceneUpdate {
            entities,
            deletions,
        };
        (at_ns, update)
    };
    let messages: Vec<_> = (0..20).map(message).collect();
    mcap_of("/scene", &messages)
}

#[test]
fn an_entity_and_a_number_are_no_other_entity() {
    // `robot` has two balls, the second of which is called robot#1 here; the entity `robot#1` is another one.
    let bytes = scenes(|frame, at_ns| {
        let x = frame as f64 * 0.01;
        let mut robot = ball("robot", at_ns, x);
        robot.spheres.push(robot.spheres[0]);
        let other = (frame < 10).then(|| ball("robot#1", at_ns, 5.0 + x));
        let entities = [robot].into_iter().chain(other).collect();
        let gone = (frame == 10).then(|| deletion(Some("robot#1"), at_ns));
        (entities, gone.into_iter().collect())
    });
    let recording = plain("hash.mcap", &bytes);
    assert_eq!(
        stays(&recording),
        [(0, 0, None), (1, 0, None), (2, 0, Some(9))]
    );
    assert_eq!(
        recording.truth.placed[2].observation.motion.position()[0],
        5.0
    );
}

#[test]
fn deletions_take_no_more_than_their_messages() {
    let count = 10_000;
    let bytes = scenes(|frame, at_ns| match frame {
        0 => (
            (0..count)
                .map(|body| ball(&body.to_string(), at_ns, 0.0))
                .collect(),
            Vec::new(),
        ),
        5 => (Vec::new(), vec![deletion(None, at_ns); count]),
        6 => (Vec::new(), vec![deletion(Some("7"), at_ns); count]),
        _ => (vec![ball("0", at_ns, frame as f64)], Vec::new()),
    });
    let recording = plain("deletions.mcap", &bytes);
    let stays = stays(&recording);
    assert_eq!(stays.len(), count + 1);
    assert_eq!(stays[..2], [(0, 0, Some(4)), (0, 7, None)]);
    assert!(
        stays[2..]
            .iter()
            .all(|(_, begin, end)| (*begin, *end) == (0, Some(4)))
    );
}

#[test]
fn a_deletion_before_the_first_pose_takes_nothing_away() {
    for at_ns in [0, 900_000_000] {
        let bytes = scenes(|frame, now| {
            let gone = (frame == 0).then(|| deletion(None, at_ns));
            let ball = ball("a", now, frame as f64);
            (vec![ball], gone.into_iter().collect())
        });
        assert_eq!(
            stays(&plain("early.mcap", &bytes)),
            [(0, 0, None)],
            "{at_ns}"
        );
    }
}

#[test]
fn what_an_entity_has_and_a_body_has_not_is_said_and_its_lifetime_ends_it() {
    let bytes = scenes(|frame, at_ns| {
        let mut short = ball("short", at_ns, frame as f64);
        short.lifetime = Some(Duration::new(0, 20_000_000));
        short.frame_id = "robot".to_owned();
        short.spheres[0].size = vector(DVec3::new(0.2, 0.4, 0.8));
        short.arrows.push(ArrowPrimitive::default());
        short.models.push(ModelPrimitive::default());
        let mut long = ball("long", at_ns, frame as f64);
        long.frame_id = "world".to_owned();
        // Its second ball is there in the first ten frames.
        if frame < 10 {
            long.spheres.push(long.spheres[0]);
        }
        let entities = match frame {
            // It is said again within its time, and later not.
            0..=8 | 15.. => vec![long, short],
            _ => vec![long],
        };
        (entities, Vec::new())
    });
    let recording = plain("prims.mcap", &bytes);
    let expected = [
        (0, 0, None),
        (1, 0, Some(9)),
        (2, 0, Some(10)),
        (2, 15, None),
    ];
    assert_eq!(stays(&recording), expected);
    let notes = recording.notes.join("\n");
    for part in [
        "arrows, models are left out",
        "an ellipsoid counts as a ball",
        "the frames robot, world, and are taken as of one",
    ] {
        assert!(notes.contains(part), "{part}: {notes}");
    }
    let bytes = scenes(|frame, at_ns| (vec![ball("a", at_ns, frame as f64)], Vec::new()));
    let notes = plain("plain.mcap", &bytes).notes.join("\n");
    assert!(
        !notes.contains("left out") && !notes.contains("frames"),
        "{notes}"
    );
}
