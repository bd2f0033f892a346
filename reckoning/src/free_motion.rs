//! Free motion of a body: an integrator's coefficients, torque-free rotation.
//!
//! The engine integrates semi-implicitly in substeps, damps once a tick, and turns by a normalised linear step. Any
//! other predictor would deviate from it (RECKONING 2). The coefficients depend on the scene and on a body's damping,
//! not on its motion: one row serves every body. Horizons are bounded by [`TRACK_AGE_MAX`].
//!
//! The axis of spin of such a body wanders: no closed form of a few coefficients exists, so that the integrator's own map
//! is iterated (RECKONING 3.7); an engine takes the same one. Positions are not known here. Invariants: a cursor changes
//! the cost of an answer, never its bits; the angular momentum keeps its length, and the energy stays within bounds.
//!
//! Moments are sent once, with the body's description, in the engine's own precision. Invariant: they are normal f32
//! above zero with bounded ratios, and their frame is of unit length: no rotation leads to an infinity (RECKONING 2.6).

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::fmt;
use core::num::NonZeroU32;

use glam::{DQuat, DVec3};

use crate::exact::{conjugate, length4, normalised, product, scale3, turned};
use crate::motion::UNIT_LENGTH_SLACK;
use crate::units::{Rate, Ticks};

/// Greatest age of a track: a moving body gets an update before, so that tables and ages stay small.
pub const TRACK_AGE_MAX: Ticks = Ticks::new(1_023);

/// The integration of a free body in a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integrator {
    /// Ticks per second.
    pub rate: Rate,
    /// Velocity and position steps in one tick.
    pub substeps: NonZeroU32,
}

/// Damping of a body's free motion: velocity is divided by `1 + dt·damping` once a tick. Per second, ≥ 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Damping {
    /// Of the linear velocity, 1/s.
    pub linear: f32,
    /// Of the angular velocity, 1/s.
    pub angular: f32,
}

/// Coefficients after n ticks, from v₀, g and |ω₀| (RECKONING 2.3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StepCoefficients {
    /// v = `velocity`·v₀ + `fall_velocity`·g.
    pub(crate) velocity: f64,
    /// p = p₀ + `reach`·v₀ + `fall`·g, seconds.
    pub(crate) reach: f64,
    /// Seconds.
    pub(crate) fall_velocity: f64,
    /// Seconds squared.
    pub(crate) fall: f64,
    /// ω = `spin`·ω₀.
    pub(crate) spin: f64,
    /// Sums over the ticks of the spin coefficient to the first, third and fifth power.
    pub(crate) turns: [f64; 3],
}

impl StepCoefficients {
    const START: Self = Self {
        velocity: 1.0,
        reach: 0.0,
        fall_velocity: 0.0,
        fall: 0.0,
        spin: 1.0,
        turns: [0.0; 3],
    };

    /// One tick later.
    fn stepped(&self, config: &StepConstants) -> Self {
        let spin2 = self.spin * self.spin;
        let spin3 = spin2 * self.spin;
        let spin5 = spin3 * spin2;
        Self {
            velocity: self.velocity * config.linear_keep,
            reach: self.reach + config.dt * self.velocity,
            fall_velocity: (self.fall_velocity + config.dt) * config.linear_keep,
            fall: (self.fall + config.dt * self.fall_velocity) + config.fall_in_tick,
            spin: self.spin * config.angular_keep,
            turns: [
                self.turns[0] + self.spin,
                self.turns[1] + spin3,
                self.turns[2] + spin5,
            ],
        }
    }

    /// See [`StepCoefficientTable::narrow_row`].
    const fn narrowed(&self) -> [f32; 4] {
        [
            self.reach as f32,
            self.fall as f32,
            self.turns[0] as f32,
            (self.turns[1] / 3.0) as f32,
        ]
    }

    /// Half the angle turned so far by a body whose initial spin is `speed` rad/s (RECKONING 2.4).
    ///
    /// Each substep turns by twice the arctangent of `u`; its series is cut after the fifth power.
    pub(crate) fn half_angle(&self, speed: f64, config: &StepConstants) -> f64 {
        let u = speed * config.half_substep;
        let u2 = u * u;
        let series = self.turns[0] - u2 * (self.turns[1] / 3.0 - u2 * (self.turns[2] / 5.0));
        (config.substeps * u) * series
    }
}

