//! Fast accept test: a cheap proof that a track is within tolerance.
//!
//! Not normative: [`Tolerance::share`] judges every track that this test leaves undecided. Invariant: an accepted
//! track is within the tolerance by that judgement. It works in f32, four moving bodies at a time, and subtracts its
//! worst error.

use alloc::vec::Vec;
use core::f32::consts::FRAC_1_PI;

use wide::f32x4;

use crate::exact;
use crate::free_motion::{Integrator, TRACK_AGE_MAX};
use crate::predictor::Conditions;
use crate::quantiser::{Grid, OTHERS};
use crate::tolerance::Tolerance;
use crate::track::{Anchor, BodyState, DenseTrack};
use crate::units::{Metres, Tick};

/// One body to test.
#[derive(Clone, Copy, Debug)]
pub struct PrefilterInput<'a> {
    /// True state at `tick`.
    pub truth: &'a BodyState,
    /// Track that subscribers predict from.
    pub track: &'a DenseTrack,
    /// Tick of the comparison.
    pub tick: Tick,
    /// Grid of the body in its stream.
    pub grid: &'a Grid,
    /// Radius of the least ball around the centre of mass that holds the body.
    pub radius: Metres,
    /// As [`Track::at`](crate::Track::at) takes them.
    pub conditions: &'a Conditions<'a>,
}

/// Separates tracks that are surely within tolerance from those that need the exact judgement.
#[derive(Clone, Debug)]
pub struct ErrorPrefilter {
    bounds: PrefilterBounds,
    /// Half a substep in seconds, and the number of substeps in a tick.
    half_substep: f32,
    substeps: f32,
    waiting: PrefilterX4,
}

impl ErrorPrefilter {
    /// A test for streams of this tolerance in scenes of this integrator.
    #[must_use]
    pub fn new(tolerance: Tolerance, integrator: Integrator) -> Self {
        let substeps = f64::from(integrator.substeps.get());
        let substep = integrator.rate.step().seconds() / substeps;
        Self {
            bounds: PrefilterBounds::of(tolerance),
            half_substep: (substep * 0.5) as f32,
            substeps: substeps as f32,
            waiting: PrefilterX4::default(),
        }
    }

    /// Tests a track; true if it is undecided. Moving bodies are tested together: this or a later call adds the places
    /// of undecided ones to `late`, in order.
    #[must_use]
    pub fn test(&mut self, place: u32, case: &PrefilterInput<'_>, late: &mut Vec<u32>) -> bool {
        let track = case.track;
        let elapsed = case.tick.since(track.origin());
        let (Some(elapsed), None) = (elapsed, track.parent()) else {
            return true;
        };
        let truth = case.truth.parts();
        let start = AnchorF32::of(&track.anchor(), case.grid);
        let diameter = self.bounds.diameter(case.radius);
        if track.is_resting() {
            let apart = |i: usize| (f64::from(truth[i]) - start.position[i]) as f32;
            let apart = [apart(0), apart(1), apart(2)];
            let holds = self
                .bounds
                .hold_still(apart, &truth, &start.rotation, diameter);
            return !holds;
        }
        let is_torque_free =
            track.predictor().is_torque_free() && case.conditions.inertia.is_some();
        if is_torque_free || elapsed > TRACK_AGE_MAX {
            return true;
        }
        let (row, _) = case.conditions.flow.row(elapsed);
        let pull = track.predictor().pull(elapsed, case.conditions);
        let (pull, fall) = match pull {
            Some(pull) => (pull.acceleration.to_array(), pull.fall),
            None => ([0.0; 3], 0.0),
        };
        let lane = self.waiting.len;
        let batch = &mut self.waiting;
        for i in 0..3 {
            let moved = start.linear[i] * row.reach + pull[i] * fall;
            let apart = f64::from(truth[i]) - (start.position[i] + moved);
            batch.apart[i][lane] = apart as f32;
            batch.spin[i][lane] = start.angular[i];
            batch.turns[i][lane] = row.turns[i] as f32;
        }
        for i in 0..4 {
            batch.truth[i][lane] = truth[3 + i];
            batch.start[i][lane] = start.rotation[i];
        }
        batch.diameter[lane] = diameter;
        batch.places[lane] = place;
        batch.len += 1;
        if batch.len == LANES {
            self.finish(late);
        }
        false
    }

