//! The state datagrams: what each kind holds, bit by bit (PROTOCOL 5).
//!
//! Codec only: what a datagram means for a stream is decided in `stream`.
mod age;
mod cost;
mod digest;
mod echo;
mod excess;
mod forge;
mod full;
mod galois;
mod header;
mod model;
mod parity;
mod push;
mod repair;
mod saying;
mod state;
mod steps;
mod tables;
mod tally;
mod walk;
mod whole;
mod zigzag;

pub use age::Age;
pub(crate) use cost::{Opening, PlaceCost, Pricing};
pub use digest::{Digest, Doubt, Ranges};
pub use echo::Echo;
pub use excess::Excess;
#[doc(hidden)]
pub use forge::Forge;
pub use full::{FULL_RECORD_BYTES, FullPacket, FullRecord};
pub(crate) use galois::{add_times, inverse, times};
pub use header::{Head, Kind, Low16, StreamId};
pub use parity::Parity;
pub(crate) use parity::{column_into, column_of, packet_of};
pub(crate) use repair::REPAIR_RECORDS;
pub use repair::{Repair, RepairRecord, RepairWriter};
pub use saying::{Course, Saying};
pub use state::{StatePacket, StateWriter, Update, Vouch};
#[doc(hidden)]
pub use tables::Tables;
#[doc(hidden)]
pub use tally::Tally;
pub use whole::TrackSaying;
pub(crate) use whole::{law_code, law_of};
