//! What makes good a lost packet: what its bodies do now

use alloc::vec::Vec;

use bytes::Bytes;

use super::Publisher;
use crate::limits::{HISTORY_PACKETS, UPDATES_PER_PACKET_MAX};
use crate::packet::{Echo, RepairRecord, RepairWriter, TrackSaying};
use crate::stream::redundancy::Redundancy;

impl Publisher {
    /// Says the parities that are due after a tick that was spoken of, silent or not, and appends them to `out`.
    pub fn say_parities(&mut self, redundancy: Redundancy, out: &mut Vec<Bytes>) {
        if self.features.redundancy {
            self.parities.end_tick(self.stream, redundancy, out);
        }
    }

    /// Answers a listener that lost packets by parities, where these serve, and appends them to `out`. Returns the
    /// numbers of the packets that must be repaired instead, each once.
    pub fn answer(&mut self, echo: &Echo, out: &mut Vec<Bytes>) -> Vec<u64> {
        let next = self.history.next();
        let mut lost: Vec<u64> = echo.lost.iter().map(|lost| lost.expand(next)).collect();
        lost.sort_unstable();
        lost.dedup();
        let heard = echo.next.expand(next);
        let wanted = usize::from(echo.parities);
        self.parities
            .answer(self.stream, lost.into_iter(), (heard, wanted), out)
    }

    /// The datagrams that say what the bodies of a lost packet do now, or `None` when it is too old to be known.
    #[must_use]
    pub fn repair(&self, number: u64, notices: u64) -> Option<Vec<Bytes>> {
        let mut writer = RepairWriter::default();
        let mut bodies = self.history.bodies(number)?.to_vec();
        // Who lacks a carrier could not read what named it since.
        let lost = bodies.len();
        for naming in self.namings.iter().filter(|naming| naming.number >= number) {
            if bodies[..lost].binary_search(&naming.carrier).is_ok() {
                bodies.push(naming.body);
            }
        }
        bodies.sort_unstable();
        bodies.dedup();
        // More than a repair holds: a new snapshot is cheaper.
        if bodies.len() > UPDATES_PER_PACKET_MAX {
            return None;
        }
        for index in bodies {
            let Some(slot) = self.tracks.slot(index) else {
                continue;
            };
            let age = self.tick.since(slot.origin()).unwrap_or_default();
            let whole = TrackSaying::of(&slot.track());
            writer.push(&RepairRecord {
                index,
                seat: self.usher.seats().of(index),
                age,
                whole,
            });
        }
        let datagrams = writer.finish(self.stream, number, self.tick.value(), notices);
        Some(datagrams.into_iter().map(Bytes::from).collect())
    }

    /// What was named in this tick was so in its last packet at the latest; what no repair is asked of any more goes.
    pub(super) fn number_namings(&mut self) {
        let next = self.history.next();
        for naming in self.namings.iter_mut().rev() {
            if naming.number != u64::MAX {
                break;
            }
            naming.number = next.saturating_sub(1);
        }
        while let Some(oldest) = self.namings.front()
            && oldest.number + (HISTORY_PACKETS as u64) < next
        {
            self.namings.pop_front();
        }
    }
}
