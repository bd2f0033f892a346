//! Fast accept test: a cheap proof that a track is within tolerance.
//!
//! Not normative: [`Tolerance::share`] judges every track that this test leaves undecided. Invariant: an accepted
//! track is within the tolerance by that judgement. It works in f32, four bodies at a time, and subtracts its worst
//! error. Terms that depend on the track alone are computed once for each track.

use alloc::vec::Vec;
use core::f32::consts::FRAC_1_PI;

use wide::f32x4;

use crate::exact;
use crate::free_motion::{Integrator, StepCoefficientTable, TRACK_AGE_MAX};
use crate::predictor::{ACCELERATION_TICKS, Conditions, Predictor};
use crate::quantiser::{Grid, OTHERS};
use crate::tolerance::Tolerance;
use crate::track::{Anchor, BodyState, DenseTrack};
use crate::units::{Metres, Ticks};

/// The numbers of a body, beside its track, that a prediction and its judgement need.
#[derive(Clone, Copy, Debug)]
pub struct PrefilterBody<'a> {
    /// Tolerance of the body in its stream.
    pub tolerance: Tolerance,
    /// Grid of the body in its stream.
    pub grid: &'a Grid,
    /// Radius of the least ball around the centre of mass that holds the body.
    pub radius: Metres,
    /// As [`Track::at`](crate::Track::at) takes them.
    pub conditions: &'a Conditions<'a>,
}

/// The motion of a track after its origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TrackCourse {
    Still,
    Free,
    /// Under a constant acceleration, which ends.
    Accelerated,
}

/// A track in the numbers of this test, by rows that four bodies turn into columns.
#[derive(Clone, Copy, Debug)]
pub struct PrefilterTrack {
    /// Position, metres; length of half a chord of one, metres.
    start: [f32; 4],
    /// Linear velocity, m/s; the greatest distance, metres.
    linear: [f32; 4],
    /// Axis of the spin, of unit length; half the angle turned in an undamped tick but for the series, radians.
    spin: [f32; 4],
    /// Acceleration, m/s²; the square of the tangent of half the angle turned in a substep.
    pull: [f32; 4],
    /// Off by 2⁻²¹ at most, if the anchor is packed.
    rotation: [f32; 4],
    course: TrackCourse,
}

/// One body to test.
#[derive(Clone, Copy, Debug)]
pub struct PrefilterInput<'a> {
    /// True state at the tick of the comparison.
    pub truth: &'a BodyState,
    /// Track that subscribers predict from.
    pub track: &'a PrefilterTrack,
    /// Age of the track at that tick.
    pub age: Ticks,
    /// The table of the body's damping.
    pub flow: &'a StepCoefficientTable,
}

/// Separates tracks that are surely within tolerance from those that need the exact judgement.
#[derive(Clone, Debug)]
pub struct ErrorPrefilter {
    tolerance: Tolerance,
    /// Bound for the sine of half the turn; two where the turn has no bound of its own.
    half_chord: f32,
    /// Half a substep in seconds, and the number of substeps in a tick.
    half_substep: f64,
    substeps: f64,
}

impl ErrorPrefilter {
    /// A test for streams of this tolerance in scenes of this integrator.
    #[must_use]
    pub fn new(tolerance: Tolerance, integrator: Integrator) -> Self {
        let substeps = f64::from(integrator.substeps.get());
        let substep = integrator.rate.step().seconds() / substeps;
        Self {
            tolerance,
            half_chord: half_chord(tolerance),
            half_substep: substep * 0.5,
            substeps,
        }
    }

