//! The moments for which the velocities of a recording hold.
//!
//! This project's step moves a body and damps it afterwards, and its velocities hold at the moment of their pose. Other
//! engines damp first, or report the angular velocity that turned the body in the last step: that of half a step before.
//! How poses follow from velocities tells both, and then the velocities of this project's step follow from theirs.

use glam::{DQuat, DVec3};
use rhumb_reckoning::BodyState;

use super::algebra::{ShortTurn, median, slope};

/// The first act of an engine on a body in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum First {
    /// It is moved by the velocity of the last tick.
    #[default]
    Moved,
    /// Its velocity is damped.
    Damped,
}

/// The moments of a recording's velocities.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Instants {
    pub(crate) first: First,
    /// Ticks from the moment of an angular velocity to that of its pose.
    pub(crate) behind: f64,
}

/// Shares of the velocities that stay after a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Kept {
    pub(crate) linear: f64,
    pub(crate) angular: f64,
}

/// Principal moments, and the rotation principal axes → body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Moments {
    pub(crate) moments: [f64; 3],
    pub(crate) axes: DQuat,
}

/// Ticks from a velocity to its pose that say something: from less than half of a substep of eight to half a tick.
const BEHIND: std::ops::RangeInclusive<f64> = 0.04..=0.6;

impl Instants {
    /// True for what this project's step does.
    pub(crate) fn is_own(&self) -> bool {
        *self == Self::default()
    }

    /// Takes the shares of all ticks: of the spin's change up to the mean spin of a tick, (n + 1) / 2n after n substeps.
    pub(crate) fn new(first: First, turns: Vec<f64>) -> Self {
        let behind = median(turns).map_or(0.0, |share| share - 0.5);
        // NaN is in no range.
        let says = BEHIND.contains(&behind.abs());
        Self {
            first,
            behind: if says { behind } else { 0.0 },
        }
    }

    /// The state that this project's step would have.
    pub(crate) fn own(
        &self,
        state: &BodyState,
        kept: Kept,
        moments: Option<Moments>,
        step_s: f64,
    ) -> BodyState {
        let motion = state.motion();
        let (mut linear, mut angular) = (motion.twist().linear, motion.twist().angular);
        if let Some(Moments { moments, axes }) = moments.filter(|_| self.behind != 0.0) {
            let turn = motion.pose().rotation * axes;
            let spin = later(turn.conjugate() * angular, moments, self.behind * step_s);
            angular = turn * spin;
        }
        if self.first == First::Damped {
            linear *= kept.linear.min(1.0);
            angular *= kept.angular.min(1.0);
        }
        let [px, py, pz, x, y, z, w, ..] = state.parts();
        let [linear, angular] = [linear, angular].map(|of| of.as_vec3().to_array());
        BodyState::new([px, py, pz], [x, y, z, w], linear, angular).unwrap_or(*state)
    }
}

/// A spin about principal axes after some time without torque: one step of Runge and Kutta's method.
fn later(spin: DVec3, moments: [f64; 3], time_s: f64) -> DVec3 {
    let moments = DVec3::from_array(moments);
    let change = |spin: DVec3| (moments * spin).cross(spin) / moments;
    let one = change(spin);
    let two = change(spin + one * (time_s / 2.0));
    let three = change(spin + two * (time_s / 2.0));
    let four = change(spin + three * time_s);
    spin + (one + 2.0 * (two + three) + four) * (time_s / 6.0)
}

/// The fall of a body in a tick beside its velocity, as a share of g·t², and the way at the velocity before in the same unit.
pub(crate) struct Fall {
    pub(crate) beside: f64,
    pub(crate) way: f64,
}

/// The share of its way that damping gives a body in a tick, as its falls say: below zero, as it takes it.
pub(crate) fn given(falls: &[Fall]) -> f64 {
    let pairs: Vec<(f64, f64)> = falls.iter().map(|fall| (fall.beside, fall.way)).collect();
    slope(&pairs)
}

/// Damping or the way: which comes first in a tick in which damping takes the share `lost` of the velocity. Of n substeps it takes (n + 1) / 2n of
/// that from the way if it comes first, and (n - 1) / 2n if the way does.
pub(crate) fn first(given: f64, lost: f64) -> First {
    if (given + lost).abs() < given.abs() {
        First::Damped
    } else {
        First::Moved
    }
}

/// Change of a spin in a tick, as a share of it, from which on it tells the moment of the mean one.
const CHANGE_MIN: f64 = 1e-3;

/// The part of a tick's change of spin, damping apart, up to the mean spin by which the body turned in it.
pub(crate) fn turn_share(
    pair: [&BodyState; 2],
    kept: f64,
    first: First,
    step_s: f64,
) -> Option<f64> {
    let [before, after] = pair.map(BodyState::motion);
    let turn = after.pose().rotation * before.pose().rotation.conjugate();
    let mean = turn.to_scaled_axis_short() / step_s;
    let (from, to) = match first {
        First::Moved => (before.twist().angular, after.twist().angular / kept),
        First::Damped => (before.twist().angular * kept, after.twist().angular),
    };
    let change = to - from;
    let tells = change.length() > CHANGE_MIN * from.length();
    tells.then(|| (mean - from).dot(change) / change.length_squared())
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOMENTS: [f64; 3] = [1.0, 2.0, 2.4];

    #[test]
    fn a_spin_later_has_the_same_energy_and_momentum() {
        let spin = DVec3::new(2.0, 3.0, -1.0);
        let of = |spin: DVec3| {
            let momentum = DVec3::from_array(MOMENTS) * spin;
            (momentum.length_squared(), momentum.dot(spin))
        };
        let (a, b) = (of(spin), of(later(spin, MOMENTS, 0.01)));
        assert!(
            (a.0 - b.0).abs() < 1e-7 && (a.1 - b.1).abs() < 1e-7,
            "{a:?} {b:?}"
        );
        let back = later(later(spin, MOMENTS, 0.01), MOMENTS, -0.01);
        assert!((back - spin).length() < 1e-8, "{back}");
    }

    #[test]
    fn a_share_far_from_any_step_and_one_near_the_middle_say_nothing() {
        for share in [0.51, 1.3, -0.3, f64::NAN] {
            assert!(Instants::new(First::Moved, vec![share]).is_own(), "{share}");
        }
        assert_eq!(Instants::new(First::Moved, vec![1.0]).behind, 0.5);
        assert_eq!(Instants::new(First::Moved, vec![0.625]).behind, 0.125);
        assert!(Instants::new(First::Moved, Vec::new()).is_own());
    }
}
