//! A member of a remote scene, without its sockets.
//!
//! The poses of the scene at any moment, clocks, body ids, and the way into the scene. Reads no system clock and opens
//! no socket: time is an argument, and the tracks come from a
//! [`rhumb_protocol::stream::Subscriber`]. `rhumb-client` and the client of browsers use it.
#![forbid(unsafe_code)]

mod client_ids;
mod clocks;
mod contacts;
#[cfg(feature = "queries")]
mod copy_queries;
mod gathered_view;
mod joining;
mod live_view;
mod moment;
mod shapes;
mod unanswered;
mod view;

pub use client_ids::{AddError, ClientIds};
pub use clocks::{DEPTH_MAX, InvalidTicks, SHIFT_TICKS_MAX, SceneClock, UpstreamClock};
pub use contacts::{Contacts, TouchingPair};
#[cfg(feature = "queries")]
pub use copy_queries::{CopyAnswer, CopyQueries};
pub use joining::{JoinError, JoinMode, Joining, RESUME_WITHIN, may_resume};
pub use live_view::{LiveView, PipelineDepth, ViewOptions};
pub use moment::RenderTime;
pub use shapes::BodyCentres;
pub use unanswered::{RefusalReason, RefusedRequest};
pub use view::{RenderParams, View};
