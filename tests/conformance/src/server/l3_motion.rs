//! L3.4: effects of commands on a body's motion, with any physics engine.
//!
//! Each case has one or two bodies in a scene of its own. Tolerances allow one tick, since engines integrate position
//! and velocity in different orders.

use glam::{DVec3, Quat, Vec3};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, LockedAxes, Shape, ShapeId};
use rhumb_reckoning::{BodyId, Damping, Tick};

use super::l3_physics::{SECOND, TICK, alone, now};
use super::scenery::{BALL, EXACT, G, RADIUS, ball, body, floor, floor_shape, moving, turning};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::LossyClient;
use crate::trial::Trial;

const FULL: StreamChoice = StreamChoice::Full;

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "an impulse changes the velocity at once, by impulse over mass",
        "PROTOCOL 4.4-6, 2.6-1",
        impulse,
    ),
    (
        2,
        "a force acts during one tick, and no longer",
        "PROTOCOL 4.4-6, 2.6-1",
        force,
    ),
    (
        3,
        "a torque impulse changes the spin of a ball by impulse over moment of inertia",
        "PROTOCOL 4.4-6, 2.6-1",
        spin,
    ),
    (
        4,
        "a torque acts during one tick, and no longer",
        "PROTOCOL 4.4-6, 2.6-1",
        torque,
    ),
    (
        5,
        "a set velocity takes effect, and stays where no force acts",
        "PROTOCOL 4.4-6, 2.6-1",
        velocity,
    ),
    (
        6,
        "a teleported body is at its new place at once",
        "PROTOCOL 4.4-6, 2.6-1",
        put,
    ),
    (
        7,
        "a kinematic body keeps its velocity, and does not fall",
        "PROTOCOL 2.6-18",
        kinematic,
    ),
    (
        8,
        "a kinematic body with a new pose moves there during the next tick",
        "PROTOCOL 2.6-18",
        lifted,
    ),
    (
        9,
        "a kinematic body pushes and is not pushed",
        "PROTOCOL 2.6-18",
        pushes,
    ),
    (
        10,
        "a body falls by its gravity scale",
        "PROTOCOL 2.6-12",
        scaled,
    ),
    (
        11,
        "a changed gravity acts from the next step on",
        "PROTOCOL 4.4-6, 6.9-2",
        gravity,
    ),
    (
        12,
        "damping slows a body as specified",
        "PROTOCOL 6.1-4",
        damped,
    ),
    (
        13,
        "a collision of two balls conserves momentum",
        "PROTOCOL 2.6-17",
        momentum,
    ),
    (
        14,
        "a body that sleeps wakes when it is pushed",
        "PROTOCOL 6.3-14",
        wakes,
    ),
    (
        15,
        "a body with locked rotations keeps its rotation when it is hit",
        "PROTOCOL 2.6-19",
        unturned,
    ),
    (
        16,
        "a box that spins about its middle axis flips",
        "PROTOCOL 2.6-19",
        tumbles,
    ),
    (
        17,
        "a ball does not fall through a floor",
        "PROTOCOL 2.6-16",
        fast,
    ),
    (
        18,
        "a fixed body with a new pose stays there",
        "PROTOCOL 2.6-16, 6.10-2",
        moved_floor,
    ),
];

pub(super) fn cases() -> Vec<Case> {
    table("L3.4", &[Feature::Lockstep], CASES).collect()
}

/// Mass of the ball, in kilograms: its volume at the scene's density.
fn mass() -> f64 {
    let volume = 4.0 / 3.0 * std::f64::consts::PI * f64::from(RADIUS).powi(3);
    volume * 1_000.0
}

/// Moment of inertia of the ball about any axis, in kg·m².
fn moment() -> f64 {
    0.4 * mass() * f64::from(RADIUS).powi(2)
}

/// A ball at rest in a scene without gravity.
fn still(trial: &mut Trial<'_>) -> Result<(LossyClient, BodyId), Stop> {
    let (mut subscriber, id) = alone(trial, false, FULL)?;
    subscriber.must(ball(id, Vec3::ZERO, Vec3::ZERO))?;
    Ok((subscriber, id))
}

fn near(what: &str, is: f64, wanted: f64, slack: f64) -> CaseResult {
    ensure(
        (is - wanted).abs() <= slack,
        format!("{what} must be {wanted}, not {is}"),
    )
}

