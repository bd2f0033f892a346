//! How the updates of one tick become packets.

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::Tick;

use super::Publisher;
use crate::packet::{Excess, StateWriter, Update};

impl Publisher {
    /// Cuts the updates of one tick into datagrams.
    ///
    /// What builds on another body's track comes after that body, in the same packet or a later one.
    pub(super) fn pack(
        &mut self,
        tick: Tick,
        updates: &mut [Update],
        notices: u64,
        out: &mut Vec<Bytes>,
    ) {
        updates.sort_unstable_by_key(|update| update.seat);
        let mut halved = false;
        if let Some((datagram, fitting)) = self.write(tick, updates, notices, true)
            && fitting == updates.len()
        {
            halved = updates.len() > 1 && self.parities.halves(datagram.len());
            if !halved {
                self.send(datagram, updates, out);
                return;
            }
        }
        updates.sort_unstable_by_key(|update| (update.saying.names_carrier(), update.seat));
        let alone = updates.partition_point(|update| !update.saying.names_carrier());
        let cut = if halved {
            self.middle(updates).min(alone)
        } else {
            alone
        };
        let (first, second) = updates.split_at_mut(cut);
        if halved {
            second.sort_unstable_by_key(|update| update.seat);
            self.parities.halve();
        }
        let (first, second) = (&*first, &*second);
        for (group, last) in [(first, second.is_empty()), (second, true)] {
            let mut rest: &[Update] = group;
            while let Some((datagram, fitting)) = self.write(tick, rest, notices, last) {
                let (said, later) = rest.split_at(fitting);
                self.send(datagram, said, out);
                rest = later;
            }
        }
    }

    /// How many of the first updates take half of the bits of all.
    fn middle(&self, updates: &[Update]) -> usize {
        let bits = updates.iter().map(|update| self.bits_of(update));
        let half = bits.clone().sum::<u64>() / 2;
        let mut so_far = 0;
        let before = |bits: &u64| {
            so_far += bits;
            so_far <= half
        };
        bits.take_while(before).count().max(1)
    }

    /// A packet of as many updates as fit, and how many those are; it ends its tick if all do and `last` is set.
    fn write(
        &self,
        tick: Tick,
        updates: &[Update],
        notices: u64,
        last: bool,
    ) -> Option<(Vec<u8>, usize)> {
        if updates.is_empty() {
            return None;
        }
        let number = self.history.next();
        let mut writer = StateWriter::new(self.stream, number, tick.value(), notices);
        let fitting = updates
            .iter()
            .take_while(|update| writer.push(update))
            .count();
        let ends_tick = last && fitting == updates.len();
        let datagram = match self.excess() {
            excess if ends_tick && excess != Excess::NONE => writer.finish_in_arrears(excess),
            _ => writer.finish(ends_tick),
        };
        Some((datagram, fitting))
    }

    fn send(&mut self, datagram: Vec<u8>, said: &[Update], out: &mut Vec<Bytes>) {
        let seats = self.usher.seats();
        let body = |update: &Update| update.body.or_else(|| seats.body(update.seat));
        let mut bodies = Vec::with_capacity(said.len());
        bodies.extend(said.iter().filter_map(body));
        bodies.sort_unstable();
        if self.features.redundancy {
            self.parities.record(self.history.next(), &datagram);
        }
        self.history.record(bodies.into_iter());
        self.statistics.updates += said.len() as u64;
        self.statistics.packets += 1;
        self.statistics.bytes += datagram.len() as u64;
        out.push(Bytes::from(datagram));
    }
}
