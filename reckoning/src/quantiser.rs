//! Quantisation of motions: grids, quantised states, residuals.
//!
//! Both ends predict from the same integers, so that rounding never accumulates (RECKONING 4). Properties, tested
//! below: a value on its grid quantises to itself; quantising errs by half a step at most; order is kept; beyond its
//! limit a value saturates. A packed rotation has a grid of its own, the same for every body, and one form for each
//! rotation (RECKONING 4.3).

use glam::{DQuat, DVec3};

use crate::exact::{add3, floor_to_i32, normalised, product, scale3, sqrt, turn_by};
use crate::motion::{Motion, Pose, Twist};
use crate::tolerance::Tolerance;
use crate::units::{Metres, Seconds};

/// Largest position on a grid, in fine steps: 2³⁰.
pub const POSITION_LIMIT: i32 = 1 << 30;
/// Largest velocity on a grid, in steps: 2²⁴.
pub const VELOCITY_LIMIT: i32 = 1 << 24;
/// Largest position that a residual may hold, in steps: 2²⁶, which is the whole of [`POSITION_LIMIT`].
pub const RESIDUAL_LIMIT: i32 = 1 << 26;
/// Largest turn that a residual may hold, in steps: 2¹⁰.
pub const TURN_LIMIT: i32 = 1 << 10;

/// Position step of a residual as a share of the tolerance. See ARCHITECTURE.md, "Grids", for this and the next two.
const POSITION_SHARE: f64 = 0.5625;
/// Turn step, as a share of the tolerance at the bounding radius.
const TURN_SHARE: f64 = 0.5625;
/// Velocity step, as a share of the tolerance per second.
const VELOCITY_SHARE: f64 = 0.0625;
/// Greatest exponent of velocity residuals: how many times their steps can be doubled.
pub const VELOCITY_EXPONENT_MAX: u32 = 12;
/// Fine steps in a position step: motions are kept in fine steps, so that a residual of zero moves a body by next to
/// nothing.
pub const FINE_STEPS: i32 = 16;
const _: () = assert!(RESIDUAL_LIMIT * FINE_STEPS <= POSITION_LIMIT);
/// The coarsest turn step, radians, for bodies so small that any turn is within tolerance.
const TURN_STEP_MAX: f64 = 0.25;
/// The coarsest angular velocity step, rad/s, likewise.
const ANGULAR_STEP_MAX: f64 = 4.0;

/// The steps of one body's grids in one stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    position: f64,
    fine: f64,
    turn: f64,
    linear: f64,
    angular: f64,
}

impl Grid {
    /// The grids of a body with this bounding radius under this tolerance (RECKONING 4.2).
    #[must_use]
    pub fn new(tolerance: Tolerance, radius: Metres) -> Self {
        match tolerance {
            Tolerance::Surface(length) => {
                let (length, radius) = (length.metres().metres(), radius.metres());
                let (position, linear) = (length * POSITION_SHARE, length * VELOCITY_SHARE);
                Self {
                    position,
                    fine: position / f64::from(FINE_STEPS),
                    turn: ((length * TURN_SHARE) / radius).min(TURN_STEP_MAX),
                    linear,
                    angular: (linear / radius).min(ANGULAR_STEP_MAX),
                }
            }
            Tolerance::Parts { position, turn } => {
                // A surface tolerance is shared by two parts; a bound of its own equals a shared one of twice the
                // length.
                let length = position.metres().metres() * 2.0;
                let angle = turn.radians().radians() * 2.0;
                let position = length * POSITION_SHARE;
                Self {
                    position,
                    fine: position / f64::from(FINE_STEPS),
                    turn: (angle * TURN_SHARE).min(TURN_STEP_MAX),
                    linear: length * VELOCITY_SHARE,
                    angular: (angle * VELOCITY_SHARE).min(ANGULAR_STEP_MAX),
                }
            }
        }
    }

    /// One step of position in a residual, metres.
    #[must_use]
    pub const fn position(&self) -> f64 {
        self.position
    }

    /// One step of position in a motion, metres: a sixteenth of [`Self::position`].
    #[must_use]
    pub const fn fine(&self) -> f64 {
        self.fine
    }