    /// The track of a body in the numbers of this test; `None` if only the exact judgement can compare it.
    #[must_use]
    pub fn track(&self, track: &DenseTrack, body: &PrefilterBody<'_>) -> Option<PrefilterTrack> {
        let predictor = track.predictor();
        let is_torque_free = predictor.is_torque_free() && body.conditions.inertia.is_some();
        let (length, diameter) = match body.tolerance {
            Tolerance::Surface(length) => (length, 2.0 * body.radius.metres()),
            // The test has one bound for turns.
            Tolerance::Parts { .. } if body.tolerance != self.tolerance => return None,
            Tolerance::Parts { position, .. } => (position, 0.0),
        };
        if track.parent().is_some() || is_torque_free {
            return None;
        }
        let course = match predictor {
            Predictor::Rest => TrackCourse::Still,
            Predictor::Accelerated(_) => TrackCourse::Accelerated,
            _ => TrackCourse::Free,
        };
        let start = AnchorValues::of(&track.anchor(), body.grid);
        let [x, y, z] = start.position;
        let off = (x.abs() + y.abs() + z.abs()) * f64::from(POSITION_SLACK);
        let length = length.metres().metres() * f64::from(LENGTH_SLACK) - off;
        let moves = if course == TrackCourse::Still {
            0.0
        } else {
            1.0
        };
        let [p, q, r] = start.angular;
        let speed = exact::sqrt(p * p + q * q + r * r) * moves;
        let tangent = speed * self.half_substep;
        let axis = if speed > 0.0 { 1.0 / speed } else { 0.0 };
        let pull = match predictor.acceleration() {
            Some(acceleration) => acceleration.acceleration(),
            None if predictor.falls() => body.conditions.gravity,
            None => glam::DVec3::ZERO,
        };
        Some(PrefilterTrack {
            start: row(start.position, 1.0, diameter),
            linear: row(start.linear, moves, length),
            spin: row(start.angular, axis, tangent * self.substeps),
            pull: row(pull.to_array(), 1.0, tangent * tangent),
            rotation: start.rotation,
            course,
        })
    }

    /// A batch of tests.
    #[must_use]
    pub const fn batch<'a>(&self) -> PrefilterBatch<'a> {
        PrefilterBatch {
            half_chord: self.half_chord,
            lanes: None,
            len: 0,
        }
    }
}

/// Bodies that are tested together, four at a time.
#[derive(Clone, Debug)]
pub struct PrefilterBatch<'a> {
    half_chord: f32,
    /// The first `len` lanes wait. The others repeat a body that was tested before.
    lanes: Option<[PrefilterLane<'a>; LANES]>,
    len: usize,
}

/// A body that waits for others.
#[derive(Clone, Copy, Debug)]
struct PrefilterLane<'a> {
    place: u32,
    truth: &'a BodyState,
    track: &'a PrefilterTrack,
    /// See [`StepCoefficientTable::narrow_row`].
    coefficients: [f32; 4],
}

impl<'a> PrefilterBatch<'a> {
    /// Tests a track; true if it is undecided. Bodies are tested together: this or a later call adds the places of
    /// undecided ones to `late`, in order.
    #[must_use]
    #[inline]
    pub fn test(&mut self, place: u32, case: &PrefilterInput<'a>, late: &mut Vec<u32>) -> bool {
        let track = case.track;
        // A moving body gets an update at this age.
        if track.course != TrackCourse::Still && case.age >= TRACK_AGE_MAX {
            return true;
        }
        let mut coefficients = case.flow.narrow_row(case.age);
        if track.course == TrackCourse::Accelerated {
            let (fall, _) = case.flow.ended(case.age, ACCELERATION_TICKS);
            coefficients[1] = fall as f32;
        }
        let lane = PrefilterLane {
            place,
            truth: case.truth,
            track,
            coefficients,
        };
        match &mut self.lanes {
            // Already below: the remainder lets the compiler drop the bounds check.
            Some(lanes) => lanes[self.len % LANES] = lane,
            none => *none = Some([lane; LANES]),
        }
        self.len += 1;
        if self.len == LANES {
            self.finish(late);
        }
        false
    }

    /// Finishes the batch that waits, and adds its undecided places.
    pub fn finish(&mut self, undecided: &mut Vec<u32>) {
        let Some(lanes) = &self.lanes else {
            return;
        };
        let within = hold(lanes, self.half_chord);
        for (number, lane) in lanes.iter().enumerate().take(self.len) {
            if within & (1 << number) == 0 {
                undecided.push(lane.place);
            }
        }
        self.len = 0;
    }
}

