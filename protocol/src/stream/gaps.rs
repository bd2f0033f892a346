//! A subscriber's knowledge of packets: missing ones, stated error scales.
//!
//! Handles numbers only; the subscriber handles the contents. A packet is *missing* while neither it nor a refresh of
//! it was received. It is *unread* if it was received but partly builds on a missing one. The stream is *converged*
//! while there is neither; then every track is known.
//!
//! An error scale is stated by a stream with a budget. A statement covers the ticks since the packet before it. If that
//! packet is missing, it covers its own tick alone. For other ticks the error scale is unknown.

use alloc::collections::{BTreeMap, VecDeque};

use rhumb_reckoning::Tick;

use crate::limits::HISTORY_PACKETS;
use crate::packet::ErrorScale;

/// A packet that was not received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Missing {
    /// The tick of a later packet; this packet was sent no later.
    before: Tick,
    /// True if it arrived, but could not be applied completely.
    arrived: bool,
    /// The received parts, as bits, of its latest refresh.
    received: Option<(RefreshId, u64)>,
}

/// A refresh of a lost packet, identified by the state of the scene when it was encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct RefreshId {
    /// The tick of its tracks.
    pub(crate) as_of: Tick,
    /// The count of scene events: bodies may be removed between two refreshes at one tick.
    pub(crate) scene_events: u64,
    /// The number of parts.
    pub(crate) parts: u8,
}

/// A packet that was only partly applied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Unread {
    tick: Tick,
    /// True if every refresh so far, of packets that it may build on, is at least as new as itself.
    covered: bool,
}

/// The way in which a packet came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// The network brought it.
    ByItself,
    /// Repair symbols restored it.
    Rebuilt,
}

/// The numbers of the packets that were read as they arrived by themselves, as far back as packets can be missing.
///
/// A packet with an unreadable update may be read several times; it has arrived once.
#[derive(Clone, Debug)]
struct OwnArrivals {
    bits: [u64; HISTORY_PACKETS / 64],
    /// Since the start.
    count: u64,
}

impl OwnArrivals {
    const NONE: Self = Self {
        bits: [0; HISTORY_PACKETS / 64],
        count: 0,
    };

    const fn place(number: u64) -> (usize, u64) {
        let place = (number % HISTORY_PACKETS as u64) as usize;
        (place / 64, 1 << (place % 64))
    }

    /// Takes the place of a number that is 1,024 lower.
    const fn begin(&mut self, number: u64) {
        let (word, bit) = Self::place(number);
        self.bits[word] &= !bit;
    }

    fn note(&mut self, number: u64) {
        let (word, bit) = Self::place(number);
        self.count += u64::from(self.bits[word] & bit == 0);
        self.bits[word] |= bit;
    }
}

/// The class of a packet that arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PacketArrival {
    /// The packet is new: read it.
    Fresh,
    /// The packet was received before.
    Duplicate,
    /// The packet lies so far ahead that the packets before it can no longer be refreshed.
    Lost,
}

/// The missing and unread packets of one stream.
#[derive(Clone, Debug)]
pub(crate) struct PacketGaps {
    next: u64,
    missing: BTreeMap<u64, Missing>,
    unread: BTreeMap<u64, Unread>,
    own_arrivals: OwnArrivals,
}

impl PacketGaps {
    /// A stream whose packets before `next` are all known.
    pub(crate) const fn new(next: u64) -> Self {
        Self {
            next,
            missing: BTreeMap::new(),
            unread: BTreeMap::new(),
            own_arrivals: OwnArrivals::NONE,
        }
    }

    /// The number of packets that arrived by themselves before a refresh or a repair symbol replaced them.
    pub(crate) const fn arrived(&self) -> u64 {
        self.own_arrivals.count
    }

    /// One more than the newest number known to have been sent.
    pub(crate) const fn next(&self) -> u64 {
        self.next
    }

    /// True if every packet sent so far was received, recovered or refreshed.
    pub(crate) fn is_converged(&self) -> bool {
        self.missing.is_empty() && self.unread.is_empty()
    }

