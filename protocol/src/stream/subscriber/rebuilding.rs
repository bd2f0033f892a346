//! How a subscriber has lost packets back, and reads what waited for them

use alloc::vec::Vec;

use super::Subscriber;
use crate::limits::PARITY_SPAN;
use crate::packet::{Head, Parity, StatePacket, Update, packet_of};
use crate::wire::bytes::Reader;
use crate::wire::{Malformed, Wire};

impl Subscriber {
    /// Keeps a packet for the parities that cover it, and to read it again.
    pub(super) fn keep(&mut self, number: u64, datagram: &[u8]) {
        self.restorer.hear_packet(number, datagram);
    }

    /// Keeps a parity for what it may give back.
    pub(super) fn read_parity(&mut self, parity: Parity) {
        let next = self.gaps.next();
        let last = parity.last.expand(next);
        // What lies so far ahead is for packets to say.
        if !self.placed || last >= next + u64::from(PARITY_SPAN) {
            return;
        }
        self.statistics.parities += 1;
        self.restorer.add(last, parity);
    }

    /// Reads what parities give back by now as if it had arrived.
    pub(super) fn rebuild(&mut self) {
        for (number, column) in self.restorer.rebuild() {
            if self.read_rebuilt(number, &column).is_err() {
                self.restorer.distrust(number);
                self.statistics.malformed += 1;
                return;
            }
            self.restorer.hear(number, &column);
        }
    }

    fn read_rebuilt(&mut self, number: u64, column: &[u8]) -> Result<(), Malformed> {
        let datagram = packet_of(self.stream, number, column).ok_or(Malformed::OutOfRange)?;
        let (before, disordered) = (self.statistics.packets, self.statistics.disordered);
        let (ends_tick, reader) = opened(&datagram)?;
        self.read_state(&datagram, StatePacket::decode(ends_tick, reader)?)?;
        self.statistics.rebuilt += self.statistics.packets - before;
        self.statistics.disordered = disordered;
        Ok(())
    }

    /// Reads those packets after a late one again that could not be read without it.
    pub(super) fn read_again_after(&mut self, late: u64, updates: &mut Vec<Update>) {
        let kept = (late + 1..self.gaps.next())
            .rev()
            .take(PARITY_SPAN as usize);
        for number in kept.collect::<Vec<_>>().into_iter().rev() {
            let Some(column) = self.restorer.column(number) else {
                continue;
            };
            let Some(datagram) = packet_of(self.stream, number, column) else {
                continue;
            };
            let Ok((ends_tick, reader)) = opened(&datagram) else {
                continue;
            };
            let Ok(packet) = StatePacket::decode(ends_tick, reader) else {
                continue;
            };
            let tick = self.tick_of(packet.tick);
            // It was read once already, so that it can be again.
            if packet.updates(updates).is_ok() && self.gaps.read_again(number) {
                self.hear_all(number, tick, updates);
            }
        }
    }
}

/// Whether a packet ends its tick, and what follows its head.
fn opened(datagram: &[u8]) -> Result<(bool, Reader<'_>), Malformed> {
    let mut reader = Reader::new(datagram);
    let head = Head::decode(&mut reader)?;
    Ok((head.kind == crate::packet::Kind::StateEnd, reader))
}