    /// One step of turn, radians.
    #[must_use]
    pub const fn turn(&self) -> f64 {
        self.turn
    }

    /// One step of linear velocity, m/s.
    #[must_use]
    pub const fn linear(&self) -> f64 {
        self.linear
    }

    /// One step of angular velocity, rad/s.
    #[must_use]
    pub const fn angular(&self) -> f64 {
        self.angular
    }
}

/// The nearest grid point, halves upward, saturating at `limit`.
fn quantise(value: f64, step: f64, limit: i32) -> i32 {
    floor_to_i32(value / step + 0.5).clamp(-limit, limit)
}

fn quantise3(value: DVec3, step: f64, limit: i32) -> [i32; 3] {
    [
        quantise(value.x, step, limit),
        quantise(value.y, step, limit),
        quantise(value.z, step, limit),
    ]
}

fn value3(steps: [i32; 3], step: f64) -> DVec3 {
    DVec3::new(
        f64::from(steps[0]) * step,
        f64::from(steps[1]) * step,
        f64::from(steps[2]) * step,
    )
}

/// A quantised motion: what a stream carries of a moving body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QuantisedState {
    /// In steps of [`Grid::fine`].
    pub position: [i32; 3],
    /// Smallest three.
    pub rotation: PackedRotation,
    /// In steps of the grid's linear velocity.
    pub linear: [i32; 3],
    /// In steps of the grid's angular velocity.
    pub angular: [i32; 3],
}

impl QuantisedState {
    /// The grid point nearest to a motion.
    #[must_use]
    pub fn of(motion: &Motion, grid: &Grid) -> Self {
        let (pose, twist) = (motion.pose(), motion.twist());
        Self {
            position: Self::position_of(&pose, grid),
            rotation: PackedRotation::of(pose.rotation),
            linear: quantise3(twist.linear, grid.linear, VELOCITY_LIMIT),
            angular: quantise3(twist.angular, grid.angular, VELOCITY_LIMIT),
        }
    }

    /// The grid point nearest to a position.
    #[must_use]
    fn position_of(pose: &Pose, grid: &Grid) -> [i32; 3] {
        quantise3(pose.position, grid.fine, POSITION_LIMIT)
    }

    /// The motion of these steps.
    #[must_use]
    pub fn motion(&self, grid: &Grid) -> Motion {
        let (pose, twist) = self.raw(grid);
        let rotation = normalised(pose.rotation);
        Motion::from_checked(Pose { rotation, ..pose }, twist)
    }

    /// The same, its rotation not normalised.
    pub(crate) fn raw(&self, grid: &Grid) -> (Pose, Twist) {
        let pose = Pose {
            position: value3(self.position, grid.fine),
            rotation: self.rotation.unnormalised(),
        };
        (pose, self.twist(grid))
    }

    /// The same place, without velocities.
    #[must_use]
    pub fn stilled(self) -> Self {
        Self {
            linear: [0; 3],
            angular: [0; 3],
            ..self
        }
    }

    /// The same pose with the velocities that a residual makes of these, saturating at the limit.
    #[must_use]
    fn hastened(&self, by: &VelocityResidual) -> Self {
        let [linear, angular] = by.steps();
        Self {
            linear: plus(self.linear, linear, VELOCITY_LIMIT),
            angular: plus(self.angular, angular, VELOCITY_LIMIT),
            ..*self
        }
    }

    /// The velocities of these steps.
    #[must_use]
    pub fn twist(&self, grid: &Grid) -> Twist {
        Twist {
            linear: value3(self.linear, grid.linear),
            angular: value3(self.angular, grid.angular),
        }
    }

    /// True if every part is within its limit, as every decoded state must be.
    #[must_use]
    pub fn is_within_limits(&self) -> bool {
        within(self.position, POSITION_LIMIT)
            && within(self.linear, VELOCITY_LIMIT)
            && within(self.angular, VELOCITY_LIMIT)
    }
}

