//! The packer: makes the datagrams of a stream, and answers losses of them.
//!
//! Numbers packets and keeps what answers need. Knows updates, but neither tracks nor tolerances. Invariants: no
//! datagram exceeds the largest packet; an update that builds on another body's track comes after that body.

use alloc::vec;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::Tick;

use crate::packet::{
    Checksums, CostModel, ErrorScale, InitialCostModel, LargestPacket, LossReport, Low16,
    RefreshRecord, RefreshWriter, StreamId, Update, UpdateWriter, Watermark,
};
use crate::stream::aliases::AliasMap;
use crate::stream::fec::{FecEncoder, SymbolRequest};
use crate::stream::losses::SentPackets;
use crate::stream::{Features, PublisherStatistics, Redundancy};

/// Fewer updates than this usually fit one packet; that is tried first.
const MANY: usize = 64;

/// The state of a stream that its datagrams of one tick refer to.
#[derive(Clone, Copy, Debug)]
pub(super) struct PublishedTick {
    pub(super) tick: Tick,
    /// The scene's number of events so far.
    pub(super) scene_events: u64,
    /// The factor by which tracks exceed their tolerances.
    pub(super) error_scale: ErrorScale,
}

/// The packets of a stream.
#[derive(Debug)]
pub(super) struct Packer {
    stream: StreamId,
    largest_packet: LargestPacket,
    /// See [`Features::packing`] and [`Features::halves`].
    packing: bool,
    halves: bool,
    /// See [`Features::redundancy`] and [`Features::unsolicited`].
    redundancy: bool,
    unsolicited: bool,
    sent_packets: SentPackets,
    repair_symbols: FecEncoder,
    /// Counters of updates, packets and bytes.
    statistics: PublisherStatistics,
}

impl Packer {
    pub(super) fn new(
        stream: StreamId,
        largest_packet: LargestPacket,
        features: &Features,
    ) -> Self {
        Self {
            stream,
            largest_packet,
            packing: features.packing,
            halves: features.halves,
            redundancy: features.redundancy,
            unsolicited: features.unsolicited,
            sent_packets: SentPackets::default(),
            repair_symbols: FecEncoder::default(),
            statistics: PublisherStatistics::default(),
        }
    }

    /// Splits the updates of one tick into datagrams.
    ///
    /// An update that builds on another body's track comes after that body, in the same packet or a later one.
    /// `aliases`: those of the updates.
    pub(super) fn pack(
        &mut self,
        at: &PublishedTick,
        updates: &mut [Update],
        aliases: &AliasMap<()>,
        out: &mut Vec<Bytes>,
    ) {
        if !self.packing {
            return self.pack_singly(at, updates, aliases, out);
        }
        sort_by_alias(updates);
        if !self.surely_fill_more(updates)
            && let Some((datagram, fitting)) = self.write(at, updates, true)
            && fitting == updates.len()
        {
            let splits = self.halves && self.repair_symbols.halves(datagram.len());
            if updates.len() > 1 && splits {
                self.pack_halves(at, updates, aliases, out);
            } else {
                self.send(datagram, updates, aliases, out);
            }
            return;
        }
        let alone = sort_parents_first(updates);
        self.pack_groups(at, updates.split_at(alone), aliases, out);
    }

    /// Encodes the repair symbols that are due after a published tick, silent or not.
    pub(super) fn encode_repair_symbols(&mut self, redundancy: Redundancy, out: &mut Vec<Bytes>) {
        if self.redundancy {
            let redundancy = if self.unsolicited {
                redundancy
            } else {
                Redundancy::Off
            };
            self.repair_symbols.end_tick(self.stream, redundancy, out);
        }
    }

