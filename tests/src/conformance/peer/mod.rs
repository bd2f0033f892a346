//! The suite's own ends of connections, mannerly only where a case wants so.

mod complaints;
mod couple;
pub(super) mod datagram;
mod decoder;
mod feed;
mod follower;
mod guest;
mod host;
mod memory;
mod promise;
mod running;
mod setting;

pub use couple::Couple;
pub use decoder::Decoder;
pub use feed::{Feed, Word};
pub use follower::{Fate, Follower};
pub use guest::Guest;
pub use host::Host;
pub use promise::{compare, compare_recorded};
pub use setting::Setting;
