//! Which packets of a stream were heard, and since when what is not known.
//!
//! Numbers only: what a packet says is the subscriber's affair. A packet is *missing* while neither it nor a repair of
//! it was heard, and *unread* when it was heard but some of it builds on a missing one. The stream is *settled* while
//! there is neither; then everything said so far is known.

use alloc::collections::BTreeMap;

use rhumb_reckoning::Tick;

use crate::limits::HISTORY_PACKETS;

/// A packet that was not heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Missing {
    /// No later than this was it sent: the tick of a packet after it.
    before: Tick,
    /// Which parts of which of its repairs were heard.
    heard: Option<(RepairOf, u64)>,
}

/// One answer of the publisher to a lost packet: what the packet's bodies did when it was given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct RepairOf {
    /// The tick of its tracks.
    pub(crate) as_of: Tick,
    /// Notices given by then: at one tick, bodies may go between two answers.
    pub(crate) notices: u64,
    /// Into how many parts it was cut.
    pub(crate) parts: u8,
}

/// A packet of which something could not be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Unread {
    tick: Tick,
    /// Whether every repair so far of what it may build on is as new as itself.
    covered: bool,
}

/// Whether a packet is to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// It is new.
    Fresh,
    /// It was heard before.
    Duplicate,
    /// It lies so far ahead that what lies between can no longer be repaired.
    Lost,
}

/// The account of one stream's packets.
#[derive(Clone, Debug)]
pub(crate) struct Gaps {
    next: u64,
    missing: BTreeMap<u64, Missing>,
    unread: BTreeMap<u64, Unread>,
}

impl Gaps {
    /// All packets before `next` are known.
    pub(crate) const fn new(next: u64) -> Self {
        Self {
            next,
            missing: BTreeMap::new(),
            unread: BTreeMap::new(),
        }
    }

    /// One more than the newest number known to have been sent.
    pub(crate) const fn next(&self) -> u64 {
        self.next
    }

    /// Whether everything that was sent so far was heard or made good.
    pub(crate) fn is_settled(&self) -> bool {
        self.missing.is_empty() && self.unread.is_empty()
    }

    /// The missing numbers, oldest first.
    pub(crate) fn missing(&self) -> impl Iterator<Item = u64> + Clone {
        self.missing.keys().copied()
    }

    /// Whether a packet is missing.
    pub(crate) fn lacks(&self, number: u64) -> bool {
        self.missing.contains_key(&number)
    }

    /// Whether a packet before this one is missing.
    pub(crate) fn lacks_before(&self, number: u64) -> bool {
        self.missing.range(..number).next().is_some()
    }

    /// A body whose track is at least this new is known for sure; `None` when every body is.
    pub(crate) fn doubted_before(&self) -> Option<Tick> {
        let missing = self.missing.values().map(|missing| missing.before);
        let unread = self.unread.values().map(|unread| unread.tick);
        missing.chain(unread).max()
    }

    /// A packet arrived that was sent at `tick`.
    pub(crate) fn arrive(&mut self, number: u64, tick: Tick) -> Arrival {
        if number >= self.next {
            if !self.remembers(number + 1) || !self.announce(number, tick) {
                return Arrival::Lost;
            }
            self.next = number + 1;
            return Arrival::Fresh;
        }
        if self.missing.contains_key(&number) {
            // It may come before what it builds on, so that nothing after it is covered by it.
            self.made_good(number, Tick::ZERO);
            Arrival::Fresh
        } else {
            Arrival::Duplicate
        }
    }

    /// All packets before `next` were sent, the last of them no later than `tick`; `false`, and no change, when the
    /// oldest that is missing can no longer be repaired.
    pub(crate) fn announce(&mut self, next: u64, tick: Tick) -> bool {
        if !self.remembers(next) {
            return false;
        }
        for number in self.next..next {
            let missing = Missing {
                before: tick,
                heard: None,
            };
            self.missing.insert(number, missing);
        }
        self.next = self.next.max(next);
        true
    }

