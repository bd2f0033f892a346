//! The state datagrams and the content of each kind, bit by bit (PROTOCOL 5).
//!
//! Codec only: `stream` decides what a datagram means. Each stream states its largest packet when it starts. Relays
//! and browsers add headers of their own, so a publisher leaves room for them.

mod cost;
mod header;
mod keyframe;
mod model;
mod payload;
mod recovery;
mod tables;
mod update;

use core::fmt;
use core::str::FromStr;

use crate::limits::{DATAGRAM_BYTES_MAX, LARGEST_PACKET_MIN};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

pub(crate) use cost::{CostModel, InitialCostModel};
pub use header::{Datagram, ErrorScale, Head, Low16, PacketKind, StreamId};
pub use keyframe::Keyframe;
pub(crate) use keyframe::{predictor_code, predictor_of};
pub use payload::{Age, PredictionMode, UpdatePayload};
pub use recovery::{Checksums, LossReport, Refresh, RefreshRecord, RefreshWriter, RepairSymbol};
pub(crate) use recovery::{
    add_times, inverse, packet_of, source_symbol_into, source_symbol_of, times,
};
#[doc(hidden)]
pub use tables::Tables;
pub use update::{FullPacket, FullRecord, Update, UpdatePacket, UpdateWriter, Watermark};
#[doc(hidden)]
pub use update::{SymbolCounts, TestEncoder};

/// A bound in bytes on every datagram of a stream, heads included (PROTOCOL 5.8).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LargestPacket(u16);

impl LargestPacket {
    /// The least size that a stream may state.
    pub const LEAST: Self = Self(LARGEST_PACKET_MIN as u16);
    /// The greatest size that a stream may state: the protocol's limit.
    pub const GREATEST: Self = Self(DATAGRAM_BYTES_MAX as u16);
    /// The size unless another one is chosen. It leaves room for 60 bytes of headers in a QUIC packet of 1,200 bytes.
    pub const DEFAULT: Self = Self(1_100);

    /// A size in bytes; `None` outside the limits (PROTOCOL 7).
    #[must_use]
    pub const fn new(bytes: u32) -> Option<Self> {
        if bytes < LARGEST_PACKET_MIN as u32 || bytes > DATAGRAM_BYTES_MAX as u32 {
            return None;
        }
        Some(Self(bytes as u16))
    }

    /// The size, bytes.
    #[must_use]
    pub const fn bytes(self) -> usize {
        self.0 as usize
    }
}

impl Default for LargestPacket {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl fmt::Display for LargestPacket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Reason why a text names no size of packets: it is not a number of bytes within the limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidLargestPacket;

impl fmt::Display for InvalidLargestPacket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "must be bytes, from {LARGEST_PACKET_MIN} to {DATAGRAM_BYTES_MAX}"
        )
    }
}

impl core::error::Error for InvalidLargestPacket {}

impl FromStr for LargestPacket {
    type Err = InvalidLargestPacket;

    fn from_str(text: &str) -> Result<Self, InvalidLargestPacket> {
        let bytes = text.parse().ok().and_then(Self::new);
        bytes.ok_or(InvalidLargestPacket)
    }
}

impl Wire for LargestPacket {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.0));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Self::new(from.varint32()?).ok_or(Malformed::OutOfRange)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_round_trips_and_one_outside_the_limits_is_refused() {
        let (least, greatest) = (LARGEST_PACKET_MIN as u32, DATAGRAM_BYTES_MAX as u32);
        for (bytes, fits) in [
            (0, false),
            (least - 1, false),
            (least, true),
            (1_100, true),
            (greatest, true),
            (greatest + 1, false),
            (u32::MAX, false),
        ] {
            let mut writer = Writer::new();
            writer.varint(u64::from(bytes));
            let written = writer.into_bytes();
            let read = LargestPacket::decode(&mut Reader::new(&written));
            assert_eq!(read, LargestPacket::new(bytes).ok_or(Malformed::OutOfRange));
            assert_eq!(read.is_ok(), fits, "{bytes}");
            let text = alloc::format!("{bytes}");
            assert_eq!(text.parse(), read.map_err(|_| InvalidLargestPacket));
            if let Ok(size) = read {
                let mut writer = Writer::new();
                size.encode(&mut writer);
                assert_eq!(writer.into_bytes(), written);
                assert_eq!(size.bytes(), bytes as usize);
            }
        }
    }
}
