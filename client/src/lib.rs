//! Client of a remote physics scene, for a plain frame loop.
//!
//! No call of this interface is async. A call returns at once or within the client's timeout; between calls only bytes
//! arrive. A [`Client`] is a member of one scene; connect again for another scene.
//!
//! A simulator needs no other crate: this crate re-exports the types of its calls, and [`glam`].
//!
//! | feature | adds |
//! |---|---|
//! | `quic` (default) | `Client::connect`: servers over the network, and over Unix sockets |
//! | `local` | `Client::local` and `LocalServer`: a server in the same process, without sockets |
//! | `queries` | queries on the client's own copy |
//! | `nalgebra` | glam's conversions from and to the types of that crate; those of `mint` are always there |
//!
//! # Example
//!
//! Drops a ball on a floor, and prints where it is after each tick.
//!
//! ```no_run
//! use rhumb_client::scene::{BodyDesc, Shape};
//! use rhumb_client::{Client, PipelineDepth, Trust};
//!
//! # fn main() -> Result<(), rhumb_client::MainError> {
//! let trust = Trust::Fingerprint(std::env::var("RHUMB_FINGERPRINT")?.parse()?);
//! let mut client = Client::connect("127.0.0.1:4433", trust)?.join("drop")?;
//! client.add_body(BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0))?;
//! let ball = client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0))?;
//! for _ in 0..180 {
//!     let tick = client.advance(PipelineDepth::LOCKSTEP)?;
//!     println!("{tick}: {:?}, {:?}", client.view().position(ball), client.error_bound(ball));
//! }
//! # Ok(())
//! # }
//! ```
//!
//! A client has authority over the bodies that its own simulator moves: it requests authority once, and publishes them
//! in each frame.
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
//!     for (_tick, event) in std::iter::from_fn(|| client.poll_event()) {
//!         println!("{event:?}");
//!     }
//!     // Draw client.view() …
//! }
//! # }
//! ```
#![forbid(unsafe_code)]

mod client;
mod connection;
mod error;
#[cfg(feature = "local")]
mod feeding;
mod join_options;
#[cfg(feature = "local")]
mod local;
#[cfg(feature = "quic")]
mod network;
mod server_connection;

pub use client::Client;
pub use connection::{Statistics, TapChannel};
pub use error::{
    ClientError, FedQuantity, FeedError, MainError, OpenError, OutOfRange, RefusedRequests,
};
pub use glam;
pub use join_options::{JoinOptions, Refusals};
#[cfg(feature = "local")]
pub use local::{LocalPeers, LocalServer, WithLocalPeers, is_local_peer};
#[cfg(feature = "quic")]
pub use rhumb_link::{CertificateError, ConnectError, Fingerprint, FingerprintError, Trust};
pub use rhumb_link::{ClientTransport, Received, TransportCode, WireStatistics};
pub use rhumb_protocol::message::{
    AuthorityError, Denial, Inspection, InvalidToken, QueryError, QueryResult, RemovalCause,
    StageTimes, StreamChoice, TierChangeCause, TierPolicy,
};
pub use rhumb_protocol::session::{CellState, CloseCode, Event, Misuse, Replica};
pub use rhumb_protocol::stream::{
    Budget, ErrorBound, PublisherStatistics, Subscriber, SubscriberStatistics,
};
pub use rhumb_protocol::{Ending, scene};
pub use rhumb_reckoning::{
    BodyId, BodyState, Damping, Integrator, InvalidMotion, InvalidTolerance, LengthBound, Metres,
    Radians, Rate, Seconds, Tick, Ticks, Tolerance, ToleranceScale, TurnBound,
};
#[cfg(feature = "local")]
pub use rhumb_scene::{Checkpoint, CheckpointError, FedRequest, FedVelocities, Peer};
pub use rhumb_view::{
    BodyCentres, DEPTH_MAX, InvalidTicks, JoinMode, PipelineDepth, RESUME_WITHIN, RefusalReason,
    RefusedRequest, RenderParams, RenderTime, SHIFT_TICKS_MAX, TouchingPair, View,
};
#[cfg(feature = "queries")]
pub use rhumb_view::{CopyAnswer, CopyQueries};
pub use server_connection::ServerConnection;