    /// The missing numbers, oldest first.
    pub(crate) fn missing(&self) -> impl Iterator<Item = u64> + Clone {
        self.missing.keys().copied()
    }

    /// True if a packet is missing.
    pub(crate) fn lacks(&self, number: u64) -> bool {
        self.missing.contains_key(&number)
    }

    /// Tracks from this tick on are known to be current; `None` if all tracks are.
    pub(crate) fn unsure_before(&self) -> Option<Tick> {
        let missing = self.missing.values().map(|missing| missing.before);
        let unread = self.unread.values().map(|unread| unread.tick);
        missing.chain(unread).max()
    }

    /// Handles the arrival of a packet that was sent at `tick`.
    pub(crate) fn arrive(&mut self, number: u64, tick: Tick, how: Arrival) -> PacketArrival {
        if number >= self.next {
            if !self.remembers(number + 1) || !self.announce(number, tick) {
                return PacketArrival::Lost;
            }
            self.next = number + 1;
            self.own_arrivals.begin(number);
        } else if self.missing.contains_key(&number) {
            // It may arrive before packets that it builds on, so it covers no later packet.
            self.resolve(number, Tick::ZERO);
        } else {
            return PacketArrival::Duplicate;
        }
        if how == Arrival::ByItself {
            self.own_arrivals.note(number);
        }
        PacketArrival::Fresh
    }

    /// Notes that all packets before `next` were sent, the last of them no later than `tick`. Returns `false`, without
    /// any change, if the oldest missing packet can no longer be refreshed.
    pub(crate) fn announce(&mut self, next: u64, tick: Tick) -> bool {
        if !self.remembers(next) {
            return false;
        }
        for number in self.next..next {
            let missing = Missing {
                before: tick,
                arrived: false,
                received: None,
            };
            self.missing.insert(number, missing);
            self.own_arrivals.begin(number);
        }
        self.next = self.next.max(next);
        true
    }

    /// True if a publisher whose next packet is `next` can still refresh the oldest packet that would then be missing.
    fn remembers(&self, next: u64) -> bool {
        let oldest = self.missing.keys().next().copied();
        let oldest = oldest.unwrap_or(self.next).min(self.next);
        next.saturating_sub(oldest) <= HISTORY_PACKETS as u64
    }

    /// Notes that a part of an arrived packet builds on a missing one.
    ///
    /// `of_the_same`: the missing packet updates the same bodies, so its refresh may be sufficient.
    pub(crate) fn note_unread(&mut self, number: u64, tick: Tick, of_the_same: bool) {
        // A packet that is itself missing is requested already.
        if self.missing.contains_key(&number) {
            return;
        }
        let has_missing_before = self.missing.range(..number).next().is_some();
        let unread = self.unread.entry(number).or_insert(Unread {
            tick,
            covered: true,
        });
        unread.covered &= of_the_same && has_missing_before;
        self.promote_unread();
    }

    /// Takes a received packet that could not be applied, and is not covered by a refresh, as one that arrives only
    /// now. Returns `false` if the packet needs no second reading, or was not read yet: a rebuilt packet may wait for
    /// scene events.
    pub(crate) fn read_again(&mut self, number: u64) -> bool {
        let has_arrived = self
            .missing
            .get(&number)
            .is_some_and(|missing| missing.arrived);
        if has_arrived {
            // Packets that wait for this one are read again too: no refresh contains the bodies of this one.
            self.resolve(number, Tick::ZERO);
        }
        has_arrived
    }

    /// Handles a part of a refresh, and returns whether the packet is now refreshed. Parts of different refreshes do
    /// not combine, because they are split at different places.
    pub(crate) fn refreshed(&mut self, number: u64, refresh: RefreshId, part: u8) -> bool {
        let Some(missing) = self.missing.get_mut(&number) else {
            return false;
        };
        let before = match missing.received {
            Some((newer, _)) if newer > refresh => return false,
            Some((same, parts)) if same == refresh => parts,
            _ => 0,
        };
        let received = before | 1 << (part % 64);
        missing.received = Some((refresh, received));
        let all = u64::MAX >> (64 - refresh.parts.clamp(1, 64));
        let is_whole = received & all == all;
        if is_whole {
            self.resolve(number, refresh.as_of);
        }
        is_whole
    }

