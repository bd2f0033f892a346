//! Four predictions side by side, equal to scalar ones to the bit.
//!
//! For bodies that keep their axis of spin, which most do. Each lane repeats [`Track::at`](crate::Track::at), or
//! [`Residual::onto`], operation by operation; at a branch, both sides are computed and one is kept.

use glam::{DQuat, DVec3};
use wide::f64x4;

use crate::exact::{ANGLE_LIMIT, COSINE, HALF_PI_HIGH, HALF_PI_LOW, SINE, TWO_OVER_PI};
use crate::free_motion::{StepCoefficientTable, StepCoefficients, StepConstants};
use crate::motion::{Motion, Pose, Twist};
use crate::predictor::{ACCELERATION_TICKS, Conditions, Predictor};
use crate::quantiser::{
    FINE_STEPS, Grid, OTHERS, PACKED_STEPS, POSITION_LIMIT, PackedRotation, QuantisedState,
    Residual, VELOCITY_LIMIT,
};
use crate::track::{Anchor, DenseTrack, elapsed};
use crate::units::{Seconds, Tick, Ticks};

/// Bodies side by side.
const LANES: usize = 4;

/// Up to four bodies to predict, one array for each number.
#[derive(Clone, Debug, Default)]
pub struct PredictionX4 {
    len: usize,
    keys: [u32; LANES],
    /// In `units`, as the velocities.
    position: [[f64; LANES]; 3],
    /// Not normalised; zero for the part at `implied`.
    rotation: [[f64; LANES]; 4],
    /// The place of the part that follows from the others; [`ALL_GIVEN`] for none.
    implied: [f64; LANES],
    /// Of `position`, `linear` and `angular`.
    units: [[f64; LANES]; 3],
    linear: [[f64; LANES]; 3],
    angular: [[f64; LANES]; 3],
    /// Acceleration: gravity, or that of the predictor.
    gravity: [[f64; LANES]; 3],
    /// [`StepCoefficients`](crate::free_motion::StepCoefficients): `reach`, `velocity`, `fall`, `fall_velocity`, `spin`,
    /// `turns`.
    row: [[f64; LANES]; 8],
    config: Option<StepConstants>,
}

/// Motions side by side.
struct MotionX4 {
    position: [f64x4; 3],
    rotation: [f64x4; 4],
    linear: [f64x4; 3],
    angular: [f64x4; 3],
}

impl PredictionX4 {
    /// Capacity of a batch.
    pub const LANES: usize = LANES;

    /// Adds a body under a key; returns `false` if the body needs scalar prediction or the batch is full
    /// ([`Self::is_full`]).
    ///
    /// The arguments are those of [`Track::at`](crate::Track::at); all bodies of a batch belong to scenes with the
    /// same integrator.
    #[must_use]
    #[inline]
    pub fn take(
        &mut self,
        key: u32,
        track: &DenseTrack,
        tick: Tick,
        grid: &Grid,
        conditions: &Conditions<'_>,
    ) -> bool {
        let predictor = track.predictor();
        let is_torque_free = predictor.is_torque_free() && conditions.inertia.is_some();
        if is_torque_free || predictor == Predictor::Rest || self.is_full() {
            return false;
        }
        let elapsed = conditions.flow.within(elapsed(track.origin(), tick));
        let (row, config) = conditions.flow.row(elapsed);
        // Already below: the remainder lets the compiler drop the bounds checks of the stores below.
        let lane = self.len % LANES;
        self.lay(lane, &track.anchor(), grid);
        let (acceleration, fall) = match predictor.acceleration() {
            Some(acceleration) => (
                acceleration.acceleration(),
                conditions.flow.ended(elapsed, ACCELERATION_TICKS),
            ),
            None if predictor.falls() => (conditions.gravity, (row.fall, row.fall_velocity)),
            None => (NO_PULL, (row.fall, row.fall_velocity)),
        };
        set3(&mut self.gravity, lane, acceleration);
        set_row(&mut self.row, lane, row, fall);
        self.config = Some(*config);
        self.keys[lane] = key;
        self.len += 1;
        true
    }

