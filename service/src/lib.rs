//! Rhumb's server: scenes as a service, with sockets, threads and tokens.
//!
//! The scenes themselves are `rhumb-scene`. Only `serve` has sockets, through the transport. `serve` and `log` have clocks;
//! all else gets the time as an argument or a function.
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
//! server.scenes.hooks = Some(Hooks::new(|name, _config| {
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
#![forbid(unsafe_code)]

mod access;
mod agones;
pub mod cli;
#[cfg(feature = "demo")]
mod demo;
mod directory;
mod dispatcher;
mod durable;
mod edge;
mod flight;
mod http;
mod log;
mod metrics;
#[cfg(feature = "view")]
mod page_beside;
mod recording;
mod serve;
mod settings;
mod signals;
mod start;
mod token_command;
#[cfg(feature = "top")]
mod top;
#[cfg(feature = "view")]
mod view;

pub use access::{InvalidKeyFile, KeyError, KeyFile, TokenKeys};
pub use dispatcher::{Checkpoints, Dispatcher, DispatcherSettings};
pub use durable::{Damage, DataDir, DataError};
pub use edge::{Deliver, EdgeArguments, FanOut, FanOutSide, run_shared_edge};
#[cfg(feature = "view")]
pub use page_beside::PageBeside;
#[cfg(feature = "foxglove")]
pub use recording::ViewersError;
#[cfg(feature = "app")]
pub use rhumb_app;
pub use rhumb_edge::{SharedPacket, SharedStream};
pub use rhumb_scene::{
    Activity, BakeJob, Bakers, BodyDesc, BodyId, BodyKind, BodyState, Checkpoint, CheckpointError,
    Command, CommandError, Digest, Hook, HookError, Hooks, IdRange, Inertia, Instant, Invalid,
    InvalidLimit, Joints, Limits, Metres, Observation, Peer, ProvidedScene, ProvidedScenes,
    RemovalCause, Scene, SceneConfig, SceneFault, SceneName, SceneRouter, SceneScript,
    SceneSettings, Shape, ShapeId, Span, StepEvents, StepThreads, StepThreadsError, Stepped,
    SubscriberStatistics, Tick, Tolerance, UpstreamStatistics, engine, glam,
};
pub use rhumb_transport::{
    BindError, CertificateError, CertificateHashes, Fingerprint, Origins, PageOrigin, ServeError,
    ServerStatistics, Stop, Waker, outward_ip,
};
pub use serve::{Access, Identity, RunError, Server, run_on_cores, usable_cores};
#[cfg(feature = "view")]
pub use view::{ViewError, ViewScene};
