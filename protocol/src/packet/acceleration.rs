//! The encoding of a constant acceleration in an update.
//!
//! It is encoded once, with the mode that it belongs to. A correction that keeps the mode does not repeat it (PROTOCOL
//! 5.6).

use rhumb_reckoning::{ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT, ConstantAcceleration};

use super::model::Model;
use super::tables::contexts;
use crate::wire::Malformed;
use crate::wire::range::{RangeReader, RangeWriter};

pub(super) fn write_acceleration(
    model: &mut Model,
    push: &ConstantAcceleration,
    to: &mut RangeWriter,
) {
    numbers_of_acceleration(push, |context, number| {
        model.write(context, number.unsigned_abs(), to);
        if number != 0 && context != contexts::ACCELERATION_EXPONENT {
            to.raw(u32::from(number < 0), 1);
        }
    });
}

pub(super) fn read_acceleration(
    model: &mut Model,
    from: &mut RangeReader<'_>,
) -> Result<ConstantAcceleration, Malformed> {
    let exponent = model.read(contexts::ACCELERATION_EXPONENT, from)?;
    let (mut steps, mut sum) = ([0; 3], 0_u64);
    for (part, steps) in steps.iter_mut().enumerate() {
        let size = model.read(contexts::acceleration().context(part, sum), from)?;
        if size > ACCELERATION_LIMIT as u32 {
            return Err(Malformed::OutOfRange);
        }
        let negative = size != 0 && from.bit()?;
        *steps = if negative {
            -(size as i16)
        } else {
            size as i16
        };
        sum += u64::from(size);
    }
    if exponent > u32::from(ACCELERATION_EXPONENT_MAX) {
        return Err(Malformed::OutOfRange);
    }
    ConstantAcceleration::new(steps, exponent as u8).ok_or(Malformed::OutOfRange)
}

/// Calls `emit` for each number in the order on the wire, with its context. The first number has no sign.
pub(super) fn numbers_of_acceleration(
    push: &ConstantAcceleration,
    mut emit: impl FnMut(usize, i32),
) {
    emit(contexts::ACCELERATION_EXPONENT, i32::from(push.exponent()));
    let mut sum = 0_u64;
    for (part, steps) in push.steps().into_iter().enumerate() {
        emit(
            contexts::acceleration().context(part, sum),
            i32::from(steps),
        );
        sum += u64::from(steps.unsigned_abs());
    }
}
