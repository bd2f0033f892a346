//! Answers to lost packets: refreshes of their bodies, and repair symbols.

use alloc::vec::Vec;

use bytes::Bytes;

use super::Publisher;
use crate::packet::{Keyframe, LossReport, RefreshRecord, RefreshWriter};
use crate::stream::fec_encoder::SymbolRequest;
use crate::stream::redundancy::Redundancy;

impl Publisher {
    /// Encodes the repair symbols that are due after a published tick, silent or not, and appends them to `out`.
    pub fn encode_repair_symbols(&mut self, redundancy: Redundancy, out: &mut Vec<Bytes>) {
        if self.features.redundancy {
            let redundancy = if self.features.unsolicited {
                redundancy
            } else {
                Redundancy::Off
            };
            self.repair_symbols.end_tick(self.stream, redundancy, out);
        }
    }

    /// Answers the only receiver of a stream, which is sent all repair symbols: see `answer_one`.
    pub fn answer(&mut self, loss_report: &LossReport, out: &mut Vec<Bytes>) -> Vec<u64> {
        self.answer_one(loss_report, Some(0), out)
    }

    /// Answers a receiver that lost packets. Appends repair symbols to `out` where they suffice, and returns the
    /// numbers of the packets that must be refreshed instead, each once.
    ///
    /// `sent_from`: the number of the next packet when this receiver was first sent the symbols of
    /// [`Self::encode_repair_symbols`]; `None` if it is sent none.
    pub(crate) fn answer_one(
        &mut self,
        loss_report: &LossReport,
        sent_from: Option<u64>,
        out: &mut Vec<Bytes>,
    ) -> Vec<u64> {
        let next = self.sent_packets.next();
        let mut lost: Vec<u64> = loss_report
            .lost
            .iter()
            .map(|lost| lost.expand(next))
            .collect();
        lost.sort_unstable();
        lost.dedup();
        let request = SymbolRequest {
            received_below: loss_report.next.expand(next),
            wanted: usize::from(loss_report.repair_symbols),
            sent_from: sent_from.unwrap_or(u64::MAX),
        };
        self.repair_symbols
            .answer(self.stream, lost.into_iter(), request, out)
    }

    /// The datagrams with the present tracks of a lost packet's bodies; `None` for a packet that is too old.
    #[must_use]
    pub fn refresh(&self, number: u64, scene_events: u64) -> Option<Vec<Bytes>> {
        let mut writer = RefreshWriter::within(self.largest_packet);
        for &index in self.sent_packets.bodies(number)? {
            let Some(slot) = self.tracks.slot(index) else {
                continue;
            };
            let age = self.tick.since(slot.origin()).unwrap_or_default();
            let keyframe = Keyframe::of(&slot.track());
            writer.push(&RefreshRecord {
                index,
                alias: self.alias_table.aliases().of(index),
                age,
                keyframe,
            });
        }
        let datagrams = writer.finish(self.stream, number, self.tick.value(), scene_events);
        Some(datagrams.into_iter().map(Bytes::from).collect())
    }
}
