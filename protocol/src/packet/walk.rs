//! The numbers of a correction, in the order in which they are said.
//!
//! One walk for who writes, who reads and who counts the cost.

use rhumb_reckoning::{Residual, VelocityResidual};

use super::age::Age;
use super::tables::contexts;

/// Walks over the numbers of a residual in the order in which they are said, with the context of each.
pub(super) fn numbers(kind: usize, age: Age, residual: &Residual, mut say: impl FnMut(usize, i32)) {
    let mut residual = *residual;
    let mut walk = Walk::new(kind, age);
    while let Some(context) = walk.context() {
        let number = *walk.place(&mut residual);
        say(context, number);
        walk.step(number.unsigned_abs());
    }
}

/// The same over its numbers of position and of turn alone.
pub(super) fn numbers_of_place(
    kind: usize,
    age: Age,
    residual: &Residual,
    mut say: impl FnMut(usize, u32),
) {
    let mut walk = Walk::new(kind, age);
    for part in residual.position.iter().chain(&residual.turn) {
        let Some(context) = walk.context() else {
            return;
        };
        let size = part.unsigned_abs();
        say(context, size);
        walk.step(size);
    }
}

/// The same over the numbers of its velocities alone.
pub(super) fn numbers_of_velocity(
    kind: usize,
    age: Age,
    velocity: &VelocityResidual,
    mut say: impl FnMut(usize, u32),
) {
    let mut walk = Walk {
        next: 6,
        ..Walk::new(kind, age)
    };
    for part in velocity.linear.iter().chain(&velocity.angular) {
        let Some(context) = walk.context() else {
            return;
        };
        let size = part.unsigned_abs();
        say(context, size);
        walk.step(size);
    }
}

/// A place among the numbers of a residual: position, turn, linear and angular velocity, three each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walk {
    kind: usize,
    age: usize,
    next: usize,
    /// Sum of the sizes so far in this triple, and the largest of the first triple.
    sum: u32,
    largest: u32,
}

impl Walk {
    pub(super) const fn new(kind: usize, age: Age) -> Self {
        Self {
            kind,
            age: contexts::age_class(age.count()),
            next: 0,
            sum: 0,
            largest: 0,
        }
    }

    pub(super) const fn context(&self) -> Option<usize> {
        let (triple, part) = (self.next / 3, self.next % 3);
        match triple {
            0 => Some(contexts::position(self.kind, self.age, part, self.sum)),
            1 => Some(contexts::turn(
                self.kind,
                self.age,
                part,
                self.sum,
                self.largest,
            )),
            2 | 3 if self.kind % 2 == 1 => Some(contexts::velocity(
                self.kind, self.age, triple, part, self.sum,
            )),
            _ => None,
        }
    }

    /// Where the number at this place lies.
    pub(super) fn place<'a>(&self, residual: &'a mut Residual) -> &'a mut i32 {
        let part = self.next % 3;
        match self.next / 3 {
            0 => &mut residual.position[part],
            1 => &mut residual.turn[part],
            triple => {
                let velocity = residual.velocity.get_or_insert_default();
                if triple == 2 {
                    &mut velocity.linear[part]
                } else {
                    &mut velocity.angular[part]
                }
            }
        }
    }

    pub(super) fn step(&mut self, size: u32) {
        if self.next < 3 {
            self.largest = self.largest.max(size);
        }
        self.next += 1;
        self.sum = if self.next.is_multiple_of(3) {
            0
        } else {
            self.sum.saturating_add(size)
        };
    }
}
