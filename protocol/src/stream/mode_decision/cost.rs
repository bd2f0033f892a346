//! Stage two: the cost of a correction per tick of its lifetime.
//!
//! The coder's state is that at the start of a packet, because the packet's other updates are not known yet.

use rhumb_reckoning::{Residual, VelocityResidual};

use crate::packet::{Age, CostModel, InitialCostModel, PredictionMode};

/// Cost of an update's alias gap in the packet, in 1/256 bits.
const OVERHEAD: u32 = 4 * 256;

/// Cost of other updates that is added to a correction's, in 1/256 bits, and their lifetime in ticks.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Beside {
    pub(super) bits: f64,
    pub(super) ticks: f64,
}

impl Beside {
    /// Assumed cost (15 bits) and lifetime (2.5 ticks) of the update after the lookahead. Without it, short and cheap
    /// updates always win.
    pub(super) const NEXT: Self = Self {
        bits: 15.0 * 256.0,
        ticks: 2.5,
    };
}

/// Cost function of the corrections of one prediction mode.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cost {
    mode: PredictionMode,
    /// Age of the corrected track.
    age: Age,
    beside: Beside,
}

impl Cost {
    pub(super) const fn new(mode: PredictionMode, age: Age, beside: Beside) -> Self {
        Self { mode, age, beside }
    }

    /// Cost of a correction, in 1/256 bits.
    pub(super) fn bits(&self, residual: &Residual) -> u32 {
        let velocity = residual.velocity.as_ref();
        self.of_form(velocity.is_some())
            + Self::of_place(residual)
            + velocity.map_or(0, |velocity| self.of_velocity(velocity))
    }

    /// Cost of the form, with or without velocities, and of the alias gap.
    pub(super) fn of_form(&self, moved: bool) -> u32 {
        OVERHEAD + InitialCostModel.cost_of_form(&self.mode, self.age, moved)
    }

    /// Cost of position and turn, the same for all modes.
    pub(super) fn of_place(residual: &Residual) -> u32 {
        InitialCostModel.cost_of_place(residual)
    }

    /// Cost of velocities.
    pub(super) fn of_velocity(&self, velocity: &VelocityResidual) -> u32 {
        InitialCostModel.cost_of_velocity(&self.mode, self.age, velocity)
    }

    /// Cost per tick; infinite for a correction that does not hold.
    pub(super) fn price(&self, bits: u32, ticks: f64) -> f64 {
        if ticks > 0.0 {
            (self.beside.bits + f64::from(bits)) / (self.beside.ticks + ticks)
        } else {
            f64::INFINITY
        }
    }

    /// Cost function of the next correction of the same track, `age` later; it includes the bits and ticks of this one.
    pub(super) fn following(&self, bits: u32, ticks: usize, age: Age) -> Self {
        let beside = Beside {
            bits: self.beside.bits + f64::from(bits),
            ticks: self.beside.ticks + ticks as f64,
        };
        Self::new(PredictionMode::Same, age, beside)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_price_is_bits_per_tick_and_infinite_without_a_lifetime() {
        let cost = Cost::new(PredictionMode::Same, Age::new(3), Beside::default());
        let bits = cost.bits(&Residual::default());
        assert!(bits > OVERHEAD);
        assert_eq!(cost.price(bits, 4.0), f64::from(bits) / 4.0);
        assert_eq!(cost.price(bits, 0.0), f64::INFINITY);
        let next = cost.following(bits, 4, Age::new(4));
        assert_eq!(next.price(bits, 4.0), f64::from(bits) / 4.0);
    }
}
