//! The numbers of a correction, in the order on the wire.
//!
//! The writer walks over them; the reader and the cost model use the same contexts in the same order.

use rhumb_reckoning::{Residual, VelocityResidual};

use super::age::Age;
use super::tables::contexts::{self, TripleContexts};

/// Calls `emit` for each number of a residual in the order on the wire, with its context.
pub(super) fn numbers(
    kind: usize,
    age: Age,
    residual: &Residual,
    mut emit: impl FnMut(usize, i32),
) {
    each_of_place(residual, &mut emit);
    if let Some(velocity) = &residual.velocity {
        each_of_velocity(kind, age, velocity, &mut emit);
    }
}

#[inline]
fn each_of_place(residual: &Residual, emit: &mut impl FnMut(usize, i32)) {
    let largest = each(residual.position, contexts::POSITIONS, emit);
    each(residual.turn, contexts::turn(largest), emit);
}

#[inline]
fn each_of_velocity(
    kind: usize,
    age: Age,
    velocity: &VelocityResidual,
    emit: &mut impl FnMut(usize, i32),
) {
    let age = age.count();
    each(velocity.linear, contexts::velocity(kind, age, 2), emit);
    each(velocity.angular, contexts::velocity(kind, age, 3), emit);
}

/// Emits three numbers and returns the largest size. Their contexts depend on their index and on the sizes before.
#[inline]
fn each(numbers: [i32; 3], contexts: TripleContexts, emit: &mut impl FnMut(usize, i32)) -> u32 {
    let (mut sum, mut largest) = (0, 0);
    for (part, number) in numbers.into_iter().enumerate() {
        emit(contexts.context(part, sum), number);
        let size = number.unsigned_abs();
        sum += u64::from(size);
        largest = largest.max(size);
    }
    largest
}
