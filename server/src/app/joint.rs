//! What a client's joint is among those of a scene.
//!
//! A joint of the client says of each of six motions whether it is held, limited or free. Scenes have four kinds of joint;
//! what is none of them is refused. One to the world that lets an actor go anywhere and keeps it from turning, as avatars
//! have, is no joint at all but a body that nothing turns.

use glam::{Quat, Vec3};
use rhumb_app::{AddJoint, Grip};
use rhumb_protocol::scene::{Joint, JointFrame, JointKind, JointLimits};
use rhumb_reckoning::BodyId;

use super::form::{Frame, unit};
use super::refusal::Refusal;

/// What is left of one motion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Freedom {
    Held,
    Limited(JointLimits),
    Free,
}

/// Linear, then angular.
fn freedoms(told: &AddJoint) -> [[Freedom; 3]; 2] {
    let one = |least: f32, most: f32| {
        if least > most {
            Freedom::Free
        } else if least == most {
            Freedom::Held
        } else {
            Freedom::Limited(JointLimits { least, most })
        }
    };
    let three = |lower: Vec3, upper: Vec3| {
        [
            one(lower.x, upper.x),
            one(lower.y, upper.y),
            one(lower.z, upper.z),
        ]
    };
    [
        three(told.linear_lower, told.linear_upper),
        three(told.angular_lower, told.angular_upper),
    ]
}

/// Whether it keeps an actor from turning and leaves it free to go anywhere.
pub(super) fn is_upright(told: &AddJoint) -> bool {
    freedoms(told) == [[Freedom::Free; 3], [Freedom::Held; 3]]
}

/// Its kind, and the turn that puts the axis that is left free along x.
fn kind(told: &AddJoint) -> Option<(JointKind, Quat)> {
    let [linear, angular] = freedoms(told);
    let held = |freedoms: [Freedom; 3]| freedoms == [Freedom::Held; 3];
    let limits = |freedom| match freedom {
        Freedom::Limited(limits) => Some(limits),
        Freedom::Held | Freedom::Free => None,
    };
    let only = |freedoms: [Freedom; 3]| {
        let mut free = (0..3).filter(|axis| freedoms[*axis] != Freedom::Held);
        free.next().filter(|_| free.next().is_none())
    };
    if held(linear) && held(angular) {
        return Some((JointKind::Fixed, Quat::IDENTITY));
    }
    if held(linear)
        && let Some(axis) = only(angular)
    {
        return Some((JointKind::Revolute(limits(angular[axis])), along(axis)));
    }
    if held(angular)
        && let Some(axis) = only(linear)
    {
        return Some((JointKind::Prismatic(limits(linear[axis])), along(axis)));
    }
    let ball = held(linear) && !angular.contains(&Freedom::Held);
    let whole = |freedom| {
        limits(freedom).unwrap_or(JointLimits {
            least: -core::f32::consts::PI,
            most: core::f32::consts::PI,
        })
    };
    match (ball, angular == [Freedom::Free; 3]) {
        (true, true) => Some((JointKind::Spherical(None), Quat::IDENTITY)),
        (true, false) => Some((
            JointKind::Spherical(Some(angular.map(whole))),
            Quat::IDENTITY,
        )),
        (false, _) => None,
    }
}

/// Turns x into an axis.
const fn along(axis: usize) -> Quat {
    use core::f32::consts::FRAC_1_SQRT_2 as HALF;
    match axis {
        0 => Quat::IDENTITY,
        1 => Quat::from_xyzw(0.0, 0.0, HALF, HALF),
        _ => Quat::from_xyzw(0.0, -HALF, 0.0, HALF),
    }
}

/// Whether a scene can have it.
pub(super) fn check(told: &AddJoint) -> Result<(), Refusal> {
    for grip in [&told.first, &told.second] {
        unit(grip.rotation)?;
        if !grip.anchor.is_finite() {
            return Err(Refusal::Number);
        }
    }
    let limits = [
        told.linear_lower,
        told.linear_upper,
        told.angular_lower,
        told.angular_upper,
    ];
    if !limits.iter().all(|limit| limit.is_finite()) {
        return Err(Refusal::Number);
    }
    if is_upright(told) || kind(told).is_some() {
        Ok(())
    } else {
        Err(Refusal::Joint)
    }
}

/// The joint between two bodies, whose frames lie in their actors as told.
pub(super) fn between(told: &AddJoint, bodies: [(BodyId, Frame); 2]) -> Option<Joint> {
    let (kind, turn) = kind(told)?;
    let grips = [&told.first, &told.second];
    let mut frames = [JointFrame::at(Vec3::ZERO); 2];
    for ((to, grip), (_, frame)) in frames.iter_mut().zip(grips).zip(&bodies) {
        *to = in_body(grip, frame, turn).ok()?;
    }
    Some(Joint {
        kind,
        bodies: bodies.map(|(id, _)| id),
        frames,
        collide: false,
    })
}

fn in_body(grip: &Grip, frame: &Frame, turn: Quat) -> Result<JointFrame, Refusal> {
    let to_body = frame.rotation.conjugate();
    Ok(JointFrame {
        anchor: to_body * (grip.anchor - frame.position),
        rotation: unit(to_body * unit(grip.rotation)? * turn)?,
    })
}
