//! The numbers of a correction, in the order in which they are said.
//!
//! One walk for who writes, who reads and who counts the cost.

use core::convert::Infallible;

use rhumb_reckoning::{Residual, VelocityResidual};

use super::age::Age;
use super::tables::contexts;

/// Walks over the numbers of a residual in the order in which they are said, with the context of each.
#[inline]
pub(super) fn numbers(kind: usize, age: Age, residual: &Residual, mut say: impl FnMut(usize, i32)) {
    let mut residual = *residual;
    let Ok(()) = each(kind, age, &mut residual, |context, number| {
        say(context, *number);
        said(*number)
    });
}

/// The same over its numbers of position and of turn alone.
#[inline]
pub(super) fn numbers_of_place(
    kind: usize,
    age: Age,
    residual: &Residual,
    mut say: impl FnMut(usize, u32),
) {
    let (mut position, mut turn) = (residual.position, residual.turn);
    let Ok(()) = each_of_place(
        kind,
        age,
        [&mut position, &mut turn],
        &mut |context, number: &mut i32| {
            say(context, number.unsigned_abs());
            said(*number)
        },
    );
}

/// The same over the numbers of its velocities alone.
#[inline]
pub(super) fn numbers_of_velocity(
    kind: usize,
    age: Age,
    velocity: &VelocityResidual,
    mut say: impl FnMut(usize, u32),
) {
    let (mut linear, mut angular) = (velocity.linear, velocity.angular);
    let Ok(()) = each_of_velocity(
        kind,
        age,
        [&mut linear, &mut angular],
        &mut |context, number: &mut i32| {
            say(context, number.unsigned_abs());
            said(*number)
        },
    );
}

const fn said(number: i32) -> Result<u32, Infallible> {
    Ok(number.unsigned_abs())
}

/// Visits every number of a residual with its context: position and turn, and linear and angular velocity if it has any.
///
/// `visit` says or sets the number and returns its size, which decides on the contexts of what follows.
#[inline]
pub(super) fn each<E>(
    kind: usize,
    age: Age,
    residual: &mut Residual,
    mut visit: impl FnMut(usize, &mut i32) -> Result<u32, E>,
) -> Result<(), E> {
    let place = [&mut residual.position, &mut residual.turn];
    each_of_place(kind, age, place, &mut visit)?;
    match &mut residual.velocity {
        Some(velocity) => {
            let parts = [&mut velocity.linear, &mut velocity.angular];
            each_of_velocity(kind, age, parts, &mut visit)
        }
        None => Ok(()),
    }
}

#[inline]
fn each_of_place<E>(
    kind: usize,
    age: Age,
    [position, turn]: [&mut [i32; 3]; 2],
    visit: &mut impl FnMut(usize, &mut i32) -> Result<u32, E>,
) -> Result<(), E> {
    let age = contexts::age_class(age.count());
    let in_position = |part, sum| contexts::position(kind, age, part, sum);
    let largest = triple(position, in_position, visit)?;
    let in_turn = |part, sum| contexts::turn(kind, age, part, sum, largest);
    triple(turn, in_turn, visit)?;
    Ok(())
}

#[inline]
fn each_of_velocity<E>(
    kind: usize,
    age: Age,
    [linear, angular]: [&mut [i32; 3]; 2],
    visit: &mut impl FnMut(usize, &mut i32) -> Result<u32, E>,
) -> Result<(), E> {
    let age = contexts::age_class(age.count());
    let in_linear = |part, sum| contexts::velocity(kind, age, 2, part, sum);
    triple(linear, in_linear, visit)?;
    let in_angular = |part, sum| contexts::velocity(kind, age, 3, part, sum);
    triple(angular, in_angular, visit)?;
    Ok(())
}

/// Visits three numbers, whose contexts follow from their place and from the sum of the sizes before; returns the largest size.
#[inline]
fn triple<E>(
    numbers: &mut [i32; 3],
    context: impl Fn(usize, u32) -> usize,
    visit: &mut impl FnMut(usize, &mut i32) -> Result<u32, E>,
) -> Result<u32, E> {
    let (mut sum, mut largest) = (0_u32, 0);
    for (part, number) in numbers.iter_mut().enumerate() {
        let size = visit(context(part, sum), number)?;
        sum = sum.saturating_add(size);
        largest = largest.max(size);
    }
    Ok(largest)
}