fn impulse(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = still(trial)?;
    let impulse = Vec3::Z * (2.0 * mass()) as f32;
    subscriber.must(Command::Impulse { id, impulse })?;
    subscriber.advance(Tick::new(SECOND))?;
    let motion = now(&subscriber, id)?;
    near("its speed in m/s", motion.twist().linear.z, 2.0, 0.02)?;
    near("its path in m", motion.pose().position.z, 2.0, 0.05)
}

fn force(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = still(trial)?;
    // The force that changes the speed by 1 m/s in one tick.
    let force = Vec3::X * (mass() / TICK) as f32;
    subscriber.must(Command::Force { id, force })?;
    subscriber.advance(Tick::new(1))?;
    let first = now(&subscriber, id)?.twist().linear.x;
    near("its speed after a tick in m/s", first, 1.0, 0.01)?;
    subscriber.advance(Tick::new(20))?;
    near(
        "its speed later",
        now(&subscriber, id)?.twist().linear.x,
        first,
        1e-4,
    )
}

fn spin(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = still(trial)?;
    let impulse = Vec3::Y * (3.0 * moment()) as f32;
    subscriber.must(Command::TorqueImpulse { id, impulse })?;
    subscriber.advance(Tick::new(SECOND / 2))?;
    let motion = now(&subscriber, id)?;
    near("its spin in rad/s", motion.twist().angular.y, 3.0, 0.03)?;
    let turn = 2.0 * motion.pose().rotation.y.abs().asin();
    near("its turn in rad", turn, 1.5, 0.06)?;
    near("its path in m", motion.pose().position.length(), 0.0, 1e-5)
}

fn torque(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = still(trial)?;
    let torque = Vec3::X * (moment() / TICK) as f32;
    subscriber.must(Command::Torque { id, torque })?;
    subscriber.advance(Tick::new(1))?;
    near(
        "its spin in rad/s",
        now(&subscriber, id)?.twist().angular.x,
        1.0,
        0.01,
    )?;
    subscriber.advance(Tick::new(20))?;
    near(
        "its spin later",
        now(&subscriber, id)?.twist().angular.x,
        1.0,
        0.011,
    )
}

fn velocity(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = still(trial)?;
    let (linear, angular) = (Vec3::Y * 4.0, Vec3::Z);
    let set = Command::SetVelocity {
        id,
        linear,
        angular,
    };
    subscriber.must(set)?;
    subscriber.advance(Tick::new(SECOND))?;
    let twist = now(&subscriber, id)?.twist();
    near(
        "the velocity error in m/s",
        (twist.linear - DVec3::Y * 4.0).length(),
        0.0,
        1e-4,
    )?;
    near(
        "the spin error in rad/s",
        (twist.angular - DVec3::Z).length(),
        0.0,
        1e-3,
    )
}

fn put(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = still(trial)?;
    let position = Vec3::new(20.0, -3.0, 1.0);
    let rotation = Quat::from_xyzw(0.0, 1.0, 0.0, 0.0);
    let set = Command::SetPose {
        id,
        position,
        rotation,
    };
    subscriber.must(set)?;
    subscriber.advance(Tick::new(1))?;
    let pose = now(&subscriber, id)?.pose();
    near(
        "the position error in m",
        (pose.position - position.as_dvec3()).length(),
        0.0,
        1e-5,
    )?;
    near("its rotation's y", pose.rotation.y.abs(), 1.0, 1e-5)
}

/// A kinematic ball at rest in a scene with gravity.
fn lift(trial: &mut Trial<'_>) -> Result<(LossyClient, BodyId), Stop> {
    let (mut subscriber, id) = alone(trial, true, FULL)?;
    let desc = BodyDesc::plain(id, BodyKind::Kinematic, BALL);
    let motion = moving(Vec3::ZERO, Vec3::ZERO);
    subscriber.must(Command::AddBody { desc, motion })?;
    Ok((subscriber, id))
}

fn kinematic(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = lift(trial)?;
    subscriber.advance(Tick::new(10))?;
    near(
        "its fall in m",
        now(&subscriber, id)?.pose().position.length(),
        0.0,
        0.0,
    )?;
    let (linear, angular) = (Vec3::new(2.0, 1.0, 0.0), Vec3::ZERO);
    let set = Command::SetVelocity {
        id,
        linear,
        angular,
    };
    subscriber.must(set)?;
    subscriber.advance(Tick::new(10 + SECOND))?;
    let off = now(&subscriber, id)?.pose().position - DVec3::new(2.0, 1.0, 0.0);
    near("the position error in m", off.length(), 0.0, 1e-3)
}

