//! Rhumb's server: an engine behind a trait, scenes, what members hear.
//!
//! Reads no clock; only `engine::rapier` knows the engine's types, and only `serve` has sockets, by way of the transport.
//! Invariants: a refused command changes nothing; a state that is not finite never leaves the engine.
#![forbid(unsafe_code)]

mod app;
pub mod cli;
mod digest;
mod drives;
pub mod engine;
mod grants;
mod hook;
mod host;
mod member;
mod outbox;
mod placing;
mod registry;
mod room;
mod scene;
mod serve;
mod snapshot;
mod stream_names;
mod streams;
mod thin_link;
mod times;

pub use app::{AppOptions, Datagrams, States, TimeAdvanced};
pub use digest::Digest;
pub use drives::DriveStatistics;
pub use engine::{NoWorkers, Workers};
pub use hook::{Hook, HookError, Hooks};
pub use host::Host;
pub use scene::{Scene, SceneFault, Stepped};
pub use serve::{Identity, RunError, Server, run_on_cores, usable_cores};