/// Constants that all rows of one table share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StepConstants {
    pub(crate) dt: f64,
    pub(crate) substeps: f64,
    substep_count: u32,
    pub(crate) half_substep: f64,
    linear_keep: f64,
    angular_keep: f64,
    fall_in_tick: f64,
}

/// Rows from tick zero to the last one computed, for one integrator and one damping.
#[derive(Clone, Debug)]
pub struct StepCoefficientTable {
    config: StepConstants,
    rows: Vec<StepCoefficients>,
    /// See [`Self::narrow_row`].
    narrow_rows: Vec<[f32; 4]>,
}

impl StepCoefficientTable {
    /// A table for bodies of this damping; [`Self::extend_to`] computes its rows.
    #[must_use]
    pub fn new(integrator: Integrator, damping: Damping) -> Self {
        let dt = integrator.rate.step().seconds();
        let substeps = f64::from(integrator.substeps.get());
        let config = StepConstants {
            dt,
            substeps,
            substep_count: integrator.substeps.get(),
            half_substep: (dt / substeps) * 0.5,
            linear_keep: 1.0 / (1.0 + dt * f64::from(damping.linear)),
            angular_keep: 1.0 / (1.0 + dt * f64::from(damping.angular)),
            fall_in_tick: (dt * dt) * ((substeps + 1.0) / (2.0 * substeps)),
        };
        Self {
            config,
            rows: alloc::vec![StepCoefficients::START],
            narrow_rows: alloc::vec![StepCoefficients::START.narrowed()],
        }
    }

    /// Computes the rows up to `ticks`, or up to [`TRACK_AGE_MAX`] if that is less.
    pub fn extend_to(&mut self, ticks: Ticks) {
        let wanted = ticks.min(TRACK_AGE_MAX).count() as usize;
        while self.rows.len() <= wanted {
            let last = self.rows[self.rows.len() - 1];
            let next = last.stepped(&self.config);
            self.narrow_rows.push(next.narrowed());
            self.rows.push(next);
        }
    }

    /// `ticks`, or the last computed row when that is less.
    #[inline]
    pub(crate) fn within(&self, ticks: Ticks) -> Ticks {
        ticks.min(Ticks::new(self.rows.len() as u32 - 1))
    }

    /// Effect in `elapsed` ticks of an acceleration that ends at `ends`: factor on the way, s², and on the velocity,
    /// s.
    #[inline]
    pub(crate) fn ended(&self, elapsed: Ticks, ends: Ticks) -> (f64, f64) {
        let pulled = self.within(elapsed).min(ends);
        let (last, _) = self.row(pulled);
        let coasted = Ticks::new(self.within(elapsed).count() - pulled.count());
        let (coast, _) = self.row(coasted);
        (
            last.fall + last.fall_velocity * coast.reach,
            last.fall_velocity * coast.velocity,
        )
    }

    /// The row for `ticks` as the prefilter takes it: reach, fall, the sum of the spin, and a third of that of its cube.
    #[inline]
    pub(crate) fn narrow_row(&self, ticks: Ticks) -> [f32; 4] {
        self.narrow_rows[(ticks.count() as usize).min(self.narrow_rows.len() - 1)]
    }

    /// The row for `ticks`; the last one computed when `ticks` lies beyond it.
    #[inline]
    pub(crate) fn row(&self, ticks: Ticks) -> (&StepCoefficients, &StepConstants) {
        (
            &self.rows[self.within(ticks).count() as usize],
            &self.config,
        )
    }
}

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

/// The change of a body's angular momentum, relative to its principal axes, in half a tick without torque.
///
/// Turns about the axes of the least and the greatest moment, one after the other: the part of the energy that all axes
/// share turns nothing. Each turn is exact for its part of the energy but for the angle, whose tangent is its series'
/// first term. Source: McLachlan, "Explicit Lie-Poisson integration and the Euler equations", 1993.
#[derive(Clone, Copy, Debug)]
struct MomentumFlow {
    moments: DVec3,
    /// 1 / moments.
    turnability: DVec3,
    /// Axes of the least and the greatest moment.
    axes: [usize; 2],
    /// Tangent of half the angle of their turns, per angular momentum.
    tangents: [f64; 2],
    /// Steps in half a tick.
    steps: u32,
}