/// Factor on a length, against the roundings of its comparison: 2⁻¹² is a thousand times a dozen of them.
const LENGTH_SLACK: f32 = 1.0 - 1.0 / 4_096.0;
/// Taken off a length for each metre of the start, of the way and of the fall along each axis: at most five roundings,
/// each 2⁻²⁴ of it.
const POSITION_SLACK: f32 = 1.0 / 2_097_152.0;
/// Factor on a chord between quaternions: an exact start may be [`UNIT_LENGTH_SLACK`](crate::UNIT_LENGTH_SLACK) from
/// unit length. A point is at most |t − q| / |q| from the line through another.
const CHORD_FACTOR: f32 = 1.0 + 1.0 / 512.0;
/// Added to a chord. A packed rotation's greatest component is off by 2⁻²¹ in f32, sine and cosine by 4e-6 at a
/// quarter turn, and twenty roundings of numbers up to one by 1.2e-6: 6e-6 in all.
const CHORD_SLACK: f32 = 1.0 / 65_536.0;
/// Added to a chord for each radian of half the angle turned: a dozen roundings on the way to it are 7e-7 of it.
const ANGLE_SLACK: f32 = 1.0 / 524_288.0;

/// Bound for the sine of half the turn, of a tolerance of two parts.
fn half_chord(tolerance: Tolerance) -> f32 {
    let Tolerance::Parts { turn, .. } = tolerance else {
        return 2.0;
    };
    let half = turn.radians().radians() * 0.5;
    if half >= core::f64::consts::FRAC_PI_2 {
        return 2.0;
    }
    exact::sin_cos(half).0 as f32 * LENGTH_SLACK
}

/// Three numbers times a factor, and a fourth.
fn row([x, y, z]: [f64; 3], factor: f64, fourth: f64) -> [f32; 4] {
    [
        (x * factor) as f32,
        (y * factor) as f32,
        (z * factor) as f32,
        fourth as f32,
    ]
}

struct AnchorValues {
    position: [f64; 3],
    linear: [f64; 3],
    angular: [f64; 3],
    /// Off by 2⁻²¹ at most, if the anchor is packed.
    rotation: [f32; 4],
}

impl AnchorValues {
    fn of(anchor: &Anchor, grid: &Grid) -> Self {
        match anchor {
            Anchor::Exact(body_state) => {
                let p = body_state.parts();
                let three = |at: usize| [p[at], p[at + 1], p[at + 2]].map(f64::from);
                Self {
                    position: three(0),
                    linear: three(7),
                    angular: three(10),
                    rotation: [p[3], p[4], p[5], p[6]],
                }
            }
            Anchor::Quantised(quantised) => {
                let (largest, [a, b, c]) = quantised.rotation.parts();
                let part = |steps: i32| steps as f32 * (1.0 / 524_288.0);
                let (a, b, c) = (part(a), part(b), part(c));
                let rest = 1.0 - (a * a + b * b + c * c);
                let largest = usize::from(largest & 3);
                let [first, second, third] = OTHERS[largest];
                let mut rotation = [0.0; 4];
                rotation[largest] = libm::sqrtf(rest.max(0.0));
                rotation[first] = a;
                rotation[second] = b;
                rotation[third] = c;
                Self {
                    position: steps(quantised.position, grid.fine()),
                    linear: steps(quantised.linear, grid.linear()),
                    angular: steps(quantised.angular, grid.angular()),
                    rotation,
                }
            }
        }
    }
}

fn steps([a, b, c]: [i32; 3], step: f64) -> [f64; 3] {
    [
        f64::from(a) * step,
        f64::from(b) * step,
        f64::from(c) * step,
    ]
}

const LANES: usize = 4;

/// Added and taken away again, this rounds a number below 2²² to a whole one.
const ROUND: f32 = 12_582_912.0;
/// The first eight bits of pi, so that its multiples are exact, and the rest.
const PI_HIGH: f32 = 3.140_625;
const PI_LOW: f32 = 9.676_536e-4;
/// A faster spin needs more terms of the series than are taken: its body stays undecided.
const STEP_ANGLE2_MAX: f32 = 1.0 / 16.0;

