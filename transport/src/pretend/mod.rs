//! A network that exists only in memory, the same each time.
//!
//! No socket, no clock, no thread: the same seed and the same calls give the same run, to the bit.

mod arena;
mod chance;
mod counts;
mod link;
mod share;
mod terms;

pub use arena::{Arena, Direction, Rest};
pub use counts::{LinkCounts, Tally};
pub use link::{Lane, Link};
pub use share::Share;
pub use terms::{LinkTerms, TermsError};