/// Without a branch between the three, since nearly all are within.
fn within([x, y, z]: [i32; 3], limit: i32) -> bool {
    // Limits are at most 2³⁰: a value beyond one does not wrap back into the range.
    let one = |steps: i32| steps.wrapping_add(limit) as u32 <= 2 * limit as u32;
    one(x) & one(y) & one(z)
}

/// Difference of a motion from a predicted one, in grid steps (RECKONING 4.4).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Residual {
    /// Position steps.
    pub position: [i32; 3],
    /// Rotation vector from the predicted rotation, in turn steps, about the axes of the frame that positions are in.
    pub turn: [i32; 3],
    /// Difference of the velocities from those that the correction implies; none where those suffice.
    pub velocity: Option<VelocityResidual>,
}

/// Difference of velocities from the implied ones, in steps that are doubled some times.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct VelocityResidual {
    /// The number of doublings of the steps.
    pub velocity_exponent: u32,
    /// Linear velocity in these steps.
    pub linear: [i32; 3],
    /// Angular velocity in these steps.
    pub angular: [i32; 3],
}

impl VelocityResidual {
    /// In grid steps; within limits these are within [`VELOCITY_LIMIT`].
    pub(crate) fn steps(&self) -> [[i32; 3]; 2] {
        [
            each(self.linear, |steps| steps << self.velocity_exponent),
            each(self.angular, |steps| steps << self.velocity_exponent),
        ]
    }

    /// The residual that leads from the implied velocities nearest to the wanted ones, in the finest steps.
    #[must_use]
    fn finest(wanted: &Twist, implied: &QuantisedState, grid: &Grid) -> Self {
        let linear = quantise3(wanted.linear, grid.linear, VELOCITY_LIMIT / 2);
        let angular = quantise3(wanted.angular, grid.angular, VELOCITY_LIMIT / 2);
        // Both within half the limit, so that the difference is within the whole.
        let off = |wanted, implied| minus(wanted, clamped(implied, VELOCITY_LIMIT / 2));
        Self {
            velocity_exponent: 0,
            linear: off(linear, implied.linear),
            angular: off(angular, implied.angular),
        }
    }

    /// The nearest residual whose steps are doubled `velocity_exponent` times, at most [`VELOCITY_EXPONENT_MAX`].
    #[must_use]
    pub fn coarser(&self, velocity_exponent: u32) -> Self {
        let velocity_exponent = velocity_exponent.min(VELOCITY_EXPONENT_MAX);
        let coarse = |steps: i32| (steps + ((1 << velocity_exponent) >> 1)) >> velocity_exponent;
        Self {
            velocity_exponent,
            linear: each(self.linear, coarse),
            angular: each(self.angular, coarse),
        }
    }

    /// True if every part is within its limit, as every decoded residual must be.
    #[must_use]
    pub fn is_within_limits(&self) -> bool {
        let limit = VELOCITY_LIMIT >> self.velocity_exponent.min(VELOCITY_EXPONENT_MAX);
        self.velocity_exponent <= VELOCITY_EXPONENT_MAX
            && within(self.linear, limit)
            && within(self.angular, limit)
    }
}

impl Residual {
    /// Difference of truth from a predicted motion, in steps of position and of turn, not rounded.
    #[must_use]
    pub fn wanted(truth: &Pose, predicted: &Pose, grid: &Grid) -> [DVec3; 2] {
        let apart = truth.position - predicted.position;
        let turn = rotation_vector(truth.rotation, predicted.rotation);
        [
            scale3(apart, 1.0 / grid.position),
            scale3(turn, 1.0 / grid.turn),
        ]
    }

    /// The velocity residual that leads from implied velocities nearest to the wanted ones, in steps of this exponent.
    #[must_use]
    pub fn of_velocity(
        wanted: &Twist,
        implied: &QuantisedState,
        grid: &Grid,
        velocity_exponent: u32,
    ) -> VelocityResidual {
        VelocityResidual::finest(wanted, implied, grid).coarser(velocity_exponent)
    }