/// One bit for each body that surely is where its track predicts it (RECKONING 3.6, in f32).
fn hold(lanes: &[PrefilterLane<'_>; LANES], half_chord: f32) -> u32 {
    let [reach, fall, turns, cubes] = columns(lanes, |lane| lane.coefficients);
    let [px, py, pz, tangent2] = columns(lanes, |lane| lane.track.pull);
    let half = half_chords(lanes, [turns, cubes, tangent2]);
    let [sx, sy, sz, diameter] = columns(lanes, |lane| lane.track.start);
    let [lx, ly, lz, length] = columns(lanes, |lane| lane.track.linear);
    let [tx, ty, tz, _] = columns(lanes, |lane| lane.truth.first_parts());
    let moved = [lx * reach, ly * reach, lz * reach];
    let fallen = [px * fall, py * fall, pz * fall];
    let mut way = f32x4::ZERO;
    let mut far2 = f32x4::ZERO;
    for (axis, apart) in [tx - sx, ty - sy, tz - sz].into_iter().enumerate() {
        let off = (apart - moved[axis]) - fallen[axis];
        far2 += off * off;
        way += moved[axis].abs() + fallen[axis].abs();
    }
    let left = (length - diameter * half) - way * POSITION_SLACK;
    // Written so that NaN does not hold.
    let within = half.simd_le(f32x4::splat(half_chord))
        & left.simd_ge(f32x4::ZERO)
        & far2.simd_le(left * left)
        & tangent2.simd_le(f32x4::splat(STEP_ANGLE2_MAX));
    within.to_bitmask()
}

/// Bounds on half the chord between the true and the predicted rotation.
///
/// `turns`, `cubes`: see [`StepCoefficientTable::narrow_row`]. `tangent2`: see [`PrefilterTrack::pull`].
#[inline]
fn half_chords(lanes: &[PrefilterLane<'_>; LANES], [turns, cubes, tangent2]: [f32x4; 3]) -> f32x4 {
    let [ax, ay, az, tick] = columns(lanes, |lane| lane.track.spin);
    let angle = tick * (turns - tangent2 * cubes);
    // Half a turn more is the same rotation with the other sign.
    let half_turns = (angle * FRAC_1_PI + ROUND) - ROUND;
    let (k, dw) = sin_cos((angle - half_turns * PI_HIGH) - half_turns * PI_LOW);
    let (dx, dy, dz) = (ax * k, ay * k, az * k);
    let [qx, qy, qz, qw] = columns(lanes, |lane| lane.track.rotation);
    let predicted_motion = [
        dw * qx + dx * qw + dy * qz - dz * qy,
        dw * qy - dx * qz + dy * qw + dz * qx,
        dw * qz + dx * qy - dy * qx + dz * qw,
        dw * qw - dx * qx - dy * qy - dz * qz,
    ];
    let truth = columns(lanes, |lane| lane.truth.rotation());
    let mut dot = f32x4::ZERO;
    for i in 0..4 {
        dot += truth[i] * predicted_motion[i];
    }
    // One, less two where the product is negative.
    let sign = f32x4::ONE - (dot.simd_lt(f32x4::ZERO) & f32x4::splat(2.0));
    let mut chord2 = f32x4::ZERO;
    for i in 0..4 {
        let off = truth[i] - sign * predicted_motion[i];
        chord2 += off * off;
    }
    // The last term of the series, which is not taken, is at most this share of the first one.
    let cut = tangent2 * tangent2 * 0.2;
    let slack = f32x4::splat(CHORD_SLACK) + tick * turns * (cut + ANGLE_SLACK);
    chord2.sqrt() * CHORD_FACTOR + slack
}

/// A row of each body, as columns.
#[inline(always)]
fn columns<'a>(
    lanes: &'a [PrefilterLane<'_>; LANES],
    row: impl Fn(&'a PrefilterLane<'_>) -> [f32; 4],
) -> [f32x4; 4] {
    let [a, b, c, d] = lanes;
    let lane = |lane| f32x4::new(row(lane));
    f32x4::transpose([lane(a), lane(b), lane(c), lane(d)])
}

/// Sine and cosine up to a quarter turn either way, by their Taylor series: off by 3.7e-6 and 5e-7 at most.
fn sin_cos(x: f32x4) -> (f32x4, f32x4) {
    let x2 = x * x;
    let series = |coefficients: [f32; 5]| {
        let mut sum = f32x4::ZERO;
        for c in coefficients {
            sum = sum * x2 + c;
        }
        sum
    };
    let sine = series([
        1.0 / 362_880.0,
        -1.0 / 5_040.0,
        1.0 / 120.0,
        -1.0 / 6.0,
        1.0,
    ]);
    let cosine = series([
        -1.0 / 3_628_800.0,
        1.0 / 40_320.0,
        -1.0 / 720.0,
        1.0 / 24.0,
        -1.0 / 2.0,
    ]);
    (x * sine, cosine * x2 + 1.0)
}

