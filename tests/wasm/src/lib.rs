//! The predictors as plain functions for a check in JavaScript.
//!
//! The caller sets numbers by index, requests one prediction, and reads the result by index. Invariant: the result is the last prediction, or all zeros if the inputs were refused.

pub mod codec;

use core::num::NonZeroU32;
use core::sync::atomic::{AtomicU64, Ordering};

use glam::DVec3;
use rhumb_reckoning::{
    BodyState, Conditions, ConstantAcceleration, Damping, Inertia, Integrator, Motion, Predictor,
    Rate, StepCoefficientTable, TRACK_AGE_MAX, Ticks,
};

/// The inputs of a prediction; [`give`] has the order.
static GIVEN: [AtomicU64; 32] = [const { AtomicU64::new(0) }; 32];
/// The result: position, rotation, linear and angular velocity.
static RESULT: [AtomicU64; 13] = [const { AtomicU64::new(0) }; 13];

/// Sets one input of the next prediction; an index out of range is ignored.
///
/// 0 to 12: the initial state. 13 to 15: gravity. 16: ticks, 17: seconds, 18: substeps, 19: linear damping, 20: angular
/// damping. 21 to 23: moments of inertia, all zero if unknown. 24 to 27: their frame. 28 to 30: steps of an
/// acceleration, 31: its exponent.
#[unsafe(no_mangle)]
pub extern "C" fn give(index: u32, value: f64) {
    if let Some(slot) = GIVEN.get(index as usize) {
        slot.store(value.to_bits(), Ordering::Relaxed);
    }
}

/// Predicts by predictor 0 (rest), 1 (uniform), 2 (ballistic), 3 (torque-free), 4 (ballistic and torque-free) or 5
/// (constant acceleration). Returns 1 if there is a result, 0 if the inputs were refused.
#[unsafe(no_mangle)]
pub extern "C" fn predict(predictor: u32, elapsed: u32) -> u32 {
    let end = prediction(predictor, elapsed);
    let numbers = end.map_or([0.0; 13], |motion| thirteen(&motion));
    for (slot, number) in RESULT.iter().zip(numbers) {
        slot.store(number.to_bits(), Ordering::Relaxed);
    }
    u32::from(end.is_some())
}

/// One number of the last prediction; zero for an index out of range.
#[unsafe(no_mangle)]
pub extern "C" fn result(index: u32) -> f64 {
    RESULT.get(index as usize).map_or(0.0, read)
}

fn read(slot: &AtomicU64) -> f64 {
    f64::from_bits(slot.load(Ordering::Relaxed))
}

fn given(index: usize) -> f64 {
    read(&GIVEN[index])
}

fn prediction(predictor: u32, elapsed: u32) -> Option<Motion> {
    let predictor = match Predictor::ALL.get(predictor as usize)? {
        Predictor::Accelerated(_) => {
            let steps = [28, 29, 30].map(|index| given(index) as i16);
            Predictor::Accelerated(ConstantAcceleration::new(steps, given(31) as u8)?)
        }
        predictor => *predictor,
    };
    // The inputs are widened f32s, so narrowing them is exact.
    let single = |index: usize| given(index) as f32;
    let three = |first: usize| [single(first), single(first + 1), single(first + 2)];
    let rotation = [single(3), single(4), single(5), single(6)];
    let start = BodyState::new(three(0), rotation, three(7), three(10)).ok()?;
    let integrator = Integrator {
        rate: Rate::new(given(16) as u32, given(17) as u32)?,
        substeps: NonZeroU32::new(given(18) as u32)?,
    };
    let damping = Damping {
        linear: single(19),
        angular: single(20),
    };
    let mut flow = StepCoefficientTable::new(integrator, damping);
    flow.extend_to(TRACK_AGE_MAX);
    let frame = [single(24), single(25), single(26), single(27)];
    let inertia = match three(21) {
        [0.0, 0.0, 0.0] => None,
        moments => Some(Inertia::new(moments, frame).ok()?),
    };
    let conditions = Conditions {
        gravity: DVec3::new(given(13), given(14), given(15)),
        flow: &flow,
        inertia: inertia.as_ref(),
    };
    Some(predictor.predict(&start.motion(), Ticks::new(elapsed), &conditions))
}

fn thirteen(motion: &Motion) -> [f64; 13] {
    let (pose, twist) = (motion.pose(), motion.twist());
    let (p, q) = (pose.position, pose.rotation);
    let (v, w) = (twist.linear, twist.angular);
    [
        p.x, p.y, p.z, q.x, q.y, q.z, q.w, v.x, v.y, v.z, w.x, w.y, w.z,
    ]
}
