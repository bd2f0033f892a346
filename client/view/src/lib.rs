//! The poses of a remote scene, and the clock that chooses the moment.
//!
//! Reads no system clock and opens no socket: time is an argument, and the tracks come from a
//! [`rhumb_protocol::stream::Subscriber`]. `rhumb-client` uses it.
#![forbid(unsafe_code)]

mod pipeline_depth;
mod render_params;
mod render_time;
mod scene_clock;
mod view;

pub use pipeline_depth::PipelineDepth;
pub use render_params::RenderParams;
pub use render_time::RenderTime;
pub use scene_clock::SceneClock;
pub use view::View;
