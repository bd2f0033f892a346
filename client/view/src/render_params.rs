//! Parameters for computing a view.

use rhumb_reckoning::Seconds;

use crate::render_time::RenderTime;

/// Parameters for computing a view.
#[derive(Clone, Copy, Debug)]
pub struct RenderParams {
    /// The moment to show.
    pub at: RenderTime,
    /// The caller's own time, which times the smoothing of corrections.
    pub now: Seconds,
    /// True if corrections are smoothed.
    pub smooth: bool,
    /// The time from one tick to the next.
    pub step: Seconds,
}