impl MomentumFlow {
    /// `substeps` of a tick of `dt` seconds.
    fn new(inertia: &Inertia, dt: f64, substeps: u32) -> Self {
        let moments = inertia.wide_moments();
        let turnability = DVec3::new(1.0 / moments.x, 1.0 / moments.y, 1.0 / moments.z);
        let (mut least, mut middle, mut greatest) = (0, 1, 2);
        if moments[middle] < moments[least] {
            (least, middle) = (middle, least);
        }
        if moments[greatest] < moments[middle] {
            (middle, greatest) = (greatest, middle);
        }
        if moments[middle] < moments[least] {
            (least, middle) = (middle, least);
        }
        let steps = substeps.div_ceil(2);
        let step = (dt * 0.5) / f64::from(steps);
        let beyond = |axis: usize| turnability[axis] - turnability[middle];
        Self {
            moments,
            turnability,
            axes: [least, greatest],
            tangents: [
                beyond(least) * (step * 0.25),
                beyond(greatest) * (step * 0.5),
            ],
            steps,
        }
    }

    fn half_tick(&self, momentum: DVec3) -> DVec3 {
        let [least, greatest] = self.axes;
        let [small, large] = self.tangents;
        let mut momentum = momentum.to_array();
        for _ in 0..self.steps {
            turn(&mut momentum, least, small);
            turn(&mut momentum, greatest, large);
            turn(&mut momentum, least, small);
        }
        DVec3::from_array(momentum)
    }

    fn momentum(&self, w: DVec3) -> DVec3 {
        let m = self.moments;
        DVec3::new(m.x * w.x, m.y * w.y, m.z * w.z)
    }

    fn angular(&self, p: DVec3) -> DVec3 {
        let n = self.turnability;
        DVec3::new(p.x * n.x, p.y * n.y, p.z * n.z)
    }
}

/// Turns an angular momentum about one of its axes, by an angle that grows with the component along that axis.
fn turn(p: &mut [f64; 3], axis: usize, tangent: f64) {
    let (second, third) = ([1, 2, 0][axis], [2, 0, 1][axis]);
    let a = p[axis] * tangent;
    let r = 1.0 / (1.0 + a * a);
    let (c, s) = ((1.0 - a * a) * r, (a + a) * r);
    (p[second], p[third]) = (c * p[second] + s * p[third], c * p[third] - s * p[second]);
}

/// The angular velocity of a body after some half ticks without torque, about the axes that it has now.
///
/// World frame, rad/s. An engine that turns a body by one angular velocity in a tick takes the one after half a tick,
/// and takes the other half when the body has turned: then a free body rotates as it is predicted to.
#[must_use]
pub fn precessed(
    rotation: DQuat,
    angular: DVec3,
    inertia: &Inertia,
    integrator: &Integrator,
    half_ticks: u32,
) -> DVec3 {
    let dt = integrator.rate.step().seconds();
    let flow = MomentumFlow::new(inertia, dt, integrator.substeps.get());
    let axes = normalised(product(rotation, inertia.unit_frame()));
    let mut momentum = flow.momentum(turned(conjugate(axes), angular));
    for _ in 0..half_ticks {
        momentum = flow.half_tick(momentum);
    }
    turned(axes, flow.angular(momentum))
}

/// A rotating body in its principal axes: there a turn about the axis of spin does not change the spin.
#[derive(Clone, Debug)]
pub(crate) struct TorqueFreeRotation {
    start: RotationState,
    elapsed: u32,
    /// Principal axes → world.
    axes: DQuat,
    /// Angular momentum relative to the principal axes.
    momentum: DVec3,
    flow: MomentumFlow,
    /// Body → principal axes.
    frame: DQuat,
}

impl TorqueFreeRotation {
    fn new(start: RotationState, inertia: &Inertia, config: &StepConstants) -> Self {
        let (rotation, angular) = start;
        let frame = inertia.unit_frame();
        let axes = normalised(product(rotation, frame));
        let flow = MomentumFlow::new(inertia, config.dt, config.substep_count);
        Self {
            start,
            elapsed: 0,
            axes,
            momentum: flow.momentum(turned(conjugate(axes), angular)),
            flow,
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
            self.tick(config);
            self.elapsed += 1;
        }
    }

