//! The control messages, reliable and in order (PROTOCOL 4).
mod choice;
mod client;
mod denial;
mod drive;
mod extensions;
mod frame;
mod grease;
mod inertia;
mod inspection;
mod moving;
mod notice;
mod server;

pub use choice::StreamChoice;
pub use client::ClientMessage;
pub use denial::Denial;
pub use drive::{Drive, DriveError, Driving};
pub use extensions::{Extension, Extensions};
pub use frame::{Framed, Frames, frame};
pub use grease::{Grease, is_no_version};
pub use inspection::{Inspection, StageTimes};
pub use moving::{MoveCause, Moves};
pub use notice::{Notice, RemovalCause};
pub use server::{Joined, ServerMessage, Welcome};

/// The versions of the protocol that this library speaks, newest first.
pub const VERSIONS: [u16; 1] = [1];
/// The first bytes that a client says.
pub const MAGIC: [u8; 4] = *b"RHMB";
