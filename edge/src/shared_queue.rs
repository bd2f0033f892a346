//! Packets that wait for a fan-out.
//!
//! Sends nothing. Invariant: at most [`SHARED_BYTES`] wait; the oldest are dropped for newer ones, as a network drops them.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::SceneName;

/// Bytes that wait for a fan-out, with the cost of each packet. Derived: those of a client that does not read.
const SHARED_BYTES: usize = 4 << 20;
/// Cost of a packet beside its bytes.
const PACKET_COST_BYTES: usize = 64;

/// A stream that a fan-out carries.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SharedStream {
    /// The scene.
    pub scene: SceneName,
    /// The stream of the scene.
    pub stream: StreamId,
}

/// A packet for all that a fan-out carries it to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SharedPacket {
    /// Its stream.
    pub of: SharedStream,
    /// The datagram.
    pub bytes: Bytes,
}

/// The packets, oldest first.
#[derive(Debug, Default)]
pub(crate) struct SharedQueue {
    waiting: VecDeque<SharedPacket>,
    cost_bytes: usize,
}

impl SharedQueue {
    pub(crate) fn push(&mut self, packet: SharedPacket) {
        self.cost_bytes += cost(&packet);
        self.waiting.push_back(packet);
        while self.cost_bytes > SHARED_BYTES && self.pop().is_some() {}
    }

    pub(crate) fn pop(&mut self) -> Option<SharedPacket> {
        let packet = self.waiting.pop_front()?;
        self.cost_bytes -= cost(&packet);
        Some(packet)
    }
}

fn cost(packet: &SharedPacket) -> usize {
    packet.bytes.len() + PACKET_COST_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_fan_out_the_oldest_packets_are_dropped() {
        let mut queue = SharedQueue::default();
        let packet = |number: u32| SharedPacket {
            of: SharedStream {
                scene: "stage".parse().expect("a valid name"),
                stream: StreamId(1),
            },
            bytes: Bytes::from([number.to_be_bytes().as_slice(), &[0; 996]].concat()),
        };
        for number in 0..10_000 {
            queue.push(packet(number));
        }
        let kept = SHARED_BYTES / (1_000 + PACKET_COST_BYTES);
        let left: Vec<_> = std::iter::from_fn(|| queue.pop()).collect();
        assert_eq!(left.len(), kept);
        assert_eq!(left[0], packet(10_000 - kept as u32));
        assert_eq!(queue.cost_bytes, 0);
    }
}