    /// One tick of the engine: half of the precession, the substeps, the damping, the other half.
    fn tick(&mut self, config: &StepConstants) {
        let halfway = self.flow.half_tick(self.momentum);
        let t = scale3(self.flow.angular(halfway), config.half_substep);
        let substep = normalised(DQuat::from_xyzw(t.x, t.y, t.z, 1.0));
        for _ in 0..config.substep_count {
            self.axes = product(self.axes, substep);
        }
        self.momentum = self.flow.half_tick(scale3(halfway, config.angular_keep));
    }

    /// The rotation in world axes.
    fn spin(&self) -> RotationState {
        let axes = normalised(self.axes);
        let rotation = normalised(product(axes, self.frame));
        (rotation, turned(axes, self.flow.angular(self.momentum)))
    }
}

/// Principal moments of inertia (kg·m²; only their ratios matter) and the rotation principal axes → body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inertia {
    moments: [f32; 3],
    frame: [f32; 4],
}

impl Inertia {
    /// A moment may exceed another by this factor at most: 2²⁴, a needle four thousand times as long as wide.
    pub const RATIO_MAX: f64 = 16_777_216.0;
    /// Principal axes that coincide with the body's own.
    pub const OWN_AXES: [f32; 4] = [0.0, 0.0, 0.0, 1.0];
    /// Moments that differ by no more than this share of the greatest are equal: 2⁻²⁰, eight times what f32 rounds off.
    pub const EQUAL: f64 = 1.0 / 1_048_576.0;

    /// Takes moments about three axes, and the quaternion (x, y, z, w) that turns those axes into the body's frame.
    ///
    /// # Errors
    ///
    /// [`InvalidInertia`] names the part that is out of range.
    pub fn new(moments: [f32; 3], frame: [f32; 4]) -> Result<Self, InvalidInertia> {
        if !moments.iter().all(|m| m.is_normal() && *m > 0.0) {
            return Err(InvalidInertia::Moment);
        }
        let inertia = Self { moments, frame };
        let (least, greatest) = inertia.extremes();
        if greatest > least * Self::RATIO_MAX {
            return Err(InvalidInertia::Ratio);
        }
        let length = length4(inertia.raw_frame());
        // Written so that NaN fails too.
        let near_unit = (length - 1.0).abs() <= UNIT_LENGTH_SLACK;
        if !near_unit {
            return Err(InvalidInertia::Frame);
        }
        Ok(inertia)
    }

    /// Moments about the principal axes, kg·m².
    #[must_use]
    pub const fn moments(&self) -> [f32; 3] {
        self.moments
    }

    /// Quaternion x, y, z, w, principal axes → body.
    #[must_use]
    pub const fn frame(&self) -> [f32; 4] {
        self.frame
    }

    /// True if all moments are equal up to rounding: such a body keeps its spin, and its inertia is not sent.
    #[must_use]
    pub fn is_isotropic(&self) -> bool {
        let (least, greatest) = self.extremes();
        greatest - least <= greatest * Self::EQUAL
    }

    fn extremes(&self) -> (f64, f64) {
        let [a, b, c] = self.moments.map(f64::from);
        (a.min(b).min(c), a.max(b).max(c))
    }

    fn raw_frame(&self) -> DQuat {
        DQuat::from_array(self.frame.map(f64::from))
    }

    /// The moments, widened.
    fn wide_moments(&self) -> DVec3 {
        DVec3::from_array(self.moments.map(f64::from))
    }

    /// The frame, widened and normalised.
    fn unit_frame(&self) -> DQuat {
        normalised(self.raw_frame())
    }
}

/// Reason why numbers are not an inertia.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum InvalidInertia {
    /// A moment is not a normal number above zero.
    Moment,
    /// A moment exceeds another by more than [`Inertia::RATIO_MAX`].
    Ratio,
    /// The frame is not a finite quaternion of unit length.
    Frame,
}

impl fmt::Display for InvalidInertia {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Moment => "a moment of inertia is not a normal number above zero",
            Self::Ratio => "moments of inertia are too far apart",
            Self::Frame => "the principal frame is not a finite quaternion of unit length",
        })
    }
}

