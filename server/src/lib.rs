//! A scene: an engine behind a trait, bodies, members, streams.
//!
//! The part that an integrator embeds. A [`SceneLoop`] is one scene with its clients, and a [`SceneRouter`] any number of
//! them. They are sans-IO: they have no sockets, threads, files or clock. A driver hands them what clients send, and
//! moments; they say what to transmit, and when to call them again ([`Endpoint`]). In one process the crate `rhumb-client`
//! drives them, and `rhumb-server` over a network.
//!
//! Only `engine::rapier` uses the engine's types. Invariants: a refused command changes nothing; a state that is not finite
//! never leaves the engine.
//!
//! [`Endpoint`]: rhumb_protocol::Endpoint
//!
//! # Example
//!
//! A scene without members: a ball falls on a floor.
//!
//! ```
//! use rhumb_protocol::scene::{BodyDesc, Command, SceneConfig, Shape, ShapeId};
//! use rhumb_reckoning::BodyId;
//! use rhumb_scene::Scene;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut scene = Scene::new(SceneConfig::default())?;
//! let floor = BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0);
//! let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 4.0, 0.0);
//! for (index, body) in [floor, ball].iter().enumerate() {
//!     let (id, shape) = (BodyId::new(index as u32, 0), ShapeId(index as u32));
//!     scene.apply(&Command::AddShape { id: shape, shape: body.shape().clone() })?;
//!     scene.apply(&Command::AddBody { desc: body.desc(id, shape), motion: body.state()? })?;
//! }
//! for _ in 0..120 {
//!     scene.step()?;
//! }
//! let ball = scene.observation(BodyId::new(1, 0)).ok_or("the ball is gone")?;
//! let [_, height, ..] = ball.motion.parts();
//! assert!((height - 0.5).abs() < 0.01);
//! # Ok(())
//! # }
//! ```
#![cfg_attr(not(feature = "box3d"), forbid(unsafe_code))]
#![deny(unsafe_code)]

mod baking;
mod bodies_by_cell;
mod checkpoint;
mod clients;
mod control_stream;
pub mod engine;
mod event_monitor;
mod feed;
mod greeting;
mod hook;
mod load;
mod member;
mod permit;
mod record;
mod registry;
mod rights;
mod router;
mod scene;
mod scene_loop;
mod sessions;
mod settings;
mod streams;
mod taken_cell;
mod tier_controller;

pub use baking::{BakeJob, Bakers};
pub use checkpoint::{Checkpoint, CheckpointError, replay};
#[doc(hidden)]
pub use control_stream::{ControlStream, PendingOutput};
pub use engine::{StepThreads, StepThreadsError};
#[doc(hidden)]
pub use event_monitor::EventKey;
pub use event_monitor::StepEvents;
pub use feed::{
    AnsweredBefore, FedRequest, FedVelocities, Feed, FeedTaken, Feeds, TICKS_APART_MAX,
};
pub use glam;
pub use greeting::{Greeted, Greeting};
pub use hook::{
    Hook, HookError, Hooks, Incident, ObserveScenes, SceneObserver, Traffic, Unobserved,
};
pub use load::{Admission, SceneSlots, ServerLoad, TenantLoads, tenant_of};
pub use member::UpstreamStatistics;
pub use permit::{ClientName, Ownership, Permit, Quotas, decode_client_of, encode_client_of};
pub use record::{
    AppliedCommand, Author, Batch, COMMAND_BYTES_KEPT, LogEntry, OpenedSession, PacketHead,
    ReceivedCommand, RunRecord, SessionNumber, TickMetrics, decode_u64,
};
pub use rhumb_protocol::message::RemovalCause;
pub use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, IdRange, Invalid, Joints, SceneConfig, SceneName,
    Shape, ShapeId,
};
pub use rhumb_protocol::stream::{Activity, Observation, SubscriberStatistics};
pub use rhumb_protocol::{Instant, Peer, Span};
pub use rhumb_reckoning::{BodyId, BodyState, Inertia, Metres, Tick, Tolerance};
pub use router::SceneRouter;
pub use scene::{Digest, FrozenScene, IMAGE_FORMAT, Scene, SceneFault, Stepped};
#[doc(hidden)]
pub use scene_loop::SceneLoop;
pub use sessions::{CommandLog, Frozen, RestoredScene, ResumableSession, SceneStore, Sessions};
pub use settings::{
    Heartbeat, InvalidLimit, LimitRow, Limits, ProvidedScene, ProvidedScenes, SceneScript,
    SceneSettings, SharedClock,
};
