//! Sayings come back as they were said, at about their cost

use super::*;
use crate::packet::cost::Pricing;
use crate::packet::whole::tests::{steps, whole};
use alloc::vec::Vec;
use proptest::prelude::*;
use rhumb_reckoning::{COARSENESS_LIMIT, HORIZON, RESIDUAL_LIMIT, TURN_LIMIT, VELOCITY_LIMIT};

fn course() -> impl Strategy<Value = Course> {
    let carrier_age = || (0_u32..2_000).prop_map(Age::new);
    prop_oneof![
        3 => Just(Course::Same),
        2 => (
            prop::sample::select(&Predictor::ALL[..]),
            proptest::option::of(carrier_age())
        )
            .prop_map(|(predictor, carrier_age)| Course::World {
                predictor,
                carrier_age
            }),
        1 => (prop_oneof![0..INDICES_MAX, Just(5)], carrier_age()).prop_map(
            |(carrier, carrier_age)| Course::Held {
                carrier,
                carrier_age
            }
        ),
    ]
}

pub(crate) fn saying() -> impl Strategy<Value = Saying> {
    let velocity = (0..=COARSENESS_LIMIT).prop_flat_map(|coarseness| {
        let limit = VELOCITY_LIMIT >> coarseness;
        (steps(limit), steps(limit)).prop_map(move |(linear, angular)| VelocityResidual {
            coarseness,
            linear,
            angular,
        })
    });
    let residual = (
        steps(RESIDUAL_LIMIT),
        steps(TURN_LIMIT),
        proptest::option::of(velocity),
    );
    let settling = (any::<bool>(), steps(i32::MAX), steps(1 << 20), -9..=9_i32).prop_map(
        |(negated, position, others, largest)| Settling {
            negated,
            position,
            others,
            largest,
        },
    );
    prop_oneof![
        whole().prop_map(Saying::Whole),
        (1_u32..=1 << 30, settling).prop_map(|(age, settling)| Saying::Settled {
            age: Age::new(age),
            settling,
        }),
        (course(), 1_u32..=HORIZON.count(), residual).prop_map(
            |(course, age, (position, turn, velocity))| {
                let still = matches!(
                    course,
                    Course::Held { .. }
                        | Course::World {
                            predictor: Predictor::Rest,
                            ..
                        }
                );
                Saying::Residual {
                    course,
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

fn seated() -> impl Strategy<Value = (u32, Option<u32>, Saying)> {
    let body = prop_oneof![Just(None), (0..INDICES_MAX).prop_map(Some)];
    (0_u32..5_000, body, saying()).prop_map(|(gap, body, saying)| {
        let whole = matches!(saying, Saying::Whole(_));
        (gap, body.or(whole.then_some(7)), saying)
    })
}

proptest! {
    #[test]
    fn sayings_come_back_at_about_their_cost(sayings in proptest::collection::vec(seated(), 0..20)) {
        let (mut tongue, mut writer, mut cost) = (Tongue::default(), RangeWriter::default(), 0);
        for (gap, body, saying) in &sayings {
            cost += tongue.cost(saying) + 64 * 256;
            tongue.write(*gap, *body, saying, &mut writer);
        }
        tongue.end(&mut writer);
        let bytes = writer.into_bytes();
        prop_assert!(bytes.len() * 8 * 256 <= cost as usize + cost as usize / 8 + 16 * 256);
        let (mut tongue, mut reader) = (Tongue::default(), RangeReader::new(&bytes));
        let mut read = Vec::new();
        while let Some(update) = tongue.read(&mut reader).unwrap() {
            read.push(update);
        }
        prop_assert_eq!(read, sayings);
        prop_assert_eq!(reader.finish(), Ok(()));
    }

    #[test]
    fn what_is_read_is_written_alike(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
        let (mut tongue, mut reader) = (Tongue::default(), RangeReader::new(&bytes));
        let mut read = Vec::new();
        let ended = loop {
            match tongue.read(&mut reader) {
                Ok(Some(update)) if read.len() < 64 => read.push(update),
                Ok(None) => break true,
                _ => break false,
            }
        };
        if ended && reader.finish().is_ok() {
            let (mut tongue, mut writer) = (Tongue::default(), RangeWriter::default());
            for (gap, body, saying) in &read {
                tongue.write(*gap, *body, saying, &mut writer);
            }
            tongue.end(&mut writer);
            prop_assert_eq!(writer.into_bytes(), bytes);
        }
    }
}

#[test]
fn every_form_has_its_code() {
    for (code, mode) in Mode::ALL.into_iter().enumerate() {
        assert_eq!(mode.code(), code);
    }
}
