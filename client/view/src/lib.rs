//! A member of a remote scene, without its sockets.
//!
//! The poses of the scene at any moment, clocks, body ids, and the way into the scene. Reads no system clock and opens
//! no socket: time is an argument, and the tracks come from a
//! [`rhumb_protocol::stream::Subscriber`]. `rhumb-client` and the client of browsers use it.
#![forbid(unsafe_code)]

mod add_error;
mod body_centres;
mod client_ids;
#[cfg(feature = "queries")]
mod copy_queries;
mod id_allocator;
mod invalid_ticks;
mod joining;
mod jump;
mod live_view;
mod moment;
mod own_bodies;
mod pipeline_depth;
mod refusal;
mod render_params;
mod render_time;
mod resumption;
mod scene_clock;
mod shape_clashes;
mod shape_numbers;
mod shown_bound;
mod unanswered;
mod upstream_clock;
mod view;

pub use add_error::AddError;
pub use body_centres::BodyCentres;
pub use client_ids::ClientIds;
#[cfg(feature = "queries")]
pub use copy_queries::{CopyAnswer, CopyQueries};
pub use invalid_ticks::InvalidTicks;
pub use joining::{JoinError, JoinMode, Joining};
pub use live_view::{LiveView, ViewOptions};
pub use pipeline_depth::PipelineDepth;
pub use refusal::{RefusalReason, RefusedRequest};
pub use render_params::RenderParams;
pub use render_time::RenderTime;
pub use resumption::{RESUME_WITHIN, may_resume};
pub use scene_clock::SceneClock;
pub use upstream_clock::UpstreamClock;
pub use view::View;