fn lifted(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = lift(trial)?;
    let (position, rotation) = (Vec3::X * 0.5, Quat::IDENTITY);
    let set = Command::SetPose {
        id,
        position,
        rotation,
    };
    subscriber.must(set)?;
    for tick in [1, 10] {
        subscriber.advance(Tick::new(tick))?;
        let off = now(&subscriber, id)?.pose().position - position.as_dvec3();
        near("the position error in m", off.length(), 0.0, 1e-6)?;
    }
    Ok(())
}

fn pushes(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, false, FULL)?;
    let pushed = body(subscriber.granted, 1)?;
    let desc = BodyDesc::plain(id, BodyKind::Kinematic, BALL);
    let motion = moving(Vec3::ZERO, Vec3::X);
    subscriber.must(Command::AddBody { desc, motion })?;
    subscriber.must(ball(pushed, Vec3::X * 1.5, Vec3::ZERO))?;
    subscriber.advance(Tick::new(2 * SECOND))?;
    let (lift, ball) = (now(&subscriber, id)?, now(&subscriber, pushed)?);
    let off = lift.pose().position - DVec3::X * 2.0;
    near("its deviation in m", off.length(), 0.0, 1e-3)?;
    let ahead = ball.pose().position.x - lift.pose().position.x;
    ensure(
        ahead >= 0.95,
        format!("the ball is pushed ahead, and is {ahead} m in front"),
    )
}

fn scaled(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, true, FULL)?;
    let scales = [0.0, 0.5, -1.0];
    let named = |place: usize| BodyId::new(id.index() + place as u32, id.generation());
    for (place, scale) in scales.into_iter().enumerate() {
        let mut desc = BodyDesc::plain(named(place), BodyKind::Dynamic, BALL);
        desc.gravity_scale = scale;
        let motion = moving(Vec3::X * (3 * place) as f32, Vec3::ZERO);
        subscriber.must(Command::AddBody { desc, motion })?;
    }
    subscriber.advance(Tick::new(SECOND))?;
    let g = f64::from(G);
    for (place, scale) in scales.into_iter().enumerate() {
        let speed = now(&subscriber, named(place))?.twist().linear.y;
        near("its speed in m/s", speed, -g * f64::from(scale), g * TICK)?;
    }
    Ok(())
}

fn gravity(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, true, FULL)?;
    subscriber.must(ball(id, Vec3::ZERO, Vec3::ZERO))?;
    subscriber.advance(Tick::new(30))?;
    let before = now(&subscriber, id)?.twist().linear;
    let gravity = Vec3::X * 6.0;
    subscriber.must(Command::SetGravity { gravity })?;
    subscriber.advance(Tick::new(60))?;
    let gained = now(&subscriber, id)?.twist().linear - before;
    near("its gain in vertical speed in m/s", gained.y, 0.0, 1e-4)?;
    near("its gain in horizontal speed in m/s", gained.x, 3.0, 0.1)?;
    ensure(
        subscriber.replica()?.gravity() == gravity,
        "all members receive the change",
    )
}

fn damped(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, false, FULL)?;
    let mut desc = BodyDesc::plain(id, BodyKind::Dynamic, BALL);
    desc.damping = Some(Damping {
        linear: 1.0,
        angular: 0.0,
    });
    let motion = moving(Vec3::ZERO, Vec3::X * 10.0);
    subscriber.must(Command::AddBody { desc, motion })?;
    subscriber.advance(Tick::new(SECOND))?;
    // After one second 1/e of the speed is left; the engine's steps change that slightly.
    let wanted = 10.0 * (-1.0_f64).exp();
    near(
        "its speed in m/s",
        now(&subscriber, id)?.twist().linear.x,
        wanted,
        0.1,
    )
}

fn momentum(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, false, FULL)?;
    let other = body(subscriber.granted, 1)?;
    subscriber.must(ball(id, Vec3::ZERO, Vec3::X * 3.0))?;
    subscriber.must(ball(other, Vec3::X * 2.0, Vec3::ZERO))?;
    subscriber.advance(Tick::new(2 * SECOND))?;
    let (one, two) = (
        now(&subscriber, id)?.twist(),
        now(&subscriber, other)?.twist(),
    );
    let off = one.linear + two.linear - DVec3::X * 3.0;
    near("the lost momentum per mass in m/s", off.length(), 0.0, 0.03)?;
    ensure(two.linear.x >= 0.5, "the other ball was hit")
}