#[cfg(test)]
mod tests {
    use core::num::NonZeroU32;

    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    use super::*;
    use crate::free_motion::{Damping, StepCoefficientTable};
    use crate::motion::{Divergence, Motion, Pose, Twist};
    use crate::predictor::{ConstantAcceleration, Predictor};
    use crate::quantiser::QuantisedState;
    use crate::track::Track;
    use crate::units::{Radians, Rate, Tick, Ticks};

    const INTEGRATOR: Integrator = Integrator {
        rate: Rate::HZ_60,
        substeps: match NonZeroU32::new(4) {
            Some(four) => four,
            None => panic!("four is not zero"),
        },
    };

    fn table(damping: Damping) -> StepCoefficientTable {
        let mut table = StepCoefficientTable::new(INTEGRATOR, damping);
        table.extend_to(TRACK_AGE_MAX);
        table
    }

    fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
        (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    fn motion() -> impl Strategy<Value = Motion> {
        let far = prop_oneof![vector(3.0), vector(3e4)];
        let spin = prop_oneof![Just(DVec3::ZERO), vector(5.0), vector(60.0), vector(1e4)];
        (far, vector(3.0), vector(30.0), spin).prop_map(|(position, turn, linear, angular)| {
            let rotation = DQuat::from_scaled_axis(turn);
            Motion::new(Pose { position, rotation }, Twist { linear, angular }).unwrap()
        })
    }

    fn body_state(motion: &Motion, length: f32) -> BodyState {
        let (pose, twist) = (motion.pose(), motion.twist());
        BodyState::new(
            pose.position.as_vec3().to_array(),
            pose.rotation.as_quat().to_array().map(|part| part * length),
            twist.linear.as_vec3().to_array(),
            twist.angular.as_vec3().to_array(),
        )
        .unwrap()
    }

    fn tolerance() -> impl Strategy<Value = Tolerance> {
        let length = prop_oneof![0.001_f64..0.02, 0.02_f64..0.3];
        (length, proptest::option::of(0.0001_f64..3.13)).prop_map(|(length, turn)| match turn {
            None => Tolerance::from_metres(Metres::new(length)).unwrap(),
            Some(turn) => Tolerance::parts(Metres::new(length), Radians::new(turn)).unwrap(),
        })
    }

    struct PrefilterAnswer {
        undecided: bool,
        share: f64,
    }

    /// `off`: truth beside the prediction, as shares of what the tolerance allows a body of this radius.
    fn ask(
        tolerance: Tolerance,
        radius: f64,
        track: &Track,
        age: u32,
        off: [DVec3; 2],
        length: f32,
        damping: Damping,
    ) -> PrefilterAnswer {
        let radius = Metres::new(radius);
        let grid = Grid::new(tolerance, radius);
        let flow = table(damping);
        let gravity = if track.predictor.falls() {
            DVec3::new(0.3, -9.8, 0.1)
        } else {
            DVec3::ZERO
        };
        let conditions = Conditions {
            gravity,
            flow: &flow,
            inertia: None,
        };
        let tick = track.origin + Ticks::new(age);
        let predicted_motion = track.at(tick, &grid, &conditions).pose();
        let reach = tolerance.reach(radius).metres();
        let turn = DQuat::from_scaled_axis(off[1] * (reach / radius.metres()).min(3.0));
        let truth = Pose {
            position: predicted_motion.position + off[0] * reach,
            rotation: turn * predicted_motion.rotation,
        };
        let truth = Motion::new(truth, Twist::ZERO).unwrap();
        let truth = body_state(&truth, length);
        let apart = Divergence::between(&truth.motion().pose(), &predicted_motion);
        let body = PrefilterBody {
            tolerance,
            grid: &grid,
            radius,
            conditions: &conditions,
        };
        let mut undecided = Vec::new();
        let prefilter = ErrorPrefilter::new(tolerance, INTEGRATOR);
        let tested = prefilter.track(&DenseTrack::new(track), &body);
        let mut batch = prefilter.batch();
        let at_once = tested.as_ref().is_none_or(|track| {
            let case = PrefilterInput {
                truth: &truth,
                track,
                age: Ticks::new(age),
                flow: &flow,
            };
            batch.test(7, &case, &mut undecided)
        });
        batch.finish(&mut undecided);
        PrefilterAnswer {
            undecided: at_once || undecided == [7],
            share: tolerance.share(&apart, radius),
        }
    }

    fn anchors(start: &Motion, grid: &Grid, length: f32) -> [Anchor; 2] {
        [
            Anchor::Quantised(QuantisedState::of(start, grid)),
            Anchor::Exact(body_state(start, length)),
        ]
    }

    /// Accelerated tracks start on their grid.
    fn may_begin(predictor: Predictor, anchor: &Anchor) -> bool {
        predictor.acceleration().is_none() || matches!(anchor, Anchor::Quantised(_))
    }

    const PREDICTORS: [Predictor; 5] = [
        Predictor::Rest,
        Predictor::Uniform,
        Predictor::Ballistic,
        Predictor::BallisticTorqueFree,
        Predictor::Accelerated(ConstantAcceleration::SAMPLE),
    ];

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]

