//! The estimated cost of an update payload, in 1/256 bits.
//!
//! Not normative and without effect on the coder. The mode decision compares costs, and a writer checks that an update
//! fits.

use rhumb_reckoning::{Residual, VelocityResidual};

use super::keyframe::INDEX_BITS;
use super::model::{code_cost, opening_cost};
use super::payload::{
    Age, PredictionMode, UpdateCoder, UpdateForm, UpdatePayload, each_number, length, resting,
};
use super::tables::contexts;
use super::tables::contexts::TripleContexts;

/// The cost of one raw bit.
const BIT: u32 = 256;

/// The coder's state at the start of a packet. The mode decision does not know which updates will precede its own.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InitialCostModel;

/// The state of the coder by which costs are estimated.
pub(crate) trait CostModel {
    /// The cost of a number in a context.
    fn cost_of_number(&self, context: usize, number: u32) -> u32;

    /// The row of frequencies for an update's form.
    fn row(&self) -> usize;

    /// The parent of the last attached body.
    fn parent(&self) -> Option<u32>;

    /// The cost of three consecutive numbers with their signs.
    #[inline]
    fn cost_of_three(&self, contexts: TripleContexts, numbers: [i32; 3]) -> u32 {
        // Written out, because `map` of an array is not inlined here.
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

    /// The cost of this payload as the next one, without its alias gap.
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
                    + self.cost_of_place(residual)
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

    /// The cost of a correction's form, age, parent and acceleration.
    #[inline]
    fn cost_of_form(&self, mode: &PredictionMode, age: Age, moved: bool) -> u32 {
        let form = UpdateForm::of_mode(mode, moved);
        let context = contexts::age(form.kind());
        code_cost(self.row(), form.code())
            + self.cost_of_number(context, age.count() - 1)
            + self.cost_of_parent(mode)
    }

    /// The cost of the position and rotation in a correction.
    #[inline]
    fn cost_of_place(&self, residual: &Residual) -> u32 {
        let [x, y, z] = residual.position;
        let largest = x.unsigned_abs().max(y.unsigned_abs()).max(z.unsigned_abs());
        self.cost_of_three(contexts::POSITIONS, residual.position)
            + self.cost_of_three(contexts::turn(largest), residual.turn)
    }

    /// The cost of the velocities in a correction of this mode.
    #[inline]
    fn cost_of_velocity(
        &self,
        mode: &PredictionMode,
        age: Age,
        velocity: &VelocityResidual,
    ) -> u32 {
        let kind = UpdateForm::of_mode(mode, true).kind();
        let age = age.count();
        let velocity_exponent = contexts::velocity_exponent(kind, age);
        self.cost_of_number(velocity_exponent, velocity.velocity_exponent)
            + self.cost_of_three(contexts::velocity(kind, age, 2), velocity.linear)
            + self.cost_of_three(contexts::velocity(kind, age, 3), velocity.angular)
    }

    fn cost_of_parent(&self, mode: &PredictionMode) -> u32 {
        let age = |age: Age| self.cost_of_number(contexts::PARENT_AGE, age.count());
        match *mode {
            PredictionMode::Same => 0,
            PredictionMode::World { parent_age, .. } => {
                let acceleration = mode.acceleration().map_or(0, |acceleration| {
                    let steps = acceleration.steps().map(i32::from);
                    self.cost_of_number(
                        contexts::ACCELERATION_EXPONENT,
                        acceleration.exponent().into(),
                    ) + self.cost_of_three(contexts::acceleration(), steps)
                });
                BIT + parent_age.map_or(0, age) + acceleration
            }
            PredictionMode::Attached { parent, parent_age } => {
                let same = self.parent() == Some(parent);
                let parent_bits = if same { 1 } else { INDEX_BITS };
                parent_bits * BIT + age(parent_age)
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

/// Zero has no sign bit.
const fn sign(size: u32) -> u32 {
    if size == 0 { 0 } else { BIT }
}
