//! Rhumb's server: engines behind a trait, scenes, streams to members.
//!
//! Only `engine::rapier` uses the engine's types. Only `serve` has sockets, through the transport. `serve` and `log`
//! have clocks; all else gets the time as an argument or a function.
//! Invariants: a refused command changes nothing; a state that is not finite never leaves the engine.
//!
//! `rhumb-server` is this crate behind a command line ([`cli`]). A program that embeds it runs a [`Server`], and may
//! give scenes [`Hooks`] that push their bodies beside the engine. Logs go to `tracing`.
//!
//! # Example
//!
//! A server whose scenes of some names have a wind.
//!
//! ```no_run
//! use rhumb_server::glam::Vec3;
//! use rhumb_server::{Access, BodyKind, Command, Hook, Hooks, Identity, Scene, Server, Stop};
//!
//! /// Called before each step.
//! fn blow(scene: &Scene, out: &mut Vec<Command>) {
//!     let dynamic = scene.bodies().filter(|body| body.kind == BodyKind::Dynamic);
//!     out.extend(dynamic.map(|body| Command::Force { id: body.id, force: Vec3::X }));
//! }
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let listen = "127.0.0.1:4433".parse()?;
//! let mut server = Server::bind(listen, &Identity::Development, Access::OpenOnLoopback)?;
//! server.attach(Hooks::new(|name, _config| {
//!     let windy = name.as_str().starts_with("windy/");
//!     windy.then(|| Hook::new(blow))
//! }));
//! println!("listening on {}, fingerprint {}", server.address(), server.fingerprint());
//!
//! // A clone can stop the server from any other thread.
//! let stop = Stop::new();
//! let statistics = server.run(&stop)?;
//! println!("{} connections in all", statistics.opened);
//! # Ok(())
//! # }
//! ```
#![cfg_attr(not(feature = "box3d"), forbid(unsafe_code))]
#![deny(unsafe_code)]

mod access;
mod announcement;
#[cfg(feature = "app")]
mod app_arguments;
#[cfg(feature = "app")]
mod app_host;
mod authority_table;
mod baking;
mod body_placement;
pub mod cli;
mod command_line;
mod command_log;
#[cfg(feature = "demo")]
mod demo;
mod digest;
mod durable;
mod empty_scenes;
pub mod engine;
mod event_monitor;
mod flight;
mod front;
mod grants;
mod hook;
mod http;
mod journal;
mod limits;
mod load;
mod log;
mod member;
mod metrics;
mod observer;
mod outbox;
mod over_budget;
mod provided;
mod pulse;
mod query_budget;
mod record;
mod recorders;
mod recording;
mod registry;
mod rewind;
mod rights;
mod scene;
mod scene_connection;
mod scene_runner;
mod scene_slots;
mod serve;
mod server_loop;
mod sessions;
mod settings;
mod snapshot;
mod start_check;
mod stream_names;
mod streams;
mod tier_controller;
mod times;
mod token_command;
#[cfg(feature = "top")]
mod top;
#[cfg(feature = "view")]
mod view;

pub use access::{KeyError, TokenKeys};
#[cfg(feature = "app")]
#[doc(hidden)]
pub use app_host::AppScenes;
pub use authority_table::UpstreamStatistics;
pub use baking::{BakeJob, Bakers};
pub use command_log::{CommandLog, Frozen, RestoredScene, SceneStore};
pub use digest::Digest;
pub use durable::{Damage, DataDir, DataError};
pub use engine::{Workers, WorkersError};
pub use event_monitor::StepEvents;
pub use front::Front;
pub use glam;
pub use hook::{Hook, HookError, Hooks};
pub use journal::{Batch, Journal};
pub use limits::{InvalidLimit, LimitRow, Limits};
pub use load::ServerLoad;
pub use observer::{Incident, ObserveScenes, SceneObserver, TickFigures, Traffic, Unobserved};
pub use provided::{ProvidedScene, ProvidedScenes, SceneScript};
pub use pulse::Pulse;
pub use record::{Record, SessionNumber, decode_u64};
#[cfg(feature = "app")]
pub use rhumb_app;
pub use rhumb_protocol::message::RemovalCause;
pub use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, IdRange, Invalid, Joints, SceneConfig, SceneName,
    Shape, ShapeId,
};
pub use rhumb_protocol::stream::{Activity, Observation, SubscriberStatistics};
pub use rhumb_protocol::{Instant, Peer, Span};
pub use rhumb_reckoning::{BodyId, BodyState, Inertia, Metres, Tick, Tolerance};
pub use rhumb_transport::{
    BindError, CertificateError, CertificateHashes, Fingerprint, Origins, PageOrigin, ServeError,
    ServerStatistics, Stop,
};
pub use rights::{ClientName, Ownership, Permit, Quotas, decode_client_of, encode_client_of};
pub use scene::{FrozenScene, Scene, SceneFault, Stepped};
pub use scene_slots::SceneSlots;
pub use serve::{Access, Identity, RunError, Server, run_on_cores, usable_cores};
#[doc(hidden)]
pub use server_loop::OwnedScene;
pub use server_loop::ServerLoop;
pub use sessions::{ResumableSession, Sessions};
#[cfg(feature = "view")]
pub use view::{ViewError, ViewScene};
