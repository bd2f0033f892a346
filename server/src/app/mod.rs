//! Server of the APP protocol, for its existing clients (`spec/APP.md`).
//!
//! Each APP client leads a scene of its own, which other members of this server may subscribe to: same engine, same
//! checks, same containment. The transport owns the sockets.

mod actor;
mod endpoint;
mod form;
mod frame_clock;
mod guest;
mod guests;
mod joint;
mod lead;
mod lifting;
mod names;
mod options;
mod outline;
mod realise;
mod refusal;
mod send_queue;
mod shape_cache;
mod state_reporter;
mod world_mirror;

pub(crate) use guests::Guests;
pub use options::{AppOptions, Datagrams, States, TimeAdvanced};