fn wakes(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, true, EXACT)?;
    let under = body(subscriber.granted, 1)?;
    subscriber.must(floor_shape())?;
    subscriber.must(floor(under))?;
    subscriber.must(ball(id, Vec3::Y * RADIUS, Vec3::ZERO))?;
    for second in 1..=6 {
        subscriber.advance(Tick::new(second * SECOND))?;
    }
    let impulse = Vec3::Y * (5.0 * mass()) as f32;
    subscriber.must(Command::Impulse { id, impulse })?;
    subscriber.advance(Tick::new(6 * SECOND + 20))?;
    let height = now(&subscriber, id)?.pose().position.y;
    ensure(
        height >= 0.8,
        format!("it jumps, and is not still at {height} m"),
    )
}

fn unturned(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, false, FULL)?;
    let other = body(subscriber.granted, 1)?;
    let mut desc = BodyDesc::plain(id, BodyKind::Dynamic, BALL);
    desc.locked = LockedAxes::ROTATIONS;
    let motion = moving(Vec3::ZERO, Vec3::ZERO);
    subscriber.must(Command::AddBody { desc, motion })?;
    // The hit is off centre, so that an unlocked body would turn.
    subscriber.must(ball(other, Vec3::new(-2.0, 0.4, 0.0), Vec3::X * 4.0))?;
    subscriber.advance(Tick::new(2 * SECOND))?;
    let motion = now(&subscriber, id)?;
    ensure(motion.twist().linear.length() >= 0.5, "it was hit")?;
    near(
        "its rotation's w",
        motion.pose().rotation.w.abs(),
        1.0,
        1e-6,
    )
}

fn tumbles(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, false, FULL)?;
    let shape = ShapeId(7);
    subscriber.must(Command::AddShape {
        id: shape,
        shape: Shape::Cuboid {
            half_extents: Vec3::new(0.2, 0.5, 1.0),
        },
    })?;
    let spin = Vec3::new(0.05, 6.0, 0.0);
    let desc = BodyDesc::plain(id, BodyKind::Dynamic, shape);
    let motion = turning(Vec3::ZERO, Quat::IDENTITY, Vec3::ZERO, spin);
    subscriber.must(Command::AddBody { desc, motion })?;
    let mut least = f64::INFINITY;
    for tick in 1..=6 * SECOND {
        subscriber.advance(Tick::new(tick))?;
        let motion = now(&subscriber, id)?;
        // The direction of the box's own y axis in the world.
        least = least.min((motion.pose().rotation * DVec3::Y).y);
        let off = motion.pose().position.length();
        near("its displacement in m", off, 0.0, 1e-3)?;
    }
    ensure(
        least <= -0.5,
        format!("its axis flips; the least value of its y component is {least}"),
    )
}

fn fast(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, id) = alone(trial, true, FULL)?;
    let under = body(subscriber.granted, 1)?;
    subscriber.must(floor_shape())?;
    subscriber.must(floor(under))?;
    // The path per tick is shorter than the floor is thick.
    subscriber.must(ball(id, Vec3::Y * 10.0, Vec3::NEG_Y * 60.0))?;
    subscriber.advance(Tick::new(2 * SECOND))?;
    let height = now(&subscriber, id)?.pose().position.y;
    ensure(
        height >= 0.0,
        format!("it is on the floor, not at {height} m"),
    )
}

fn moved_floor(trial: &mut Trial<'_>) -> CaseResult {
    let (mut subscriber, _) = alone(trial, true, FULL)?;
    let under = body(subscriber.granted, 1)?;
    subscriber.must(floor_shape())?;
    subscriber.must(floor(under))?;
    subscriber.advance(Tick::new(5))?;
    let (id, position, rotation) = (under, Vec3::Y * 7.0, Quat::IDENTITY);
    let set = Command::SetPose {
        id,
        position,
        rotation,
    };
    subscriber.must(set)?;
    for tick in [6, 60] {
        subscriber.advance(Tick::new(tick))?;
        let off = now(&subscriber, id)?.pose().position - position.as_dvec3();
        near("the position error in m", off.length(), 0.0, 1e-6)?;
    }
    Ok(())
}
