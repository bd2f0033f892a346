//! Characters over the wire: they walk, climb, slide, fall, jump and push.
//!
//! The helpers of the parent check after every tick that the copy keeps its promise.

use glam::{Quat, Vec3};
use rhumb_protocol::limits::CHARACTERS_MAX;
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, BodyEvent, BodyKind, Character, CharacterStep, Command, CommandError,
    Compound, Heights, Invalid, JumpFrom, Locomotion, Mesh, Quantity, Shape, ShapeId,
};
use rhumb_protocol::session::Event;
use rhumb_reckoning::BodyId;

use super::{Remote, VALID, floor, near};

/// Height of the centre of [`person`] above the ground that it stands on: half its height, and its offset.
const STANDING: f32 = 0.92;

/// A body of 1.8 m that stands on the floor at this place.
fn person(x: f32) -> BodyBuilder {
    BodyDesc::kinematic(Shape::capsule(0.6, 0.3)).at(x, STANDING, 0.0)
}

fn slab(x: f32, y: f32, half: Vec3) -> BodyBuilder {
    BodyDesc::fixed(Shape::cuboid(half.x, half.y, half.z)).at(x, y, 0.0)
}

impl Remote {
    fn with_floor() -> Self {
        let mut remote = Self::new();
        remote.add(&floor());
        remote
    }

    fn add_character(&mut self, body: &BodyBuilder, character: Character) -> BodyId {
        let id = self.add(body);
        self.done(&set(id, character));
        id
    }

    fn walk(&mut self, id: BodyId, linear: Vec3) {
        self.done(&Command::SetVelocity {
            id,
            linear,
            angular: Vec3::ZERO,
        });
    }

    /// Steps, and returns the events of bodies with their ticks.
    fn body_events(&mut self, ticks: u64) -> Vec<(u64, BodyEvent)> {
        self.events();
        self.steps(ticks);
        let of_bodies = self.events().into_iter().filter_map(|event| match event {
            Event::Body { tick, event } => Some((tick.value(), event)),
            _ => None,
        });
        of_bodies.collect()
    }
}

fn set(id: BodyId, character: Character) -> Command {
    Command::SetLocomotion {
        id,
        locomotion: Locomotion::Character(character).into(),
    }
}

const fn jump(id: BodyId, speed: f32, from: JumpFrom) -> Command {
    Command::Jump { id, speed, from }
}

#[test]
fn a_character_walks_by_its_velocity_and_stops() {
    let mut remote = Remote::with_floor();
    let id = remote.add_character(&person(0.0), Character::default());
    remote.steps(10);
    remote.walk(id, Vec3::new(2.0, 0.0, 0.0));
    remote.steps(60);
    near(remote.position(id).x, 2.0, 0.02);
    near(remote.position(id).y, STANDING, 0.01);
    near(remote.velocity(id).x, 2.0, 0.02);
    remote.walk(id, Vec3::ZERO);
    remote.steps(1);
    let stopped = remote.position(id);
    remote.steps(120);
    assert_eq!(remote.position(id), stopped, "it stands to the bit");
}

/// A body that begins within its gap, on a box, and with the box: the engine does not find the box in the first step.
#[test]
fn a_character_stands_on_a_box_however_near_it_begins() {
    for height in [0.895, 0.9, 0.91, STANDING, 1.0] {
        let mut remote = Remote::new();
        remote.add(&slab(0.0, -0.5, Vec3::new(20.0, 0.5, 20.0)));
        let body = person(0.0).at(0.0, height, 0.0);
        let id = remote.add_character(&body, Character::default());
        remote.steps(60);
        near(remote.position(id).y, STANDING, 0.002);
        remote.walk(id, Vec3::new(1.0, 0.0, 0.5));
        let events = remote.body_events(120);
        near(remote.position(id).y, STANDING, 0.002);
        // The engine's casts on a box lose a twentieth of the way.
        near(remote.position(id).x, 2.0, 0.15);
        assert_eq!(events, [], "from {height} m");
    }
}

