//! The control messages, reliable and in order (PROTOCOL 4).
mod client;
mod denial;
mod frame;
mod inertia;
mod inspection;
mod notice;
mod server;

pub use client::{ClientMessage, StreamChoice};
pub use denial::Denial;
pub use frame::{Framed, Frames, frame};
pub use inspection::{Inspection, StageTimes};
pub use notice::{Notice, RemovalCause};
pub use server::{Joined, ServerMessage, Welcome};

/// The versions of the protocol that this library speaks, newest first.
pub const VERSIONS: [u16; 1] = [1];
/// The first bytes that a client says.
pub const MAGIC: [u8; 4] = *b"RHMB";
