//! Track: the last published motion of a body, the base of all predictions.
//!
//! Publisher and subscriber share this one type. It holds integers or the engine's exact bits: two tracks are equal
//! exactly when all their predictions are (RECKONING 3.1).

use glam::{DQuat, DVec3};

use crate::body::BodyId;
use crate::exact::normalised;
use crate::flow::TRACK_AGE_MAX;
use crate::motion::{InvalidMotion, Motion, Pose, Twist};
use crate::predictor::{Conditions, Predictor};
use crate::quantiser::{Grid, QuantisedState};
use crate::tick::{Tick, Ticks};
use crate::torque_free_rotation::RotationCursor;

/// A published motion, its tick, and the predictor that continues it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Track {
    /// Tick of the motion. It grows with each update of a body: it also names the track's revision.
    pub origin: Tick,
    /// Continues the motion.
    pub predictor: Predictor,
    /// The motion.
    pub anchor: Anchor,
    /// The body in whose frame the motion is, and which moves this one; none for the world.
    pub parent: Option<BodyId>,
}

/// A published motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Anchor {
    /// On the stream's grid.
    Quantised(QuantisedState),
    /// To the last bit of the engine's f32 state.
    Exact(BodyState),
}

impl Anchor {
    /// The quantised state; `None` for an exact one.
    #[must_use]
    pub const fn quantised(&self) -> Option<QuantisedState> {
        match self {
            Self::Quantised(quantised) => Some(*quantised),
            Self::Exact(_) => None,
        }
    }
}

/// A motion in the engine's own precision, kept as bits so that it can be compared and hashed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BodyState {
    bits: [u32; 13],
}

impl BodyState {
    /// Position, quaternion (x, y, z, w), linear and angular velocity.
    ///
    /// # Errors
    ///
    /// [`InvalidMotion`], as from [`Motion::new`].
    pub fn new(
        position: [f32; 3],
        rotation: [f32; 4],
        linear: [f32; 3],
        angular: [f32; 3],
    ) -> Result<Self, InvalidMotion> {
        let mut bits = [0; 13];
        let parts = position
            .iter()
            .chain(&rotation)
            .chain(&linear)
            .chain(&angular);
        for (slot, part) in bits.iter_mut().zip(parts) {
            *slot = part.to_bits();
        }
        let body_state = Self { bits };
        let (pose, twist) = body_state.raw();
        Motion::new(pose, twist)?;
        Ok(body_state)
    }

    /// The thirteen numbers in the order of [`Self::new`].
    #[must_use]
    #[inline]
    pub fn parts(&self) -> [f32; 13] {
        let mut parts = [0.0; 13];
        for (part, bits) in parts.iter_mut().zip(self.bits) {
            *part = f32::from_bits(bits);
        }
        parts
    }

    /// All bits, in the order of [`Self::new`].
    #[inline]
    pub(crate) const fn bits(&self) -> [u32; 13] {
        self.bits
    }

    /// The state of bits that a checked state gave.
    #[inline]
    pub(crate) const fn from_bits(bits: [u32; 13]) -> Self {
        Self { bits }
    }

    /// Position in the engine's precision, metres.
    #[must_use]
    pub fn position(&self) -> [f32; 3] {
        let p = self.parts();
        [p[0], p[1], p[2]]
    }

    /// Quaternion x, y, z, w in the engine's precision.
    #[must_use]
    pub fn rotation(&self) -> [f32; 4] {
        let p = self.parts();
        [p[3], p[4], p[5], p[6]]
    }

    /// The same pose without movement.
    #[must_use]
    pub fn stilled(mut self) -> Self {
        self.bits[7..].fill(0);
        self
    }

    /// Widened to f64, the rotation not normalised.
    pub(crate) fn raw(&self) -> (Pose, Twist) {
        let p = |place: usize| f64::from(f32::from_bits(self.bits[place]));
        (
            Pose {
                position: DVec3::new(p(0), p(1), p(2)),
                rotation: DQuat::from_xyzw(p(3), p(4), p(5), p(6)),
            },
            Twist {
                linear: DVec3::new(p(7), p(8), p(9)),
                angular: DVec3::new(p(10), p(11), p(12)),
            },
        )
    }