    /// Writes the start of a lane. Its numbers are scaled with those of the other lanes.
    #[inline(always)]
    fn lay(&mut self, lane: usize, anchor: &Anchor, grid: &Grid) {
        let (position, linear, angular, units) = match anchor {
            Anchor::Exact(body_state) => {
                let (pose, twist) = body_state.raw();
                for (part, value) in pose.rotation.to_array().into_iter().enumerate() {
                    self.rotation[part][lane] = value;
                }
                self.implied[lane] = ALL_GIVEN;
                (pose.position, twist.linear, twist.angular, [1.0; 3])
            }
            Anchor::Quantised(quantised) => {
                let (largest, others) = quantised.rotation.parts();
                let largest = usize::from(largest) % 4;
                for (place, part) in OTHERS[largest].into_iter().zip(others) {
                    self.rotation[place % 4][lane] = f64::from(part) / PACKED_STEPS;
                }
                self.rotation[largest][lane] = 0.0;
                self.implied[lane] = IMPLIED[largest];
                (
                    numbers(quantised.position),
                    numbers(quantised.linear),
                    numbers(quantised.angular),
                    [grid.fine(), grid.linear(), grid.angular()],
                )
            }
        };
        set3(&mut self.position, lane, position);
        set3(&mut self.linear, lane, linear);
        set3(&mut self.angular, lane, angular);
        for (quantity, unit) in units.into_iter().enumerate() {
            self.units[quantity][lane] = unit;
        }
    }

    /// True if the batch is full.
    #[must_use]
    pub const fn is_full(&self) -> bool {
        self.len == LANES
    }

    /// Predicts all bodies of the batch, hands each out under its key, and empties the batch.
    pub fn predict(&mut self, mut out: impl FnMut(u32, Motion)) {
        let Some(config) = self.config.take() else {
            return;
        };
        let keys = self.keys;
        self.predicted(&config)
            .each(self.len, |lane, motion| out(keys[lane], motion));
        self.len = 0;
    }

    /// Predicts and corrects all bodies of the batch, and empties it. `None` for an empty batch.
    ///
    /// `corrections`: one for each body, in the order of [`Self::take`].
    pub fn correct<'a>(
        &mut self,
        corrections: impl IntoIterator<Item = LaneCorrection<'a>>,
    ) -> Option<CorrectedX4> {
        let config = self.config.take()?;
        let laid = LaneCorrections::of(corrections.into_iter().take(self.len));
        let len = core::mem::take(&mut self.len);
        Some(laid.onto(&self.predicted(&config), len))
    }

    /// Predicts all lanes, the unused ones too.
    #[inline]
    fn predicted(&self, config: &StepConstants) -> MotionX4 {
        let [unit, linear_unit, angular_unit] = lanes3(&self.units);
        let [x, y, z] = times(lanes3(&self.angular), angular_unit);
        let start = StartX4 {
            position: times(lanes3(&self.position), unit),
            rotation: normalised(self.rotation()),
            linear: times(lanes3(&self.linear), linear_unit),
            angular: [x, y, z],
            pull: lanes3(&self.gravity),
            speed: (x * x + y * y + z * z).sqrt(),
        };
        start.after(&self.row, config)
    }

    /// The rotations with all four parts, as [`PackedRotation::value`] has them before it normalises.
    #[inline(always)]
    fn rotation(&self) -> [f64x4; 4] {
        let [x, y, z, w] = lanes4(&self.rotation);
        // The zero of the implied part changes no sum.
        let rest = f64x4::splat(1.0) - (x * x + y * y + z * z + w * w);
        let rest = rest.fast_max(f64x4::splat(0.0)).sqrt();
        let implied = lanes(&self.implied);
        let with = |part: f64x4, place: usize| part | (rest & implied.simd_eq(IMPLIED[place]));
        [with(x, 0), with(y, 1), with(z, 2), with(w, 3)]
    }
}

/// The places of the four parts of a rotation, as lanes hold them.
const IMPLIED: [f64; 4] = [0.0, 1.0, 2.0, 3.0];
/// The place that no part has.
const ALL_GIVEN: f64 = 4.0;

/// Starts side by side, their rotations normalised.
struct StartX4 {
    position: [f64x4; 3],
    rotation: [f64x4; 4],
    linear: [f64x4; 3],
    angular: [f64x4; 3],
    pull: [f64x4; 3],
    /// The length of the angular velocity.
    speed: f64x4,
}