    /// The motion that this residual makes of a predicted one (RECKONING 4.4).
    ///
    /// `over`: divergence time of the prediction, above zero; the correction divided by it is the implied velocity.
    #[must_use]
    pub fn onto(&self, predicted: &Motion, over: Seconds, grid: &Grid) -> QuantisedState {
        let (pose, twist) = (predicted.pose(), predicted.twist());
        let turned = value3(self.turn, grid.turn);
        let [p, q, r] = self.turn;
        let rotation = if p | q | r == 0 {
            PackedRotation::of(pose.rotation)
        } else {
            PackedRotation::of(normalised(product(turn_by(turned), pose.rotation)))
        };
        let rate = 1.0 / over.seconds();
        let linear = add3(
            twist.linear,
            scale3(value3(self.position, grid.position), rate),
        );
        let angular = add3(twist.angular, scale3(turned, rate));
        self.onto_implied(QuantisedState {
            position: QuantisedState::position_of(&pose, grid),
            rotation,
            linear: quantise3(linear, grid.linear, VELOCITY_LIMIT),
            angular: quantise3(angular, grid.angular, VELOCITY_LIMIT),
        })
    }

    /// Completes a corrected state whose position is still the predicted one and whose velocities are the implied
    /// ones.
    fn onto_implied(&self, from: QuantisedState) -> QuantisedState {
        let [x, y, z] = self.position;
        let fine = |steps: i32| steps.saturating_mul(FINE_STEPS);
        let fine = [fine(x), fine(y), fine(z)];
        let implied = QuantisedState {
            position: plus(from.position, fine, POSITION_LIMIT),
            ..from
        };
        match &self.velocity {
            Some(velocity) => implied.hastened(velocity),
            None => implied,
        }
    }

    /// True if every part is within its limit, as every decoded residual must be.
    #[must_use]
    pub fn is_within_limits(&self) -> bool {
        let velocity = self.velocity.as_ref();
        within(self.position, RESIDUAL_LIMIT)
            && within(self.turn, TURN_LIMIT)
            && velocity.is_none_or(VelocityResidual::is_within_limits)
    }
}

fn clamped(steps: [i32; 3], limit: i32) -> [i32; 3] {
    each(steps, |step| step.clamp(-limit, limit))
}

/// Written out, since `map` of an array stays a call here.
fn each([a, b, c]: [i32; 3], then: impl Fn(i32) -> i32) -> [i32; 3] {
    [then(a), then(b), then(c)]
}

/// Component by component, of numbers within half a velocity's limit.
fn minus(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Component by component, saturating at the limit, which is at most 2³⁰.
fn plus(a: [i32; 3], b: [i32; 3], limit: i32) -> [i32; 3] {
    let one = |i: usize| a[i].saturating_add(b[i]).clamp(-limit, limit);
    [one(0), one(1), one(2)]
}

/// The shortest turn from one rotation to another, as axis times angle, world frame, radians.
///
/// Only the sender computes it, so that it need not be exact.
fn rotation_vector(to: DQuat, from: DQuat) -> DVec3 {
    let turn = product(to, crate::exact::conjugate(from));
    let sign = if turn.w < 0.0 { -1.0 } else { 1.0 };
    let axis = scale3(DVec3::new(turn.x, turn.y, turn.z), sign);
    let sine = crate::exact::length3(axis);
    if sine == 0.0 {
        return DVec3::ZERO;
    }
    let angle = 2.0 * libm::atan2(sine, turn.w * sign);
    scale3(axis, angle / sine)
}

/// A rotation as its three smaller components in steps of 2⁻¹⁹ and the place of the largest, which is positive.
///
/// 62 bits. Error: below 6.7e-6 rad (half a step in each coded component, three halves in the largest), or 9.4e-6 rad
/// where components so nearly tie that a second pass rounds again; 0.94 mm at 100 m from the centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PackedRotation {
    /// Low two bits of the first word: the place of the largest component. Then a component of twenty bits, half of
    /// the third, and in the second word the second component and the other half. A table of tracks stays dense.
    words: [u32; 2],
}

/// Steps in one.
pub(crate) const PACKED_STEPS: f64 = 524_288.0;
/// For each place of the greatest component, the places of the others.
pub(crate) const OTHERS: [[usize; 3]; 4] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];