    /// Whether a publisher whose next packet is `next` remembers the oldest packet that would then be missing.
    fn remembers(&self, next: u64) -> bool {
        let oldest = self.missing.keys().next().copied();
        let oldest = oldest.unwrap_or(self.next).min(self.next);
        next.saturating_sub(oldest) <= HISTORY_PACKETS as u64
    }

    /// Something in a packet that arrived builds on what is missing.
    ///
    /// `of_the_same`: the missing packet spoke of the same bodies, so that its repair may serve.
    pub(crate) fn could_not_read(&mut self, number: u64, tick: Tick, of_the_same: bool) {
        // What is asked for already need not wait too.
        if self.missing.contains_key(&number) {
            return;
        }
        let waits = self.missing.range(..number).next().is_some();
        let unread = self.unread.entry(number).or_insert(Unread {
            tick,
            covered: true,
        });
        unread.covered &= of_the_same && waits;
        self.settle();
    }

    /// Takes a packet that was heard, and of which something could not be read that no repair so far covers, as one that
    /// is heard only now; `false` if there is nothing more to read in it.
    pub(crate) fn read_again(&mut self, number: u64) -> bool {
        let is_missing = self.missing.contains_key(&number);
        if is_missing {
            // What waited for it is to be read again too: no repair speaks of this one's bodies.
            self.made_good(number, Tick::ZERO);
        }
        is_missing
    }

    /// A part of a repair arrived; whether the packet is made good by it. Parts of different repairs do not add up: they are
    /// cut in different places.
    pub(crate) fn repaired(&mut self, number: u64, repair: RepairOf, part: u8) -> bool {
        let Some(missing) = self.missing.get_mut(&number) else {
            return false;
        };
        let before = match missing.heard {
            Some((newer, _)) if newer > repair => return false,
            Some((same, parts)) if same == repair => parts,
            _ => 0,
        };
        let heard = before | 1 << (part % 64);
        missing.heard = Some((repair, heard));
        let all = u64::MAX >> (64 - repair.parts.clamp(1, 64));
        let is_whole = heard & all == all;
        if is_whole {
            self.made_good(number, repair.as_of);
        }
        is_whole
    }

    fn made_good(&mut self, number: u64, as_of: Tick) {
        self.missing.remove(&number);
        for (_, unread) in self.unread.range_mut(number..) {
            unread.covered &= as_of >= unread.tick;
        }
        self.settle();
    }

    /// An unread packet that a repair came too early for must be repaired itself; one with nothing missing before it is
    /// covered.
    fn settle(&mut self) {
        let missing = &mut self.missing;
        self.unread.retain(|number, unread| {
            if !unread.covered {
                let before = unread.tick;
                missing.insert(
                    *number,
                    Missing {
                        before,
                        heard: None,
                    },
                );
            }
            unread.covered
        });
        let oldest_missing = self.missing.keys().next().copied().unwrap_or(u64::MAX);
        self.unread.retain(|number, _| *number > oldest_missing);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    fn tick(value: u64) -> Tick {
        Tick::new(value)
    }

    fn repair(as_of: u64, parts: u8) -> RepairOf {
        RepairOf {
            as_of: tick(as_of),
            notices: 0,
            parts,
        }
    }

    #[test]
    fn a_gap_is_seen_and_filled_by_a_late_packet() {
        let mut gaps = Gaps::new(0);
        assert_eq!(gaps.arrive(0, tick(1)), Arrival::Fresh);
        assert_eq!(gaps.arrive(2, tick(3)), Arrival::Fresh);
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [1]);
        assert_eq!(gaps.doubted_before(), Some(tick(3)));
        assert_eq!(gaps.arrive(1, tick(2)), Arrival::Fresh);
        assert!(gaps.is_settled());
        assert_eq!(gaps.arrive(1, tick(2)), Arrival::Duplicate);
    }

