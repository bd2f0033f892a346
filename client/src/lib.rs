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
//! use rhumb_client::scene::{BodyKind, BodyTerms, Cadence, Command, Material, Pace, SceneTerms, Shape, ShapeId};
//! use rhumb_client::{Client, Damping, Depth, Entry, Integrator, Options, Rate, Trust, Verbatim};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let terms = SceneTerms {
//!     integrator: Integrator { rate: Rate::HZ_60, substeps: NonZeroU32::MIN },
//!     gravity: Vec3::new(0.0, -9.81, 0.0),
//!     pace: Pace::Lockstep,
//!     material: Material { friction: 0.5, restitution: 0.0, density: 1_000.0 },
//!     damping: Damping::default(),
//!     sleep: None,
//!     cadence: Cadence::EACH_TICK,
//! };
//! let trust = Trust::Fingerprint(std::env::var("RHUMB_FINGERPRINT")?.parse()?);
//! let entry = Entry::CreateOrJoin(terms);
//! let mut client = Client::open(Options::new("127.0.0.1:4433", trust, "pit".parse()?, entry))?;
//!
//! let ball = client.granted().id(0).ok_or("the server granted no indices")?;
//! let terms = BodyTerms::plain(ball, BodyKind::Dynamic, ShapeId(0));
//! let motion = Verbatim::new([0.0, 100.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])?;
//! client.command(Command::AddShape { id: ShapeId(0), shape: Shape::Ball { radius: 0.5 } })?;
//! client.command(Command::AddBody { terms, motion })?;
//! for _ in 0..300 {
//!     client.advance(Depth::LOCKSTEP)?;
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
//! use rhumb_client::{BodyId, Client, ClientError, Tolerance, Verbatim};
//!
//! # fn frame() -> Verbatim { unreachable!() }
//! # fn run(client: &mut Client, avatar: BodyId) -> Result<(), ClientError> {
//! client.drive(&[avatar], Tolerance::FINE)?;
//! loop {
//!     // Where the avatar is now, and how it moves.
//!     client.publish(&[(avatar, frame())])?;
//!     client.follow()?;
//!     // Draw client.view() …
//! }
//! # }
//! ```
#![forbid(unsafe_code)]

mod client;
mod clock;
mod depth;
mod error;
mod happening;
mod options;
mod pump;
mod view;

pub use client::Client;
pub use clock::DisplayTime;
pub use depth::Depth;
pub use error::{ClientError, OpenError};
pub use glam;
pub use happening::{Happening, Statistics};
pub use options::{Entry, Options};
pub use pump::Way;
pub use rhumb_protocol::Ending;
pub use rhumb_protocol::message::{
    Denial, DriveError, Inspection, MoveCause, Moves, RemovalCause, StageTimes, StreamChoice,
};
pub use rhumb_protocol::scene;
pub use rhumb_protocol::session::{CloseCode, Misuse, Replica};
pub use rhumb_protocol::stream::{
    Bound, Budget, PublisherStatistics, Subscriber, SubscriberStatistics,
};
pub use rhumb_reckoning::{
    BodyId, Class, Damping, Integrator, InvalidMotion, InvalidTolerance, LengthBound, Metres,
    Radians, Rate, Seconds, Tick, Ticks, Tolerance, TurnBound, Verbatim,
};
pub use rhumb_transport::{
    CertificateError, ConnectError, Fingerprint, FingerprintError, TransportCode, Trust,
    WireStatistics,
};
pub use view::{Glass, View};
