//! The state datagrams and the content of each kind, bit by bit (PROTOCOL 5).
//!
//! Codec only: `stream` decides what a datagram means.
mod acceleration;
mod age;
mod checksums;
mod codes;
mod cost;
mod error_scale;
mod full;
mod galois;
mod header;
mod keyframe;
mod largest_packet;
mod loss_report;
mod model;
mod payload;
mod refresh;
mod repair_symbol;
mod residual_numbers;
mod rest_steps;
#[cfg(feature = "raw")]
mod symbol_counts;
mod tables;
#[cfg(feature = "raw")]
mod test_encoder;
mod update;
mod zigzag;

pub use age::Age;
pub use checksums::Checksums;
pub(crate) use cost::{CostModel, InitialCostModel};
pub use error_scale::ErrorScale;
pub use full::{FullPacket, FullRecord};
pub(crate) use galois::{add_times, inverse, times};
pub use header::{Datagram, Head, Low16, PacketKind, StreamId};
pub use keyframe::Keyframe;
pub(crate) use keyframe::{predictor_code, predictor_of};
pub use largest_packet::{InvalidLargestPacket, LargestPacket};
pub use loss_report::LossReport;
pub use payload::{PredictionMode, UpdatePayload};
pub use refresh::{Refresh, RefreshRecord, RefreshWriter};
pub use repair_symbol::RepairSymbol;
pub(crate) use repair_symbol::{packet_of, source_symbol_into, source_symbol_of};
#[cfg(feature = "raw")]
pub use symbol_counts::SymbolCounts;
#[cfg(feature = "raw")]
pub use tables::Tables;
#[cfg(feature = "raw")]
pub use test_encoder::TestEncoder;
pub use update::{Update, UpdatePacket, UpdateWriter, Watermark};
