//! Properties and shapes of bodies, at their creation and changed afterwards.
//!
//! The helpers of the parent check after every tick that the copy keeps its promise.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, CollisionGroups, Command, CommandError, Invalid, LockedAxes, Mass,
    Material, Quantity, Shape, ShapeId,
};
use rhumb_reckoning::{BodyId, Damping};

use super::{G, Remote, VALID, ball, floor, near};

#[test]
fn damping_and_gravity_scale_change_in_flight() {
    let mut remote = Remote::new();
    let ball = remote.add(&ball().linear_velocity([8.0, 0.0, 0.0]));
    remote.steps(30);
    near(remote.velocity(ball).y, -G * 0.5, 0.1);
    remote.change(ball, |desc| desc.gravity_scale = 0.0);
    remote.steps(30);
    near(remote.velocity(ball).y, -G * 0.5, 0.1);
    remote.change(ball, |desc| {
        desc.damping = Some(Damping {
            linear: 20.0,
            angular: 0.0,
        });
    });
    remote.steps(60);
    assert!(remote.velocity(ball).length() < 0.01);
}

#[test]
fn a_locked_axis_takes_no_motion() {
    let mut remote = Remote::new();
    let height = LockedAxes::EACH[1];
    let ball = remote.add(&ball().locked_axes(height | LockedAxes::ROTATIONS));
    remote.done(&Command::ImpulseAt {
        id: ball,
        impulse: Vec3::new(500.0, 500.0, 0.0),
        point: Vec3::new(0.0, 0.5, 0.0),
    });
    remote.steps(60);
    assert_eq!(remote.position(ball).y, 0.0);
    assert_eq!(remote.spin(ball), Vec3::ZERO);
    assert!(remote.position(ball).x > 0.5);
    remote.change(ball, |desc| desc.locked = LockedAxes::NONE);
    remote.steps(60);
    assert!(remote.position(ball).y < -4.0);
}

#[test]
fn an_impulse_at_a_point_turns_a_body_as_its_mass_properties_say() {
    let mut remote = Remote::new();
    let body = remote.add(&ball().gravity_scale(0.0).mass(4.0));
    remote.change(body, |desc| {
        desc.mass = Some(Mass {
            mass: 2.0,
            moments: Some(Vec3::splat(0.5)),
        });
    });
    remote.done(&Command::ImpulseAt {
        id: body,
        impulse: Vec3::new(0.0, 0.0, 3.0),
        point: Vec3::new(0.5, 0.0, 0.0),
    });
    remote.steps(1);
    near(remote.velocity(body).z, 3.0 / 2.0, 1e-4);
    near(remote.spin(body).y, -3.0 * 0.5 / 0.5, 1e-3);
    remote.done(&Command::ForceAt {
        id: body,
        force: Vec3::new(0.0, 0.0, -6.0),
        point: Vec3::ZERO,
    });
    remote.steps(1);
    near(remote.velocity(body).z, 1.5 - 6.0 / 2.0 / 60.0, 1e-4);
}

#[test]
fn a_body_of_its_own_mass_has_the_moments_of_its_shape_in_proportion() {
    let mut remote = Remote::new();
    for (number, own) in [None, Some(8.0)].into_iter().enumerate() {
        let cube = BodyDesc::dynamic(Shape::cuboid(0.5, 0.5, 0.5)).gravity_scale(0.0);
        let cube = cube.at(number as f32 * 10.0, 0.0, 0.0);
        let cube = remote.add(&own.map_or(cube.clone(), |mass| cube.clone().mass(mass)));
        remote.done(&Command::TorqueImpulse {
            id: cube,
            impulse: Vec3::new(0.0, 2.0, 0.0),
        });
        remote.steps(1);
        // A cube of one metre: a sixth of its mass.
        near(
            remote.spin(cube).y,
            2.0 * 6.0 / own.unwrap_or(1_000.0),
            1e-3,
        );
    }
}

#[test]
fn a_body_becomes_kinematic_static_and_dynamic_again() {
    let mut remote = Remote::new();
    let body = remote.add(&ball().linear_velocity([3.0, 0.0, 0.0]));
    remote.steps(10);
    let there = remote.position(body);
    for (kind, moves) in [(BodyKind::Kinematic, true), (BodyKind::Fixed, false)] {
        remote.change(body, |desc| desc.kind = kind);
        remote.steps(10);
        assert_eq!(remote.position(body), there);
        let answer = remote.send(&Command::SetVelocity {
            id: body,
            linear: Vec3::X,
            angular: Vec3::ZERO,
        });
        let stands = CommandError::NotPushable(body);
        assert_eq!(answer, if moves { Ok(()) } else { Err(stands) });
        remote.done(&Command::SetPose {
            id: body,
            position: there,
            rotation: Quat::IDENTITY,
        });
        remote.steps(2);
    }
    remote.change(body, |desc| {
        desc.kind = BodyKind::Dynamic;
    });
    remote.steps(30);
    assert!(remote.position(body).y < there.y - 0.5);
}