#[test]
fn a_character_turns_as_it_walks() {
    let mut remote = Remote::with_floor();
    let id = remote.add_character(&person(0.0), Character::default());
    remote.done(&Command::SetVelocity {
        id,
        linear: Vec3::X,
        angular: Vec3::Y,
    });
    remote.steps(60);
    near(remote.position(id).x, 1.0, 0.02);
    let rotation = remote.truth.observation(id).expect("it lives").motion;
    let turned = Quat::from_slice(&rotation.parts()[3..7]);
    near(turned.angle_between(Quat::from_rotation_y(1.0)), 0.0, 0.01);
}

#[test]
fn a_character_climbs_a_step_that_is_low_enough() {
    for (height, climbs) in [(0.2, true), (0.6, false)] {
        let mut remote = Remote::with_floor();
        remote.add(&slab(3.0, height / 2.0, Vec3::new(1.0, height / 2.0, 2.0)));
        let stepping = Character::default().step(CharacterStep::new(0.3, 0.1));
        let id = remote.add_character(&person(0.0), stepping);
        remote.walk(id, Vec3::new(2.0, 0.0, 0.0));
        remote.steps(80);
        let there = remote.position(id);
        if climbs {
            // Each climb takes it a tick or two.
            near(there.x, 2.0 * 80.0 / 60.0, 0.3);
            near(there.y, STANDING + height, 0.02);
        } else {
            assert!(there.x < 1.7, "{there}");
            near(there.y, STANDING, 0.02);
        }
    }
}

#[test]
fn a_character_climbs_a_slope_that_is_flat_enough() {
    for (degrees, climbs) in [(30.0_f32, true), (60.0, false)] {
        let mut remote = Remote::with_floor();
        let slope = Quat::from_rotation_z(degrees.to_radians());
        let ramp = BodyDesc::fixed(Shape::HalfSpace { normal: Vec3::Y })
            .at(1.0, 0.0, 0.0)
            .rotation(slope);
        remote.add(&ramp);
        let id = remote.add_character(&person(-1.0), Character::default());
        remote.walk(id, Vec3::new(2.0, 0.0, 0.0));
        remote.steps(120);
        let there = remote.position(id);
        if climbs {
            assert!(there.y > STANDING + 0.6, "{there}");
        } else {
            assert!(there.y < STANDING + 0.1, "{there}");
        }
    }
}

#[test]
fn a_character_slides_down_a_steep_slope_and_stands_on_a_flat_one() {
    for (degrees, slides) in [(25.0_f32, false), (60.0, true)] {
        let mut remote = Remote::new();
        let slope = Quat::from_rotation_z(degrees.to_radians());
        let ramp = BodyDesc::fixed(Shape::HalfSpace { normal: Vec3::Y }).rotation(slope);
        remote.add(&ramp);
        let above = slope * Vec3::Y * 0.35 + Vec3::Y * 0.6;
        let body = person(0.0).position(above);
        let id = remote.add_character(&body, Character::default());
        let events = remote.body_events(60);
        let fell = above.y - remote.position(id).y;
        let reached = events
            .iter()
            .any(|(_, event)| *event == BodyEvent::ReachedGround(id));
        if slides {
            assert!(fell > 1.0 && !reached, "{fell}, {events:?}");
        } else {
            assert!(fell < 0.1 && reached, "{fell}, {events:?}");
        }
    }
}

