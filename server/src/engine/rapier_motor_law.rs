//! The law of a motor over a step, and the settings that follow it.
//!
//! Knows numbers only, neither bodies nor joints.

use rhumb_protocol::scene::Motor;

/// The mean acceleration of a motor in a step, by its law and as the solver takes it: in substeps, each by its end.
pub(super) fn mean_acceleration(
    motor: &Motor,
    lack: f64,
    rate: f64,
    (step, substep): (f64, f64),
) -> f64 {
    let (turned, rate_after) = after_step(motor, lack, rate, (step, substep));
    debug_assert!(turned.is_finite(), "its numbers are");
    (rate_after - rate) / step
}

/// The way and the rate of a motor after a step, by its law.
pub(super) fn after_step(
    motor: &Motor,
    lack: f64,
    rate: f64,
    (step, substep): (f64, f64),
) -> (f64, f64) {
    let (stiffness, damping) = (f64::from(motor.stiffness), f64::from(motor.damping));
    let (mut way, mut now) = (0.0, rate);
    let mut left = step;
    while left > substep * 0.5 {
        let slow = f64::from(motor.velocity) - now;
        let force = stiffness * (lack - way - substep * now) + damping * slow;
        now += substep * force / (1.0 + substep * damping + substep * substep * stiffness);
        way += substep * now;
        left -= substep;
    }
    (way, now)
}

/// Stiffness and damping of a row, N/m and N·s/m or about it, that accelerate by the motor's.
///
/// A substep solves each row twice. With `a` and `b` the two eases of the row and `c` the softness of the motor, a row that
/// takes `x` of the lack for each pass gives the impulse `x · (1 + x · (a − b))`; one substep of the motor's law takes
/// `1 / (b · (1 + c))`.
pub(super) fn gains([a, b]: [f64; 2], motor: &Motor, substep: f64) -> Gains {
    let (mut stiffness, mut damping) = (f64::from(motor.stiffness), f64::from(motor.damping));
    let softness =
        |stiffness: f64, damping: f64| 1.0 / (substep * substep * stiffness + substep * damping);
    let mut c = softness(stiffness, damping);
    let is_sound = c.is_finite() && b > 0.0;
    if !is_sound {
        return Gains::default();
    }
    let wanted = 1.0 / (b * (1.0 + c));
    let lost = a - b;
    let mut is_exact = true;
    let mut x = match lost > a * 1e-6 {
        true => ((1.0 + 4.0 * lost * wanted).sqrt() - 1.0) / (2.0 * lost),
        false => wanted,
    };
    if x > 1.0 / a {
        // The most that the row can do, at the same damping ratio.
        is_exact = false;
        x = 1.0 / a;
        c = a * a / (b * (2.0 * a - b)) - 1.0;
        let c = c.max(f64::EPSILON);
        let ratio = damping / (2.0 * stiffness.sqrt());
        if stiffness > 0.0 {
            let root = ((ratio * ratio + 1.0 / c).sqrt() - ratio) / substep;
            stiffness = root * root;
            damping = 2.0 * ratio * root;
        } else {
            damping = 1.0 / (c * substep);
        }
    }
    let yielding = (1.0 / x - a).max(a * 1e-6);
    let weight = softness(stiffness, damping) / yielding;
    Gains {
        stiffness: stiffness * weight,
        damping: damping * weight,
        share: x * (1.0 + x * lost),
        is_exact,
    }
}

/// The settings of a motor in Rapier.
#[derive(Default)]
pub(super) struct Gains {
    /// N/m or N·m.
    pub(super) stiffness: f64,
    /// N·s/m or N·m·s.
    pub(super) damping: f64,
    /// Impulse of a substep for each unit of velocity that the row lacks.
    pub(super) share: f64,
    /// False if the motor is too strong for the row.
    pub(super) is_exact: bool,
}
