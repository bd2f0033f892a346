//! Lanes against scalar predictions and corrections, to the bit.

use alloc::vec::Vec;
use core::num::NonZeroU32;

use proptest::prelude::*;

use super::*;
use crate::free_motion::{Damping, Integrator, StepCoefficientTable, TRACK_AGE_MAX};
use crate::quantiser::{QuantisedState, RESIDUAL_LIMIT, Residual, TURN_LIMIT, VelocityResidual};
use crate::tolerance::Tolerance;
use crate::track::{BodyState, Track};
use crate::units::{Metres, Rate, Seconds, Ticks};

fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
    (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
}

fn track() -> impl Strategy<Value = Track> {
    let spin = prop_oneof![Just(DVec3::ZERO), vector(9.0), vector(60.0), vector(1e8)];
    let predictor = prop::sample::select(&Predictor::ALL[1..]);
    let length = prop_oneof![Just(1.0_f32), 0.9995_f32..1.0005];
    (
        vector(1e3),
        vector(3.0),
        vector(30.0),
        spin,
        predictor,
        any::<bool>(),
        length,
    )
        .prop_map(
            |(position, turn, linear, angular, predictor, quantised, length)| {
                let rotation = DQuat::from_scaled_axis(turn);
                let motion = Motion::new(Pose { position, rotation }, Twist { linear, angular });
                let motion = motion.unwrap();
                let anchor = if quantised || predictor.acceleration().is_some() {
                    Anchor::Quantised(QuantisedState::of(&motion, &grid()))
                } else {
                    let wide = rotation.as_quat().to_array().map(|part| part * length);
                    let narrow = |v: DVec3| v.as_vec3().to_array();
                    let body_state =
                        BodyState::new(narrow(position), wide, narrow(linear), narrow(angular));
                    Anchor::Exact(body_state.unwrap())
                };
                Track {
                    origin: Tick::new(100),
                    predictor,
                    anchor,
                    parent: None,
                }
            },
        )
}

fn grid() -> Grid {
    Grid::new(Tolerance::NORMAL, Metres::new(0.5))
}

fn bits(motion: &Motion) -> Vec<u64> {
    let (pose, twist) = (motion.pose(), motion.twist());
    let all = [pose.position, twist.linear, twist.angular].map(|v| v.to_array());
    let all = all
        .iter()
        .flatten()
        .copied()
        .chain(pose.rotation.to_array());
    all.map(f64::to_bits).collect()
}

proptest! {
    #[test]
    fn x4_prediction_equals_scalar_prediction(
        tracks in proptest::collection::vec((track(), 0_u64..1_400), 1..=4),
        damping in [0.0_f32..1.0, 0.0_f32..1.0],
    ) {
        let integrator = Integrator { rate: Rate::HZ_60, substeps: NonZeroU32::new(4).unwrap() };
        let mut flow = StepCoefficientTable::new(integrator, Damping { linear: damping[0], angular: damping[1] });
        flow.extend_to(TRACK_AGE_MAX);
        let gravity = DVec3::new(0.1, -9.8, 0.0);
        let conditions = Conditions { gravity, flow: &flow, inertia: None };
        let mut batch = PredictionX4::default();
        let mut expected = Vec::new();
        for (key, (track, tick)) in (10..).zip(&tracks) {
            let tick = Tick::new(*tick);
            prop_assert!(batch.take(key, &DenseTrack::new(track), tick, &grid(), &conditions));
            expected.push((key, bits(&track.at(tick, &grid(), &conditions))));
        }
        prop_assert_eq!(batch.is_full(), tracks.len() == 4);
        let mut predicted = Vec::new();
        batch.predict(|key, motion| predicted.push((key, bits(&motion))));
        prop_assert_eq!(predicted, expected);
        batch.predict(|_, _| unreachable!("it is empty"));
        let mut starts = StartsX4::default();
        for (lane, (track, _)) in tracks.iter().enumerate() {
            let start = UnpackedStart::of(&DenseTrack::new(track), &grid(), &conditions).unwrap();
            starts.put(lane, &start);
            starts.put(lane, &starts.get(lane));
        }
        let (flows, tick) = ([&flow; 4], Tick::new(tracks[0].1));
        let mut predicted = Vec::new();
        starts.predict(tick, &flows[..tracks.len()], |lane, motion| predicted.push((lane, bits(&motion))));
        let expected: Vec<_> = tracks.iter().map(|(track, _)| bits(&track.at(tick, &grid(), &conditions))).collect();
        prop_assert_eq!(predicted, expected.into_iter().enumerate().collect::<Vec<_>>());
    }
}

