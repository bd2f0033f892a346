//! Stage two: what a correction costs for each tick that it holds.
//!
//! Bits are those at the beginning of a packet: what the packet's other updates have taught the coder is not known yet.

use rhumb_reckoning::{Predictor, Residual};

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
    /// Of the form, without velocities and with them.
    forms: [u32; 2],
    beside: Beside,
}

impl Cost {
    pub(super) fn new(
        mode: PredictionMode,
        predictor: Predictor,
        age: Age,
        beside: Beside,
    ) -> Self {
        let form = |moved| OVERHEAD + InitialCostModel.cost_of_form(&mode, age, moved);
        let still = form(false);
        let moves = predictor != Predictor::Rest;
        Self {
            mode,
            age,
            forms: [still, if moves { form(true) } else { still }],
            beside,
        }
    }

    /// Bits of a correction, in 1/256.
    pub(super) fn bits(&self, residual: &Residual) -> f64 {
        let form = self.forms[usize::from(residual.velocity.is_some())];
        f64::from(form + InitialCostModel.cost_of_residual(&self.mode, self.age, residual))
    }

    /// Bits for each tick: less is better.
    pub(super) fn price(&self, bits: f64, ticks: f64) -> f64 {
        if ticks > 0.0 {
            (self.beside.bits + bits) / (self.beside.ticks + ticks)
        } else {
            f64::INFINITY
        }
    }

    /// What the next correction of the same track costs, `age` later; this one's bits and ticks are paid.
    pub(super) fn following(&self, bits: f64, ticks: usize, age: Age) -> Self {
        let beside = Beside {
            bits: self.beside.bits + bits,
            ticks: self.beside.ticks + ticks as f64,
        };
        Self::new(PredictionMode::Same, Predictor::Rest, age, beside)
    }
}
