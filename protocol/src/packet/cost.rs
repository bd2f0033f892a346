//! What a saying would cost: for who chooses, or must know that it fits.
//!
//! Nothing here is normative, and nothing changes the coder. Costs are in 1/256 bits. A correction costs what its form,
//! its place and its velocities do, each by itself, so that who tries many need not count the same numbers again.

use rhumb_reckoning::{Push, Residual, VelocityResidual};

use super::age::Age;
use super::model::{code_cost, opening_cost};
use super::push::numbers_of_push;
use super::saying::{Course, INDEX_BITS, Mode, Saying, Tongue, each_number};
use super::steps::{length, settled};
use super::tables::contexts;
use super::walk::{numbers_of_place, numbers_of_velocity};

/// A whole bit.
const BIT: u32 = 256;

/// A packet of which nothing is said yet: who chooses does not know what will be said before.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Opening;

/// What position and turn of a correction cost at the beginning of a packet, whatever its form.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlaceCost {
    /// In which context each number is said by the first kind of form, and its size; position, then turn.
    numbers: [(u16, u32); 6],
    signs: u32,
}

impl PlaceCost {
    pub(crate) fn of(age: Age, residual: &Residual) -> Self {
        let mut place = Self {
            numbers: [(0, 0); 6],
            signs: 0,
        };
        let mut free = place.numbers.iter_mut();
        numbers_of_place(0, age, residual, |context, size| {
            if let Some(number) = free.next() {
                // There are fewer contexts than 2¹⁶.
                *number = (context as u16, size);
            }
            place.signs += sign(size);
        });
        place
    }

    /// By a form of this course, with velocities or without.
    #[inline]
    pub(crate) fn by(&self, course: &Course, moved: bool) -> u32 {
        let kind = Mode::of_course(course, moved).kind();
        let [x, y, z, a, b, c] = self.numbers;
        let position = kind * contexts::KIND_OF_POSITION;
        let turn = kind * contexts::KIND_OF_TURN;
        let of = |(context, size): (u16, u32), behind: usize| {
            opening_cost(usize::from(context) + behind, size)
        };
        let positions = of(x, position) + of(y, position) + of(z, position);
        let turns = of(a, turn) + of(b, turn) + of(c, turn);
        self.signs + positions + turns
    }
}

/// By what expectations costs are reckoned.
pub(crate) trait Pricing {
    /// What a number costs in a context.
    fn cost_of_number(&self, context: usize, number: u32) -> u32;

    /// Which expectation of an update's form holds.
    fn row(&self) -> usize;

    /// The body that the last held one is held by.
    fn carrier(&self) -> Option<u32>;

    /// What saying this next would cost, its gap aside.
    fn cost(&self, saying: &Saying) -> u32 {
        let bits = match saying {
            Saying::Residual {
                course,
                age,
                residual,
            } => {
                let velocity = residual.velocity.as_ref();
                let moved = velocity.is_some();
                let said =
                    velocity.map_or(0, |velocity| self.cost_of_velocity(course, *age, velocity));
                return self.cost_of_form(course, *age, moved)
                    + self.cost_of_place(course, *age, moved, residual)
                    + said;
            }
            Saying::Whole(whole) => whole.bit_len() as u32 + INDEX_BITS,
            Saying::Settled { settling, .. } => {
                let lengths = settled(settling).map(|(_, step, _)| length(step));
                1 + lengths.iter().sum::<u32>()
            }
        };
        let mut cost = bits * BIT + cost_of_mode(self.row(), Mode::of(saying));
        each_number(saying, |context, number| {
            cost += self.cost_of_number(context, number);
        });
        cost
    }

    /// Of a correction, what says its form, its age, its carrier and its push.
    #[inline]
    fn cost_of_form(&self, course: &Course, age: Age, moved: bool) -> u32 {
        let mode = Mode::of_course(course, moved);
        let context = contexts::age(mode.kind());
        cost_of_mode(self.row(), mode)
            + self.cost_of_number(context, age.count() - 1)
            + self.cost_of_carrier(course)
    }

    /// Of a correction of this form, what says position and turn.
    fn cost_of_place(&self, course: &Course, age: Age, moved: bool, residual: &Residual) -> u32 {
        let mut cost = 0;
        let kind = Mode::of_course(course, moved).kind();
        numbers_of_place(kind, age, residual, |context, size| {
            cost += self.cost_of_number(context, size) + sign(size);
        });
        cost
    }

    /// Of a correction of this course, what says velocities.
    fn cost_of_velocity(&self, course: &Course, age: Age, velocity: &VelocityResidual) -> u32 {
        let kind = Mode::of_course(course, true).kind();
        let coarseness = contexts::coarseness(kind, age.count());
        let mut cost = self.cost_of_number(coarseness, velocity.coarseness);
        numbers_of_velocity(kind, age, velocity, |context, size| {
            cost += self.cost_of_number(context, size) + sign(size);
        });
        cost
    }

    fn cost_of_carrier(&self, course: &Course) -> u32 {
        let age = |age: Age| self.cost_of_number(contexts::CARRIER_AGE, age.count());
        match *course {
            Course::Same => 0,
            Course::World { carrier_age, .. } => {
                let push = course.push().map_or(0, |push| self.cost_of_push(&push));
                BIT + carrier_age.map_or(0, age) + push
            }
            Course::Held {
                carrier,
                carrier_age,
            } => {
                let again = self.carrier() == Some(carrier);
                let named = if again { 1 } else { INDEX_BITS };
                named * BIT + age(carrier_age)
            }
        }
    }

    /// What saying a push would cost.
    fn cost_of_push(&self, push: &Push) -> u32 {
        let mut cost = 0;
        numbers_of_push(push, |context, number| {
            let signed = number != 0 && context != contexts::DOUBLINGS;
            cost += self.cost_of_number(context, number.unsigned_abs()) + u32::from(signed) * BIT;
        });
        cost
    }
}

impl Pricing for Opening {
    #[inline]
    fn cost_of_number(&self, context: usize, number: u32) -> u32 {
        opening_cost(context, number)
    }

    fn row(&self) -> usize {
        0
    }

    fn carrier(&self) -> Option<u32> {
        None
    }
}

impl Pricing for Tongue {
    #[inline]
    fn cost_of_number(&self, context: usize, number: u32) -> u32 {
        self.model.cost(context, number)
    }

    fn row(&self) -> usize {
        self.last
    }

    fn carrier(&self) -> Option<u32> {
        self.carrier
    }
}

fn cost_of_mode(row: usize, mode: Mode) -> u32 {
    code_cost(row, mode.code())
}

/// What is nothing has no sign.
const fn sign(size: u32) -> u32 {
    if size == 0 { 0 } else { BIT }
}