impl StartX4 {
    /// The motions by these coefficients; see [`PredictionX4`].
    #[inline(always)]
    fn after(&self, row: &[[f64; LANES]; 8], config: &StepConstants) -> MotionX4 {
        let (position, linear, pull) = (self.position, self.linear, self.pull);
        let [reach, velocity, fall, fall_velocity] = first4(row);
        let went = |i: usize| (position[i] + linear[i] * reach) + pull[i] * fall;
        let goes = |i: usize| linear[i] * velocity + pull[i] * fall_velocity;
        let (rotation, angular) = self.spun(row, config);
        MotionX4 {
            position: [went(0), went(1), went(2)],
            rotation,
            linear: [goes(0), goes(1), goes(2)],
            angular,
        }
    }

    /// Rotations and spins (RECKONING 3.6).
    #[inline(always)]
    fn spun(&self, row: &[[f64; LANES]; 8], config: &StepConstants) -> ([f64x4; 4], [f64x4; 3]) {
        let ([x, y, z], speed) = (self.angular, self.speed);
        let [_, _, _, _, spin, s1, s3, s5] = row;
        let (spin, s1, s3, s5) = (lanes(spin), lanes(s1), lanes(s3), lanes(s5));
        let u = speed * config.half_substep;
        let u2 = u * u;
        let series = s1 - u2 * (s3 / 3.0 - u2 * (s5 / 5.0));
        let half_angle = (u * config.substeps) * series;
        let (sine, cosine) = sin_cos(half_angle);
        let k = sine / speed;
        let turned = normalised(product([x * k, y * k, z * k, cosine], self.rotation));
        let still = half_angle.simd_eq(f64x4::splat(0.0));
        let kept = |place: usize| choose(still, self.rotation[place], turned[place]);
        let rotation = if still.any() {
            [kept(0), kept(1), kept(2), kept(3)]
        } else {
            turned
        };
        (rotation, [x * spin, y * spin, z * spin])
    }
}

impl MotionX4 {
    /// Hands out the first lanes with their numbers.
    #[inline(always)]
    fn each(self, count: usize, mut out: impl FnMut(usize, Motion)) {
        let (position, linear, angular) = (
            arrays(self.position),
            arrays(self.linear),
            arrays(self.angular),
        );
        let [x, y, z, w] = self.rotation;
        let [x, y, z, w] = [x.to_array(), y.to_array(), z.to_array(), w.to_array()];
        for lane in 0..count.min(LANES) {
            let pose = Pose {
                position: at3(&position, lane),
                rotation: DQuat::from_xyzw(x[lane], y[lane], z[lane], w[lane]),
            };
            let twist = Twist {
                linear: at3(&linear, lane),
                angular: at3(&angular, lane),
            };
            out(lane, Motion::from_checked(pose, twist));
        }
    }
}

/// The start of a moving track, unpacked once to be predicted at many ticks.
#[derive(Clone, Copy, Debug)]
pub struct UnpackedStart {
    origin: Tick,
    position: [f64; 3],
    /// Normalised.
    rotation: [f64; 4],
    linear: [f64; 3],
    angular: [f64; 3],
    /// Acceleration: gravity, or that of the predictor.
    pull: [f64; 3],
    speed: f64,
    /// True for an acceleration that ends.
    accelerates: bool,
}

impl UnpackedStart {
    /// The start of a track; `None` if the body needs scalar prediction. The arguments are those of
    /// [`Track::at`](crate::Track::at).
    #[must_use]
    pub fn of(track: &DenseTrack, grid: &Grid, conditions: &Conditions<'_>) -> Option<Self> {
        let predictor = track.predictor();
        let is_torque_free = predictor.is_torque_free() && conditions.inertia.is_some();
        if is_torque_free || predictor == Predictor::Rest {
            return None;
        }
        let (pose, twist) = start(&track.anchor(), grid);
        let pull = predictor.pull(Ticks::ZERO, conditions);
        Some(Self {
            origin: track.origin(),
            position: pose.position.to_array(),
            rotation: crate::exact::normalised(pose.rotation).to_array(),
            linear: twist.linear.to_array(),
            angular: twist.angular.to_array(),
            pull: pull.map_or(NO_PULL, |pull| pull.acceleration).to_array(),
            speed: crate::exact::length3(twist.angular),
            accelerates: predictor.acceleration().is_some(),
        })
    }
}

/// A body that does not fall gets a zero that changes no number, not even the sign of another zero.
const NO_PULL: DVec3 = DVec3::splat(-0.0);

