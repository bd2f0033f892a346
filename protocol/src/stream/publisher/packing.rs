//! Packs the updates of one tick into packets.

use alloc::vec;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::Tick;

use super::Publisher;
use crate::packet::{ErrorScale, Update, UpdateWriter};

/// Fewer updates than this usually fit one packet; that is tried first.
const MANY: usize = 64;
/// Aliases for each update, beyond which updates are sorted by comparisons instead of by a table of aliases.
const SPARSE_ALIASES: usize = 16;

impl Publisher {
    /// Splits the updates of one tick into datagrams.
    ///
    /// An update that builds on another body's track comes after that body, in the same packet or a later one.
    pub(super) fn pack(
        &mut self,
        tick: Tick,
        updates: &mut [Update],
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        if !self.features.packing {
            return self.pack_singly(tick, updates, scene_events, out);
        }
        sort_by_alias(updates);
        if !self.surely_fill_more(updates)
            && let Some((datagram, fitting)) = self.write(tick, updates, scene_events, true)
            && fitting == updates.len()
        {
            let splits = self.features.halves && self.repair_symbols.halves(datagram.len());
            if updates.len() > 1 && splits {
                self.pack_halves(tick, updates, scene_events, out);
            } else {
                self.send(datagram, updates, out);
            }
            return;
        }
        let alone = sort_parents_first(updates);
        self.pack_groups(tick, updates.split_at(alone), scene_events, true, out);
    }

    /// True if updates surely exceed one packet: their estimated size is half as much again.
    fn surely_fill_more(&self, updates: &[Update]) -> bool {
        let filled = self.largest_packet.bytes() as u64 * 8 * 256;
        let mut bits = 0;
        let fills = |update: &Update| {
            bits += Self::bits_of(update);
            bits > filled * 3 / 2
        };
        updates.len() >= MANY && updates.iter().any(fills)
    }

    /// Encodes two groups of updates in as many packets as they need. The second group builds on tracks of the first.
    fn pack_groups(
        &mut self,
        tick: Tick,
        (first, second): (&[Update], &[Update]),
        scene_events: u64,
        last: bool,
        out: &mut Vec<Bytes>,
    ) {
        for (group, last) in [(first, last && second.is_empty()), (second, last)] {
            let mut rest = group;
            while let Some((datagram, fitting)) = self.write(tick, rest, scene_events, last) {
                let (sent_updates, later) = rest.split_at(fitting);
                self.send(datagram, sent_updates, out);
                rest = later;
            }
        }
    }

    /// Encodes each update in its own packet.
    fn pack_singly(
        &mut self,
        tick: Tick,
        updates: &mut [Update],
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        sort_parents_first(updates);
        let mut rest: &[Update] = updates;
        while let Some((now, later)) = rest.split_first() {
            if let Some((datagram, _)) = self.write(
                tick,
                core::slice::from_ref(now),
                scene_events,
                later.is_empty(),
            ) {
                self.send(datagram, core::slice::from_ref(now), out);
            }
            rest = later;
        }
    }

    /// Encodes updates that fit one packet in two.
    fn pack_halves(
        &mut self,
        tick: Tick,
        updates: &mut [Update],
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        self.repair_symbols.halve();
        let alone = sort_parents_first(updates);
        let cut = Self::middle(updates).min(alone);
        let (first, second) = updates.split_at_mut(cut);
        // One packet may hold parents and children; both halves are shorter than a packet that holds all.
        sort_by_alias(second);
        self.pack_groups(tick, (first, second), scene_events, true, out);
    }

    /// The number of first updates that take half of all bits.
    fn middle(updates: &[Update]) -> usize {
        let bits = updates.iter().map(Self::bits_of);
        let half = bits.clone().sum::<u64>() / 2;
        let mut so_far = 0;
        let before = |bits: &u64| {
            so_far += bits;
            so_far <= half
        };
        bits.take_while(before).count().max(1)
    }

    /// Encodes as many updates as fit a packet, and returns their number. The packet ends its tick if all fit and
    /// `last` is set.
    fn write(
        &self,
        tick: Tick,
        updates: &[Update],
        scene_events: u64,
        last: bool,
    ) -> Option<(Vec<u8>, usize)> {
        if updates.is_empty() {
            return None;
        }
        let number = self.sent_packets.next();
        let mut writer = UpdateWriter::new(self.stream, number, tick.value(), scene_events)
            .within(self.largest_packet);
        let fitting = updates
            .iter()
            .take_while(|update| writer.push(update))
            .count();
        let ends_tick = last && fitting == updates.len();
        let datagram = match self.error_scale() {
            error_scale if ends_tick && error_scale != ErrorScale::NONE => {
                writer.finish_over_budget(error_scale)
            }
            _ => writer.finish(ends_tick),
        };
        Some((datagram, fitting))
    }

    fn send(&mut self, datagram: Vec<u8>, sent_updates: &[Update], out: &mut Vec<Bytes>) {
        let aliases = self.alias_table.aliases();
        let body = |update: &Update| update.body.or_else(|| aliases.body(update.alias));
        let mut bodies = Vec::with_capacity(sent_updates.len());
        bodies.extend(sent_updates.iter().filter_map(body));
        bodies.sort_unstable();
        if self.features.redundancy {
            self.repair_symbols
                .record(self.sent_packets.next(), &datagram);
        }
        self.sent_packets.record(bodies.into_iter());
        self.statistics.updates += sent_updates.len() as u64;
        self.statistics.packets += 1;
        self.statistics.bytes += datagram.len() as u64;
        out.push(Bytes::from(datagram));
    }
}

/// Sorts updates by the aliases of their bodies, which differ from update to update.
fn sort_by_alias(updates: &mut [Update]) {
    if updates.is_sorted_by_key(|update| update.alias) {
        return;
    }
    let end = updates
        .iter()
        .map(|update| update.alias as usize + 1)
        .max()
        .unwrap_or_default();
    if end > updates.len() * SPARSE_ALIASES {
        // Updates are large, so each is moved only once.
        updates.sort_by_cached_key(|update| update.alias);
        return;
    }
    // By alias: the rank of its update.
    let mut ranks = vec![0_u32; end];
    for update in updates.iter() {
        ranks[update.alias as usize] = 1;
    }
    let mut next = 0;
    for rank in &mut ranks {
        next += core::mem::replace(rank, next);
    }
    // Each exchange brings an update to its place.
    for place in 0..updates.len() {
        loop {
            let rank = ranks[updates[place].alias as usize] as usize;
            if rank == place {
                break;
            }
            updates.swap(place, rank);
        }
    }
}

/// Sorts updates by alias, those that build on another body's track last. Returns the number of the others.
fn sort_parents_first(updates: &mut [Update]) -> usize {
    let mut free = updates.iter().all(|update| !update.payload.names_parent());
    free &= updates.is_sorted_by_key(|update| update.alias);
    if free {
        return updates.len();
    }
    updates.sort_unstable_by_key(|update| (update.payload.names_parent(), update.alias));
    updates.partition_point(|update| !update.payload.names_parent())
}
