//! Stage two: what a correction costs for each tick that it holds.
//!
//! Bits are those at the beginning of a packet: what the packet's other updates have taught the coder is not known yet.

use rhumb_reckoning::{Residual, VelocityResidual};

use crate::packet::{Age, CostModel, InitialCostModel, PredictionMode};

/// What an update costs beside its payload: its place in the packet, in 1/256 bits.
const OVERHEAD: u32 = 4 * 256;

/// What is paid beside a correction, and for how many ticks that holds: in 1/256 bits.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Beside {
    pub(super) bits: f64,
    pub(super) ticks: f64,
}

impl Beside {
    /// Assumed cost (15 bits) and lifetime (2.5 ticks) of the update that follows what lookahead knows. Without it, short and cheap updates
    /// always win.
    pub(super) const NEXT: Self = Self {
        bits: 15.0 * 256.0,
        ticks: 2.5,
    };
}

/// What the corrections of one prediction mode cost.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cost {
    mode: PredictionMode,
    /// Of the track that is corrected.
    age: Age,
    beside: Beside,
}

impl Cost {
    pub(super) const fn new(mode: PredictionMode, age: Age, beside: Beside) -> Self {
        Self { mode, age, beside }
    }

    /// Of a correction, in 1/256 bits.
    pub(super) fn bits(&self, residual: &Residual) -> u32 {
        let moved = residual.velocity.is_some();
        let velocity = residual.velocity.as_ref();
        self.of_form(moved)
            + self.of_place(residual, moved)
            + velocity.map_or(0, |velocity| self.of_velocity(velocity))
    }

    /// Whether the mode is another than the track's.
    pub(super) const fn changes(&self) -> bool {
        !matches!(self.mode, PredictionMode::Same)
    }

    /// Of the form, with velocities or without, and of a place in the packet.
    pub(super) fn of_form(&self, moved: bool) -> u32 {
        OVERHEAD + InitialCostModel.cost_of_form(&self.mode, self.age, moved)
    }

    /// Of position and turn.
    pub(super) fn of_place(&self, residual: &Residual, moved: bool) -> u32 {
        InitialCostModel.cost_of_place(&self.mode, self.age, moved, residual)
    }

    /// Of velocities.
    pub(super) fn of_velocity(&self, velocity: &VelocityResidual) -> u32 {
        InitialCostModel.cost_of_velocity(&self.mode, self.age, velocity)
    }

    /// Bits for each tick: less is better.
    pub(super) fn price(&self, bits: u32, ticks: f64) -> f64 {
        if ticks > 0.0 {
            (self.beside.bits + f64::from(bits)) / (self.beside.ticks + ticks)
        } else {
            f64::INFINITY
        }
    }

    /// What the next correction of the same track costs, `age` later; this one's bits and ticks are paid.
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
    fn a_price_is_bits_for_each_tick_and_what_does_not_hold_has_none() {
        let cost = Cost::new(PredictionMode::Same, Age::new(3), Beside::default());
        let bits = cost.bits(&Residual::default());
        assert!(bits > OVERHEAD);
        assert_eq!(cost.price(bits, 4.0), f64::from(bits) / 4.0);
        assert_eq!(cost.price(bits, 0.0), f64::INFINITY);
        let next = cost.following(bits, 4, Age::new(4));
        assert_eq!(next.price(bits, 4.0), f64::from(bits) / 4.0);
    }
}