/// Up to four unpacked starts, one array for each number. The bits of their predictions are those of
/// [`Track::at`](crate::Track::at).
#[derive(Clone, Debug, Default)]
pub struct StartsX4 {
    origins: [Tick; LANES],
    position: [[f64; LANES]; 3],
    rotation: [[f64; LANES]; 4],
    linear: [[f64; LANES]; 3],
    angular: [[f64; LANES]; 3],
    pull: [[f64; LANES]; 3],
    speed: [f64; LANES],
    accelerates: [bool; LANES],
}

impl StartsX4 {
    /// Puts a start into a lane, one of [`PredictionX4::LANES`].
    pub fn put(&mut self, lane: usize, start: &UnpackedStart) {
        let lane = lane % LANES;
        for axis in 0..3 {
            self.position[axis][lane] = start.position[axis];
            self.linear[axis][lane] = start.linear[axis];
            self.angular[axis][lane] = start.angular[axis];
            self.pull[axis][lane] = start.pull[axis];
        }
        for part in 0..4 {
            self.rotation[part][lane] = start.rotation[part];
        }
        self.origins[lane] = start.origin;
        self.speed[lane] = start.speed;
        self.accelerates[lane] = start.accelerates;
    }

    /// The start in a lane.
    #[must_use]
    pub fn get(&self, lane: usize) -> UnpackedStart {
        let lane = lane % LANES;
        let three = |of: &[[f64; LANES]; 3]| [of[0][lane], of[1][lane], of[2][lane]];
        UnpackedStart {
            origin: self.origins[lane],
            position: three(&self.position),
            rotation: [0, 1, 2, 3].map(|part: usize| self.rotation[part][lane]),
            linear: three(&self.linear),
            angular: three(&self.angular),
            pull: three(&self.pull),
            speed: self.speed[lane],
            accelerates: self.accelerates[lane],
        }
    }

    /// Predicts the first lanes at a tick, one for each table of damping, and hands each out with its number.
    pub fn predict(
        &self,
        tick: Tick,
        flows: &[&StepCoefficientTable],
        out: impl FnMut(usize, Motion),
    ) {
        if let Some(flow) = flows.first() {
            let (_, config) = flow.row(Ticks::ZERO);
            self.predicted(tick, flows, config).each(flows.len(), out);
        }
    }

    /// Predicts all lanes, the unused ones too. Browsers download one copy, which serves all callers.
    #[cfg_attr(not(target_family = "wasm"), inline(always))]
    fn predicted(
        &self,
        tick: Tick,
        flows: &[&StepCoefficientTable],
        config: &StepConstants,
    ) -> MotionX4 {
        let mut rows = [[0.0; LANES]; 8];
        for (lane, flow) in flows.iter().enumerate().take(LANES) {
            let elapsed = flow.within(elapsed(self.origins[lane], tick));
            let (row, _) = flow.row(elapsed);
            let fall = if self.accelerates[lane] {
                flow.ended(elapsed, ACCELERATION_TICKS)
            } else {
                (row.fall, row.fall_velocity)
            };
            set_row(&mut rows, lane, row, fall);
        }
        let start = StartX4 {
            position: lanes3(&self.position),
            rotation: lanes4(&self.rotation),
            linear: lanes3(&self.linear),
            angular: lanes3(&self.angular),
            pull: lanes3(&self.pull),
            speed: lanes(&self.speed),
        };
        start.after(&rows, config)
    }
}

/// Writes the coefficients of a lane. `fall`: factors on the acceleration.
#[inline(always)]
fn set_row(
    rows: &mut [[f64; LANES]; 8],
    lane: usize,
    row: &StepCoefficients,
    (fall, fall_velocity): (f64, f64),
) {
    let [s1, s3, s5] = row.turns;
    let coefficients = [
        row.reach,
        row.velocity,
        fall,
        fall_velocity,
        row.spin,
        s1,
        s3,
        s5,
    ];
    for (place, coefficient) in coefficients.into_iter().enumerate() {
        rows[place][lane] = coefficient;
    }
}

/// The motion of an anchor, its rotation not normalised.
#[inline(always)]
fn start(anchor: &Anchor, grid: &Grid) -> (Pose, Twist) {
    match anchor {
        Anchor::Exact(body_state) => body_state.raw(),
        Anchor::Quantised(quantised) => quantised.raw(grid),
    }
}

fn set3(to: &mut [[f64; LANES]; 3], lane: usize, from: DVec3) {
    to[0][lane] = from.x;
    to[1][lane] = from.y;
    to[2][lane] = from.z;
}

