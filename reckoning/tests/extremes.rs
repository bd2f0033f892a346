//! Whatever can be said leads to numbers, and every rotation has one encoding.
//!
//! Proof by random cases over all bits of f32, all grids and all limits, and over rotations whose parts nearly tie.

use core::num::NonZeroU32;

use glam::{DQuat, DVec3};
use proptest::prelude::*;
use rhumb_reckoning::{
    Damping, Divergence, FlowTable, Grid, HORIZON, Integrator, Metres, Motion, POSITION_LIMIT,
    PackedRotation, Pose, Predictor, Rate, Residual, Snapped, TURN_LIMIT, Ticks, Tolerance,
    VELOCITY_LIMIT, Verbatim,
};

const LAWS: [Predictor; 3] = [Predictor::Rest, Predictor::Uniform, Predictor::Ballistic];

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

fn table() -> impl Strategy<Value = FlowTable> {
    let damping = (0.0..=f32::MAX, 0.0..=f32::MAX);
    (1..=u32::MAX, 1..=u32::MAX, 1..=u32::MAX, damping).prop_map(
        |(ticks, seconds, substeps, (linear, angular))| {
            let integrator = Integrator {
                rate: Rate::new(ticks, seconds).expect("not zero"),
                substeps: NonZeroU32::new(substeps).expect("not zero"),
            };
            let mut table = FlowTable::new(integrator, Damping { linear, angular });
            table.extend_to(HORIZON);
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

fn snapped() -> impl Strategy<Value = Snapped> {
    let velocities = (steps(VELOCITY_LIMIT), steps(VELOCITY_LIMIT));
    (steps(POSITION_LIMIT), rotation(), velocities).prop_map(
        |(position, rotation, (linear, angular))| Snapped {
            position,
            rotation: PackedRotation::of(rotation),
            linear,
            angular,
        },
    )
}

fn residual() -> impl Strategy<Value = Residual> {
    let velocities = (steps(VELOCITY_LIMIT), steps(VELOCITY_LIMIT));
    (steps(POSITION_LIMIT), steps(TURN_LIMIT), velocities).prop_map(
        |(position, turn, (linear, angular))| Residual {
            position,
            turn,
            linear,
            angular,
        },
    )
}

/// Gravity as RECKONING 2.5 has it.
fn pull() -> impl Strategy<Value = DVec3> {
    (singles(), single()).prop_map(|(scene, scale)| {
        DVec3::from_array(scene.map(|part| f64::from(part) * f64::from(scale)))
    })
}

fn is_a_motion(motion: &Motion) -> bool {
    let length = motion.pose().rotation.length();
    Motion::new(motion.pose(), motion.twist()).is_ok() && (length - 1.0).abs() < 1e-15
}

proptest! {
    #[test]
    fn a_prediction_from_any_verbatim_motion_is_a_motion(
        position in singles(), turned in rotation(), linear in singles(), angular in singles(),
        table in table(), pull in pull(), elapsed in 0_u32..1_100,
    ) {
        let rotation = turned.to_array().map(|part| part as f32);
        let start = Verbatim::new(position, rotation, linear, angular).unwrap().motion();
        for law in LAWS {
            let end = law.predict(&start, Ticks::new(elapsed), pull, &table);
            prop_assert!(is_a_motion(&end), "{end:?}");
        }
    }

    #[test]
    fn a_prediction_from_any_snapped_motion_is_a_motion_and_can_be_said(
        anchor in snapped(), residual in residual(), grid in grid(), table in table(), pull in pull(), elapsed in 0_u32..1_100,
    ) {
        for law in LAWS {
            let end = law.predict(&anchor.motion(&grid), Ticks::new(elapsed), pull, &table);
            prop_assert!(is_a_motion(&end), "{end:?}");
            for said in [Snapped::of(&end, &grid), residual.onto(&end, &grid)] {
                prop_assert!(said.is_within_limits());
                prop_assert!(is_a_motion(&said.motion(&grid)));
                prop_assert_eq!(Snapped::of(&said.motion(&grid), &grid), said);
            }
        }
    }

    #[test]
    fn a_near_tie_packs_into_what_is_taken_back(q in near_tie()) {
        let packed = PackedRotation::of(q);
        let (largest, others) = packed.parts();
        prop_assert_eq!(PackedRotation::from_parts(largest, others), Some(packed));
        prop_assert_eq!(PackedRotation::of(packed.value()), packed);
        let pose = |rotation| Pose { position: DVec3::ZERO, rotation };
        let turn = Divergence::between(&pose(q), &pose(packed.value())).turn();
        prop_assert!(turn.radians() < 9.4e-6, "{turn}");
    }

    #[test]
    fn what_is_taken_back_means_a_rotation(largest in 0_u8..4, others in steps(PackedRotation::LIMIT)) {
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
        let start = |linear, angular| Verbatim::new([0.0; 3], rotation, linear, angular).unwrap().motion();
        let end = |start: Motion| Predictor::Uniform.predict(&start, Ticks::new(elapsed), DVec3::ZERO, &table);
        let there = end(start(linear, angular));
        let back = end(start(linear.map(|part| -part), angular.map(|part| -part)));
        prop_assert_eq!(there.pose().position, -back.pose().position);
        prop_assert_eq!(there.twist().angular, -back.twist().angular);
    }
}
