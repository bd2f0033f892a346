//! A physics server and its clients in one process, without sockets.
//!
//! [`Local::local`] stands where `Client::connect` stands otherwise. Every later call is the same, so that a simulator
//! begins with its physics in its own process, and moves it to another machine by one line. The packets are those of
//! the network.
//!
//! A [`LocalServer`] steps on the thread of the client that waits for it, or on a thread of its own.
//!
//! | server | a lockstep frame | a pipelined frame | a free-running scene |
//! |---|---|---|---|
//! | [`LocalServer::new`] | no thread is woken | the caller steps | steps within calls of its clients |
//! | [`LocalServer::spawn`] | two threads are woken | steps beside the caller | steps at its own rate |
//!
//! # Example
//!
//! ```
//! use rhumb_client::scene::{BodyDesc, Shape};
//! use rhumb_client::{Client, PipelineDepth};
//! use rhumb_local::Local as _;
//!
//! # fn main() -> Result<(), rhumb_client::MainError> {
//! let mut client = Client::local().join("drop")?;
//! client.add_body(BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0))?;
//! let ball = client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0))?;
//! for _ in 0..180 {
//!     client.advance(PipelineDepth::LOCKSTEP)?;
//! }
//! let height = client.view().position(ball).ok_or("the ball is gone")?.y;
//! assert!((height - 0.5).abs() < 0.1, "{height}");
//! # Ok(())
//! # }
//! ```
#![forbid(unsafe_code)]

mod driver;
mod server;

use rhumb_client::{Client, ServerConnection};

pub use server::LocalServer;

/// Clients whose server is in the same process.
pub trait Local {
    /// Connects to a server of this client's own, which steps on the thread of the client's calls.
    fn local() -> ServerConnection;
}

impl Local for Client {
    fn local() -> ServerConnection {
        LocalServer::new().connect()
    }
}