fn at3(from: &[[f64; LANES]; 3], lane: usize) -> DVec3 {
    DVec3::new(from[0][lane], from[1][lane], from[2][lane])
}

fn lanes(from: &[f64; LANES]) -> f64x4 {
    f64x4::from(*from)
}

fn lanes3([x, y, z]: &[[f64; LANES]; 3]) -> [f64x4; 3] {
    [lanes(x), lanes(y), lanes(z)]
}

fn lanes4([x, y, z, w]: &[[f64; LANES]; 4]) -> [f64x4; 4] {
    [lanes(x), lanes(y), lanes(z), lanes(w)]
}

fn arrays([x, y, z]: [f64x4; 3]) -> [[f64; LANES]; 3] {
    [x.to_array(), y.to_array(), z.to_array()]
}

fn first4(row: &[[f64; LANES]; 8]) -> [f64x4; 4] {
    [
        lanes(&row[0]),
        lanes(&row[1]),
        lanes(&row[2]),
        lanes(&row[3]),
    ]
}

/// As [`exact::normalised`](crate::exact::normalised).
#[inline(always)]
fn normalised([x, y, z, w]: [f64x4; 4]) -> [f64x4; 4] {
    let n = (x * x + y * y + z * z + w * w).sqrt();
    [x / n, y / n, z / n, w / n]
}

/// As [`exact::product`](crate::exact::product).
#[inline(always)]
fn product(a: [f64x4; 4], b: [f64x4; 4]) -> [f64x4; 4] {
    let ([ax, ay, az, aw], [bx, by, bz, bw]) = (a, b);
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// Added and taken away again, this rounds a number below 2⁵¹ to a whole one.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// The greatest whole number not above one below 2⁵¹.
fn floor(x: f64x4) -> f64x4 {
    let near = (x + ROUND) - ROUND;
    near - (near.simd_gt(x) & f64x4::splat(1.0))
}

/// As `exact::sin_cos`.
#[inline(always)]
fn sin_cos(x: f64x4) -> (f64x4, f64x4) {
    let quarters = floor(x * TWO_OVER_PI + 0.5);
    let r = (x - quarters * HALF_PI_HIGH) - quarters * HALF_PI_LOW;
    let r2 = r * r;
    let sine = r + r * (r2 * polynomial(&SINE, r2));
    let cosine = r2 * polynomial(&COSINE, r2) + 1.0;
    // Quarter of the turn: exact, since all of these are whole and small.
    let quarter = quarters - floor(quarters * 0.25) * 4.0;
    let is = |number: f64| quarter.simd_eq(f64x4::splat(number));
    let odd = is(1.0) | is(3.0);
    // Minus one where the mask is set, one elsewhere.
    let sign = |negative: f64x4| f64x4::splat(1.0) - (negative & f64x4::splat(2.0));
    let first = choose(odd, cosine, sine) * sign(is(2.0) | is(3.0));
    let second = choose(odd, sine, cosine) * sign(is(1.0) | is(2.0));
    let in_range = x.abs().simd_le(f64x4::splat(ANGLE_LIMIT));
    (
        in_range & first,
        choose(in_range, second, f64x4::splat(1.0)),
    )
}

/// Lane by lane `one` where the mask is set, and `other` elsewhere.
fn choose(mask: f64x4, one: f64x4, other: f64x4) -> f64x4 {
    other ^ ((one ^ other) & mask)
}

/// Horner's rule from the highest coefficient down.
fn polynomial(coefficients: &[f64], x: f64x4) -> f64x4 {
    let mut sum = f64x4::splat(0.0);
    for c in coefficients.iter().rev() {
        sum = sum * x + *c;
    }
    sum
}

/// The correction of one body's prediction.
#[derive(Clone, Copy, Debug)]
pub struct LaneCorrection<'a> {
    /// The correction.
    pub residual: &'a Residual,
    /// Divergence time of the prediction, above zero.
    pub over: Seconds,
    /// Grid of the body.
    pub grid: &'a Grid,
}

/// Corrections, as arrays by quantity and then by lane.
struct LaneCorrections {
    apart: [[f64; LANES]; 3],
    turns: [[f64; LANES]; 3],
    /// Of the velocities, in steps of the grid.
    linear: [[f64; LANES]; 3],
    angular: [[f64; LANES]; 3],
    /// True if a lane has any of those.
    has_velocity: bool,
    /// Of the grids: `position`, `fine`, `turn`, `linear`, `angular`.
    steps: [[f64; LANES]; 5],
    over: [f64; LANES],
}

