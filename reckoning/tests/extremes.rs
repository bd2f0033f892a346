//! Every valid encoding gives finite numbers; a rotation has one encoding.
//!
//! Proof by random cases over all bits of f32, all grids and all limits, and over rotations whose parts nearly tie.

use core::num::NonZeroU32;

use glam::{DQuat, DVec3};
use proptest::prelude::*;
use rhumb_reckoning::{
    BodyState, Conditions, Damping, Divergence, Grid, Inertia, Integrator, Metres, Motion,
    POSITION_LIMIT, PackedRotation, Pose, Predictor, QuantisedState, RESIDUAL_LIMIT, Rate,
    Residual, RotationCursor, StepCoefficientTable, TRACK_AGE_MAX, TURN_LIMIT, Ticks, Tolerance,
    VELOCITY_EXPONENT_MAX, VELOCITY_LIMIT, VelocityResidual, attached_motion, relative_to,
};

/// The predictors of one closed formula, and those that iterate every substep.
const FORMULAS: [Predictor; 3] = [Predictor::Rest, Predictor::Uniform, Predictor::Ballistic];
const ITERATIONS: [Predictor; 2] = [Predictor::TorqueFree, Predictor::BallisticTorqueFree];

fn single() -> impl Strategy<Value = f32> {
    use proptest::num::f32::{NEGATIVE, NORMAL, POSITIVE, SUBNORMAL, ZERO};
    POSITIVE | NEGATIVE | NORMAL | SUBNORMAL | ZERO
}

fn singles() -> impl Strategy<Value = [f32; 3]> {
    [single(), single(), single()]
}

fn rotation() -> impl Strategy<Value = DQuat> {
    proptest::array::uniform4(-1.0_f64..1.0)
        .prop_filter("too short to normalise", |q| {
            q.iter().map(|c| c * c).sum::<f64>() > 1e-3
        })
        .prop_map(|q| DQuat::from_array(q).normalize())
}

/// Two to four parts within three steps of each other, on half steps or between, at any place with any sign.
fn near_tie() -> impl Strategy<Value = DQuat> {
    let parts = proptest::array::uniform4((any::<bool>(), any::<bool>(), -6_i32..=6, 0.0_f64..0.5));
    (parts, 0.0_f64..0.9)
        .prop_filter("nothing ties", |(parts, _)| parts.iter().any(|p| p.0))
        .prop_map(|(parts, rest)| {
            let part = |(tied, positive, halves, between): (bool, bool, i32, f64)| {
                let size = if tied { 1.0 } else { rest };
                let near = size + (f64::from(halves) * 0.5 + between) / 524_288.0;
                if positive { near } else { -near }
            };
            DQuat::from_array(parts.map(part)).normalize()
        })
}

fn table() -> impl Strategy<Value = StepCoefficientTable> {
    table_of(u32::MAX)
}

fn table_of(substeps_most: u32) -> impl Strategy<Value = StepCoefficientTable> {
    let damping = (0.0..=f32::MAX, 0.0..=f32::MAX);
    (1..=u32::MAX, 1..=u32::MAX, 1..=substeps_most, damping).prop_map(
        |(ticks, seconds, substeps, (linear, angular))| {
            let integrator = Integrator {
                rate: Rate::new(ticks, seconds).expect("not zero"),
                substeps: NonZeroU32::new(substeps).expect("not zero"),
            };
            let mut table = StepCoefficientTable::new(integrator, Damping { linear, angular });
            table.extend_to(TRACK_AGE_MAX);
            table
        },
    )
}

fn grid() -> impl Strategy<Value = Grid> {
    (1_000_u32..=10_000_000, 1e-4_f64..1e5).prop_map(|(micrometres, radius)| {
        let tolerance = Tolerance::from_micrometres(micrometres).expect("within bounds");
        Grid::new(tolerance, Metres::new(radius))
    })
}

fn steps(limit: i32) -> impl Strategy<Value = [i32; 3]> {
    let one = prop_oneof![Just(-limit), -limit..=limit, Just(limit)];
    proptest::array::uniform3(one)
}

