//! What crossed the wire in a mode of the paper's protocol, counted
//!
//! CountSink as a `Frame` has it, so that 28 bytes for each datagram make it the wire's: a TCP segment has 12 more, and is
//! acknowledged by one of 40 that has nothing else.

use bytes::Bytes;

use crate::drive::remote::Retention;
use crate::record::PacketDirection;

/// Bytes that a segment has of headers beyond a datagram's: 40 less 28.
const SEGMENT_MORE_BYTES: u64 = 12;
/// What a segment holds at most: an Ethernet packet of 1,500 bytes, less 40.
const SEGMENT_BYTES: usize = 1_460;

/// Bytes and packets, one way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Count {
    pub(super) bytes: u64,
    pub(super) packets: u64,
}

/// Both ways, and the bytes themselves since they were last taken, if they are kept.
#[derive(Debug)]
pub(super) struct Wire {
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

impl Wire {
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

    /// One read of TCP.
    pub(super) fn segments_down(&mut self, bytes: &[u8]) {
        let segments = bytes.len().div_ceil(SEGMENT_BYTES) as u64;
        let more = segments * SEGMENT_MORE_BYTES;
        self.down.add(segments, bytes.len() as u64 + more);
        self.up.add(segments, more);
        keep(self.keep, bytes, &mut self.control_down);
    }

    /// One write to TCP.
    pub(super) fn segments_up(&mut self, bytes: &[u8]) {
        let segments = bytes.len().div_ceil(SEGMENT_BYTES) as u64;
        let more = segments * SEGMENT_MORE_BYTES;
        self.up.add(segments, bytes.len() as u64 + more);
        self.down.add(segments, more);
        keep(self.keep, bytes, &mut self.control_up);
    }

    /// What crossed since this was last asked, each way in one piece, datagram after datagram.
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
    fn with_a_datagrams_headers_a_segment_has_its_own_and_its_acknowledgement() {
        let on_wire = |count: Count| count.bytes + 28 * count.packets;
        let mut wire = Wire::new(Retention::Everything);
        wire.segments_up(&[0; 32]);
        assert_eq!((on_wire(wire.up), on_wire(wire.down)), (72, 40));
        wire.datagram_down(&[0; 88]);
        assert_eq!(on_wire(wire.down), 40 + 116);
        wire.segments_down(&[0; 3_000]);
        assert_eq!(on_wire(wire.down), 156 + 3_120);
        let taken = wire.take();
        assert_eq!(taken.len(), 3);
        assert!(wire.take().is_empty());
        let mut wire = Wire::new(Retention::Costs);
        wire.datagram_down(&[0; 88]);
        assert_eq!((on_wire(wire.down), wire.take().len()), (116, 0));
    }
}
