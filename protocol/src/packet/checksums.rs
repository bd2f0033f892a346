//! The packet with the checksum over all tracks of a stream.
//!
//! Codec only; `stream/state_checksum` computes the checksum.

use alloc::vec::Vec;

use super::header::{Head, Low16, PacketKind, StreamId};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// The checksum over a publisher's tracks after its newest packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Checksums {
    /// Number of the stream's next packet: the checksum covers all packets before it.
    pub next: Low16,
    /// Low bits of the tick up to which nothing more is to be sent.
    pub tick: Low16,
    /// Low bits of the count of scene events up to that tick.
    pub scene_events: Low16,
    /// The checksum over the tracks of all bodies.
    pub sum: u64,
}

impl Checksums {
    /// Encodes the datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        let kind = PacketKind::Checksums;
        Head { kind, stream }.encode(&mut to);
        self.next.encode(&mut to);
        self.tick.encode(&mut to);
        self.scene_events.encode(&mut to);
        to.raw(&self.sum.to_le_bytes());
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if the body is no checksum packet.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let next = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let scene_events = Low16::decode(&mut from)?;
        let mut sum = [0; 8];
        sum.copy_from_slice(from.raw(8)?);
        from.finish()?;
        Ok(Self {
            next,
            tick,
            scene_events,
            sum: u64::from_le_bytes(sum),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checksum_packet_has_these_bytes() {
        let checksums = Checksums {
            next: Low16(0x1170),
            tick: Low16(300),
            scene_events: Low16(12),
            sum: 0x0102_0304_0506_0708,
        };
        let bytes = checksums.encode(StreamId(5));
        let expected = [0x57, 0x70, 0x11, 0x2c, 1, 12, 0, 8, 7, 6, 5, 4, 3, 2, 1];
        assert_eq!(bytes, expected);
        let mut reader = Reader::new(&bytes);
        assert!(Head::decode(&mut reader).is_ok());
        assert_eq!(Checksums::decode(reader.clone()), Ok(checksums));
        for cut in 0..reader.rest().len() {
            assert!(Checksums::decode(Reader::new(&reader.rest()[..cut])).is_err());
        }
    }
}