impl PackedRotation {
    /// No turn: the fourth component is the largest, the others are zero.
    pub const IDENTITY: Self = Self::packed(3, [0; 3]);
    /// The largest size of one of the smaller components: 2¹⁹/√2, rounded up.
    pub const LIMIT: i32 = 370_728;

    /// The grid point of a unit quaternion (RECKONING 4.3).
    #[must_use]
    pub fn of(rotation: DQuat) -> Self {
        Self::nearest(rotation).stable()
    }

    /// Repeats the packing until it is a fixed point.
    pub(crate) fn stable(self) -> Self {
        let mut packed = self;
        // If two components tie, rounding may make the other one the largest; the second pass is then stable.
        for _ in 0..3 {
            if packed.is_surely_stable() {
                break;
            }
            let again = Self::nearest(packed.value());
            if again == packed {
                break;
            }
            packed = again;
        }
        packed
    }

    /// True if the largest component is the largest by a whole step in its own value too: then that value packs to
    /// itself. The other components are whole steps up to rounding errors far below half a step.
    fn is_surely_stable(self) -> bool {
        let (_, others) = self.parts();
        let square = |part: i32| i64::from(part) * i64::from(part);
        let sum: i64 = others.iter().copied().map(square).sum();
        let most = others.iter().map(|part| part.abs()).max().unwrap_or(0);
        square(1 << 19) - sum >= square(most + 1)
    }

    fn nearest(rotation: DQuat) -> Self {
        let part = |part: f64| floor_to_i32(part * PACKED_STEPS + 0.5);
        Self::of_steps([
            part(rotation.x),
            part(rotation.y),
            part(rotation.z),
            part(rotation.w),
        ])
    }

    fn of_steps(steps: [i32; 4]) -> Self {
        let most = 1 << 20;
        let steps = steps.map(|part| part.clamp(-most, most));
        let mut largest = 0;
        for i in 1..4 {
            if steps[i].abs() > steps[largest].abs() {
                largest = i;
            }
        }
        let sign = if steps[largest] < 0 { -1 } else { 1 };
        let most = 1 << 19;
        let [a, b, c] = OTHERS[largest];
        let other = |i: usize| (steps[i] * sign).clamp(-most, most - 1);
        Self::packed(largest as u8, [other(a), other(b), other(c)])
    }

    /// Packs a place and components of at most twenty bits.
    pub(crate) const fn packed(largest: u8, [a, b, c]: [i32; 3]) -> Self {
        const MASK: u32 = (1 << 20) - 1;
        let (a, b, c) = (a as u32 & MASK, b as u32 & MASK, c as u32 & MASK);
        Self {
            words: [largest as u32 | a << 2 | c << 22, b | (c >> 10) << 20],
        }
    }

    /// The value in two words.
    #[inline]
    pub(crate) const fn words(self) -> [u32; 2] {
        self.words
    }

    /// The value of words that a checked value gave.
    #[inline]
    pub(crate) const fn from_words(words: [u32; 2]) -> Self {
        Self { words }
    }

    /// Checks decoded parts: `None` unless they are the one encoding of their rotation.
    #[must_use]
    pub fn from_parts(largest: u8, others: [i32; 3]) -> Option<Self> {
        let small = |part: &i32| (-Self::LIMIT..=Self::LIMIT).contains(part);
        let bounded = largest < 4 && others.iter().all(small);
        if !bounded {
            return None;
        }
        let packed = Self::packed(largest, others);
        (packed.is_surely_stable() || Self::nearest(packed.value()) == packed).then_some(packed)
    }

    /// Place of the largest component (x, y, z, w are 0 to 3), and the others in that order.
    #[must_use]
    pub const fn parts(self) -> (u8, [i32; 3]) {
        let [low, high] = self.words;
        let c = (low >> 22) | (high >> 20 << 10);
        // Shifting up and down extends the sign.
        const fn signed(bits: u32) -> i32 {
            (bits << 12) as i32 >> 12
        }
        ((low & 3) as u8, [signed(low >> 2), signed(high), signed(c)])
    }

    /// The unit quaternion of this grid point (RECKONING 4.3).
    #[must_use]
    pub fn value(self) -> DQuat {
        normalised(self.unnormalised())
    }