impl core::error::Error for InvalidInertia {}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(linear: f32, angular: f32) -> StepCoefficientTable {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).unwrap(),
        };
        let mut table = StepCoefficientTable::new(integrator, Damping { linear, angular });
        table.extend_to(TRACK_AGE_MAX);
        table
    }

    #[test]
    fn the_coefficients_equal_stepping_by_hand() {
        let table = table(0.3, 0.1);
        let (dt, h, keep) = (1.0 / 60.0, 1.0 / 240.0, 1.0 / (1.0 + 0.3_f32 as f64 / 60.0));
        let (mut p, mut v, g) = (0.0, 5.0, -9.8);
        for _ in 0..120 {
            for _ in 0..4 {
                v += g * h;
                p += v * h;
            }
            v *= keep;
        }
        let (flow, _) = table.row(Ticks::new(120));
        assert!((flow.reach * 5.0 + flow.fall * g - p).abs() < 1e-9);
        assert!((flow.velocity * 5.0 + flow.fall_velocity * g - v).abs() < 1e-9);
        assert!((dt - 4.0 * h).abs() < 1e-15);
    }

    #[test]
    fn the_angle_equals_stepping_by_hand() {
        let table = table(0.0, 0.05);
        let (h, keep) = (1.0 / 240.0, 1.0 / (1.0 + 0.05_f32 as f64 / 60.0));
        let (mut spin, mut half) = (40.0, 0.0);
        for _ in 0..300 {
            for _ in 0..4 {
                half += libm::atan(spin * h * 0.5);
            }
            spin *= keep;
        }
        let (flow, config) = table.row(Ticks::new(300));
        // 40 rad/s for five seconds; the cut series is worth less than a thousandth of a radian.
        assert!((flow.half_angle(40.0, config) - half).abs() < 1e-3);
    }

    #[test]
    fn acceleration_ends_after_its_ticks() {
        let table = table(0.3, 0.0);
        let (h, keep, g) = (1.0 / 240.0, 1.0 / (1.0 + 0.3_f32 as f64 / 60.0), -9.8);
        let (mut p, mut v) = (0.0, 0.0);
        for tick in 1..=200 {
            for _ in 0..4 {
                v += if tick <= 64 { g * h } else { 0.0 };
                p += v * h;
            }
            v *= keep;
            let (fall, fall_velocity) = table.ended(Ticks::new(tick), Ticks::new(64));
            assert!((fall * g - p).abs() < 1e-9, "{tick}");
            assert!((fall_velocity * g - v).abs() < 1e-9, "{tick}");
        }
    }

    #[test]
    fn beyond_the_horizon_the_last_row_stands() {
        let table = table(0.0, 0.0);
        assert_eq!(
            table.row(TRACK_AGE_MAX).0,
            table.row(Ticks::new(1_000_000)).0
        );
    }

    #[test]
    fn invalid_inertia_is_refused() {
        let own = Inertia::OWN_AXES;
        for wrong in [0.0, -1.0, f32::NAN, f32::INFINITY, f32::MIN_POSITIVE / 2.0] {
            let refused = Inertia::new([1.0, wrong, 1.0], own);
            assert_eq!(refused, Err(InvalidInertia::Moment));
        }
        let needle = Inertia::new([1.0, 1e-8, 1.0], own);
        assert_eq!(needle, Err(InvalidInertia::Ratio));
        for frame in [[0.0; 4], [0.0, 0.0, 0.0, 1.01], [f32::NAN, 0.0, 0.0, 1.0]] {
            assert_eq!(Inertia::new([1.0; 3], frame), Err(InvalidInertia::Frame));
        }
    }

    #[test]
    fn moments_that_differ_by_rounding_only_are_equal() {
        let of = |moments| Inertia::new(moments, Inertia::OWN_AXES).unwrap();
        assert!(of([2.0; 3]).is_isotropic());
        assert!(of([3.0, 3.000_000_5, 3.0]).is_isotropic());
        assert!(!of([3.0, 3.00001, 3.0]).is_isotropic());
        assert!(!of([1.0, 2.0, 2.0]).is_isotropic());
    }
}
