//! A fan-out: carries the packets of streams from one edge to many.
//!
//! The edge that publishes is the owner of those that follow. Connections between them carry all but the packets, which the
//! fan-out may drop, repeat and disorder (PROTOCOL 14-1). Sends nothing by itself: a program brings the fan-out.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use rhumb_edge::{Edge, SharedPacket, SharedStream};

/// Packets of a fan-out that wait for the edge; beyond them the newest are dropped, as a network drops them. Derived: 4
/// MiB of packets of the usual size.
const WAITING_MAX: usize = 4_096;

/// A carrier of packets.
pub trait FanOut: Send {
    /// Hands a packet to all that follow its stream. Does not wait; what cannot be sent now is dropped.
    fn publish(&mut self, packet: SharedPacket);

    /// Delivers the packets of these streams from now on, and of no others.
    fn follow(&mut self, streams: &BTreeSet<SharedStream>);
}

/// The end of a fan-out at which an edge is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FanOutSide {
    /// Its members are edges, which receive packets by the fan-out alone.
    Publishes,
    /// Its owner is an edge that publishes.
    Follows,
}

/// The way of packets to the edge, from any thread.
#[derive(Clone)]
pub struct Deliver {
    waiting: Arc<AtomicUsize>,
    to: Arc<dyn Fn(SharedPacket) + Send + Sync>,
}

impl Deliver {
    pub(super) fn new(to: impl Fn(SharedPacket) + Send + Sync + 'static) -> Self {
        let (waiting, to) = (Arc::default(), Arc::new(to));
        Self { waiting, to }
    }

    /// A packet has come.
    pub fn packet(&self, packet: SharedPacket) {
        if self.waiting.fetch_add(1, Ordering::AcqRel) < WAITING_MAX {
            return (self.to)(packet);
        }
        self.taken();
    }

    /// The edge has taken one.
    pub(super) fn taken(&self) {
        self.waiting.fetch_sub(1, Ordering::AcqRel);
    }
}

/// An edge's end of a fan-out.
pub(super) struct Sharing {
    pub(super) side: FanOutSide,
    fan_out: Box<dyn FanOut>,
    deliver: Deliver,
    followed: BTreeSet<SharedStream>,
}

impl Sharing {
    pub(super) fn new(side: FanOutSide, fan_out: Box<dyn FanOut>, deliver: Deliver) -> Self {
        Self {
            side,
            fan_out,
            deliver,
            followed: BTreeSet::new(),
        }
    }

    /// Publishes what an edge has for it.
    pub(super) fn publish(&mut self, edge: &mut Edge) {
        while let Some(packet) = edge.poll_shared() {
            self.fan_out.publish(packet);
        }
    }

    /// Follows the streams that an edge needs now.
    pub(super) fn follow(&mut self, edge: &Edge) {
        let needed: BTreeSet<_> = edge.streams().collect();
        if self.side == FanOutSide::Follows && needed != self.followed {
            self.fan_out.follow(&needed);
            self.followed = needed;
        }
    }

    /// The edge takes a packet.
    pub(super) fn taken(&self) {
        self.deliver.taken();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use rhumb_protocol::packet::StreamId;

    use super::*;

    #[test]
    fn packets_that_an_edge_does_not_take_are_dropped() {
        let taken = Arc::new(Mutex::new(Vec::new()));
        let came = Arc::clone(&taken);
        let deliver = Deliver::new(move |packet| came.lock().expect("unpoisoned").push(packet));
        let packet = |number: u32| SharedPacket {
            of: SharedStream {
                scene: "stage".parse().expect("a valid name"),
                stream: StreamId(1),
            },
            bytes: number.to_be_bytes().to_vec().into(),
        };
        for number in 0..10_000 {
            deliver.packet(packet(number));
        }
        assert_eq!(taken.lock().expect("unpoisoned").len(), WAITING_MAX);
        deliver.taken();
        deliver.packet(packet(10_000));
        assert_eq!(
            taken.lock().expect("unpoisoned").last(),
            Some(&packet(10_000))
        );
    }
}
