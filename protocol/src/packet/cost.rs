//! What a payload would cost: for who chooses, or must know that it fits.
//!
//! Nothing here is normative, and nothing changes the coder. Costs are in 1/256 bits.

use rhumb_reckoning::{Residual, VelocityResidual};

use super::age::Age;
use super::model::{code_cost, opening_cost};
use super::payload::{
    INDEX_BITS, PredictionMode, UpdateCoder, UpdateForm, UpdatePayload, each_number,
};
use super::rest_steps::{length, resting};
use super::tables::contexts::{self, TripleContexts};

/// A keyframe bit.
const BIT: u32 = 256;

/// A packet of which nothing is said yet: who chooses does not know what will be said before.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InitialCostModel;

/// By what expectations costs are reckoned.
pub(crate) trait CostModel {
    /// What a number costs in a context.
    fn cost_of_number(&self, context: usize, number: u32) -> u32;

    /// Which expectation of an update's form holds.
    fn row(&self) -> usize;

    /// The body that the last held one is held by.
    fn parent(&self) -> Option<u32>;

    /// What three numbers with their signs cost that are written in a row.
    #[inline]
    fn cost_of_three(&self, contexts: TripleContexts, numbers: [i32; 3]) -> u32 {
        // Written out, since `map` of an array stays a call here.
        let [a, b, c] = numbers;
        let (a, b, c) = (a.unsigned_abs(), b.unsigned_abs(), c.unsigned_abs());
        let sum = u64::from(a) + u64::from(b);
        self.cost_of_number(contexts.context(0, 0), a)
            + self.cost_of_number(contexts.context(1, u64::from(a)), b)
            + self.cost_of_number(contexts.context(2, sum), c)
            + sign(a)
            + sign(b)
            + sign(c)
    }

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
                return self.cost_of_form(mode, *age, moved)
                    + self.cost_of_place(mode, *age, moved, residual)
                    + velocity.map_or(0, |it| self.cost_of_velocity(mode, *age, it));
            }
            UpdatePayload::Keyframe(keyframe) => keyframe.bit_len() as u32 + INDEX_BITS,
            UpdatePayload::Resting {
                rest_correction, ..
            } => {
                let lengths = resting(rest_correction).map(|(_, step, _)| length(step));
                1 + lengths.iter().sum::<u32>()
            }
        };
        let mut cost = bits * BIT + code_cost(self.row(), UpdateForm::of(payload).code());
        each_number(payload, |context, number| {
            cost += self.cost_of_number(context, number);
        });
        cost
    }

    /// Of a correction, what says its form, its age, its parent and its push.
    fn cost_of_form(&self, mode: &PredictionMode, age: Age, moved: bool) -> u32 {
        let form = UpdateForm::of_mode(mode, moved);
        let context = contexts::age(form.kind());
        code_cost(self.row(), form.code())
            + self.cost_of_number(context, age.count() - 1)
            + self.cost_of_parent(mode)
    }

    /// Of a correction of this mode, what says position and turn.
    #[inline]
    fn cost_of_place(
        &self,
        mode: &PredictionMode,
        age: Age,
        moved: bool,
        residual: &Residual,
    ) -> u32 {
        let kind = UpdateForm::of_mode(mode, moved).kind();
        let class = contexts::age_class(age.count());
        let [x, y, z] = residual.position;
        let largest = x.unsigned_abs().max(y.unsigned_abs()).max(z.unsigned_abs());
        self.cost_of_three(contexts::position(kind, class), residual.position)
            + self.cost_of_three(contexts::turn(kind, class, largest), residual.turn)
    }

    /// Of a correction of this mode, what says velocities.
    #[inline]
    fn cost_of_velocity(
        &self,
        mode: &PredictionMode,
        age: Age,
        velocity: &VelocityResidual,
    ) -> u32 {
        let kind = UpdateForm::of_mode(mode, true).kind();
        let class = contexts::age_class(age.count());
        let velocity_exponent = contexts::velocity_exponent(kind, age.count());
        self.cost_of_number(velocity_exponent, velocity.velocity_exponent)
            + self.cost_of_three(contexts::velocity(kind, class, 2), velocity.linear)
            + self.cost_of_three(contexts::velocity(kind, class, 3), velocity.angular)
    }

    fn cost_of_parent(&self, mode: &PredictionMode) -> u32 {
        let age = |age: Age| self.cost_of_number(contexts::PARENT_AGE, age.count());
        match *mode {
            PredictionMode::Same => 0,
            PredictionMode::World { parent_age, .. } => {
                let push = mode.acceleration().map_or(0, |push| {
                    let steps = push.steps().map(i32::from);
                    self.cost_of_number(contexts::ACCELERATION_EXPONENT, push.exponent().into())
                        + self.cost_of_three(contexts::acceleration(), steps)
                });
                BIT + parent_age.map_or(0, age) + push
            }
            PredictionMode::Attached { parent, parent_age } => {
                let again = self.parent() == Some(parent);
                let named = if again { 1 } else { INDEX_BITS };
                named * BIT + age(parent_age)
            }
        }
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

/// What is nothing has no sign.
const fn sign(size: u32) -> u32 {
    if size == 0 { 0 } else { BIT }
}
