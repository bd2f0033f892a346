//! What the tests of the whole share: stage, truth, table, process.
//!
//! No promise is kept here; the families in `tests/` are. Nothing here sleeps or reads a clock.
#![forbid(unsafe_code)]

mod avatar;
pub mod conformance;
mod fnv;
pub mod fuzzing;
pub mod grammar;
mod plugin;
mod process;
pub mod requirements;
mod rude;
mod seed;
mod stage;
mod table;
pub mod testee;
mod told;
mod truth;
pub mod vectors;
mod walk;
mod witness;

pub use avatar::Avatars;
pub use plugin::{PluginTalk, Recording, falling, hear};
pub use process::{Ended, Programme, ServerProcess};
pub use rude::Rude;
pub use seed::{Dice, seed};
pub use stage::{COMMANDER, Stage, TICK};
pub use table::{Fate, Said, Sieve, Table};
pub use told::Told;
pub use truth::{Record, Truth};
pub use walk::{Walk, drive};
pub use witness::{Claim, Witness, assert_same_copy, copy_digest};
