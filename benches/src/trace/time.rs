//! The one time axis of a trace.
//!
//! Log time is tick times step from zero, so that truth and every mode lie above each other.

use super::TraceOptions;
use crate::record::RunConfig;

/// How a load's ticks become moments, and which of them are drawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Time {
    step_s: f64,
    stride: u64,
    rest_delay_s: f64,
}

impl Time {
    pub(super) fn of(config: &RunConfig, options: &TraceOptions) -> Self {
        Self {
            step_s: config.step_s,
            stride: (1.0 / (config.step_s * options.scene_hz)).round().max(1.0) as u64,
            rest_delay_s: options.resting_after_s,
        }
    }

    /// The moment of a tick, nanoseconds.
    pub(super) fn at_ns(&self, tick: u64) -> u64 {
        (tick as f64 * self.step_s * 1e9).round() as u64
    }

    /// Whether a tick is to be drawn when `drawn` was the last.
    pub(super) const fn draws_after(&self, drawn: u64, tick: u64) -> bool {
        tick / self.stride > drawn / self.stride
    }

    /// How long a body lies still before it is drawn among those at rest.
    pub(super) fn rest_delay_ticks(&self) -> u64 {
        (self.rest_delay_s / self.step_s).round() as u64
    }
}