#[test]
fn a_character_jumps_and_lands_and_its_copy_learns_of_both() {
    let mut remote = Remote::with_floor();
    let id = remote.add_character(&person(0.0), Character::default());
    let ground = remote.body_events(10);
    // In the first step the engine does not know the floor yet, which came with it.
    assert_eq!(ground, [(2, BodyEvent::ReachedGround(id))]);
    remote.done(&jump(id, 5.0, JumpFrom::Ground));
    let left = remote.body_events(30);
    assert_eq!(left, [(11, BodyEvent::LeftGround(id))]);
    // Half a second at 10 m/s² reaches 1.25 m.
    near(remote.position(id).y, STANDING + 1.25, 0.06);
    // In the air it has no ground to jump from.
    remote.done(&jump(id, 5.0, JumpFrom::Ground));
    let landed = remote.body_events(60);
    let [(tick, BodyEvent::ReachedGround(_))] = landed[..] else {
        panic!("{landed:?}");
    };
    assert!((68..=74).contains(&tick), "{tick}");
    near(remote.position(id).y, STANDING, 0.01);
    for _ in 0..2 {
        remote.done(&jump(id, 5.0, JumpFrom::Anywhere));
        remote.steps(20);
    }
    assert!(remote.position(id).y > STANDING + 1.8, "it jumped twice");
}

#[test]
fn a_jump_ends_below_a_ceiling() {
    let mut remote = Remote::with_floor();
    remote.add(&slab(0.0, 2.6, Vec3::new(2.0, 0.2, 2.0)));
    let id = remote.add_character(&person(0.0), Character::default());
    remote.steps(5);
    remote.done(&jump(id, 8.0, JumpFrom::Ground));
    remote.steps(12);
    let highest = remote.position(id).y;
    assert!(highest < 1.5 && remote.velocity(id).y <= 0.0, "{highest}");
    remote.steps(40);
    near(remote.position(id).y, STANDING, 0.01);
}

#[test]
fn a_character_without_gravity_does_not_fall() {
    let mut remote = Remote::new();
    let floating = person(0.0).gravity_scale(0.0);
    let id = remote.add_character(&floating, Character::default());
    remote.walk(id, Vec3::new(1.0, 0.5, 0.0));
    remote.steps(60);
    near(remote.position(id).x, 1.0, 1e-3);
    near(remote.position(id).y, STANDING + 0.5, 1e-3);
}

#[test]
fn a_character_pushes_a_box_by_its_mass() {
    let mut pushed = [0.0; 2];
    for (way, mass) in pushed.iter_mut().zip([80.0, 0.0]) {
        let mut remote = Remote::with_floor();
        let load = BodyDesc::dynamic(Shape::cuboid(0.3, 0.3, 0.3)).mass(20.0);
        let load = remote.add(&load.at(1.5, 0.3, 0.0));
        let id = remote.add_character(&person(0.0), Character::default().mass(mass));
        remote.walk(id, Vec3::new(2.0, 0.0, 0.0));
        remote.steps(90);
        *way = remote.position(load).x - 1.5;
    }
    let [heavy, none] = pushed;
    assert!(heavy > 0.3 && none.abs() < 0.02, "{heavy}, {none}");
}

#[test]
fn a_moving_platform_carries_a_character() {
    let mut remote = Remote::with_floor();
    let platform = BodyDesc::kinematic(Shape::cuboid(1.0, 0.1, 1.0)).at(0.0, 1.0, 0.0);
    let platform = remote.add(&platform);
    let on_top = person(0.0).position(Vec3::new(0.0, 1.1 + STANDING, 0.0));
    let id = remote.add_character(&on_top, Character::default());
    remote.steps(5);
    remote.walk(platform, Vec3::new(1.0, 0.0, 0.0));
    remote.steps(60);
    near(remote.position(platform).x, 1.0, 0.01);
    // It starts a few ticks after the platform.
    near(remote.position(id).x, 1.0, 0.15);
    remote.walk(platform, Vec3::new(0.0, 1.0, 0.0));
    remote.steps(60);
    near(remote.position(id).y, 2.1 + STANDING, 0.1);
}

