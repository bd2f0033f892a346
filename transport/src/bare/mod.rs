//! QUIC ends without manners, for who tries others: they do as they are told.
//!
//! No part of a session: nothing is bounded but by how long a trial lasts, nothing is repaired, and every end that is
//! seen is told as it was seen. What a line says and hears is the caller's matter, down to its streams.

mod client;
mod line;
mod server;
mod terms;

pub use line::{BareEnd, BareLine, Seen};
pub use server::BareServer;
pub use terms::{BareError, BareTerms};
