//! A remote physics scene, from a plain frame loop.
//!
//! No async in this interface: calls wait no longer than they are told, and nothing happens between them but that bytes
//! arrive. A [`Client`] is a member of one scene; open another for another scene.
//!
//! ```no_run
//! use rhumb_client::{Client, Depth, Entry, Options, Trust};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let fingerprint = std::env::var("RHUMB_FINGERPRINT")?.parse()?;
//! let options = Options::new("127.0.0.1:4433", Trust::Fingerprint(fingerprint), "pit".parse()?, Entry::Join);
//! let mut client = Client::open(options)?;
//! loop {
//!     client.advance(Depth::LOCKSTEP)?;
//!     let view = client.view();
//!     for place in view.changed() {
//!         println!("{} is at {}", view.ids()[place], view.positions()[place]);
//!     }
//! }
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
pub use happening::{Happening, Statistics};
pub use options::{Entry, Options};
pub use pump::Way;
pub use rhumb_protocol::message::{
    Denial, DriveError, Inspection, MoveCause, Moves, RemovalCause, StreamChoice,
};
pub use rhumb_protocol::scene;
pub use rhumb_protocol::stream::{Bound, Budget};
pub use rhumb_reckoning::{BodyId, Metres, Radians, Tick, Tolerance, Verbatim};
pub use rhumb_transport::{Fingerprint, Trust, WireStatistics};
pub use view::{Glass, View};
