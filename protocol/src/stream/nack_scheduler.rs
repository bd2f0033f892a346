//! When each missing packet is reported again.
//!
//! One packet's timer never delays another's. Keeps no more than it is told is missing.

use alloc::collections::BTreeMap;

use super::retry_timer::RetryTimer;
use super::subscriber::Subscriber;
use crate::time::{Instant, Span};

/// How long a gap may be disorder before it counts as loss, where packets came in disorder before; elsewhere it is
/// loss at once.
const DISORDER: Span = Span::from_millis(4);
/// The longest pause between two reports of one packet.
const WAIT_MOST: Span = Span::from_millis(500);

/// The missing packets of one stream and their timers.
#[derive(Clone, Debug)]
pub(super) struct NackScheduler {
    open: BTreeMap<u64, RetryTimer>,
}

impl NackScheduler {
    /// Nothing is missing.
    pub(super) const fn new() -> Self {
        Self {
            open: BTreeMap::new(),
        }
    }

    /// Starts timers for packets that are newly missing, and drops those of packets that are not missing any more.
    pub(super) fn watch(&mut self, now: Instant, stream: &Subscriber) {
        let in_order = stream.statistics().disordered == 0;
        let allowed = if in_order { Span::ZERO } else { DISORDER };
        self.wait_for(now, allowed, stream.missing_packets());
    }

    /// These packets are missing now, in rising order.
    fn wait_for(
        &mut self,
        now: Instant,
        allowed: Span,
        missing: impl Iterator<Item = u64> + Clone,
    ) {
        let mut still = missing.clone().peekable();
        self.open.retain(|number, _| {
            while still.next_if(|other| other < number).is_some() {}
            still.next_if_eq(number).is_some()
        });
        for number in missing {
            let new = || RetryTimer::new(allowed, WAIT_MOST);
            self.open.entry(number).or_insert_with(new).begin(now);
        }
    }

    /// When the next report is due.
    pub(super) fn due(&self) -> Option<Instant> {
        self.open.values().filter_map(RetryTimer::due).min()
    }

    /// The packets to report now, in rising order. The pause until the next report of each is `min_delay` at least, and
    /// never zero, even before a round trip is measured.
    pub(super) fn ask(&mut self, now: Instant, min_delay: Span) -> impl Iterator<Item = u64> {
        let min_delay = min_delay.max(DISORDER);
        let open = self.open.iter_mut();
        open.filter_map(move |(number, patience)| patience.ask(now, min_delay).then_some(*number))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    fn at(ms: u64) -> Instant {
        Instant::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn no_packet_is_requested_twice_at_zero_round_trip() {
        let mut asking = NackScheduler::new();
        for now in [at(0), at(4), at(12)] {
            asking.wait_for(now, Span::ZERO, [3].into_iter());
            assert_eq!(asking.ask(now, Span::ZERO).collect::<Vec<_>>(), [3]);
            assert!(asking.ask(now, Span::ZERO).next().is_none());
        }
        assert_eq!(asking.due(), Some(at(28)));
    }

    #[test]
    fn each_lost_packet_has_its_own_timer() {
        let min_delay = Span::from_millis(125);
        let mut asking = NackScheduler::new();
        asking.wait_for(at(0), DISORDER, [3].into_iter());
        assert_eq!(asking.due(), Some(at(4)));
        assert!(asking.ask(at(3), min_delay).next().is_none());
        assert_eq!(asking.ask(at(4), min_delay).collect::<Vec<_>>(), [3]);
        asking.wait_for(at(20), DISORDER, [3, 7, 9].into_iter());
        assert_eq!(asking.due(), Some(at(24)));
        assert_eq!(asking.ask(at(24), min_delay).collect::<Vec<_>>(), [7, 9]);
        assert_eq!(asking.due(), Some(at(129)));
        // 3 and 9 came; 7 is asked for again after its own wait.
        asking.wait_for(at(129), DISORDER, [7].into_iter());
        assert_eq!(asking.due(), Some(at(149)));
        assert_eq!(asking.ask(at(149), min_delay).collect::<Vec<_>>(), [7]);
        assert_eq!(asking.due(), Some(at(149 + 250)));
        asking.wait_for(at(150), DISORDER, [].into_iter());
        assert_eq!(asking.due(), None);
        asking.wait_for(at(160), Span::ZERO, [12].into_iter());
        assert_eq!(asking.ask(at(160), min_delay).collect::<Vec<_>>(), [12]);
    }
}