    /// Finishes the batch that waits, and adds its undecided places.
    pub fn finish(&mut self, undecided: &mut Vec<u32>) {
        if self.waiting.len == 0 {
            return;
        }
        let within = self
            .waiting
            .hold(&self.bounds, self.half_substep, self.substeps);
        for lane in 0..self.waiting.len {
            if within & (1 << lane) == 0 {
                undecided.push(self.waiting.places[lane]);
            }
        }
        self.waiting.len = 0;
    }
}

/// Factor on a length, against the roundings of its comparison: 2⁻¹² is a thousand times a dozen of them.
const LENGTH_SLACK: f32 = 1.0 - 1.0 / 4_096.0;
/// Factor on a chord between quaternions: an exact start may be [`UNIT_LENGTH_SLACK`](crate::UNIT_LENGTH_SLACK) from
/// unit length. A point is at most |t − q| / |q| from the line through another.
const CHORD_FACTOR: f32 = 1.0 + 1.0 / 512.0;
/// Added to a chord. A packed rotation's greatest component is off by 2⁻²¹ in f32, sine and cosine by 4e-6 at a
/// quarter turn, and twenty roundings of numbers up to one by 1.2e-6: 6e-6 in all.
const CHORD_SLACK: f32 = 1.0 / 65_536.0;
/// Added to a chord for each radian of half the angle turned: a dozen roundings on the way to it are 7e-7 of it.
const ANGLE_SLACK: f32 = 1.0 / 524_288.0;

/// A tolerance in the numbers of this file.
#[derive(Clone, Copy, Debug)]
struct PrefilterBounds {
    /// Bound for the centre of mass and, of a surface tolerance, the chord at its radius: metres.
    length: f32,
    /// Bound for the sine of half the turn; two where the turn has no bound of its own.
    half_chord: f32,
    /// True if a turn counts as a length.
    shared: bool,
}

impl PrefilterBounds {
    fn of(tolerance: Tolerance) -> Self {
        match tolerance {
            Tolerance::Surface(length) => Self {
                length: length.metres().metres() as f32 * LENGTH_SLACK,
                half_chord: 2.0,
                shared: true,
            },
            Tolerance::Parts { position, turn } => {
                let half = turn.radians().radians() * 0.5;
                let any = half >= core::f64::consts::FRAC_PI_2;
                Self {
                    length: position.metres().metres() as f32 * LENGTH_SLACK,
                    half_chord: if any {
                        2.0
                    } else {
                        exact::sin_cos(half).0 as f32 * LENGTH_SLACK
                    },
                    shared: false,
                }
            }
        }
    }

    /// Length of half a chord of one, metres.
    fn diameter(&self, radius: Metres) -> f32 {
        if self.shared {
            2.0 * radius.metres() as f32
        } else {
            0.0
        }
    }

    /// True if a resting track surely holds: `apart` in metres, `truth` in the order of [`BodyState`].
    fn hold_still(
        &self,
        apart: [f32; 3],
        truth: &[f32; 13],
        start: &[f32; 4],
        diameter: f32,
    ) -> bool {
        let mut dot = 0.0;
        for i in 0..4 {
            dot += truth[3 + i] * start[i];
        }
        let sign = if dot < 0.0 { -1.0 } else { 1.0 };
        let mut chord2 = 0.0;
        for i in 0..4 {
            let off = truth[3 + i] - sign * start[i];
            chord2 += off * off;
        }
        let half = libm::sqrtf(chord2) * CHORD_FACTOR + CHORD_SLACK;
        let left = self.length - diameter * half;
        let far2 = apart[0] * apart[0] + apart[1] * apart[1] + apart[2] * apart[2];
        // Written so that NaN does not hold.
        half <= self.half_chord && left >= 0.0 && far2 <= left * left
    }
}

struct AnchorF32 {
    position: [f64; 3],
    linear: [f64; 3],
    angular: [f32; 3],
    /// Off by 2⁻²¹ at most, if the anchor is packed.
    rotation: [f32; 4],
}