    /// Answers a receiver that lost packets: appends repair symbols to `out` where they suffice, and returns the
    /// numbers of the packets that must be refreshed instead, each once.
    ///
    /// `sent_from`: the number of the next packet when this receiver was first sent the symbols of
    /// [`Self::encode_repair_symbols`]; `None` if it is sent none.
    pub(super) fn answer(
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

    /// The datagrams with the records of a lost packet's bodies; `None` for a packet that is too old.
    pub(super) fn refresh(
        &self,
        number: u64,
        at: &PublishedTick,
        record: impl Fn(u32) -> Option<RefreshRecord>,
    ) -> Option<Vec<Bytes>> {
        let mut writer = RefreshWriter::within(self.largest_packet);
        for index in self.sent_packets.bodies(number)? {
            if let Some(record) = record(*index) {
                writer.push(&record);
            }
        }
        let datagrams = writer.finish(self.stream, number, at.tick.value(), at.scene_events);
        Some(datagrams.into_iter().map(Bytes::from).collect())
    }

    /// The datagram with the checksum over all tracks.
    pub(super) fn checksums(&self, at: &PublishedTick, sum: u64) -> Bytes {
        let checksums = Checksums {
            next: Low16::of(self.sent_packets.next()),
            tick: Low16::of(at.tick.value()),
            scene_events: Low16::of(at.scene_events),
            sum,
        };
        Bytes::from(checksums.encode(self.stream))
    }

    /// The watermark for the silence since the last packet.
    pub(super) fn watermark(&self, at: &PublishedTick) -> Bytes {
        let watermark = Watermark {
            next: Low16::of(self.sent_packets.next()),
            tick: Low16::of(at.tick.value()),
            scene_events: Low16::of(at.scene_events),
        };
        Bytes::from(match at.error_scale {
            ErrorScale::NONE => watermark.encode(self.stream),
            error_scale => watermark.encode_over_budget(self.stream, error_scale),
        })
    }

    /// The id of the stream.
    pub(super) const fn stream(&self) -> StreamId {
        self.stream
    }

    /// The largest packet that it makes.
    pub(super) const fn largest_packet(&self) -> LargestPacket {
        self.largest_packet
    }

    /// The number of the next packet.
    pub(super) const fn next_number(&self) -> u64 {
        self.sent_packets.next()
    }

    /// Counters of updates, packets and bytes; the others are zero.
    pub(super) const fn statistics(&self) -> PublisherStatistics {
        self.statistics
    }

    /// True if updates surely exceed one packet: their estimated size is half as much again.
    fn surely_fill_more(&self, updates: &[Update]) -> bool {
        let filled = self.largest_packet.bytes() as u64 * 8 * 256;
        let mut bits = 0;
        let fills = |update: &Update| {
            bits += bits_of(update);
            bits > filled * 3 / 2
        };
        updates.len() >= MANY && updates.iter().any(fills)
    }

    /// Encodes two groups of updates in as many packets as they need. The second group builds on tracks of the first.
    fn pack_groups(
        &mut self,
        at: &PublishedTick,
        (first, second): (&[Update], &[Update]),
        aliases: &AliasMap<()>,
        out: &mut Vec<Bytes>,
    ) {
        for (group, last) in [(first, second.is_empty()), (second, true)] {
            let mut rest = group;
            while let Some((datagram, fitting)) = self.write(at, rest, last) {
                let (sent_updates, later) = rest.split_at(fitting);
                self.send(datagram, sent_updates, aliases, out);
                rest = later;
            }
        }
    }

    /// Encodes each update in its own packet.
    fn pack_singly(
        &mut self,
        at: &PublishedTick,
        updates: &mut [Update],
        aliases: &AliasMap<()>,
        out: &mut Vec<Bytes>,
    ) {
        sort_parents_first(updates);
        let mut rest: &[Update] = updates;
        while let Some((now, later)) = rest.split_first() {
            let now = core::slice::from_ref(now);
            if let Some((datagram, _)) = self.write(at, now, later.is_empty()) {
                self.send(datagram, now, aliases, out);
            }
            rest = later;
        }
    }

    /// Encodes updates that fit one packet in two.
    fn pack_halves(
        &mut self,
        at: &PublishedTick,
        updates: &mut [Update],
        aliases: &AliasMap<()>,
        out: &mut Vec<Bytes>,
    ) {
        self.repair_symbols.halve();
        let alone = sort_parents_first(updates);
        let cut = middle(updates).min(alone);
        let (first, second) = updates.split_at_mut(cut);
        // One packet may hold parents and children; both halves are shorter than a packet that holds all.
        sort_by_alias(second);
        self.pack_groups(at, (first, second), aliases, out);
    }

    /// Encodes as many updates as fit a packet, and returns their number. The packet ends its tick if all fit and
    /// `last` is set.
    fn write(
        &self,
        at: &PublishedTick,
        updates: &[Update],
        last: bool,
    ) -> Option<(Vec<u8>, usize)> {
        if updates.is_empty() {
            return None;
        }
        let number = self.sent_packets.next();
        let mut writer = UpdateWriter::new(self.stream, number, at.tick.value(), at.scene_events)
            .within(self.largest_packet);
        let fitting = updates
            .iter()
            .take_while(|update| writer.push(update))
            .count();
        let ends_tick = last && fitting == updates.len();
        let datagram = if ends_tick && at.error_scale != ErrorScale::NONE {
            writer.finish_over_budget(at.error_scale)
        } else {
            writer.finish(ends_tick)
        };
        Some((datagram, fitting))
    }

    /// Numbers a packet and keeps what answers to its loss need.
    fn send(
        &mut self,
        datagram: Vec<u8>,
        sent_updates: &[Update],
        aliases: &AliasMap<()>,
        out: &mut Vec<Bytes>,
    ) {
        let body = |update: &Update| update.body.or_else(|| aliases.body(update.alias));
        let mut bodies = Vec::with_capacity(sent_updates.len());
        bodies.extend(sent_updates.iter().filter_map(body));
        bodies.sort_unstable();
        if self.redundancy {
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

/// Aliases for each update, beyond which updates are sorted by comparisons instead of by a table of aliases.
const SPARSE_ALIASES: usize = 16;

/// The approximate cost of an update, in 1/256 bits.
pub(super) fn bits_of(update: &Update) -> u64 {
    /// The cost of a body's index and its new alias.
    const NAMED: u64 = 24 * 256;
    /// The cost of an existing alias.
    const ALIASED: u64 = 4 * 256;
    let name = if update.body.is_some() {
        NAMED
    } else {
        ALIASED
    };
    u64::from(InitialCostModel.cost(&update.payload)) + name
}

/// The number of first updates that take half of all bits.
fn middle(updates: &[Update]) -> usize {
    let bits = updates.iter().map(bits_of);
    let half = bits.clone().sum::<u64>() / 2;
    let mut so_far = 0;
    let before = |bits: &u64| {
        so_far += bits;
        so_far <= half
    };
    bits.take_while(before).count().max(1)
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
        return sort_by_keys(updates, |update| u64::from(update.alias));
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
    sort_by_keys(updates, |update| {
        u64::from(update.payload.names_parent()) << 32 | u64::from(update.alias)
    });
    updates.partition_point(|update| !update.payload.names_parent())
}

/// Sorts updates by keys that differ. Updates are large, so each is moved only once.
fn sort_by_keys(updates: &mut [Update], key: impl Fn(&Update) -> u64) {
    let mut order: Vec<(u64, usize)> = updates.iter().map(key).zip(0..).collect();
    order.sort_unstable();
    let mut ranks = vec![0; updates.len()];
    for (rank, (_, place)) in order.into_iter().enumerate() {
        ranks[place] = rank;
    }
    for place in 0..updates.len() {
        while ranks[place] != place {
            let rank = ranks[place];
            updates.swap(place, rank);
            ranks.swap(place, rank);
        }
    }
}

#[cfg(test)]
mod tests {
    mod packer {
        use proptest::prelude::*;
        use rhumb_reckoning::{Anchor, BodyState, Predictor, Track};

        use super::super::*;
        use crate::packet::{Datagram, Keyframe, PacketKind, UpdatePayload};
        use crate::stream::aliases::AliasTable;

        const AT: PublishedTick = PublishedTick {
            tick: Tick::new(7),
            scene_events: 0,
            error_scale: ErrorScale::NONE,
        };

        fn state(index: u32) -> BodyState {
            let state = BodyState::new(
                [index as f32, 0.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
                [0.0; 3],
                [0.0; 3],
            );
            state.expect("it is finite")
        }

        /// Keyframes of this many bodies, and their aliases.
        fn updates(bodies: u32) -> (Vec<Update>, AliasTable) {
            let mut alias_table = AliasTable::default();
            let update = |index| {
                let (alias, _) = alias_table.alias(index);
                let keyframe = Keyframe {
                    predictor: Predictor::Uniform,
                    anchor: Anchor::Exact(state(index)),
                    parent: None,
                };
                Update {
                    alias,
                    body: Some(index),
                    payload: UpdatePayload::Keyframe(keyframe),
                }
            };
            ((0..bodies).map(update).collect(), alias_table)
        }

        fn kind(datagram: &Bytes) -> PacketKind {
            let datagram = Datagram::open(datagram);
            datagram.expect("a packer makes datagrams").head().kind
        }

        proptest! {
            #[test]
            fn every_update_is_in_one_packet_none_is_too_large_and_the_last_ends_the_tick(
                (bodies, packing) in (0_u32..150, any::<bool>()),
            ) {
                let features = Features { packing, ..Features::ALL };
                let mut packer = Packer::new(StreamId(1), LargestPacket::DEFAULT, &features);
                let (mut updates, alias_table) = updates(bodies);
                let mut out = Vec::new();
                packer.pack(&AT, &mut updates, alias_table.aliases(), &mut out);
                prop_assert!(out.iter().all(|datagram| datagram.len() <= LargestPacket::DEFAULT.bytes()));
                let ends = out.iter().map(|datagram| kind(datagram) == PacketKind::UpdatesEnd);
                prop_assert!(ends.eq((1..=out.len()).map(|number| number == out.len())));
                let statistics = packer.statistics();
                prop_assert_eq!(statistics.updates, u64::from(bodies));
                prop_assert_eq!(statistics.packets, out.len() as u64);
                let mut refreshed = Vec::new();
                for number in 0..packer.next_number() {
                    let seen = core::cell::RefCell::new(&mut refreshed);
                    let refresh = packer.refresh(number, &AT, |index| {
                        seen.borrow_mut().push(index);
                        let keyframe = Keyframe::of(&Track::resting(AT.tick, state(index)));
                        let age = rhumb_reckoning::Ticks::ZERO;
                        Some(RefreshRecord { index, alias: None, age, keyframe })
                    });
                    prop_assert!(refresh.is_some_and(|datagrams| !datagrams.is_empty()));
                }
                refreshed.sort_unstable();
                prop_assert!(refreshed.into_iter().eq(0..bodies));
            }
        }

        #[test]
        fn a_packet_that_was_never_sent_has_no_refresh() {
            let packer = Packer::new(StreamId(1), LargestPacket::DEFAULT, &Features::ALL);
            assert_eq!(packer.refresh(0, &AT, |_| None), None);
        }
    }

    mod update_order {
        use proptest::prelude::*;
        use rhumb_reckoning::{Anchor, BodyId, BodyState, Predictor};

        use super::super::*;
        use crate::packet::{Keyframe, UpdatePayload};

        fn update(alias: u32, parent: Option<u32>) -> Update {
            let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
            Update {
                alias,
                body: Some(alias),
                payload: UpdatePayload::Keyframe(Keyframe {
                    predictor: Predictor::Uniform,
                    anchor: Anchor::Exact(still.expect("it is finite")),
                    parent: parent.map(|index| BodyId::new(index, 0)),
                }),
            }
        }

        /// Updates with different aliases below `end`, in any order.
        fn updates(end: u32) -> impl Strategy<Value = Vec<Update>> {
            let parents =
                proptest::collection::btree_map(0..end, proptest::option::of(0_u32..9), 0..40);
            let updates = parents.prop_map(|parents| {
                let updates = parents
                    .into_iter()
                    .map(|(alias, parent)| update(alias, parent));
                updates.collect::<Vec<_>>()
            });
            updates.prop_shuffle()
        }

        proptest! {
            #[test]
            fn updates_are_sorted_by_alias_however_far_apart_aliases_are(
                (mut few, mut many) in (updates(60), updates(100_000)),
            ) {
                for updates in [&mut few, &mut many] {
                    let mut expected = updates.clone();
                    expected.sort_by_key(|update| update.alias);
                    sort_by_alias(updates);
                    prop_assert_eq!(&*updates, &expected);
                }
            }

            #[test]
            fn updates_that_name_a_parent_come_last(mut updates in updates(60)) {
                let alone = sort_parents_first(&mut updates);
                let (first, last) = updates.split_at(alone);
                prop_assert!(first.iter().all(|update| !update.payload.names_parent()));
                prop_assert!(last.iter().all(|update| update.payload.names_parent()));
                for group in [first, last] {
                    prop_assert!(group.is_sorted_by_key(|update| update.alias));
                }
            }

            #[test]
            fn the_first_half_of_several_updates_takes_at_most_half_of_the_bits(updates in updates(60)) {
                prop_assume!(updates.len() > 1);
                let bits = |updates: &[Update]| updates.iter().map(bits_of).sum::<u64>();
                let middle = middle(&updates);
                prop_assert!(middle < updates.len());
                prop_assert!(middle == 1 || bits(&updates[..middle]) <= bits(&updates) / 2);
                prop_assert!(bits(&updates[..=middle]) > bits(&updates) / 2);
            }
        }
    }
}