    fn resolve(&mut self, number: u64, as_of: Tick) {
        self.missing.remove(&number);
        for (_, unread) in self.unread.range_mut(number..) {
            unread.covered &= as_of >= unread.tick;
        }
        self.promote_unread();
    }

    /// Requests unread packets whose refresh was older than themselves. An unread packet with no missing packet before
    /// it is covered.
    fn promote_unread(&mut self) {
        let missing = &mut self.missing;
        self.unread.retain(|number, unread| {
            if !unread.covered {
                let before = unread.tick;
                missing.insert(
                    *number,
                    Missing {
                        before,
                        arrived: true,
                        received: None,
                    },
                );
            }
            unread.covered
        });
        let oldest_missing = self.missing.keys().next().copied().unwrap_or(u64::MAX);
        self.unread.retain(|number, _| *number > oldest_missing);
    }
}

/// The newest statements of one stream.
#[derive(Clone, Debug)]
pub(crate) struct ErrorScaleLog {
    /// First tick, last tick, and the error scale between them.
    statements: VecDeque<(Tick, Tick, ErrorScale)>,
    /// The number of the next packet if none is missing, and the first tick that its statement covers.
    next: u64,
    from: Tick,
}

/// The number of statements kept: a view shows ticks that are at most a second old.
const KEPT: usize = 256;

impl ErrorScaleLog {
    /// An empty log. The snapshot shows a tick before the packet with number `next`.
    pub(crate) const fn new(next: u64, snapshot: Tick) -> Self {
        Self {
            statements: VecDeque::new(),
            next,
            from: snapshot,
        }
    }

    /// Adds a received packet; `error_scale` is its statement, if it ends its tick.
    pub(crate) fn packet(&mut self, number: u64, tick: Tick, error_scale: Option<ErrorScale>) {
        let from = if number == self.next { self.from } else { tick };
        if let Some(error_scale) = error_scale {
            self.add(from, tick, error_scale);
        }
        if number >= self.next {
            self.next = number + 1;
            self.from = if error_scale.is_some() {
                tick.next()
            } else {
                from
            };
        }
    }

    /// Adds a received watermark.
    pub(crate) fn watermark(&mut self, next: u64, tick: Tick, error_scale: ErrorScale) {
        let from = if next == self.next { self.from } else { tick };
        self.add(from, tick, error_scale);
    }

    fn add(&mut self, from: Tick, to: Tick, error_scale: ErrorScale) {
        if from > to {
            return;
        }
        if let Some(last) = self.statements.back_mut()
            && last.0 == from
            && last.2 == error_scale
        {
            last.1 = last.1.max(to);
            return;
        }
        if self.statements.len() == KEPT {
            self.statements.pop_front();
        }
        self.statements.push_back((from, to, error_scale));
    }

    /// The factor on the tolerances at a tick, if it is known.
    pub(crate) fn at(&self, tick: Tick) -> Option<f64> {
        self.stated_at(tick)?.factor()
    }

    /// The least error scale stated for a tick.
    pub(crate) fn stated_at(&self, tick: Tick) -> Option<ErrorScale> {
        let covering = self
            .statements
            .iter()
            .filter(|(from, to, _)| (*from..=*to).contains(&tick));
        covering.map(|(_, _, error_scale)| *error_scale).min()
    }
}

#[cfg(test)]
mod tests {
    use alloc::vec::Vec;

    use super::*;

    fn tick(value: u64) -> Tick {
        Tick::new(value)
    }

    fn arrive(gaps: &mut PacketGaps, number: u64, at: u64) -> PacketArrival {
        gaps.arrive(number, tick(at), Arrival::ByItself)
    }

    fn refresh(as_of: u64, parts: u8) -> RefreshId {
        RefreshId {
            as_of: tick(as_of),
            scene_events: 0,
            parts,
        }
    }