impl AnchorF32 {
    #[inline(always)]
    fn of(anchor: &Anchor, grid: &Grid) -> Self {
        match anchor {
            Anchor::Exact(body_state) => {
                let p = body_state.parts();
                Self {
                    position: [f64::from(p[0]), f64::from(p[1]), f64::from(p[2])],
                    linear: [f64::from(p[7]), f64::from(p[8]), f64::from(p[9])],
                    angular: [p[10], p[11], p[12]],
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
                let angular = steps(quantised.angular, grid.angular());
                Self {
                    position: steps(quantised.position, grid.fine()),
                    linear: steps(quantised.linear, grid.linear()),
                    angular: [angular[0] as f32, angular[1] as f32, angular[2] as f32],
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

/// Up to four moving bodies, one array for each number.
#[derive(Clone, Debug, Default)]
struct PrefilterX4 {
    len: usize,
    places: [u32; LANES],
    /// Truth less the predicted position, metres.
    apart: [[f32; LANES]; 3],
    /// Spin of the track, rad/s.
    spin: [[f32; LANES]; 3],
    turns: [[f32; LANES]; 3],
    start: [[f32; LANES]; 4],
    truth: [[f32; LANES]; 4],
    diameter: [f32; LANES],
}

/// Added and taken away again, this rounds a number below 2²² to a whole one.
const ROUND: f32 = 12_582_912.0;
/// The first eight bits of pi, so that its multiples are exact, and the rest.
const PI_HIGH: f32 = 3.140_625;
const PI_LOW: f32 = 9.676_536e-4;
/// A faster spin needs more terms of the series than are taken: its body stays undecided.
const STEP_ANGLE2_MAX: f32 = 1.0 / 16.0;

impl PrefilterX4 {
    /// One bit for each body that surely is where its track predicts it (RECKONING 3.6, in f32).
    fn hold(&self, bounds: &PrefilterBounds, half_substep: f32, substeps: f32) -> u32 {
        let [wx, wy, wz] = three(&self.spin);
        let speed = (wx * wx + wy * wy + wz * wz).sqrt();
        let u = speed * half_substep;
        let u2 = u * u;
        let [s1, s3, s5] = three(&self.turns);
        let angle = (u * substeps) * (s1 - u2 * (s3 * (1.0 / 3.0) - u2 * (s5 * 0.2)));
        // Half a turn more is the same rotation with the other sign.
        let turns = (angle * FRAC_1_PI + ROUND) - ROUND;
        let (sine, cosine) = sin_cos((angle - turns * PI_HIGH) - turns * PI_LOW);
        let k = sine / speed.fast_max(f32x4::splat(1e-30));
        let (dx, dy, dz, dw) = (wx * k, wy * k, wz * k, cosine);
        let [qx, qy, qz, qw] = four(&self.start);
        let predicted_motion = [
            dw * qx + dx * qw + dy * qz - dz * qy,
            dw * qy - dx * qz + dy * qw + dz * qx,
            dw * qz + dx * qy - dy * qx + dz * qw,
            dw * qw - dx * qx - dy * qy - dz * qz,
        ];
        let truth = four(&self.truth);
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
        let slack = f32x4::splat(CHORD_SLACK) + angle * ANGLE_SLACK;
        let half = chord2.sqrt() * CHORD_FACTOR + slack;
        let left = f32x4::splat(bounds.length) - f32x4::from(self.diameter) * half;
        let [ax, ay, az] = three(&self.apart);
        let far2 = ax * ax + ay * ay + az * az;
        // Written so that NaN does not hold.
        let within = half.simd_le(f32x4::splat(bounds.half_chord))
            & left.simd_ge(f32x4::ZERO)
            & far2.simd_le(left * left)
            & u2.simd_le(f32x4::splat(STEP_ANGLE2_MAX));
        within.to_bitmask()
    }
}

fn three([a, b, c]: &[[f32; LANES]; 3]) -> [f32x4; 3] {
    let lanes = f32x4::from;
    [lanes(*a), lanes(*b), lanes(*c)]
}

fn four([a, b, c, d]: &[[f32; LANES]; 4]) -> [f32x4; 4] {
    let lanes = f32x4::from;
    [lanes(*a), lanes(*b), lanes(*c), lanes(*d)]
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
    use crate::units::{Radians, Rate, Ticks};

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
        let case = PrefilterInput {
            truth: &truth,
            track: &DenseTrack::new(track),
            tick,
            grid: &grid,
            radius,
            conditions: &conditions,
        };
        let mut undecided = Vec::new();
        let mut prefilter = ErrorPrefilter::new(tolerance, INTEGRATOR);
        let at_once = prefilter.test(7, &case, &mut undecided);
        prefilter.finish(&mut undecided);
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
