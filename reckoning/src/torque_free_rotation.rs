//! Torque-free rotation of bodies with unequal moments of inertia.
//!
//! The axis of spin of such a body wanders: no closed form of a few coefficients exists, so that the engine's own map
//! is iterated (RECKONING 3.7). Positions are not known here. Invariant: a cursor changes the cost of an answer, never
//! its bits.

use alloc::boxed::Box;

use glam::{DQuat, DVec3};

use crate::exact::{conjugate, dot3, normalised, product, scale3, sqrt, turned};
use crate::flow::StepConstants;
use crate::inertia::Inertia;
use crate::tick::Ticks;

/// A rotation (body → world) and the angular velocity about world axes, rad/s.
pub(crate) type RotationState = (DQuat, DVec3);

/// Progress of one rotation: queries tick by tick cost one step each instead of all steps from the start.
///
/// One cursor serves one body of one stream. It restarts by itself for another start or an earlier tick; predictors
/// that keep their spin do not use it.
#[derive(Clone, Debug, Default)]
pub struct RotationCursor {
    torque_free_rotation: Option<Box<TorqueFreeRotation>>,
}

impl RotationCursor {
    /// The spin `elapsed` ticks after `start`: the same bits as [`TorqueFreeRotation::after`].
    pub(crate) fn after(
        &mut self,
        start: RotationState,
        elapsed: Ticks,
        inertia: &Inertia,
        config: &StepConstants,
    ) -> RotationState {
        let reached = |torque_free_rotation: &&mut Box<TorqueFreeRotation>| {
            torque_free_rotation.elapsed <= elapsed.count()
                && torque_free_rotation.begins_with(&start)
        };
        if let Some(torque_free_rotation) = self.torque_free_rotation.as_mut().filter(reached) {
            torque_free_rotation.advance(elapsed, config);
            return torque_free_rotation.spin();
        }
        let mut torque_free_rotation = TorqueFreeRotation::new(start, inertia, config);
        torque_free_rotation.advance(elapsed, config);
        let spin = torque_free_rotation.spin();
        match &mut self.torque_free_rotation {
            Some(kept) => **kept = torque_free_rotation,
            none => *none = Some(Box::new(torque_free_rotation)),
        }
        spin
    }
}

/// A rotating body in its principal axes: there a turn about the axis of spin does not change the spin.
#[derive(Clone, Debug)]
pub(crate) struct TorqueFreeRotation {
    start: RotationState,
    elapsed: u32,
    /// Principal axes → world, of any length.
    axes: DQuat,
    /// Angular velocity about the principal axes, rad/s.
    angular: DVec3,
    moments: DVec3,
    /// Decrease of each component of the spin in a substep, per product of the other two: seconds.
    exchange: DVec3,
    /// Body → principal axes.
    frame: DQuat,
}

impl TorqueFreeRotation {
    pub(crate) fn new(start: RotationState, inertia: &Inertia, config: &StepConstants) -> Self {
        let (rotation, angular) = start;
        let frame = inertia.unit_frame();
        let axes = normalised(product(rotation, frame));
        let m = inertia.wide_moments();
        let exchange = DVec3::new((m.z - m.y) / m.x, (m.x - m.z) / m.y, (m.y - m.x) / m.z);
        Self {
            start,
            elapsed: 0,
            axes,
            angular: turned(conjugate(axes), angular),
            moments: m,
            exchange: scale3(exchange, config.substep),
            frame: conjugate(frame),
        }
    }

    /// The spin `elapsed` ticks after `start`, from the beginning.
    pub(crate) fn after(
        start: RotationState,
        elapsed: Ticks,
        inertia: &Inertia,
        config: &StepConstants,
    ) -> RotationState {
        let mut torque_free_rotation = Self::new(start, inertia, config);
        torque_free_rotation.advance(elapsed, config);
        torque_free_rotation.spin()
    }

    /// True if the rotation started from `start`, to the bit.
    fn begins_with(&self, start: &RotationState) -> bool {
        let bits = |(rotation, angular): &RotationState| {
            let ([x, y, z, w], [a, b, c]) = (rotation.to_array(), angular.to_array());
            [x, y, z, w, a, b, c].map(f64::to_bits)
        };
        bits(&self.start) == bits(start)
    }

    fn advance(&mut self, elapsed: Ticks, config: &StepConstants) {
        while self.elapsed < elapsed.count() {
            for _ in 0..config.substep_count {
                self.substep(config);
            }
            self.angular = scale3(self.angular, config.angular_keep);
            self.elapsed += 1;
        }
    }

    /// One velocity step and one position step of the engine.
    fn substep(&mut self, config: &StepConstants) {
        let (w, e) = (self.angular, self.exchange);
        let bent = DVec3::new(
            w.x - e.x * (w.y * w.z),
            w.y - e.y * (w.z * w.x),
            w.z - e.z * (w.x * w.y),
        );
        let (before, after) = (self.momentum(w), self.momentum(bent));
        let (before, after) = (dot3(before, before), dot3(after, after));
        let mut w = if after == 0.0 {
            w
        } else {
            scale3(bent, sqrt(before / after))
        };
        let speed2 = dot3(w, w);
        if speed2 > config.spin_max * config.spin_max {
            w = scale3(w, config.spin_max / sqrt(speed2));
        }
        let (a, t) = (self.axes, scale3(w, config.half_substep));
        self.angular = w;
        self.axes = DQuat::from_xyzw(
            a.x + (a.w * t.x + a.y * t.z - a.z * t.y),
            a.y + (a.w * t.y - a.x * t.z + a.z * t.x),
            a.z + (a.w * t.z + a.x * t.y - a.y * t.x),
            a.w - (a.x * t.x + a.y * t.y + a.z * t.z),
        );
    }

    fn momentum(&self, w: DVec3) -> DVec3 {
        let m = self.moments;
        DVec3::new(m.x * w.x, m.y * w.y, m.z * w.z)
    }

    /// The rotation in world axes.
    fn spin(&self) -> RotationState {
        let axes = normalised(self.axes);
        let rotation = normalised(product(axes, self.frame));
        (rotation, turned(axes, self.angular))
    }
}
