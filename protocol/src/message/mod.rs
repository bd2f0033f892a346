//! The control messages, reliable and in order (PROTOCOL 4).
mod authority;
mod choice;
mod client;
mod denial;
mod extensions;
mod frame;
mod grease;
mod inertia;
mod inspection;
mod resync;
mod scene_event;
mod server;
mod tier_policy;
mod version;

pub use authority::{AuthorityError, AuthorityGrant, TakeAuthority};
pub use choice::StreamChoice;
pub use client::ClientMessage;
pub use denial::Denial;
pub use extensions::{Extension, Extensions};
pub use frame::{Framed, Frames, frame};
pub use grease::{Grease, is_no_version};
pub use inspection::{Inspection, StageTimes};
pub use resync::ResyncCause;
pub use scene_event::{RemovalCause, SceneEvent};
pub use server::{Joined, ServerMessage, Welcome};
pub use tier_policy::{TierChangeCause, TierPolicy};
pub use version::{MAGIC, VERSIONS};
