//! The common time axis of a trace.
//!
//! Log time is tick times step, from zero, so truth and all modes align.

use rhumb_reckoning::Rate;
use rhumb_trace::log_time_ns;

use super::options::TraceOptions;

/// Maps a load's ticks to log times and selects the ticks to draw.
#[derive(Clone, Copy, Debug)]
pub(super) struct Time {
    rate: Rate,
    stride: u64,
    rest_delay_s: f64,
}

impl Time {
    pub(super) fn of(rate: Rate, options: &TraceOptions) -> Self {
        let step_s = rate.step().seconds();
        Self {
            rate,
            stride: (1.0 / (step_s * options.scene_hz)).round().max(1.0) as u64,
            rest_delay_s: options.resting_after_s,
        }
    }

    /// Log time of a tick, nanoseconds.
    pub(super) fn at_ns(&self, tick: u64) -> u64 {
        log_time_ns(self.rate, tick)
    }

    /// True if a tick is to be drawn if `drawn` was the last drawn one.
    pub(super) const fn draws_after(&self, drawn: u64, tick: u64) -> bool {
        tick / self.stride > drawn / self.stride
    }

    /// Ticks that a body lies still before it is drawn on `resting`.
    pub(super) fn rest_delay_ticks(&self) -> u64 {
        (self.rest_delay_s / self.rate.step().seconds()).round() as u64
    }
}
