//! Payloads: round trips, costs, forms, and what is malformed.

use alloc::vec::Vec;

use proptest::prelude::*;
use rhumb_reckoning::{
    RESIDUAL_LIMIT, TRACK_AGE_MAX, TURN_LIMIT, VELOCITY_EXPONENT_MAX, VELOCITY_LIMIT,
};

use super::*;
use crate::limits::INDICES_MAX;
use crate::packet::cost::CostModel;
use crate::packet::keyframe::tests::{keyframe, steps};

fn mode() -> impl Strategy<Value = PredictionMode> {
    let parent_age = || (0_u32..2_000).prop_map(Age::new);
    prop_oneof![
        3 => Just(PredictionMode::Same),
        2 => (
            prop::sample::select(&Predictor::ALL[..]),
            proptest::option::of(parent_age())
        )
            .prop_map(|(predictor, parent_age)| PredictionMode::World {
                predictor,
                parent_age
            }),
        1 => (prop_oneof![0..INDICES_MAX, Just(5)], parent_age()).prop_map(
            |(parent, parent_age)| PredictionMode::Attached {
                parent,
                parent_age
            }
        ),
    ]
}

pub(crate) fn payload() -> impl Strategy<Value = UpdatePayload> {
    let velocity = (0..=VELOCITY_EXPONENT_MAX).prop_flat_map(|velocity_exponent| {
        let limit = VELOCITY_LIMIT >> velocity_exponent;
        (steps(limit), steps(limit)).prop_map(move |(linear, angular)| VelocityResidual {
            velocity_exponent,
            linear,
            angular,
        })
    });
    let residual = (
        steps(RESIDUAL_LIMIT),
        steps(TURN_LIMIT),
        proptest::option::of(velocity),
    );
    let rest_correction = (any::<bool>(), steps(i32::MAX), steps(1 << 20), -9..=9_i32).prop_map(
        |(negated, position, others, largest)| RestCorrection {
            negated,
            position,
            others,
            largest,
        },
    );
    prop_oneof![
        keyframe().prop_map(UpdatePayload::Keyframe),
        (1_u32..=1 << 30, rest_correction).prop_map(|(age, rest_correction)| {
            UpdatePayload::Resting {
                age: Age::new(age),
                rest_correction,
            }
        }),
        (mode(), 1_u32..=TRACK_AGE_MAX.count(), residual).prop_map(
            |(mode, age, (position, turn, velocity))| {
                let still = matches!(
                    mode,
                    PredictionMode::Attached { .. }
                        | PredictionMode::World {
                            predictor: Predictor::Rest,
                            ..
                        }
                );
                UpdatePayload::Residual {
                    mode,
                    age: Age::new(age),
                    residual: Residual {
                        position,
                        turn,
                        velocity: velocity.filter(|_| !still),
                    },
                }
            }
        ),
    ]
}

fn aliased() -> impl Strategy<Value = (u32, Option<u32>, UpdatePayload)> {
    let body = prop_oneof![Just(None), (0..INDICES_MAX).prop_map(Some)];
    (0_u32..5_000, body, payload()).prop_map(|(gap, body, payload)| {
        let keyframe = matches!(payload, UpdatePayload::Keyframe(_));
        (gap, body.or(keyframe.then_some(7)), payload)
    })
}

proptest! {
    #[test]
    fn payloads_round_trip_at_about_their_cost(payloads in proptest::collection::vec(aliased(), 0..20)) {
        let (mut coder, mut writer, mut cost) = (UpdateCoder::default(), RangeWriter::default(), 0);
        for (gap, body, payload) in &payloads {
            cost += coder.cost(payload) + 64 * 256;
            coder.write(*gap, *body, payload, &mut writer);
        }
        coder.end(&mut writer);
        let bytes = writer.into_bytes();
        prop_assert!(bytes.len() * 8 * 256 <= cost as usize + cost as usize / 8 + 16 * 256);
        let (mut coder, mut reader) = (UpdateCoder::default(), RangeReader::new(&bytes));
        let mut read = Vec::new();
        let mut take = |gap, body, payload| {
            read.push((gap, body, payload));
            Ok(())
        };
        while coder.read(&mut reader, &mut take).unwrap() {}
        prop_assert_eq!(read, payloads);
        prop_assert_eq!(reader.finish(), Ok(()));
    }

    #[test]
    fn decode_then_encode_is_identity(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
        let (mut coder, mut reader) = (UpdateCoder::default(), RangeReader::new(&bytes));
        let mut read = Vec::new();
        let ended = loop {
            let more = coder.read(&mut reader, |gap, body, payload| {
                read.push((gap, body, payload));
                Ok(())
            });
            match more {
                Ok(true) if read.len() <= 64 => {}
                Ok(false) => break true,
                _ => break false,
            }
        };
        if ended && reader.finish().is_ok() {
            let (mut coder, mut writer) = (UpdateCoder::default(), RangeWriter::default());
            for (gap, body, payload) in &read {
                coder.write(*gap, *body, payload, &mut writer);
            }
            coder.end(&mut writer);
            prop_assert_eq!(writer.into_bytes(), bytes);
        }
    }
}

#[test]
fn every_form_has_a_distinct_code() {
    for (code, form) in UpdateForm::ALL.into_iter().enumerate() {
        assert_eq!(form.code(), code);
    }
}

#[test]
fn an_age_counts_published_ticks() {
    let third = NonZeroU32::new(3).unwrap();
    let age = |origin, tick, publish_interval| {
        let age = Age::of(Tick::new(origin), Tick::new(tick), publish_interval);
        age.map(Age::count)
    };
    for (origin, tick, counted) in [(6, 9, 1), (8, 9, 1), (9, 9, 0), (0, 12, 4), (5, 12, 3)] {
        assert_eq!(age(origin, tick, third), Some(counted));
        assert_eq!(
            age(origin, tick, NonZeroU32::MIN),
            Some((tick - origin) as u32)
        );
    }
    assert_eq!(age(10, 9, third), None);
    assert_eq!(age(0, 1 << 40, NonZeroU32::MIN), None);
}
