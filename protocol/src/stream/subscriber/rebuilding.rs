//! The subscriber recovers lost packets and reads packets that waited.

use alloc::vec::Vec;

use super::Subscriber;
use crate::limits::FEC_SPAN;
use crate::packet::{Datagram, PacketKind, RepairSymbol, Update, UpdatePacket, packet_of};
use crate::stream::gaps::Arrival;
use crate::wire::Malformed;

impl Subscriber {
    /// Keeps a packet to decode repair symbols with it, and to read it again.
    pub(super) fn keep(&mut self, number: u64, datagram: &Datagram<'_>) {
        self.fec_decoder.add_packet(number, datagram);
    }

    /// Keeps a repair symbol for recovery.
    pub(super) fn read_repair_symbol(&mut self, repair_symbol: RepairSymbol) {
        let next = self.gaps.next();
        let last = repair_symbol.last.expand(next);
        // Only packets may move the window that far.
        if !self.placed || last >= next + u64::from(FEC_SPAN) {
            return;
        }
        self.statistics.repair_symbols += 1;
        self.fec_decoder.add(last, repair_symbol);
    }

    /// Reads the packets that repair symbols recover as if they had arrived.
    pub(super) fn rebuild(&mut self) {
        for (number, source_symbol) in self.fec_decoder.rebuild() {
            if self.read_rebuilt(number, &source_symbol).is_err() {
                self.fec_decoder.drop_repair_symbols(number);
                self.statistics.malformed += 1;
                return;
            }
            self.fec_decoder.add_known(number, &source_symbol);
        }
    }

    fn read_rebuilt(&mut self, number: u64, source_symbol: &[u8]) -> Result<(), Malformed> {
        let datagram =
            packet_of(self.stream, number, source_symbol).ok_or(Malformed::OutOfRange)?;
        let (before, disordered) = (self.statistics.packets, self.statistics.disordered);
        let datagram = Datagram::open(&datagram)?;
        self.read_state(&datagram, packet_in(&datagram)?, Arrival::Rebuilt)?;
        self.statistics.rebuilt += self.statistics.packets - before;
        self.statistics.disordered = disordered;
        Ok(())
    }

    /// Reads packets again that could not be applied without the late one.
    pub(super) fn read_again_after(&mut self, late: u64, updates: &mut Vec<Update>) {
        let kept = (late + 1..self.gaps.next()).rev().take(FEC_SPAN as usize);
        for number in kept.collect::<Vec<_>>().into_iter().rev() {
            let Some(source_symbol) = self.fec_decoder.source_symbol(number) else {
                continue;
            };
            let Some(datagram) = packet_of(self.stream, number, source_symbol) else {
                continue;
            };
            let Ok(datagram) = Datagram::open(&datagram) else {
                continue;
            };
            let Ok(packet) = packet_in(&datagram) else {
                continue;
            };
            let tick = self.tick_of(packet.tick);
            // It was decoded before, so decoding succeeds again.
            if packet.updates(updates).is_ok() && self.gaps.read_again(number) {
                self.apply_all(number, tick, updates);
            }
        }
    }
}

/// The update packet in a datagram.
fn packet_in<'a>(datagram: &Datagram<'a>) -> Result<UpdatePacket<'a>, Malformed> {
    let ends_tick = datagram.head().kind == PacketKind::UpdatesEnd;
    UpdatePacket::decode(ends_tick, datagram.body())
}
