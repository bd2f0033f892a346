//! The state datagrams: what each kind holds, bit by bit (PROTOCOL 5).
//!
//! Codec only: what a datagram means for a stream is decided in `stream`.
mod echo;
mod full;
mod header;
mod repair;
mod saying;
mod state;

pub use echo::Echo;
pub use full::{FULL_RECORD_BYTES, FullPacket, FullRecord};
pub use header::{Head, Kind, Low16, StreamId};
pub use repair::{Repair, RepairRecord, RepairWriter};
pub use saying::{Saying, TrackSaying};
pub use state::{StatePacket, StateWriter, Update, Vouch};
