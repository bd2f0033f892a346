//! Conversion of an APP client's joint into a joint of a scene.
//!
//! A client's joint makes each of six motions locked, limited or free. Scenes have four kinds of joint; all other
//! combinations are refused. A joint to the world that only prevents rotation, as avatars have, becomes a body without
//! rotation instead.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{Joint, JointFrame, JointKind, JointLimits};
use rhumb_reckoning::BodyId;

use crate::actor::{Frame, unit};
use crate::options::Refusal;
use crate::wire::{AddJoint, Grip};

/// Freedom of one motion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Freedom {
    Locked,
    Limited(JointLimits),
    Free,
}

/// Linear, then angular.
fn freedoms(message: &AddJoint) -> [[Freedom; 3]; 2] {
    let one = |least: f32, most: f32| {
        if least > most {
            Freedom::Free
        } else if least == most {
            Freedom::Locked
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
        three(message.linear_lower, message.linear_upper),
        three(message.angular_lower, message.angular_upper),
    ]
}

/// True if it prevents rotation and leaves all translation free.
pub(super) fn is_upright(message: &AddJoint) -> bool {
    freedoms(message) == [[Freedom::Free; 3], [Freedom::Locked; 3]]
}

/// A joint's kind, and the turn that puts the remaining free axis along x.
fn kind(message: &AddJoint) -> Option<(JointKind, Quat)> {
    let [linear, angular] = freedoms(message);
    let locked = |freedoms: [Freedom; 3]| freedoms == [Freedom::Locked; 3];
    let limits = |freedom| match freedom {
        Freedom::Limited(limits) => Some(limits),
        Freedom::Locked | Freedom::Free => None,
    };
    let only = |freedoms: [Freedom; 3]| {
        let mut free = (0..3).filter(|axis| freedoms[*axis] != Freedom::Locked);
        free.next().filter(|_| free.next().is_none())
    };
    if locked(linear) && locked(angular) {
        return Some((JointKind::Fixed, Quat::IDENTITY));
    }
    if locked(linear)
        && let Some(axis) = only(angular)
    {
        return Some((JointKind::Revolute(limits(angular[axis])), along(axis)));
    }
    if locked(angular)
        && let Some(axis) = only(linear)
    {
        return Some((JointKind::Prismatic(limits(linear[axis])), along(axis)));
    }
    let ball = locked(linear) && !angular.contains(&Freedom::Locked);
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

/// Checks that a scene can have the joint.
pub(super) fn check(message: &AddJoint) -> Result<(), Refusal> {
    for grip in [&message.first, &message.second] {
        unit(grip.rotation)?;
        if !grip.anchor.is_finite() {
            return Err(Refusal::Number);
        }
    }
    let limits = [
        message.linear_lower,
        message.linear_upper,
        message.angular_lower,
        message.angular_upper,
    ];
    if !limits.iter().all(|limit| limit.is_finite()) {
        return Err(Refusal::Number);
    }
    if is_upright(message) || kind(message).is_some() {
        Ok(())
    } else {
        Err(Refusal::Joint)
    }
}

/// The joint between two bodies, whose frames are given in their actors.
pub(super) fn between(message: &AddJoint, bodies: [(BodyId, Frame); 2]) -> Option<Joint> {
    let (kind, turn) = kind(message)?;
    let grips = [&message.first, &message.second];
    let mut frames = [JointFrame::at(Vec3::ZERO); 2];
    for ((to, grip), (_, frame)) in frames.iter_mut().zip(grips).zip(&bodies) {
        *to = in_body(grip, frame, turn).ok()?;
    }
    Some(Joint {
        kind,
        bodies: bodies.map(|(id, _)| id),
        frames,
        collide: false,
        motors: [None; 6],
        strength: None,
    })
}

fn in_body(grip: &Grip, frame: &Frame, turn: Quat) -> Result<JointFrame, Refusal> {
    let to_body = frame.rotation.conjugate();
    Ok(JointFrame {
        anchor: to_body * (grip.anchor - frame.position),
        rotation: unit(to_body * unit(grip.rotation)? * turn)?,
    })
}
