//! Byte counts on the wire for a mode of the paper's protocol.
//!
//! Counted like a `Frame`: adding 28 bytes per datagram gives bytes on the wire. A TCP segment has 12 header bytes
//! more and is acknowledged by an empty packet of 40.

use bytes::Bytes;

use crate::drive::remote::Retention;
use crate::record::PacketDirection;

/// Header bytes of a TCP segment beyond those of a datagram: 40 less 28.
const SEGMENT_MORE_BYTES: u64 = 12;
/// Payload of a full segment: an Ethernet packet of 1,500 bytes less 40 of headers.
const SEGMENT_BYTES: usize = 1_460;

/// Bytes and packets in one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Count {
    pub(super) bytes: u64,
    pub(super) packets: u64,
}

/// Counts in both directions, and the bytes since they were last taken, if kept.
#[derive(Debug)]
pub(super) struct WireCounter {
    pub(super) down: Count,
    pub(super) up: Count,
    keep: Retention,
    state_down: Vec<u8>,
    control_down: Vec<u8>,
    control_up: Vec<u8>,
    datagram_up: Vec<u8>,
}

impl Count {
    fn add(&mut self, packets: u64, bytes: u64) {
        self.packets += packets;
        self.bytes += bytes;
    }

    pub(super) const fn since(self, before: Self) -> Self {
        Self {
            bytes: self.bytes - before.bytes,
            packets: self.packets - before.packets,
        }
    }
}

impl WireCounter {
    pub(super) fn new(keep: Retention) -> Self {
        Self {
            down: Count::default(),
            up: Count::default(),
            keep,
            state_down: Vec::new(),
            control_down: Vec::new(),
            control_up: Vec::new(),
            datagram_up: Vec::new(),
        }
    }

    pub(super) fn datagram_down(&mut self, bytes: &[u8]) {
        self.down.add(1, bytes.len() as u64);
        keep(self.keep, bytes, &mut self.state_down);
    }

    pub(super) fn datagram_up(&mut self, bytes: &[u8]) {
        self.up.add(1, bytes.len() as u64);
        keep(self.keep, bytes, &mut self.datagram_up);
    }

    /// Counts one read from TCP.
    pub(super) fn segments_down(&mut self, bytes: &[u8]) {
        let segments = bytes.len().div_ceil(SEGMENT_BYTES) as u64;
        let more = segments * SEGMENT_MORE_BYTES;
        self.down.add(segments, bytes.len() as u64 + more);
        self.up.add(segments, more);
        keep(self.keep, bytes, &mut self.control_down);
    }

    /// Counts one write to TCP.
    pub(super) fn segments_up(&mut self, bytes: &[u8]) {
        let segments = bytes.len().div_ceil(SEGMENT_BYTES) as u64;
        let more = segments * SEGMENT_MORE_BYTES;
        self.up.add(segments, bytes.len() as u64 + more);
        self.down.add(segments, more);
        keep(self.keep, bytes, &mut self.control_up);
    }

    /// Takes the bytes since the last call, one piece per direction.
    pub(super) fn take(&mut self) -> Vec<(PacketDirection, Bytes)> {
        let lanes = [
            (PacketDirection::ControlUp, &mut self.control_up),
            (PacketDirection::StateUp, &mut self.datagram_up),
            (PacketDirection::StateDown, &mut self.state_down),
            (PacketDirection::ControlDown, &mut self.control_down),
        ];
        let full = lanes.into_iter().filter(|(_, bytes)| !bytes.is_empty());
        full.map(|(direction, bytes)| (direction, Bytes::from(std::mem::take(bytes))))
            .collect()
    }
}

fn keep(keep: Retention, bytes: &[u8], lane: &mut Vec<u8>) {
    if keep == Retention::Everything {
        lane.extend_from_slice(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_segment_counts_its_headers_and_its_acknowledgement() {
        let on_wire = |count: Count| count.bytes + 28 * count.packets;
        let mut wire = WireCounter::new(Retention::Everything);
        wire.segments_up(&[0; 32]);
        assert_eq!((on_wire(wire.up), on_wire(wire.down)), (72, 40));
        wire.datagram_down(&[0; 88]);
        assert_eq!(on_wire(wire.down), 40 + 116);
        wire.segments_down(&[0; 3_000]);
        assert_eq!(on_wire(wire.down), 156 + 3_120);
        let taken = wire.take();
        assert_eq!(taken.len(), 3);
        assert!(wire.take().is_empty());
        let mut wire = WireCounter::new(Retention::Costs);
        wire.datagram_down(&[0; 88]);
        assert_eq!((on_wire(wire.down), wire.take().len()), (116, 0));
    }
}