fn quantised() -> impl Strategy<Value = QuantisedState> {
    let velocities = (steps(VELOCITY_LIMIT), steps(VELOCITY_LIMIT));
    (steps(POSITION_LIMIT), rotation(), velocities).prop_map(
        |(position, rotation, (linear, angular))| QuantisedState {
            position,
            rotation: PackedRotation::of(rotation),
            linear,
            angular,
        },
    )
}

fn residual() -> impl Strategy<Value = Residual> {
    let velocities = (0..=VELOCITY_EXPONENT_MAX).prop_flat_map(|velocity_exponent| {
        let limit = VELOCITY_LIMIT >> velocity_exponent;
        (steps(limit), steps(limit)).prop_map(move |(linear, angular)| VelocityResidual {
            velocity_exponent,
            linear,
            angular,
        })
    });
    let velocities = proptest::option::of(velocities);
    (steps(RESIDUAL_LIMIT), steps(TURN_LIMIT), velocities).prop_map(
        |(position, turn, velocities)| Residual {
            position,
            turn,
            velocity: velocities,
        },
    )
}

fn rate() -> impl Strategy<Value = Rate> {
    let edge = || prop_oneof![Just(1), 1..=u32::MAX, Just(u32::MAX)];
    (edge(), edge()).prop_map(|(ticks, seconds)| Rate::new(ticks, seconds).expect("not zero"))
}

/// Gravity as RECKONING 2.5 has it.
fn pull() -> impl Strategy<Value = DVec3> {
    (singles(), single()).prop_map(|(scene, scale)| {
        DVec3::from_array(scene.map(|part| f64::from(part) * f64::from(scale)))
    })
}

/// Moments as far apart and as great or small as they may be, about any axes.
fn inertia() -> impl Strategy<Value = Inertia> {
    let share = || prop_oneof![Just(1.0_f32), 1.0_f32..16_777_216.0, Just(16_777_216.0)];
    let least = prop_oneof![Just(f32::MIN_POSITIVE), 1e-30_f32..1e30];
    (least, [share(), share(), share()], rotation()).prop_map(|(least, shares, frame)| {
        let moments = shares.map(|share| least * share);
        Inertia::new(moments, frame.to_array().map(|part| part as f32)).expect("within bounds")
    })
}

fn is_a_motion(motion: &Motion) -> bool {
    let length = motion.pose().rotation.length();
    Motion::new(motion.pose(), motion.twist()).is_ok() && (length - 1.0).abs() < 1e-15
}