    #[test]
    fn a_late_packet_fills_the_gap() {
        let mut gaps = PacketGaps::new(0);
        assert_eq!(arrive(&mut gaps, 0, 1), PacketArrival::Fresh);
        assert_eq!(arrive(&mut gaps, 2, 3), PacketArrival::Fresh);
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [1]);
        assert_eq!(gaps.unsure_before(), Some(tick(3)));
        assert_eq!(arrive(&mut gaps, 1, 2), PacketArrival::Fresh);
        assert!(gaps.is_converged());
        assert_eq!(arrive(&mut gaps, 1, 2), PacketArrival::Duplicate);
    }

    #[test]
    fn a_refresh_counts_when_all_its_parts_are_received() {
        let mut gaps = PacketGaps::new(0);
        assert!(gaps.announce(1, tick(5)));
        assert!(!gaps.refreshed(0, refresh(6, 2), 1));
        assert!(!gaps.refreshed(0, refresh(6, 2), 1));
        assert!(!gaps.is_converged());
        assert!(gaps.refreshed(0, refresh(6, 2), 0));
        assert!(gaps.is_converged());
    }

    #[test]
    fn parts_of_different_refreshes_do_not_combine() {
        let mut gaps = PacketGaps::new(0);
        assert!(gaps.announce(1, tick(5)));
        gaps.refreshed(0, refresh(6, 2), 0);
        gaps.refreshed(0, refresh(7, 2), 1);
        gaps.refreshed(0, refresh(6, 2), 1);
        let later = RefreshId {
            scene_events: 1,
            ..refresh(7, 2)
        };
        gaps.refreshed(0, later, 0);
        assert!(!gaps.is_converged());
        gaps.refreshed(0, later, 1);
        assert!(gaps.is_converged());
    }

    #[test]
    fn a_refresh_as_new_as_an_unread_packet_covers_it() {
        let mut gaps = PacketGaps::new(0);
        assert_eq!(arrive(&mut gaps, 1, 2), PacketArrival::Fresh);
        gaps.note_unread(1, tick(2), true);
        gaps.refreshed(0, refresh(2, 1), 0);
        assert!(gaps.is_converged());
    }

    #[test]
    fn an_unread_packet_newer_than_the_refresh_is_requested() {
        let mut gaps = PacketGaps::new(0);
        assert_eq!(arrive(&mut gaps, 1, 2), PacketArrival::Fresh);
        assert_eq!(arrive(&mut gaps, 2, 9), PacketArrival::Fresh);
        gaps.note_unread(2, tick(9), true);
        gaps.refreshed(0, refresh(5, 1), 0);
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [2]);
        gaps.refreshed(2, refresh(9, 1), 0);
        assert!(gaps.is_converged());
    }

    #[test]
    fn refreshed_packets_are_not_requested_again() {
        let mut gaps = PacketGaps::new(0);
        assert_eq!(arrive(&mut gaps, 1, 2), PacketArrival::Fresh);
        gaps.note_unread(1, tick(2), false);
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [0, 1]);
        gaps.note_unread(1, tick(2), true);
        gaps.refreshed(1, refresh(2, 1), 0);
        assert_eq!(arrive(&mut gaps, 0, 1), PacketArrival::Fresh);
        assert!(gaps.is_converged());
    }

    #[test]
    fn dependents_are_reread_after_their_packet() {
        let mut gaps = PacketGaps::new(0);
        assert_eq!(arrive(&mut gaps, 1, 2), PacketArrival::Fresh);
        gaps.note_unread(1, tick(2), false);
        assert_eq!(arrive(&mut gaps, 2, 2), PacketArrival::Fresh);
        gaps.note_unread(2, tick(2), true);
        gaps.refreshed(0, refresh(2, 1), 0);
        assert!(gaps.read_again(1));
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [2]);
        assert!(gaps.read_again(2));
        assert!(gaps.is_converged());
    }

    #[test]
    fn a_packet_that_its_publisher_no_longer_keeps_loses_sync() {
        let mut gaps = PacketGaps::new(0);
        let sent_packets = HISTORY_PACKETS as u64;
        for number in 1..sent_packets {
            assert_eq!(arrive(&mut gaps, number, number), PacketArrival::Fresh);
        }
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [0]);
        assert_eq!(
            arrive(&mut gaps, sent_packets, sent_packets),
            PacketArrival::Lost
        );
    }

    #[test]
    fn a_packet_too_far_ahead_is_lost_and_changes_nothing() {
        let mut gaps = PacketGaps::new(0);
        assert_eq!(
            arrive(&mut gaps, HISTORY_PACKETS as u64 + 1, 2),
            PacketArrival::Lost
        );
        assert!(gaps.is_converged());
        assert_eq!(gaps.next(), 0);
    }

    #[test]
    fn a_packet_that_arrives_twice_has_arrived_once() {
        let mut gaps = PacketGaps::new(0);
        assert_eq!(
            gaps.arrive(0, tick(1), Arrival::Rebuilt),
            PacketArrival::Fresh
        );
        gaps.note_unread(0, tick(1), false);
        assert_eq!(gaps.arrived(), 0);
        for _ in 0..2 {
            assert_eq!(arrive(&mut gaps, 0, 1), PacketArrival::Fresh);
            gaps.note_unread(0, tick(1), false);
            assert_eq!(gaps.arrived(), 1);
        }
        assert!(gaps.refreshed(0, refresh(1, 1), 0));
        for number in 1..=HISTORY_PACKETS as u64 {
            arrive(&mut gaps, number, number);
        }
        assert_eq!(gaps.arrived(), HISTORY_PACKETS as u64 + 1);
    }

    const DOUBLE: u8 = 8;

    fn double() -> ErrorScale {
        let double = ErrorScale::covering(2.0);
        assert_eq!(double.factor(), Some(f64::from(DOUBLE) / 4.0));
        double
    }

    #[test]
    fn a_statement_covers_the_ticks_since_the_last_packet() {
        let mut log = ErrorScaleLog::new(7, Tick::new(100));
        assert_eq!(log.at(Tick::new(100)), None);
        log.watermark(7, Tick::new(104), double());
        assert_eq!(log.at(Tick::new(100)), Some(2.0));
        log.packet(7, Tick::new(106), Some(ErrorScale::NONE));
        // The packet's statement covers every tick up to it.
        assert_eq!(log.at(Tick::new(101)), Some(1.0));
        assert_eq!(log.at(Tick::new(106)), Some(1.0));
        assert_eq!(log.at(Tick::new(107)), None);
        log.packet(8, Tick::new(107), None);
        log.packet(9, Tick::new(107), Some(double()));
        assert_eq!(log.at(Tick::new(107)), Some(2.0));
    }

    #[test]
    fn after_a_missing_packet_a_statement_covers_its_own_tick_alone() {
        let mut log = ErrorScaleLog::new(0, Tick::new(0));
        log.packet(0, Tick::new(5), Some(ErrorScale::NONE));
        log.packet(2, Tick::new(9), Some(double()));
        assert_eq!(log.at(Tick::new(8)), None);
        assert_eq!(log.at(Tick::new(9)), Some(2.0));
        log.packet(1, Tick::new(7), Some(ErrorScale::NONE));
        assert_eq!(log.at(Tick::new(7)), Some(1.0));
        assert_eq!(log.at(Tick::new(6)), None);
        log.watermark(5, Tick::new(12), ErrorScale::UNBOUNDED);
        assert_eq!(log.at(Tick::new(12)), None);
        log.packet(3, Tick::new(11), Some(double()));
        assert_eq!(log.at(Tick::new(10)), Some(2.0));
    }

    #[test]
    fn memory_is_bounded() {
        let mut log = ErrorScaleLog::new(0, Tick::new(0));
        for number in 0..10_000 {
            let error_scale = if number % 2 == 0 {
                double()
            } else {
                ErrorScale::NONE
            };
            log.packet(number, Tick::new(number + 1), Some(error_scale));
        }
        assert!(log.statements.len() <= KEPT);
        assert_eq!(log.at(Tick::new(10_000)), Some(1.0));
    }
}
