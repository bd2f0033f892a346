//! The suite's own ends of connections, mannerly only where a case wants so.

mod decoder;
mod feed;
mod follower;
mod guest;
mod host;
mod promise;

pub use decoder::Decoder;
pub use feed::{Feed, Setting, Word};
pub use follower::{Fate, Follower};
pub use guest::Guest;
pub use host::Host;
pub use promise::{compare, compare_recorded};