proptest! {
    #[test]
    fn a_prediction_from_any_exact_state_is_a_motion(
        position in singles(), turned in rotation(), linear in singles(), angular in singles(),
        table in table(), pull in pull(), elapsed in 0_u32..1_100,
    ) {
        let rotation = turned.to_array().map(|part| part as f32);
        let start = BodyState::new(position, rotation, linear, angular).unwrap().motion();
        let conditions = Conditions { gravity: pull, flow: &table, inertia: None };
        for predictor in FORMULAS {
            let end = predictor.predict(&start, Ticks::new(elapsed), &conditions);
            prop_assert!(is_a_motion(&end), "{end:?}");
        }
    }

    #[test]
    fn a_prediction_from_any_quantised_motion_is_valid_and_encodable(
        anchor in quantised(), residual in residual(), rate in rate(), grid in grid(), table in table(), pull in pull(),
        elapsed in 0_u32..1_100,
    ) {
        let conditions = Conditions { gravity: pull, flow: &table, inertia: None };
        for predictor in FORMULAS {
            let end = predictor.predict(&anchor.motion(&grid), Ticks::new(elapsed), &conditions);
            prop_assert!(is_a_motion(&end), "{end:?}");
            let over = predictor.divergence_time(Ticks::new(elapsed), rate);
            for coded in [QuantisedState::of(&end, &grid), residual.onto(&end, over, &grid)] {
                prop_assert!(coded.is_within_limits());
                prop_assert!(is_a_motion(&coded.motion(&grid)));
                prop_assert_eq!(QuantisedState::of(&coded.motion(&grid), &grid), coded);
            }
        }
    }

    #[test]
    fn attached_motion_is_valid_and_encodable(
        positions in [singles(), singles()], turned in [rotation(), rotation()],
        linear in singles(), angular in singles(),
        grid in grid(),
    ) {
        let [parent, body] = [0, 1].map(|i: usize| {
            let rotation = turned[i].to_array().map(|part| part as f32);
            BodyState::new(positions[i], rotation, linear, angular).unwrap().motion()
        });
        let relative = relative_to(&parent.pose(), &body.pose());
        let coded = QuantisedState::of(&relative, &grid);
        prop_assert!(coded.is_within_limits());
        for attached in [relative, coded.motion(&grid)] {
            prop_assert!(is_a_motion(&attached), "{attached:?}");
            let again = attached_motion(&parent, &attached.pose());
            prop_assert!(is_a_motion(&again), "{again:?}");
        }
    }

    #[test]
    fn torque_free_prediction_is_valid_with_any_cursor(
        turned in rotation(), linear in singles(), angular in singles(), quantised in quantised(), grid in grid(),
        table in table_of(16), inertia in inertia(), pull in pull(),
        ticks in proptest::collection::vec(0_u32..1_100, 1..5),
    ) {
        let rotation = turned.to_array().map(|part| part as f32);
        let body_state = BodyState::new([0.0; 3], rotation, linear, angular).unwrap().motion();
        let conditions = Conditions { gravity: pull, flow: &table, inertia: Some(&inertia) };
        let mut cursor = RotationCursor::default();
        for start in [body_state, quantised.motion(&grid)] {
            for elapsed in ticks.iter().copied().map(Ticks::new) {
                for predictor in ITERATIONS {
                    let end = predictor.predict(&start, elapsed, &conditions);
                    prop_assert!(is_a_motion(&end), "{end:?}");
                    let kept = predictor.predict_with(&start, elapsed, &conditions, &mut cursor);
                    prop_assert_eq!(format!("{end:?}"), format!("{kept:?}"));
                }
            }
        }
    }

    #[test]
    fn a_packed_near_tie_is_accepted_back(q in near_tie()) {
        let packed = PackedRotation::of(q);
        let (largest, others) = packed.parts();
        prop_assert_eq!(PackedRotation::from_parts(largest, others), Some(packed));
        prop_assert_eq!(PackedRotation::of(packed.value()), packed);
        let pose = |rotation| Pose { position: DVec3::ZERO, rotation };
        let turn = Divergence::between(&pose(q), &pose(packed.value())).turn();
        prop_assert!(turn.radians() < 9.4e-6, "{turn}");
    }

    #[test]
    fn decoded_parts_are_a_rotation(largest in 0_u8..4, others in steps(PackedRotation::LIMIT)) {
        if let Some(packed) = PackedRotation::from_parts(largest, others) {
            prop_assert_eq!(PackedRotation::of(packed.value()), packed);
            prop_assert!((packed.value().length() - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn the_opposite_twist_moves_the_opposite_way(
        turned in rotation(), linear in singles(), angular in singles(), elapsed in 0_u32..1_100, table in table(),
    ) {
        let rotation = turned.to_array().map(|part| part as f32);
        let start = |linear, angular| BodyState::new([0.0; 3], rotation, linear, angular).unwrap().motion();
        let conditions = Conditions { gravity: DVec3::ZERO, flow: &table, inertia: None };
        let end = |start: Motion| Predictor::Uniform.predict(&start, Ticks::new(elapsed), &conditions);
        let there = end(start(linear, angular));
        let back = end(start(linear.map(|part| -part), angular.map(|part| -part)));
        prop_assert_eq!(there.pose().position, -back.pose().position);
        prop_assert_eq!(there.twist().angular, -back.twist().angular);
    }
}