fn residual() -> impl Strategy<Value = Residual> {
    let steps = |most: i32| proptest::array::uniform3(-most..=most);
    let some = move |most: i32| prop_oneof![Just([0; 3]), steps(most), steps(3)];
    let velocity =
        (0..=3_u32, steps(400), steps(400)).prop_map(|(velocity_exponent, linear, angular)| {
            VelocityResidual {
                velocity_exponent,
                linear,
                angular,
            }
        });
    let velocity = proptest::option::of(velocity);
    (some(RESIDUAL_LIMIT), some(TURN_LIMIT), velocity).prop_map(|(position, turn, velocity)| {
        Residual {
            position,
            turn,
            velocity,
        }
    })
}

proptest! {
    #[test]
    fn x4_correction_equals_scalar_correction(
        all in proptest::collection::vec(
            (track(), 0_u64..1_400, residual(), 1_u32..1_100, prop_oneof![Just(0.5), 1e-3..1e3, Just(1e250)]),
            1..=4,
        ),
    ) {
        let integrator = Integrator { rate: Rate::HZ_60, substeps: NonZeroU32::new(4).unwrap() };
        let mut flow = StepCoefficientTable::new(integrator, Damping { linear: 0.1, angular: 0.2 });
        flow.extend_to(TRACK_AGE_MAX);
        let gravity = DVec3::new(0.1, -9.8, 0.0);
        let conditions = Conditions { gravity, flow: &flow, inertia: None };
        let (mut batch, mut corrections, mut expected) = (PredictionX4::default(), Vec::new(), Vec::new());
        let grids: Vec<Grid> = all.iter()
            .map(|(.., radius)| Grid::new(Tolerance::NORMAL, Metres::new(*radius)))
            .collect();
        for (key, ((track, tick, residual, ticks, _), grid)) in (10..).zip(all.iter().zip(&grids)) {
            let (tick, over) = (Tick::new(*tick), Seconds::new(f64::from(*ticks) / 60.0));
            prop_assert!(batch.take(key, &DenseTrack::new(track), tick, grid, &conditions));
            corrections.push(LaneCorrection { residual, over, grid });
            expected.push(residual.onto(&track.at(tick, grid, &conditions), over, grid));
        }
        let corrected = batch.correct(corrections).unwrap();
        let corrected: Vec<_> = (0..corrected.len()).map(|lane| corrected.at(lane)).collect();
        prop_assert_eq!(corrected, expected);
        batch.predict(|_, _| unreachable!("it is empty"));
        prop_assert!(batch.correct([]).is_none());
    }
}

#[test]
fn resting_and_torque_free_tracks_are_refused() {
    let integrator = Integrator {
        rate: Rate::HZ_60,
        substeps: NonZeroU32::new(4).unwrap(),
    };
    let flow = StepCoefficientTable::new(integrator, Damping::default());
    let slab = crate::free_motion::Inertia::new([1.0, 2.0, 2.9], [0.0, 0.0, 0.0, 1.0]).unwrap();
    let conditions = Conditions {
        gravity: DVec3::ZERO,
        flow: &flow,
        inertia: Some(&slab),
    };
    let anchor = Anchor::Quantised(QuantisedState::of(&Motion::IDENTITY, &grid()));
    for predictor in [Predictor::Rest, Predictor::BallisticTorqueFree] {
        let track = Track {
            origin: Tick::ZERO,
            predictor,
            anchor,
            parent: None,
        };
        let tick = Tick::ZERO + Ticks::new(1);
        let track = DenseTrack::new(&track);
        assert!(!PredictionX4::default().take(0, &track, tick, &grid(), &conditions));
        assert!(UnpackedStart::of(&track, &grid(), &conditions).is_none());
    }
}
