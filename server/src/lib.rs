//! Rhumb's server: an engine behind a trait, scenes, what members hear.
//!
//! Reads no clock; only `engine::rapier` knows the engine's types, and only `serve` has sockets, by way of the transport.
//! Invariants: a refused command changes nothing; a state that is not finite never leaves the engine.
//!
//! `rhumb-server` is this behind a command line ([`cli`]). Whoever embeds it runs a [`Server`] in a program of its own, and
//! may give scenes [`Hooks`] that push their bodies beside the engine. What is logged goes to `tracing`.
//!
//! # Example
//!
//! A server whose scenes of some names have a wind.
//!
//! ```no_run
//! use rhumb_server::glam::Vec3;
//! use rhumb_server::{BodyKind, Command, Hook, Hooks, Identity, Scene, Server, Stop};
//!
//! /// Called before each step.
//! fn blow(scene: &Scene, out: &mut Vec<Command>) {
//!     let dynamic = scene.bodies().filter(|body| body.kind == BodyKind::Dynamic);
//!     out.extend(dynamic.map(|body| Command::Force { id: body.id, force: Vec3::X }));
//! }
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut server = Server::bind("127.0.0.1:4433".parse()?, &Identity::Development)?;
//! server.attach(Hooks::new(|name, _terms| {
//!     let windy = name.as_str().starts_with("windy/");
//!     windy.then(|| Hook::new(blow))
//! }));
//! println!("listening on {}, fingerprint {}", server.address(), server.fingerprint());
//!
//! // A clone may go to any other thread, and says there when it is to end.
//! let stop = Stop::new();
//! let statistics = server.run(&stop)?;
//! println!("{} connections in all", statistics.opened);
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

mod app;
mod arrears;
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
pub use glam;
pub use hook::{Hook, HookError, Hooks};
pub use host::Host;
pub use rhumb_protocol::message::RemovalCause;
pub use rhumb_protocol::scene::{
    BodyKind, BodyTerms, Command, CommandError, IdRange, Invalid, Joints, SceneName, SceneTerms,
    Shape, ShapeId,
};
pub use rhumb_protocol::stream::{Activity, Observation, SubscriberStatistics};
pub use rhumb_protocol::{Instant, Peer};
pub use rhumb_reckoning::{BodyId, Inertia, Metres, Tick, Tolerance, Verbatim};
pub use rhumb_transport::{
    AppBindError, AppListen, BindError, CertificateError, Fingerprint, ServeError,
    ServerStatistics, Stop,
};
pub use scene::{Scene, SceneFault, Stepped};
pub use serve::{Identity, RunError, Server, run_on_cores, usable_cores};
