//! What a payload would cost: for who chooses, or must know that it fits.
//!
//! Nothing here is normative, and nothing changes the coder. Costs are in 1/256 bits. A correction costs what its form,
//! its place and its velocities do, each by itself, so that who tries many need not count the same numbers again.

use rhumb_reckoning::{ConstantAcceleration, Residual, VelocityResidual};

use super::acceleration::numbers_of_acceleration;
use super::age::Age;
use super::model::{code_cost, opening_cost};
use super::payload::{
    INDEX_BITS, PredictionMode, UpdateCoder, UpdateForm, UpdatePayload, each_number,
};
use super::residual_numbers::{numbers_of_place, numbers_of_velocity};
use super::rest_steps::{length, resting};
use super::tables::contexts;

/// A keyframe bit.
const BIT: u32 = 256;

/// A packet of which nothing is said yet: who chooses does not know what will be said before.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InitialCostModel;

/// What position and turn of a correction cost at the beginning of a packet, whatever its form.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseCost {
    /// In which context each number is said by the first kind of form, and its size; position, then turn.
    numbers: [(u16, u32); 6],
    signs: u32,
}

impl PoseCost {
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

    /// By a form of this mode, with velocities or without.
    #[inline]
    pub(crate) fn by(&self, mode: &PredictionMode, moved: bool) -> u32 {
        let kind = UpdateForm::of_mode(mode, moved).kind();
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
pub(crate) trait CostModel {
    /// What a number costs in a context.
    fn cost_of_number(&self, context: usize, number: u32) -> u32;

    /// Which expectation of an update's form holds.
    fn row(&self) -> usize;

    /// The body that the last held one is held by.
    fn parent(&self) -> Option<u32>;

    /// What payload this next would cost, its gap aside.
    fn cost(&self, payload: &UpdatePayload) -> u32 {
        let bits = match payload {
            UpdatePayload::Residual {
                mode,
                age,
                residual,
            } => {
                let velocity = residual.velocity.as_ref();
                let moved = velocity.is_some();
                let said =
                    velocity.map_or(0, |velocity| self.cost_of_velocity(mode, *age, velocity));
                return self.cost_of_form(mode, *age, moved)
                    + self.cost_of_place(mode, *age, moved, residual)
                    + said;
            }
            UpdatePayload::Keyframe(keyframe) => keyframe.bit_len() as u32 + INDEX_BITS,
            UpdatePayload::Resting {
                rest_correction, ..
            } => {
                let lengths = resting(rest_correction).map(|(_, step, _)| length(step));
                1 + lengths.iter().sum::<u32>()
            }
        };
        let mut cost = bits * BIT + cost_of_form_code(self.row(), UpdateForm::of(payload));
        each_number(payload, |context, number| {
            cost += self.cost_of_number(context, number);
        });
        cost
    }

    /// Of a correction, what says its form, its age, its parent and its push.
    #[inline]
    fn cost_of_form(&self, mode: &PredictionMode, age: Age, moved: bool) -> u32 {
        let form = UpdateForm::of_mode(mode, moved);
        let context = contexts::age(form.kind());
        cost_of_form_code(self.row(), form)
            + self.cost_of_number(context, age.count() - 1)
            + self.cost_of_parent(mode)
    }

    /// Of a correction of this form, what says position and turn.
    fn cost_of_place(
        &self,
        mode: &PredictionMode,
        age: Age,
        moved: bool,
        residual: &Residual,
    ) -> u32 {
        let mut cost = 0;
        let kind = UpdateForm::of_mode(mode, moved).kind();
        numbers_of_place(kind, age, residual, |context, size| {
            cost += self.cost_of_number(context, size) + sign(size);
        });
        cost
    }

    /// Of a correction of this mode, what says velocities.
    fn cost_of_velocity(
        &self,
        mode: &PredictionMode,
        age: Age,
        velocity: &VelocityResidual,
    ) -> u32 {
        let kind = UpdateForm::of_mode(mode, true).kind();
        let velocity_exponent = contexts::velocity_exponent(kind, age.count());
        let mut cost = self.cost_of_number(velocity_exponent, velocity.velocity_exponent);
        numbers_of_velocity(kind, age, velocity, |context, size| {
            cost += self.cost_of_number(context, size) + sign(size);
        });
        cost
    }

    fn cost_of_parent(&self, mode: &PredictionMode) -> u32 {
        let age = |age: Age| self.cost_of_number(contexts::PARENT_AGE, age.count());
        match *mode {
            PredictionMode::Same => 0,
            PredictionMode::World { parent_age, .. } => {
                let push = mode
                    .acceleration()
                    .map_or(0, |push| self.cost_of_acceleration(&push));
                BIT + parent_age.map_or(0, age) + push
            }
            PredictionMode::Attached { parent, parent_age } => {
                let again = self.parent() == Some(parent);
                let named = if again { 1 } else { INDEX_BITS };
                named * BIT + age(parent_age)
            }
        }
    }

    /// What payload a push would cost.
    fn cost_of_acceleration(&self, push: &ConstantAcceleration) -> u32 {
        let mut cost = 0;
        numbers_of_acceleration(push, |context, number| {
            let signed = number != 0 && context != contexts::ACCELERATION_EXPONENT;
            cost += self.cost_of_number(context, number.unsigned_abs()) + u32::from(signed) * BIT;
        });
        cost
    }
}

impl CostModel for InitialCostModel {
    #[inline]
    fn cost_of_number(&self, context: usize, number: u32) -> u32 {
        opening_cost(context, number)
    }

    fn row(&self) -> usize {
        0
    }

    fn parent(&self) -> Option<u32> {
        None
    }
}

impl CostModel for UpdateCoder {
    #[inline]
    fn cost_of_number(&self, context: usize, number: u32) -> u32 {
        self.model.cost(context, number)
    }

    fn row(&self) -> usize {
        self.last
    }

    fn parent(&self) -> Option<u32> {
        self.parent
    }
}

fn cost_of_form_code(row: usize, form: UpdateForm) -> u32 {
    code_cost(row, form.code())
}

/// What is nothing has no sign.
const fn sign(size: u32) -> u32 {
    if size == 0 { 0 } else { BIT }
}