        #[test]
        fn accepted_tracks_are_within_tolerance(
            start in motion(), tolerance in tolerance(), radius in prop_oneof![0.01_f64..2.0, 2.0_f64..150.0],
            age in prop_oneof![0_u32..20, 0_u32..1_023], off in [vector(1.0), vector(1.0)], scale in 0.0_f64..1.2,
            length in prop_oneof![Just(1.0_f32), 0.9991_f32..1.0009], damping in [0.0_f32..1.0, 0.0_f32..1.0],
        ) {
            let grid = Grid::new(tolerance, Metres::new(radius));
            let [linear, angular] = damping;
            for anchor in anchors(&start, &grid, length) {
                for predictor in PREDICTORS.into_iter().filter(|predictor| may_begin(*predictor, &anchor)) {
                    let track = Track { origin: Tick::new(5), predictor, anchor, parent: None };
                    let off = off.map(|off| off * scale);
                    let asked = ask(tolerance, radius, &track, age, off, length, Damping { linear, angular });
                    prop_assert!(asked.undecided || asked.share <= 1.0, "{predictor:?} {}", asked.share);
                }
            }
        }

        #[test]
        fn small_errors_are_accepted(
            position in vector(100.0), turn in vector(3.0), linear in vector(30.0), angular in vector(20.0),
            age in 0_u32..300, off in [vector(0.57), vector(0.57)], scale in 0.0_f64..0.45,
        ) {
            let rotation = DQuat::from_scaled_axis(turn);
            let start = Motion::new(Pose { position, rotation }, Twist { linear, angular }).unwrap();
            let (tolerance, radius) = (Tolerance::EXACT, 0.5);
            let grid = Grid::new(tolerance, Metres::new(radius));
            for anchor in anchors(&start, &grid, 1.0) {
                for predictor in PREDICTORS.into_iter().filter(|predictor| may_begin(*predictor, &anchor)) {
                    let track = Track { origin: Tick::new(5), predictor, anchor, parent: None };
                    let off = off.map(|off| off * scale);
                    let asked = ask(tolerance, radius, &track, age, off, 1.0, Damping::default());
                    prop_assert!(asked.share < 0.93);
                    prop_assert!(!asked.undecided, "{predictor:?} {}", asked.share);
                }
            }
        }
    }

    #[test]
    fn unsupported_cases_are_undecided() {
        let start = Motion::new(
            Pose::IDENTITY,
            Twist {
                linear: DVec3::ZERO,
                angular: DVec3::X * 1e5,
            },
        );
        let anchor = Anchor::Exact(body_state(&start.unwrap(), 1.0));
        let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
        let track = |predictor, anchor, parent| Track {
            origin: Tick::new(5),
            predictor,
            anchor,
            parent,
        };
        let attached = Anchor::Quantised(QuantisedState::of(&Motion::IDENTITY, &grid));
        for track in [
            track(Predictor::Uniform, anchor, None),
            track(
                Predictor::Rest,
                attached,
                Some(crate::motion::BodyId::new(3, 0)),
            ),
        ] {
            let none = [DVec3::ZERO; 2];
            let asked = ask(
                Tolerance::NORMAL,
                0.5,
                &track,
                3,
                none,
                1.0,
                Damping::default(),
            );
            assert!(asked.undecided);
        }
    }
}
