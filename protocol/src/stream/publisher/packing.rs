//! How the updates of one tick become packets.

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::Tick;

use super::Publisher;
use crate::packet::{ErrorScale, Update, UpdateWriter};

/// Fewer updates than this mostly fit a packet: these are written to see if they do.
const MANY: usize = 64;
/// Updates that take so much more than a packet would are not tried in one.
const SURELY_FILLED: u64 = FILLED * 3 / 2;
/// Bytes at which a packet is taken to be full where one more island would come; what updates take is not known to the
/// byte before they are said.
const FILLED: u64 = 1_040;

impl Publisher {
    /// Cuts the updates of one tick into datagrams.
    ///
    /// Bodies that touch stay in one packet where they fit one, so that they are all moved or none. What builds on another
    /// body's track comes after that body, in the same packet or a later one.
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
        if !surely_fill_more(updates)
            && let Some((datagram, fitting)) = self.write(tick, updates, scene_events, true)
            && fitting == updates.len()
        {
            if updates.len() > 1 && self.repair_symbols.halves(datagram.len()) {
                self.pack_halves(tick, updates, scene_events, out);
            } else {
                self.send(datagram, updates, out);
            }
            return;
        }
        let islands = self.sort_by_island(tick, updates);
        let (mut rest, mut islands) = (updates, islands.as_slice());
        while !islands.is_empty() {
            let (count, fitting) = Self::fitting(rest, islands);
            let (now, later) = rest.split_at_mut(fitting);
            islands = &islands[count..];
            self.pack_islands(tick, now, scene_events, islands.is_empty(), out);
            rest = later;
        }
    }

    /// How many islands fit a packet, one at least, and how many updates those have.
    fn fitting(updates: &[Update], islands: &[usize]) -> (usize, usize) {
        let (mut count, mut fitting, mut bits) = (0, 0, 0);
        for size in islands {
            let island = &updates[fitting..fitting + size];
            bits += island.iter().map(Self::bits_of).sum::<u64>();
            if count > 0 && bits > FILLED * 8 * 256 {
                break;
            }
            count += 1;
            fitting += size;
        }
        (count, fitting)
    }

    /// Says some islands in one packet, or in as many as it takes.
    fn pack_islands(
        &mut self,
        tick: Tick,
        updates: &mut [Update],
        scene_events: u64,
        last: bool,
        out: &mut Vec<Bytes>,
    ) {
        sort_by_alias(updates);
        if let Some((datagram, fitting)) = self.write(tick, updates, scene_events, last)
            && fitting == updates.len()
        {
            self.send(datagram, updates, out);
            return;
        }
        updates.sort_by_key(|update| (update.payload.names_parent(), update.alias));
        let alone = updates.partition_point(|update| !update.payload.names_parent());
        let (first, second) = updates.split_at(alone);
        for (group, last) in [(first, last && second.is_empty()), (second, last)] {
            let mut rest: &[Update] = group;
            while let Some((datagram, fitting)) = self.write(tick, rest, scene_events, last) {
                let (said, later) = rest.split_at(fitting);
                self.send(datagram, said, out);
                rest = later;
            }
        }
    }

    /// Says each update in a packet of its own.
    fn pack_singly(
        &mut self,
        tick: Tick,
        updates: &mut [Update],
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        updates.sort_unstable_by_key(|update| (update.payload.names_parent(), update.alias));
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

    /// Says in two packets what would fit one.
    fn pack_halves(
        &mut self,
        tick: Tick,
        updates: &mut [Update],
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        self.repair_symbols.halve();
        let cut = self.middle_of_islands(tick, updates).unwrap_or_else(|| {
            updates.sort_unstable_by_key(|update| (update.payload.names_parent(), update.alias));
            let alone = updates.partition_point(|update| !update.payload.names_parent());
            Self::middle(updates).min(alone)
        });
        let (first, second) = updates.split_at_mut(cut);
        self.pack_islands(tick, first, scene_events, second.is_empty(), out);
        self.pack_islands(tick, second, scene_events, true, out);
    }

    /// How many of the first updates are the islands that take about half of the bits of all, if any do.
    fn middle_of_islands(&self, tick: Tick, updates: &mut [Update]) -> Option<usize> {
        let islands = self.sort_by_island(tick, updates);
        let bits = |updates: &[Update]| -> u64 { updates.iter().map(Self::bits_of).sum() };
        let half = bits(updates) / 2;
        let (mut cut, mut so_far) = (0, 0);
        let mut best = None;
        for size in islands {
            so_far += bits(&updates[cut..cut + size]);
            cut += size;
            let off = so_far.abs_diff(half);
            if off <= half / 2 && best.is_none_or(|(least, _)| off < least) {
                best = Some((off, cut));
            }
        }
        best.map(|(_, cut)| cut)
    }

    /// How many of the first updates take half of the bits of all.
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

    /// A packet of as many updates as fit, and how many those are; it ends its tick if all do and `last` is set.
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
        let mut writer = UpdateWriter::new(self.stream, number, tick.value(), scene_events);
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

    fn send(&mut self, datagram: Vec<u8>, said: &[Update], out: &mut Vec<Bytes>) {
        let aliases = self.alias_table.aliases();
        let body = |update: &Update| update.body.or_else(|| aliases.body(update.alias));
        let mut bodies = Vec::with_capacity(said.len());
        bodies.extend(said.iter().filter_map(body));
        bodies.sort_unstable();
        if self.features.redundancy {
            self.repair_symbols
                .record(self.sent_packets.next(), &datagram);
        }
        self.sent_packets.record(bodies.into_iter());
        self.statistics.updates += said.len() as u64;
        self.statistics.packets += 1;
        self.statistics.bytes += datagram.len() as u64;
        out.push(Bytes::from(datagram));
    }
}

/// Sorts updates by the aliases of their bodies.
pub(super) fn sort_by_alias(updates: &mut [Update]) {
    if !updates.is_sorted_by_key(|update| update.alias) {
        // Updates are large: each is moved once.
        updates.sort_by_cached_key(|update| update.alias);
    }
}

/// Whether updates clearly take more than one packet.
fn surely_fill_more(updates: &[Update]) -> bool {
    let mut bits = 0;
    let fills = |update: &Update| {
        bits += Publisher::bits_of(update);
        bits > SURELY_FILLED * 8 * 256
    };
    updates.len() >= MANY && updates.iter().any(fills)
}
