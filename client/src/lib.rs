//! A remote physics scene, from a plain frame loop.
//!
//! No async in this interface: each call says for how long it may wait, and nothing happens between them but that bytes
//! arrive. [`Options::patience`] bounds each answer that a call waits for; [`Client::open`] waits for several, and for the
//! system to resolve the server's name. A [`Client`] is a member of one scene; open another for another scene.
//!
//! This crate is all that a simulator needs to name: what its calls take and give of the others, and [`glam`], is here too.
//!
//! # Example
//!
//! Drops a ball for five seconds, into a scene that it begins unless it is there.
//!
//! ```no_run
//! use std::num::NonZeroU32;
//!
//! use rhumb_client::glam::Vec3;
//! use rhumb_client::scene::{BodyKind, BodyDesc, PublishSchedule, Command, Material, Stepping, SceneConfig, Shape, ShapeId};
//! use rhumb_client::{Client, Damping, PipelineDepth, JoinMode, Integrator, Options, Rate, Trust, BodyState};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let config = SceneConfig {
//!     integrator: Integrator { rate: Rate::HZ_60, substeps: NonZeroU32::MIN },
//!     gravity: Vec3::new(0.0, -9.81, 0.0),
//!     stepping: Stepping::Lockstep,
//!     material: Material { friction: 0.5, restitution: 0.0, density: 1_000.0 },
//!     damping: Damping::default(),
//!     sleep: None,
//!     publish_schedule: PublishSchedule::EACH_TICK,
//! };
//! let trust = Trust::Fingerprint(std::env::var("RHUMB_FINGERPRINT")?.parse()?);
//! let join_mode = JoinMode::CreateOrJoin(config);
//! let mut client = Client::open(Options::new("127.0.0.1:4433", trust, "pit".parse()?, join_mode))?;
//!
//! let ball = client.granted().id(0).ok_or("the server granted no indices")?;
//! let config = BodyDesc::plain(ball, BodyKind::Dynamic, ShapeId(0));
//! let motion = BodyState::new([0.0, 100.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])?;
//! client.command(Command::AddShape { id: ShapeId(0), shape: Shape::Ball { radius: 0.5 } })?;
//! client.command(Command::AddBody { config, motion })?;
//! for _ in 0..300 {
//!     client.advance(PipelineDepth::LOCKSTEP)?;
//!     let view = client.view();
//!     for place in view.changed() {
//!         println!("{} is at {}", view.ids()[place], view.positions()[place]);
//!     }
//! }
//! # Ok(())
//! # }
//! ```
//!
//! What the caller's simulator moves itself, it drives: it says so once, and where the bodies are in each frame.
//!
//! ```no_run
//! use rhumb_client::{BodyId, Client, ClientError, Tolerance, BodyState};
//!
//! # fn frame() -> BodyState { unreachable!() }
//! # fn run(client: &mut Client, avatar: BodyId) -> Result<(), ClientError> {
//! client.take_authority(&[avatar], Tolerance::FINE)?;
//! loop {
//!     // Where the avatar is now, and how it moves.
//!     client.publish(&[(avatar, frame())])?;
//!     client.poll()?;
//!     // Draw client.view() …
//! }
//! # }
//! ```
#![forbid(unsafe_code)]

mod client;
mod client_event;
mod clock;
mod error;
mod options;
mod pipeline_depth;
mod pump;
mod view;

pub use client::Client;
pub use client_event::{ClientEvent, Statistics};
pub use clock::RenderTime;
pub use error::{ClientError, OpenError};
pub use glam;
pub use options::{JoinMode, Options};
pub use pipeline_depth::PipelineDepth;
pub use pump::TapChannel;
pub use rhumb_protocol::Ending;
pub use rhumb_protocol::message::{
    AuthorityError, Denial, Inspection, RemovalCause, StageTimes, StreamChoice, TierChangeCause,
    TierPolicy,
};
pub use rhumb_protocol::scene;
pub use rhumb_protocol::session::{CloseCode, Misuse, Replica};
pub use rhumb_protocol::stream::{
    Budget, ErrorBound, PublisherStatistics, Subscriber, SubscriberStatistics,
};
pub use rhumb_reckoning::{
    BodyId, BodyState, Damping, Integrator, InvalidMotion, InvalidTolerance, LengthBound, Metres,
    Radians, Rate, Seconds, Tick, Ticks, Tolerance, ToleranceScale, TurnBound,
};
pub use rhumb_transport::{
    CertificateError, ConnectError, Fingerprint, FingerprintError, TransportCode, Trust,
    WireStatistics,
};
pub use view::{RenderParams, View};
