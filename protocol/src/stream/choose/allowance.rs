//! What a tolerance allows a body, to reckon expected errors by.
//!
//! For who chooses alone: the promise is judged by [`Tolerance::share`].

use rhumb_reckoning::{Metres, Tolerance};

/// What a tolerance allows a body.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ToleranceAllowance {
    /// Metres, and radians.
    pub(super) position: f64,
    pub(super) turn: f64,
    /// Whether both share one bound.
    pub(super) shared: bool,
}

impl ToleranceAllowance {
    pub(crate) fn of(tolerance: Tolerance, radius: Metres) -> Self {
        match tolerance {
            Tolerance::Surface(length) => {
                let length = length.metres().metres();
                Self {
                    position: length,
                    turn: length / radius.metres(),
                    shared: true,
                }
            }
            Tolerance::Parts { position, turn } => Self {
                position: position.metres().metres(),
                turn: turn.radians().radians(),
                shared: false,
            },
        }
    }

    /// The same for tolerances so many times as wide.
    pub(super) fn loosened(self, factor: f64) -> Self {
        Self {
            position: self.position * factor,
            turn: self.turn * factor,
            ..self
        }
    }

    /// Of an error in metres and one in radians.
    pub(crate) fn share(&self, position: f64, turn: f64) -> f64 {
        let (position, turn) = (position / self.position, turn / self.turn);
        if self.shared {
            position + turn
        } else {
            position.max(turn)
        }
    }
}