impl LaneCorrections {
    #[inline(always)]
    fn of<'a>(corrections: impl Iterator<Item = LaneCorrection<'a>>) -> Self {
        let mut laid = Self {
            apart: [[0.0; LANES]; 3],
            turns: [[0.0; LANES]; 3],
            linear: [[0.0; LANES]; 3],
            angular: [[0.0; LANES]; 3],
            has_velocity: false,
            steps: [[1.0; LANES]; 5],
            over: [1.0; LANES],
        };
        for (lane, correction) in corrections.take(LANES).enumerate() {
            let LaneCorrection {
                residual,
                over,
                grid,
            } = correction;
            set3(&mut laid.apart, lane, numbers(residual.position));
            set3(&mut laid.turns, lane, numbers(residual.turn));
            if let Some(velocity) = &residual.velocity {
                let [linear, angular] = velocity.steps();
                set3(&mut laid.linear, lane, numbers(linear));
                set3(&mut laid.angular, lane, numbers(angular));
                laid.has_velocity = true;
            }
            laid.steps[0][lane] = grid.position();
            laid.steps[1][lane] = grid.fine();
            laid.steps[2][lane] = grid.turn();
            laid.steps[3][lane] = grid.linear();
            laid.steps[4][lane] = grid.angular();
            laid.over[lane] = over.seconds();
        }
        laid
    }

    /// The corrected motions of the first `len` lanes; see [`Residual::onto`].
    #[inline(always)]
    fn onto(&self, predicted: &MotionX4, len: usize) -> CorrectedX4 {
        let step = |quantity: usize| lanes(&self.steps[quantity]);
        let rate = f64x4::splat(1.0) / lanes(&self.over);
        let turned = times(lanes3(&self.turns), step(2));
        let rotation = if self.turns == [[0.0; LANES]; 3] {
            predicted.rotation
        } else {
            turned_by(turned, predicted.rotation)
        };
        let apart = lanes3(&self.apart);
        let moved = times(times(apart, step(0)), rate);
        let spun = times(turned, rate);
        let three = |[x, y, z]: [f64x4; 3], step: f64x4, limit: i32| {
            let on = |value: f64x4| clamped(floor(value / step + 0.5), limit);
            [on(x), on(y), on(z)]
        };
        let [px, py, pz] = three(predicted.position, step(1), POSITION_LIMIT);
        let mut linear = three(plus(predicted.linear, moved), step(3), VELOCITY_LIMIT);
        let mut angular = three(plus(predicted.angular, spun), step(4), VELOCITY_LIMIT);
        if self.has_velocity {
            let changed = |from: [f64x4; 3], by: &[[f64; LANES]; 3]| {
                let [x, y, z] = plus(from, lanes3(by));
                [x, y, z].map(|steps| clamped(steps, VELOCITY_LIMIT))
            };
            linear = changed(linear, &self.linear);
            angular = changed(angular, &self.angular);
        }
        let fine = |at: f64x4, by: f64x4| {
            integers(clamped(at + by * f64::from(FINE_STEPS), POSITION_LIMIT))
        };
        let [ax, ay, az] = apart;
        CorrectedX4 {
            len,
            position: [fine(px, ax), fine(py, ay), fine(pz, az)],
            rotation: PackedX4::of(rotation, len),
            linear: linear.map(integers),
            angular: angular.map(integers),
        }
    }
}

/// Corrected motions, as arrays by quantity and then by lane.
#[derive(Clone, Debug)]
pub struct CorrectedX4 {
    len: usize,
    position: [[u64; LANES]; 3],
    rotation: PackedX4,
    linear: [[u64; LANES]; 3],
    angular: [[u64; LANES]; 3],
}

impl CorrectedX4 {
    /// The number of bodies.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// True without any body: no batch is.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The motion of a body, by its place in the batch.
    ///
    /// # Panics
    ///
    /// If the batch has fewer bodies.
    #[must_use]
    #[inline(always)]
    pub fn at(&self, lane: usize) -> QuantisedState {
        assert!(lane < self.len, "the batch has this body");
        let lane = lane % LANES;
        let three = |of: &[[u64; LANES]; 3]| [0, 1, 2].map(|axis: usize| of[axis][lane] as i32);
        QuantisedState {
            position: three(&self.position),
            rotation: self.rotation.at(lane),
            linear: three(&self.linear),
            angular: three(&self.angular),
        }
    }
}