#[test]
fn a_character_walks_as_far_on_kinematic_ground_as_on_fixed() {
    let corners = [
        [-20.0, 0.0, -20.0],
        [20.0, 0.0, -20.0],
        [20.0, 0.0, 20.0],
        [-20.0, 0.0, 20.0],
    ];
    let sheet = Mesh::new(&corners.map(Vec3::from_array), &[[0, 2, 1], [0, 3, 2]]);
    let sheet = Shape::Mesh(sheet.expect("two triangles"));
    let field = Heights::new(17, 2.5, 2.5, &[0.0; 17 * 17]).expect("a flat field");
    let grounds = [
        (Shape::cuboid(20.0, 0.5, 20.0), Vec3::Y * -0.5),
        (Shape::cuboid(20.0, 2.0, 20.0), Vec3::Y * -2.0),
        (sheet, Vec3::ZERO),
        (Shape::Heights(field), Vec3::new(-20.0, 0.0, -20.0)),
        (Shape::HalfSpace { normal: Vec3::Y }, Vec3::ZERO),
    ];
    for (shape, at) in grounds {
        let ground = [BodyDesc::fixed, BodyDesc::kinematic];
        let ways = ground.map(|ground| {
            let mut remote = Remote::new();
            remote.add(&ground(shape.clone()).position(at));
            let id = remote.add_character(&person(0.0), Character::default());
            remote.steps(60);
            let begin = remote.position(id).x;
            remote.walk(id, Vec3::new(1.0, 0.0, 0.0));
            remote.steps(300);
            remote.position(id).x - begin
        });
        assert!(ways.iter().all(|way| *way > 4.5), "{shape:?}: {ways:?}");
    }
}

#[test]
fn a_character_walks_on_a_platform_that_carries_it() {
    for (platform_speed, walk) in [(1.0, 1.0), (1.0, -1.0), (2.0, 2.0), (-1.0, 3.0)] {
        let mut remote = Remote::with_floor();
        let platform = BodyDesc::kinematic(Shape::cuboid(30.0, 0.1, 3.0)).at(0.0, 1.0, 0.0);
        let platform = remote.add(&platform);
        let on_top = person(0.0).position(Vec3::new(0.0, 1.1 + STANDING, 0.0));
        let id = remote.add_character(&on_top, Character::default());
        remote.steps(30);
        remote.walk(platform, Vec3::new(platform_speed, 0.0, 0.0));
        remote.walk(id, Vec3::new(walk, 0.0, 0.0));
        remote.steps(120);
        near(remote.position(id).x, 2.0 * (platform_speed + walk), 0.25);
    }
}

#[test]
fn a_pose_puts_a_character_elsewhere_and_ends_its_fall() {
    let mut remote = Remote::with_floor();
    let id = remote.add_character(&person(0.0).at(0.0, 20.0, 0.0), Character::default());
    remote.steps(60);
    assert!(remote.velocity(id).y < -9.0);
    remote.done(&Command::SetPose {
        id,
        position: Vec3::new(5.0, 3.0, 0.0),
        rotation: Quat::IDENTITY,
    });
    remote.steps(1);
    assert_eq!(remote.position(id), Vec3::new(5.0, 3.0, 0.0));
    remote.steps(1);
    assert!(remote.velocity(id).y > -0.5, "the fall begins anew");
}

#[test]
fn a_body_that_ceases_to_be_a_character_stands_still() {
    let mut remote = Remote::with_floor();
    let id = remote.add_character(&person(0.0).at(0.0, 5.0, 0.0), Character::default());
    remote.steps(20);
    remote.done(&Command::SetLocomotion {
        id,
        locomotion: Locomotion::None.into(),
    });
    let there = remote.position(id);
    remote.steps(20);
    assert_eq!(remote.position(id), there);
    let answer = remote.send(&jump(id, 5.0, JumpFrom::Anywhere));
    assert_eq!(answer, Err(CommandError::NotCharacter(id)));
}