#[test]
fn a_disabled_body_stays_and_touches_nothing_until_it_is_enabled() {
    let mut remote = Remote::new();
    let support = remote.add(&BodyDesc::fixed(Shape::cuboid(2.0, 0.5, 2.0)).at(0.0, -1.0, 0.0));
    let ball = remote.add(&ball());
    remote.steps(240);
    near(remote.position(ball).y, 0.0, 0.02);
    // The sleeping ball wakes and falls when its support is disabled.
    remote.change(support, |desc| desc.enabled = false);
    remote.steps(60);
    let fallen = remote.position(ball);
    assert!(fallen.y < -4.0, "{fallen}");
    remote.change(ball, |desc| desc.enabled = false);
    let answer = remote.send(&Command::Impulse {
        id: ball,
        impulse: Vec3::X,
    });
    assert_eq!(answer, Err(CommandError::BodyDisabled(ball)));
    remote.steps(60);
    assert_eq!(remote.position(ball), fallen);
    remote.done(&Command::SetPose {
        id: ball,
        position: Vec3::new(0.0, 3.0, 0.0),
        rotation: Quat::IDENTITY,
    });
    remote.change(support, |desc| desc.enabled = true);
    remote.steps(2);
    assert_eq!(remote.position(ball).y, 3.0);
    remote.change(ball, |desc| desc.enabled = true);
    remote.steps(120);
    near(remote.position(ball).y, 0.0, 0.02);
}

#[test]
fn a_body_is_put_to_sleep_and_woken() {
    let mut remote = Remote::new();
    let body = remote.add(&ball());
    remote.steps(10);
    remote.done(&Command::Sleep { id: body });
    remote.steps(1);
    let there = remote.position(body);
    assert_eq!(remote.truth.awake_count(), 0);
    remote.steps(30);
    assert_eq!(remote.position(body), there);
    remote.done(&Command::Wake { id: body });
    remote.steps(30);
    assert!(remote.position(body).y < there.y - 1.0);
}

#[test]
fn sensors_and_collision_groups_let_bodies_pass() {
    let mut remote = Remote::new();
    let support = remote.add(&BodyDesc::fixed(Shape::cuboid(2.0, 0.5, 2.0)).as_sensor());
    let [first, second] = [1.0, 2.0].map(|x| remote.add(&ball().at(x, 1.1, 0.0)));
    remote.steps(60);
    assert!(remote.position(first).y < -2.0 && remote.position(second).y < -2.0);
    remote.change(support, |desc| desc.sensor = false);
    remote.change(first, |desc| {
        desc.groups = CollisionGroups {
            members: 2,
            touches: 2,
        };
    });
    remote.change(support, |desc| {
        desc.groups = CollisionGroups {
            members: 1,
            touches: 1,
        };
    });
    for (x, id) in [(-1.0, first), (1.0, second)] {
        remote.done(&Command::SetPose {
            id,
            position: Vec3::new(x, 1.5, 0.0),
            rotation: Quat::IDENTITY,
        });
        remote.done(&Command::SetVelocity {
            id,
            linear: Vec3::ZERO,
            angular: Vec3::ZERO,
        });
    }
    remote.steps(60);
    assert!(remote.position(first).y < -1.0);
    near(remote.position(second).y, 1.0, 0.05);
}

#[test]
fn friction_restitution_and_dominance_change() {
    let mut remote = Remote::new();
    let ice = Material {
        friction: 0.0,
        restitution: 0.0,
        density: 100.0,
    };
    remote.add(&floor().material(ice));
    let cube = BodyDesc::dynamic(Shape::cuboid(0.5, 0.5, 0.5)).at(0.0, 0.5, 0.0);
    let cube = remote.add(&cube.material(ice).linear_velocity([4.0, 0.0, 0.0]));
    remote.steps(60);
    near(remote.velocity(cube).x, 4.0, 0.05);
    remote.change(cube, |desc| {
        desc.material = Some(Material {
            friction: 2.0,
            ..ice
        });
    });
    remote.steps(120);
    near(remote.velocity(cube).x, 0.0, 0.01);
    // A light body of greater dominance keeps its velocity and pushes a heavy one out of its way.
    let before = remote.position(cube).x;
    let pusher = ball().at(remote.position(cube).x - 3.0, 0.5, 0.0).mass(0.1);
    let pusher = remote.add(&pusher.gravity_scale(0.0).linear_velocity([5.0, 0.0, 0.0]));
    remote.change(pusher, |desc| desc.dominance = 5);
    remote.steps(90);
    near(remote.velocity(pusher).x, 5.0, 0.01);
    assert!(remote.position(cube).x > before + 0.5);
}