    /// The motion, widened to f64 with its rotation normalised.
    #[must_use]
    pub fn motion(&self) -> Motion {
        let (pose, twist) = self.raw();
        // The constructor has checked it.
        let rotation = normalised(pose.rotation);
        Motion::from_checked(Pose { rotation, ..pose }, twist)
    }
}

impl Track {
    /// A body that rests in the engine's exact pose.
    #[must_use]
    pub fn resting(origin: Tick, body_state: BodyState) -> Self {
        Self {
            origin,
            predictor: Predictor::Rest,
            anchor: Anchor::Exact(body_state.stilled()),
            parent: None,
        }
    }

    /// The published motion.
    #[must_use]
    pub fn start(&self, grid: &Grid) -> Motion {
        match &self.anchor {
            Anchor::Quantised(quantised) => quantised.motion(grid),
            Anchor::Exact(body_state) => body_state.motion(),
        }
    }

    /// The predicted motion at a tick, in the frame of the anchor: the parent's frame if the body has a parent.
    ///
    /// Before the origin it is that of the origin, beyond the horizon that of the horizon.
    /// [`attached_motion`](crate::attached_motion) adds the motion of the parent.
    ///
    /// The gravity of `conditions` is the acceleration of this body from the track's origin on. Their flow is computed
    /// to [`TRACK_AGE_MAX`], or at least to `tick`.
    #[must_use]
    pub fn at(&self, tick: Tick, grid: &Grid, conditions: &Conditions<'_>) -> Motion {
        let start = self.start(grid);
        self.predictor
            .predict(&start, self.elapsed(tick), conditions)
    }

    /// The same bits as [`Self::at`]; results in the body's cursor are not computed again.
    #[must_use]
    pub fn at_with(
        &self,
        tick: Tick,
        grid: &Grid,
        conditions: &Conditions<'_>,
        cursor: &mut RotationCursor,
    ) -> Motion {
        let start = self.start(grid);
        self.predictor
            .predict_with(&start, self.elapsed(tick), conditions, cursor)
    }

    /// Ticks from the origin (RECKONING 3.2).
    #[inline]
    pub(crate) fn elapsed(&self, tick: Tick) -> Ticks {
        elapsed(self.origin, tick)
    }

    /// True if the track predicts rest in the world.
    #[must_use]
    pub fn is_resting(&self) -> bool {
        self.predictor == Predictor::Rest && self.parent.is_none()
    }

    /// True if the copy equals the engine's resting state to the bit.
    #[must_use]
    pub fn is_exact_rest(&self) -> bool {
        self.is_resting() && matches!(self.anchor, Anchor::Exact(_))
    }
}

/// Ticks from an origin to a tick, at most those of the horizon.
#[inline]
pub(crate) fn elapsed(origin: Tick, tick: Tick) -> Ticks {
    match tick.since(origin) {
        Some(ticks) => ticks.min(TRACK_AGE_MAX),
        None if tick > origin => TRACK_AGE_MAX,
        None => Ticks::ZERO,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_state_motion_keeps_every_bit() {
        let body_state =
            BodyState::new([0.1, -0.0, 3e-40], [0.0, 0.0, 0.0, 1.0], [1.0; 3], [2.0; 3]).unwrap();
        assert_eq!(body_state.parts()[1].to_bits(), (-0.0_f32).to_bits());
        assert_eq!(body_state.motion().pose().position.x, f64::from(0.1_f32));
        assert_eq!(body_state.stilled().parts()[7..], [0.0; 6]);
    }

    #[test]
    fn non_finite_states_are_refused() {
        let identity = [0.0, 0.0, 0.0, 1.0];
        let wrong = BodyState::new([f32::NAN, 0.0, 0.0], identity, [0.0; 3], [0.0; 3]);
        assert_eq!(wrong, Err(InvalidMotion::Position));
        let wrong = BodyState::new([0.0; 3], [0.0; 4], [0.0; 3], [0.0; 3]);
        assert_eq!(wrong, Err(InvalidMotion::Rotation));
    }

    #[test]
    fn a_track_stays_small() {
        assert!(size_of::<Track>() <= 80, "{}", size_of::<Track>());
    }
}
