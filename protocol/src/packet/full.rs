//! The packets of a full stream: every body's state in 56 bytes.
//!
//! The naive baseline for measuring reckoned streams, and a view of the engine without any loss of precision.

use alloc::vec::Vec;

use rhumb_reckoning::BodyState;

use super::LargestPacket;
use super::header::{Head, Low16, PacketKind, StreamId};
use crate::limits::INDICES_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Index (u32), position, quaternion x y z w, linear and angular velocity (f32 each), little-endian.
const FULL_RECORD_BYTES: usize = 4 + 13 * 4;

/// Bytes before the records.
const HEAD_BYTES_MAX: usize = 1 + 5 + 2 + 2 + 2;

/// One body's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FullRecord {
    /// Index of the body.
    pub index: u32,
    /// Its state, bit for bit.
    pub motion: BodyState,
}

impl FullRecord {
    fn encoded(&self) -> [u8; FULL_RECORD_BYTES] {
        let mut bytes = [0; FULL_RECORD_BYTES];
        let (index, motion) = bytes.split_at_mut(4);
        index.copy_from_slice(&self.index.to_le_bytes());
        for (place, part) in motion.chunks_exact_mut(4).zip(self.motion.parts()) {
            place.copy_from_slice(&part.to_le_bytes());
        }
        bytes
    }

    fn decode(bytes: &[u8; FULL_RECORD_BYTES]) -> Result<Self, Malformed> {
        let four = |place: usize| [0, 1, 2, 3].map(|byte| bytes[4 * place + byte]);
        let part = |place: usize| f32::from_le_bytes(four(1 + place));
        let three = |first: usize| [part(first), part(first + 1), part(first + 2)];
        let index = u32::from_le_bytes(four(0));
        if index >= INDICES_MAX {
            return Err(Malformed::OutOfRange);
        }
        let rotation = [part(3), part(4), part(5), part(6)];
        let motion = BodyState::new(three(0), rotation, three(7), three(10))
            .map_err(|_| Malformed::NotFinite)?;
        Ok(Self { index, motion })
    }
}

/// One packet of states.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FullPacket {
    /// Low bits of the packet number.
    pub number: Low16,
    /// Low bits of the tick.
    pub tick: Low16,
    /// Low bits of the count of scene events that the reader must have received.
    pub scene_events: Low16,
    /// True if this is the last packet of its tick.
    pub ends_tick: bool,
    /// The states.
    pub records: Vec<FullRecord>,
}

impl FullPacket {
    /// The number of records that fit a datagram.
    pub const RECORDS_MAX: usize = Self::records_within(LargestPacket::GREATEST);

    /// The number of records that fit a datagram of this size.
    #[must_use]
    pub(crate) const fn records_within(largest_packet: LargestPacket) -> usize {
        (largest_packet.bytes() - HEAD_BYTES_MAX) / FULL_RECORD_BYTES
    }

    /// Encodes the datagram.
    ///
    /// # Panics
    ///
    /// With more than [`Self::RECORDS_MAX`] records.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        assert!(
            self.records.len() <= Self::RECORDS_MAX,
            "records fit a datagram"
        );
        let kind = if self.ends_tick {
            PacketKind::FullEnd
        } else {
            PacketKind::Full
        };
        let bytes = HEAD_BYTES_MAX + self.records.len() * FULL_RECORD_BYTES;
        let mut to = Writer::with_capacity(bytes);
        Head { kind, stream }.encode(&mut to);
        self.number.encode(&mut to);
        self.tick.encode(&mut to);
        self.scene_events.encode(&mut to);
        for record in &self.records {
            to.raw(&record.encoded());
        }
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no packet of states.
    pub fn decode(ends_tick: bool, mut from: Reader<'_>) -> Result<Self, Malformed> {
        let number = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let scene_events = Low16::decode(&mut from)?;
        let mut records = Vec::with_capacity(from.rest().len() / FULL_RECORD_BYTES);
        while !from.rest().is_empty() {
            records.push(FullRecord::decode(&from.array()?)?);
        }
        Ok(Self {
            number,
            tick,
            scene_events,
            ends_tick,
            records,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_packet_round_trips_and_its_truncations_are_refused() {
        let motion = BodyState::new([1.0; 3], [0.0, 0.0, 0.0, 1.0], [2.0; 3], [3.0; 3]).unwrap();
        let packet = FullPacket {
            number: Low16(1),
            tick: Low16(2),
            scene_events: Low16(3),
            ends_tick: true,
            records: (0..FullPacket::RECORDS_MAX as u32)
                .map(|index| FullRecord { index, motion })
                .collect(),
        };
        let bytes = packet.encode(StreamId(9));
        assert!(bytes.len() <= LargestPacket::GREATEST.bytes());
        let mut reader = Reader::new(&bytes);
        assert_eq!(Head::decode(&mut reader).unwrap().kind, PacketKind::FullEnd);
        assert_eq!(FullPacket::decode(true, reader.clone()), Ok(packet));
        for cut in 0..reader.rest().len() {
            let whole_records = cut >= 6 && (cut - 6) % FULL_RECORD_BYTES == 0;
            assert_eq!(
                FullPacket::decode(true, Reader::new(&reader.rest()[..cut])).is_ok(),
                whole_records
            );
        }
    }
}
