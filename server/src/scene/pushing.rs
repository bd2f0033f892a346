//! Commands that change velocities: velocities, forces, torques and impulses.
//!
//! Invariant: no command makes a body faster than a velocity that can be set, along any axis, unless the body was faster
//! already. What exceeds that is refused, never shortened.

use glam::{DVec3, Vec3};
use rhumb_protocol::limits::{ANGULAR_MAX, LINEAR_MAX};
use rhumb_protocol::scene::{BodyKind, CommandError, Invalid, Quantity};
use rhumb_reckoning::{BodyId, Twist};

use super::Scene;
use crate::engine::Push;

/// Share by which rounding may lift a velocity above its limit: an impulse over a mass has three roundings of f32.
const ROUNDING: f64 = 1e-6;

impl Scene {
    pub(super) fn set_velocity(
        &mut self,
        id: BodyId,
        linear: Vec3,
        angular: Vec3,
    ) -> Result<(), CommandError> {
        let kind = self.enabled(id)?.kind;
        let twist = Twist {
            linear: linear.as_dvec3(),
            angular: angular.as_dvec3(),
        };
        match kind {
            BodyKind::Fixed => return Err(CommandError::NotPushable(id)),
            BodyKind::Dynamic => {
                let then = sum(twist, self.engine.pending(id));
                check_speed(self.coming(id), then)?;
            }
            BodyKind::Kinematic => {}
        }
        self.engine.set_velocity(id, twist);
        Ok(())
    }

    pub(super) fn push(&mut self, id: BodyId, push: Push) -> Result<(), CommandError> {
        self.pushable(id)?;
        if let Some(effect) = self.engine.effect(id, push) {
            let now = self.coming(id);
            check_speed(now, sum(now, effect))?;
        }
        self.engine.push(id, push);
        Ok(())
    }

    /// The velocities of a body at the end of the next step, if nothing but the commands until now moved it.
    fn coming(&self, id: BodyId) -> Twist {
        let observed = self.engine.observe_one(id);
        let now = observed.map_or(Twist::ZERO, |body| body.motion.motion().twist());
        sum(now, self.engine.pending(id))
    }
}

/// Refuses velocities beyond the limits, unless they were as far beyond them before.
fn check_speed(before: Twist, after: Twist) -> Result<(), CommandError> {
    let parts = [
        (before.linear, after.linear, LINEAR_MAX, Quantity::Linear),
        (
            before.angular,
            after.angular,
            ANGULAR_MAX,
            Quantity::Angular,
        ),
    ];
    for (before, after, most, quantity) in parts {
        let most = before.abs().max(DVec3::splat(f64::from(most))) * (1.0 + ROUNDING);
        if !after.is_finite() || after.abs().cmpgt(most).any() {
            return Err(CommandError::Invalid(Invalid::out_of_range(quantity)));
        }
    }
    Ok(())
}

fn sum(one: Twist, other: Twist) -> Twist {
    Twist {
        linear: one.linear + other.linear,
        angular: one.angular + other.angular,
    }
}
