//! Random motions, tracks and payloads: the content of updates.

use rhumb_protocol::limits::INDICES_MAX;
use rhumb_protocol::packet::{Age, Keyframe, PredictionMode, Update, UpdatePayload};
use rhumb_reckoning::{
    ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT, Anchor, BodyId, BodyState, ConstantAcceleration,
    PackedRotation, Predictor, QuantisedState, RESIDUAL_LIMIT, Residual, RestCorrection,
    TRACK_AGE_MAX, TURN_LIMIT, VELOCITY_EXPONENT_MAX, VELOCITY_LIMIT, VelocityResidual,
};

use super::script::Script;

/// Numbers of quantiser steps within a limit, usually small.
fn steps(script: &mut Script<'_>, limit: i32) -> [i32; 3] {
    let mut all = [0; 3];
    let small = script.any::<u8>();
    for (place, steps) in all.iter_mut().enumerate() {
        *steps = match small >> (2 * place) & 3 {
            0 => 0,
            1 => i32::from(script.any::<i8>()).clamp(-limit, limit),
            2 => i32::from(script.any::<i16>()).clamp(-limit, limit),
            _ => script.any::<i32>().clamp(-limit, limit),
        };
    }
    all
}

/// An exact motion.
pub(super) fn body_state(script: &mut Script<'_>) -> BodyState {
    let position = script.vector(1e3).to_array();
    let rotation = script.rotation().to_array();
    let (linear, angular) = (script.vector(30.0), script.vector(30.0));
    BodyState::new(position, rotation, linear.to_array(), angular.to_array()).unwrap_or_else(|_| {
        BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
            .expect("the rest state at the origin")
    })
}

/// A quantised motion.
pub(super) fn quantised(script: &mut Script<'_>) -> QuantisedState {
    let position = steps(script, rhumb_reckoning::POSITION_LIMIT);
    let largest = script.any::<u8>() % 4;
    let others = steps(script, 1 << 18);
    let rotation = PackedRotation::from_parts(largest, others)
        .or_else(|| PackedRotation::from_parts(3, [0; 3]))
        .expect("the identity is a valid rotation");
    QuantisedState {
        position,
        rotation,
        linear: steps(script, VELOCITY_LIMIT),
        angular: steps(script, VELOCITY_LIMIT),
    }
}

/// A predictor, with any acceleration.
pub(super) fn predictor(script: &mut Script<'_>) -> Predictor {
    match script.one_of(&Predictor::ALL) {
        Predictor::Accelerated(_) => {
            let [x, y, z] = steps(script, i32::from(ACCELERATION_LIMIT));
            let exponent = script.below(usize::from(ACCELERATION_EXPONENT_MAX) + 1) as u8;
            let push = ConstantAcceleration::new([x as i16, y as i16, z as i16], exponent);
            Predictor::Accelerated(push.expect("an acceleration within the limits"))
        }
        predictor => predictor,
    }
}

/// A keyframe.
pub(super) fn keyframe(script: &mut Script<'_>) -> Keyframe {
    let predictor = predictor(script);
    let exact = script.any::<bool>() && predictor.acceleration().is_none();
    let moving = predictor != Predictor::Rest;
    let anchor = match (exact, moving) {
        (true, true) => Anchor::Exact(body_state(script)),
        (true, false) => Anchor::Exact(body_state(script).stilled()),
        (false, true) => Anchor::Quantised(quantised(script)),
        (false, false) => Anchor::Quantised(quantised(script).stilled()),
    };
    let held = !exact && !moving && script.any();
    let parent = held.then(|| BodyId::new(script.below(12) as u32, 0));
    Keyframe {
        predictor,
        anchor,
        parent,
    }
}

/// The number of published ticks since an update.
fn age(script: &mut Script<'_>, most: u32) -> Age {
    let age = match script.below(4) {
        0 => script.any::<u32>() % (most + 1),
        1 => script.below(300) as u32,
        _ => script.below(8) as u32,
    };
    Age::new(age.clamp(1, most))
}

fn mode(script: &mut Script<'_>) -> PredictionMode {
    match script.below(6) {
        0..3 => PredictionMode::Same,
        3 => PredictionMode::Attached {
            parent: script.below(12) as u32,
            parent_age: age(script, 2_000),
        },
        world => PredictionMode::World {
            predictor: predictor(script),
            parent_age: (world == 4).then(|| age(script, 2_000)),
        },
    }
}

fn velocity(script: &mut Script<'_>) -> VelocityResidual {
    let velocity_exponent = script.below(VELOCITY_EXPONENT_MAX as usize + 1) as u32;
    VelocityResidual {
        velocity_exponent,
        linear: steps(script, VELOCITY_LIMIT >> velocity_exponent),
        angular: steps(script, VELOCITY_LIMIT >> velocity_exponent),
    }
}

/// The payload of an update.
pub(super) fn payload(script: &mut Script<'_>) -> UpdatePayload {
    match script.below(6) {
        0 => UpdatePayload::Keyframe(keyframe(script)),
        1 => UpdatePayload::Resting {
            age: age(script, 1 << 30),
            rest_correction: RestCorrection {
                negated: script.any(),
                position: steps(script, i32::MAX),
                others: steps(script, i32::MAX),
                largest: steps(script, i32::MAX)[0],
            },
        },
        _ => {
            let mode = mode(script);
            let still = matches!(
                mode,
                PredictionMode::Attached { .. }
                    | PredictionMode::World {
                        predictor: Predictor::Rest,
                        ..
                    }
            );
            let (age, moved) = (age(script, TRACK_AGE_MAX.count()), script.any::<bool>());
            UpdatePayload::Residual {
                mode,
                age,
                residual: Residual {
                    position: steps(script, RESIDUAL_LIMIT),
                    turn: steps(script, TURN_LIMIT),
                    velocity: (moved && !still).then(|| velocity(script)),
                },
            }
        }
    }
}

/// Updates of one packet, in rising order of alias.
pub(super) fn updates(script: &mut Script<'_>, most: usize) -> Vec<Update> {
    let mut next_alias = 0;
    let mut all = Vec::new();
    for _ in 0..script.below(most + 1) {
        let gap = match script.below(8) {
            0 => script.any::<u32>() % INDICES_MAX,
            _ => script.below(4) as u32,
        };
        let alias = next_alias + gap;
        if alias >= INDICES_MAX {
            break;
        }
        let payload = payload(script);
        let named = script.any::<bool>() || matches!(payload, UpdatePayload::Keyframe(_));
        all.push(Update {
            alias,
            body: named.then(|| script.below(12) as u32),
            payload,
        });
        next_alias = alias + 1;
    }
    all
}
