//! The paper's protocol, spoken to its existing clients (see `spec/APP.md`).
//!
//! A client leads a scene of its own, which members of this server may watch like any other: same engine, same checks,
//! same containment. Sockets are the transport's.

mod actor;
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