#[test]
fn a_swept_body_does_not_pass_through_a_moving_wall() {
    for swept in [false, true] {
        let mut remote = Remote::new();
        let wall = BodyDesc::dynamic(Shape::cuboid(0.01, 2.0, 2.0)).gravity_scale(0.0);
        let wall = remote.add(&wall);
        let bullet = BodyDesc::dynamic(Shape::ball(0.05)).gravity_scale(0.0);
        let bullet = remote.add(&bullet.at(-3.1, 0.0, 0.0).linear_velocity([200.0, 0.0, 0.0]));
        remote.change(bullet, |desc| desc.swept = swept);
        remote.steps(4);
        let passed = remote.position(bullet).x > remote.position(wall).x + 1.0;
        assert_eq!(passed, !swept, "swept: {swept}");
    }
}

#[test]
fn a_body_takes_another_shape() {
    let mut remote = Remote::new();
    remote.add(&floor());
    let body = remote.add(&ball().at(0.0, 0.5, 0.0));
    let shape = ShapeId(99);
    remote.done(&Command::AddShape {
        id: shape,
        shape: Shape::cuboid(0.5, 1.5, 0.5),
    });
    remote.change(body, |desc| desc.shape = shape);
    remote.steps(240);
    near(remote.position(body).y, 1.5, 0.05);
    // The old shape has no users any more.
    remote.done(&Command::RemoveShape { id: ShapeId(1) });
    let answer = remote.send(&Command::RemoveShape { id: shape });
    assert_eq!(answer, Err(CommandError::ShapeInUse(shape)));
}

#[test]
fn round_cuboids_cones_and_balls_come_to_rest_on_a_half_space() {
    let mut remote = Remote::new();
    remote.add(&floor());
    let round = Shape::RoundedCuboid {
        half_extents: Vec3::splat(0.4),
        radius: 0.1,
    };
    for (place, (shape, height)) in [
        (Shape::ball(0.5), 0.5),
        (round, 0.5),
        (Shape::cone(0.5, 0.5), 0.25),
        (Shape::cylinder(0.5, 0.3), 0.5),
    ]
    .into_iter()
    .enumerate()
    {
        let body = BodyDesc::dynamic(shape).at(place as f32 * 3.0, height + 0.2, 0.0);
        let body = remote.add(&body);
        remote.steps(180);
        near(remote.position(body).y, height, 0.02);
    }
    let normal = Vec3::ZERO;
    let invalid = Err(Invalid::not_finite(Quantity::Rotation));
    assert_eq!(Shape::HalfSpace { normal }.check(), invalid);
}

#[test]
fn swept_bodies_are_limited_and_a_change_frees_a_place() {
    let mut remote = Remote::new();
    let swept = |place: u32| ball().at(place as f32 * 2.0, 0.0, 0.0).swept();
    for place in 0..64 {
        remote.add(&swept(place));
    }
    let shape = ShapeId(0);
    let one_more = Command::AddBody {
        desc: swept(64).desc(BodyId::new(64, 0), shape),
        motion: swept(64).state().expect(VALID),
    };
    let answer = remote.send(&one_more);
    assert_eq!(answer, Err(CommandError::TooManySwept));
    remote.change(BodyId::new(5, 0), |desc| desc.swept = false);
    remote.done(&one_more);
    remote.steps(2);
}

#[test]
fn dampings_of_removed_bodies_can_be_used_again() {
    let mut remote = Remote::new();
    let shape = ShapeId(0);
    remote.done(&Command::AddShape {
        id: shape,
        shape: Shape::ball(0.5),
    });
    let mut refused = 0;
    for round in 0..200_u16 {
        let id = BodyId::new(u32::from(round % 70), round / 70);
        if lives(&remote, id.index()) {
            let before = BodyId::new(id.index(), round / 70 - 1);
            remote.done(&Command::RemoveBody { id: before });
        }
        let ball = ball().damping(Damping {
            linear: f32::from(round) * 0.01,
            angular: 0.0,
        });
        let answer = remote.send(&Command::AddBody {
            desc: ball.desc(id, shape),
            motion: ball.state().expect(VALID),
        });
        refused += u32::from(answer == Err(CommandError::TooManyDampings));
        if round % 20 == 0 {
            remote.steps(1);
        }
    }
    // Of each seventy bodies six find no place beside the other dampings.
    assert!((1..=18).contains(&refused), "{refused}");
}

fn lives(remote: &Remote, index: u32) -> bool {
    remote.truth.bodies().any(|desc| desc.id.index() == index)
}
