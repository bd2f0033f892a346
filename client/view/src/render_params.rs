//! The parameters by which a view is computed.

use rhumb_reckoning::Seconds;

use crate::render_time::RenderTime;

/// How a view is computed.
#[derive(Clone, Copy, Debug)]
pub struct RenderParams {
    /// The moment to show.
    pub at: RenderTime,
    /// The caller's own time, for glides.
    pub now: Seconds,
    /// Whether to glide.
    pub smooth: bool,
}