    /// The same, of unit length up to rounding.
    fn unnormalised(self) -> DQuat {
        let (largest, [a, b, c]) = self.parts();
        let part = |steps: i32| f64::from(steps) / PACKED_STEPS;
        let (a, b, c) = (part(a), part(b), part(c));
        let rest = (1.0 - ((a * a + b * b) + c * c)).max(0.0);
        // Taken from the low two bits, it is a place among four.
        let largest = usize::from(largest & 3);
        let [first, second, third] = OTHERS[largest];
        let mut parts = [0.0; 4];
        parts[largest] = sqrt(rest);
        parts[first] = a;
        parts[second] = b;
        parts[third] = c;
        DQuat::from_array(parts)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::motion::Divergence;
    use crate::units::Radians;

    fn unit_quaternion() -> impl Strategy<Value = DQuat> {
        proptest::array::uniform4(-1.0_f64..1.0)
            .prop_filter("too short to normalise", |q| {
                q.iter().map(|c| c * c).sum::<f64>() > 1e-3
            })
            .prop_map(|q| DQuat::from_array(q).normalize())
    }

    fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
        (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    fn motion() -> impl Strategy<Value = Motion> {
        (vector(1e4), unit_quaternion(), vector(50.0), vector(30.0)).prop_map(
            |(position, rotation, linear, angular)| {
                Motion::new(Pose { position, rotation }, Twist { linear, angular }).unwrap()
            },
        )
    }

    fn grid() -> impl Strategy<Value = Grid> {
        (1_000_u32..10_000_000, 0.001_f64..100.0).prop_map(|(micrometres, radius)| {
            Grid::new(
                Tolerance::from_micrometres(micrometres).unwrap(),
                Metres::new(radius),
            )
        })
    }

    /// The residual rounded to the nearest steps, without velocities.
    fn nearest(truth: &Motion, predicted: &Motion, grid: &Grid) -> Residual {
        let [position, turn] = Residual::wanted(&truth.pose(), &predicted.pose(), grid);
        let round = |v: DVec3| v.to_array().map(|x| x.round() as i32);
        Residual {
            position: round(position),
            turn: round(turn),
            velocity: None,
        }
    }

    proptest! {
        #[test]
        fn a_value_on_its_grid_quantises_to_itself(steps in -POSITION_LIMIT..=POSITION_LIMIT, grid in grid()) {
            prop_assert_eq!(quantise(f64::from(steps) * grid.fine, grid.fine, POSITION_LIMIT), steps);
        }

        #[test]
        fn quantising_errs_by_half_a_step_at_most(x in -1e5_f64..1e5, grid in grid()) {
            let steps = quantise(x, grid.position, POSITION_LIMIT);
            if steps.abs() < POSITION_LIMIT {
                prop_assert!((f64::from(steps) * grid.position - x).abs() <= grid.position * (0.5 + 1e-6));
            }
        }

        #[test]
        fn order_is_kept(a in -1e6_f64..1e6, b in -1e6_f64..1e6, grid in grid()) {
            let (low, high) = if a < b { (a, b) } else { (b, a) };
            prop_assert!(quantise(low, grid.linear, VELOCITY_LIMIT) <= quantise(high, grid.linear, VELOCITY_LIMIT));
        }

        #[test]
        fn a_packed_rotation_quantises_to_itself(q in unit_quaternion()) {
            let packed = PackedRotation::of(q);
            prop_assert_eq!(PackedRotation::of(packed.value()), packed);
            let (largest, others) = packed.parts();
            prop_assert_eq!(PackedRotation::from_parts(largest, others), Some(packed));
        }

        #[test]
        fn a_packed_rotation_is_near(q in unit_quaternion()) {
            let truth = Pose { position: DVec3::ZERO, rotation: q };
            let coded = Pose { position: DVec3::ZERO, rotation: PackedRotation::of(q).value() };
            prop_assert!(Divergence::between(&truth, &coded).turn().radians() < 9.4e-6);
        }

        #[test]
        fn a_residual_leads_within_tolerance(
            truth in motion(), predicted in motion(), micrometres in 5_000_u32..200_000, turn in 0.0005_f64..3.0,
        ) {
            let surface = Tolerance::from_micrometres(micrometres).unwrap();
            let position = surface.length().unwrap();
            let radius = Metres::new(0.5);
            for tolerance in [surface, Tolerance::parts(position, Radians::new(turn)).unwrap()] {
                let grid = Grid::new(tolerance, radius);
                let residual = nearest(&truth, &predicted, &grid);
                if residual.is_within_limits() {
                    let coded = residual.onto(&predicted, Seconds::new(0.1), &grid).motion(&grid);
                    let apart = Divergence::between(&truth.pose(), &coded.pose());
                    prop_assert!(tolerance.share(&apart, radius) <= 1.0, "{apart:?}");
                }
            }
        }

        #[test]
        fn coded_velocities_arrive(truth in motion(), predicted in motion(), grid in grid()) {
            let mut residual = nearest(&truth, &predicted, &grid);
            prop_assume!(residual.is_within_limits());
            let implied = residual.onto(&predicted, Seconds::new(0.1), &grid);
            let wanted = QuantisedState::of(&truth, &grid);
            residual.velocity = Some(Residual::of_velocity(&truth.twist(), &implied, &grid, 0));
            let coded = residual.onto(&predicted, Seconds::new(0.1), &grid);
            let far = |steps: [i32; 3]| steps.iter().any(|s| s.abs() > VELOCITY_LIMIT / 2);
            prop_assume!(!far(implied.linear) && !far(implied.angular));
            prop_assert_eq!((coded.linear, coded.angular), (wanted.linear, wanted.angular));
        }

        #[test]
        fn a_correction_implies_the_velocity_that_made_it_necessary(linear in vector(20.0), steps in 1_u32..20) {
            let grid = Grid::new(Tolerance::EXACT, Metres::new(0.5));
            let over = Seconds::new(f64::from(steps) / 60.0);
            let position = scale3(linear, over.seconds());
            let truth = Motion::new(Pose { position, rotation: DQuat::IDENTITY }, Twist::ZERO).unwrap();
            let residual = nearest(&truth, &Motion::IDENTITY, &grid);
            let implied = residual.onto(&Motion::IDENTITY, over, &grid).motion(&grid);
            // Half a step of position in that time, and half a step of velocity.
            let slack = grid.position() / over.seconds() + grid.linear();
            prop_assert!((implied.twist().linear - linear).length() <= slack);
        }
    }

    #[test]
    fn beyond_the_limit_a_value_saturates() {
        assert_eq!(quantise(1e300, 1e-3, POSITION_LIMIT), POSITION_LIMIT);
        assert_eq!(quantise(-1e300, 1e-3, POSITION_LIMIT), -POSITION_LIMIT);
    }

    #[test]
    fn ties_between_components_have_one_form() {
        let half = 0.5_f64;
        let root = half.sqrt();
        for q in [
            [half, half, half, half],
            [root, root, 0.0, 0.0],
            [0.0, -root, 0.0, root],
            [-half, half, -half, half],
        ] {
            let packed = PackedRotation::of(DQuat::from_array(q));
            assert_eq!(PackedRotation::of(packed.value()), packed);
        }
    }

    #[test]
    fn invalid_rotations_are_refused() {
        assert_eq!(PackedRotation::from_parts(4, [0; 3]), None);
        assert_eq!(
            PackedRotation::from_parts(0, [PackedRotation::LIMIT; 3]),
            None
        );
        assert_eq!(PackedRotation::from_parts(0, [i32::MIN; 3]), None);
    }

    proptest! {
        #[test]
        fn stable_rotations_pack_to_themselves(
            largest in 0_u8..4,
            others in proptest::array::uniform3(
                prop_oneof![-400_000_i32..=400_000, 302_000..303_000, 370_000..371_000]
            ),
        ) {
            let packed = PackedRotation::packed(largest, others);
            if packed.is_surely_stable() {
                prop_assert_eq!(PackedRotation::nearest(packed.value()), packed);
            }
        }
    }
}