    #[test]
    fn a_repair_counts_when_all_its_parts_were_heard() {
        let mut gaps = Gaps::new(0);
        assert!(gaps.announce(1, tick(5)));
        assert!(!gaps.repaired(0, repair(6, 2), 1));
        assert!(!gaps.repaired(0, repair(6, 2), 1));
        assert!(!gaps.is_settled());
        assert!(gaps.repaired(0, repair(6, 2), 0));
        assert!(gaps.is_settled());
    }

    #[test]
    fn parts_of_different_repairs_do_not_add_up() {
        let mut gaps = Gaps::new(0);
        assert!(gaps.announce(1, tick(5)));
        gaps.repaired(0, repair(6, 2), 0);
        gaps.repaired(0, repair(7, 2), 1);
        gaps.repaired(0, repair(6, 2), 1);
        let later = RepairOf {
            notices: 1,
            ..repair(7, 2)
        };
        gaps.repaired(0, later, 0);
        assert!(!gaps.is_settled());
        gaps.repaired(0, later, 1);
        assert!(gaps.is_settled());
    }

    #[test]
    fn a_repair_as_new_as_an_unread_packet_covers_it() {
        let mut gaps = Gaps::new(0);
        assert_eq!(gaps.arrive(1, tick(2)), Arrival::Fresh);
        gaps.could_not_read(1, tick(2), true);
        gaps.repaired(0, repair(2, 1), 0);
        assert!(gaps.is_settled());
    }

    #[test]
    fn an_unread_packet_newer_than_the_repair_is_asked_for_itself() {
        let mut gaps = Gaps::new(0);
        assert_eq!(gaps.arrive(1, tick(2)), Arrival::Fresh);
        assert_eq!(gaps.arrive(2, tick(9)), Arrival::Fresh);
        gaps.could_not_read(2, tick(9), true);
        gaps.repaired(0, repair(5, 1), 0);
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [2]);
        gaps.repaired(2, repair(9, 1), 0);
        assert!(gaps.is_settled());
    }

    #[test]
    fn what_is_asked_for_is_not_asked_for_again_once_it_was_repaired() {
        let mut gaps = Gaps::new(0);
        assert_eq!(gaps.arrive(1, tick(2)), Arrival::Fresh);
        gaps.could_not_read(1, tick(2), false);
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [0, 1]);
        gaps.could_not_read(1, tick(2), true);
        gaps.repaired(1, repair(2, 1), 0);
        assert_eq!(gaps.arrive(0, tick(1)), Arrival::Fresh);
        assert!(gaps.is_settled());
    }

    #[test]
    fn what_waits_for_a_packet_that_is_read_again_is_read_again_after_it() {
        let mut gaps = Gaps::new(0);
        assert_eq!(gaps.arrive(1, tick(2)), Arrival::Fresh);
        gaps.could_not_read(1, tick(2), false);
        assert_eq!(gaps.arrive(2, tick(2)), Arrival::Fresh);
        gaps.could_not_read(2, tick(2), true);
        gaps.repaired(0, repair(2, 1), 0);
        assert!(gaps.read_again(1));
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [2]);
        assert!(gaps.read_again(2));
        assert!(gaps.is_settled());
    }

    #[test]
    fn a_packet_that_its_publisher_has_forgotten_is_lost_for_good() {
        let mut gaps = Gaps::new(0);
        let history = HISTORY_PACKETS as u64;
        for number in 1..history {
            assert_eq!(gaps.arrive(number, tick(number)), Arrival::Fresh);
        }
        assert_eq!(gaps.missing().collect::<Vec<_>>(), [0]);
        assert_eq!(gaps.arrive(history, tick(history)), Arrival::Lost);
    }

    #[test]
    fn too_far_ahead_is_lost_and_changes_nothing() {
        let mut gaps = Gaps::new(0);
        assert_eq!(
            gaps.arrive(HISTORY_PACKETS as u64 + 1, tick(2)),
            Arrival::Lost
        );
        assert!(gaps.is_settled());
        assert_eq!(gaps.next(), 0);
    }
}