/// Rotations packed side by side.
#[derive(Clone, Debug)]
struct PackedX4 {
    largest: [u64; LANES],
    others: [[u64; LANES]; 3],
    /// One bit for each lane, set where the packing is a fixed point.
    stable: u32,
}

impl PackedX4 {
    /// As [`PackedRotation::of`] for unit quaternions: their smaller parts are far from the limits.
    #[inline(always)]
    fn of(rotation: [f64x4; 4], len: usize) -> Self {
        let [x, y, z, w] = rotation.map(|part| floor(part * PACKED_STEPS + 0.5));
        let most = x.abs();
        let second = y.abs().simd_gt(most);
        let most = most.fast_max(y.abs());
        let third = z.abs().simd_gt(most);
        let most = most.fast_max(z.abs());
        let fourth = w.abs().simd_gt(most);
        let from_third = third | fourth;
        let from_second = second | from_third;
        let largest = choose(fourth, w, choose(third, z, choose(second, y, x)));
        let sign = largest & f64x4::splat(-0.0);
        let a = choose(from_second, x, y) ^ sign;
        let b = choose(from_third, y, z) ^ sign;
        let c = choose(fourth, z, w) ^ sign;
        // As `PackedRotation::is_surely_stable`; all of these are whole and below 2⁴¹.
        let greatest = a.abs().fast_max(b.abs()).fast_max(c.abs()) + 1.0;
        let rest = f64x4::splat(PACKED_STEPS * PACKED_STEPS) - (a * a + b * b + c * c);
        let stable = rest.simd_ge(greatest * greatest);
        let one = f64x4::splat(1.0);
        let place = (from_second & one) + (from_third & one) + (fourth & one);
        Self {
            largest: integers(place),
            others: [integers(a), integers(b), integers(c)],
            stable: stable.to_bitmask() | u32::MAX << len.min(LANES),
        }
    }

    #[inline(always)]
    fn at(&self, lane: usize) -> PackedRotation {
        let others = [0, 1, 2].map(|place: usize| self.others[place][lane] as i32);
        let packed = PackedRotation::packed(self.largest[lane] as u8, others);
        if self.stable & 1 << lane != 0 {
            return packed;
        }
        packed.stable()
    }
}

/// Each times one factor.
#[inline(always)]
fn times([x, y, z]: [f64x4; 3], by: f64x4) -> [f64x4; 3] {
    [x * by, y * by, z * by]
}

/// Component by component.
#[inline(always)]
fn plus([x, y, z]: [f64x4; 3], [u, v, w]: [f64x4; 3]) -> [f64x4; 3] {
    [x + u, y + v, z + w]
}

/// Saturating at a limit. No value is NaN.
#[inline(always)]
fn clamped(value: f64x4, limit: i32) -> f64x4 {
    let limit = f64::from(limit);
    value
        .fast_max(f64x4::splat(-limit))
        .fast_min(f64x4::splat(limit))
}

/// Whole numbers below 2³¹, each in the low half of a word.
#[inline(always)]
fn integers(whole: f64x4) -> [u64; LANES] {
    // The sum has the number, in two's complement, in the low bits of its mantissa.
    (whole + ROUND).to_array().map(f64::to_bits)
}

fn numbers(steps: [i32; 3]) -> DVec3 {
    let [x, y, z] = steps;
    DVec3::new(f64::from(x), f64::from(y), f64::from(z))
}

/// Rotations, each turned by a rotation vector; a zero vector leaves its rotation as it is.
fn turned_by([x, y, z]: [f64x4; 3], rotation: [f64x4; 4]) -> [f64x4; 4] {
    let nothing = f64x4::splat(0.0);
    let angle = (x * x + y * y + z * z).sqrt();
    let (sine, cosine) = sin_cos(angle * 0.5);
    // For an angle of zero the vector is zero too, and is not normalised.
    let none = angle.simd_eq(nothing);
    let k = choose(none, nothing, sine / angle);
    let turned = normalised(product([x * k, y * k, z * k, cosine], rotation));
    let still = x.simd_eq(nothing) & y.simd_eq(nothing) & z.simd_eq(nothing);
    let kept = |place: usize| choose(still, rotation[place], turned[place]);
    [kept(0), kept(1), kept(2), kept(3)]
}

#[cfg(test)]
mod tests;