#[test]
fn a_change_that_a_character_cannot_have_ends_it() {
    let mut remote = Remote::with_floor();
    let id = remote.add_character(&person(0.0), Character::default());
    remote.change(id, |desc| desc.enabled = false);
    let disabled = remote.send(&jump(id, 5.0, JumpFrom::Anywhere));
    assert_eq!(disabled, Err(CommandError::BodyDisabled(id)));
    remote.change(id, |desc| desc.enabled = true);
    remote.done(&jump(id, 0.0, JumpFrom::Anywhere));
    remote.change(id, |desc| desc.kind = BodyKind::Dynamic);
    remote.change(id, |desc| desc.kind = BodyKind::Kinematic);
    assert_eq!(remote.truth.locomotion(id), None);
    let answer = remote.send(&jump(id, 5.0, JumpFrom::Anywhere));
    assert_eq!(answer, Err(CommandError::NotCharacter(id)));
    remote.steps(5);
}

#[test]
fn settings_that_no_character_can_have_are_refused() {
    let mut remote = Remote::with_floor();
    let ball = remote.add(&BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 3.0, 0.0));
    let answer = remote.send(&set(ball, Character::default()));
    assert_eq!(answer, Err(CommandError::NotKinematic(ball)));
    let empty = Shape::Compound(Compound::new(Vec::new()).expect(VALID));
    let group = remote.add(&BodyDesc::kinematic(empty).at(9.0, 3.0, 0.0));
    let answer = remote.send(&set(group, Character::default()));
    assert_eq!(answer, Err(CommandError::NotConvex(ShapeId(2))));
    let unknown = BodyId::new(77, 0);
    for command in [
        set(unknown, Character::default()),
        jump(unknown, 1.0, JumpFrom::Ground),
    ] {
        let answer = remote.send(&command);
        assert_eq!(answer, Err(CommandError::UnknownBody(unknown)));
    }
    let removed = remote.add_character(&person(0.0), Character::default());
    remote.done(&Command::RemoveBody { id: removed });
    let answer = remote.send(&jump(removed, 1.0, JumpFrom::Ground));
    assert_eq!(answer, Err(CommandError::UnknownBody(removed)));
    remote.steps(3);
}

/// A client checks before it sends, and the server checks the same again.
#[test]
fn numbers_that_no_character_can_have_are_named() {
    let with = |change: fn(&mut Character)| {
        let mut character = Character::default();
        change(&mut character);
        character.check()
    };
    let wrong = Err(Invalid::out_of_range(Quantity::Character));
    assert_eq!(Character::default().check(), Ok(()));
    assert_eq!(with(|character| character.offset = 0.0), wrong);
    assert_eq!(with(|character| character.climb_angle = 1.6), wrong);
    assert_eq!(with(|character| character.mass = -1.0), wrong);
    assert_eq!(with(|character| character.snap = Some(0.0)), wrong);
    let step = CharacterStep::new(0.0, 0.1);
    assert_eq!(Character::default().step(step).check(), wrong);
    let not_finite = Err(Invalid::not_finite(Quantity::Character));
    let nan = with(|character| character.slide_angle = f32::NAN);
    assert_eq!(nan, not_finite);
    let tilted = Character::default().up(Vec3::new(0.0, 2.0, 0.0)).check();
    assert_eq!(tilted, Err(Invalid::not_finite(Quantity::Rotation)));
}

#[test]
fn a_scene_has_a_limited_number_of_characters() {
    let mut remote = Remote::new();
    let mut last = None;
    for place in 0..=CHARACTERS_MAX {
        let body = BodyDesc::kinematic(Shape::ball(0.1)).at(place as f32, 0.0, 0.0);
        let id = remote.add(&body.gravity_scale(0.0));
        let answer = remote.send(&set(id, Character::default()));
        assert_eq!(answer.is_ok(), place < CHARACTERS_MAX);
        last = answer.err();
    }
    assert_eq!(last, Some(CommandError::TooManyCharacters));
}
