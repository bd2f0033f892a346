//! The NACK scheduler: when each missing packet is reported again.
//!
//! Every missing packet has its own timer. Only missing packets take memory.

use alloc::vec::Vec;

use super::retry_timer::RetryTimer;
use super::subscriber::Subscriber;
use crate::endpoint::{Instant, Span};
use crate::limits::LOST_NUMBERS_MAX;

/// Delay of a report, because packets may be reordered: the age at which a gap counts as a loss on a link that has
/// reordered packets. On other links it is a loss at once.
pub(crate) const DISORDER: Span = Span::from_millis(4);
/// The longest pause between two reports of one packet.
const WAIT_MOST: Span = Span::from_millis(500);

/// The missing packets of one stream and their timers.
#[derive(Clone, Debug)]
pub(super) struct NackScheduler {
    /// In rising order of number.
    open: Vec<(u64, RetryTimer)>,
    /// The earliest time of the next report, because the last one had no place for more packets.
    paused_until: Instant,
}

impl NackScheduler {
    /// A scheduler without missing packets.
    pub(super) const fn new() -> Self {
        Self {
            open: Vec::new(),
            paused_until: Instant::ZERO,
        }
    }

    /// Starts timers for packets that are newly missing, and drops those of packets that are not missing any more.
    pub(super) fn watch(&mut self, now: Instant, stream: &Subscriber) {
        let in_order = stream.statistics().disordered == 0;
        let allowed = if in_order { Span::ZERO } else { DISORDER };
        self.wait_for(now, allowed, stream.missing_packets());
    }

    /// Sets the missing packets, in rising order of number.
    fn wait_for(&mut self, now: Instant, allowed: Span, missing: impl Iterator<Item = u64>) {
        let mut before = core::mem::take(&mut self.open).into_iter().peekable();
        self.open.extend(missing.map(|number| {
            while before.next_if(|(other, _)| *other < number).is_some() {}
            let mut timer = match before.next_if(|(other, _)| *other == number) {
                Some((_, timer)) => timer,
                None => RetryTimer::new(allowed, WAIT_MOST),
            };
            timer.begin(now);
            (number, timer)
        }));
    }

    /// The time of the next report.
    pub(super) fn due(&self) -> Option<Instant> {
        let due = self.open.iter().filter_map(|(_, timer)| timer.due()).min();
        due.map(|due| due.max(self.paused_until))
    }

    /// The packets to report now, in rising order, as many as a report holds. The pause until the next report of each is
    /// `min_delay` at least, and never zero, even before a round trip is measured. More packets follow after a pause in
    /// which the sender answers no report.
    pub(super) fn poll(&mut self, now: Instant, min_delay: Span) -> Vec<u64> {
        if now < self.paused_until {
            return Vec::new();
        }
        let min_delay = min_delay.max(DISORDER);
        let open = self.open.iter_mut();
        let due = open.filter_map(|(number, timer)| timer.fire(now, min_delay).then_some(*number));
        let reported: Vec<u64> = due.take(LOST_NUMBERS_MAX).collect();
        if reported.len() == LOST_NUMBERS_MAX {
            self.paused_until = now + DISORDER;
        }
        reported
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Instant {
        Instant::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn no_packet_is_requested_twice_at_zero_round_trip() {
        let mut scheduler = NackScheduler::new();
        for now in [at(0), at(4), at(12)] {
            scheduler.wait_for(now, Span::ZERO, [3].into_iter());
            assert_eq!(scheduler.poll(now, Span::ZERO), [3]);
            assert!(scheduler.poll(now, Span::ZERO).is_empty());
        }
        assert_eq!(scheduler.due(), Some(at(28)));
    }

    #[test]
    fn each_lost_packet_has_its_own_timer() {
        let min_delay = Span::from_millis(125);
        let mut scheduler = NackScheduler::new();
        scheduler.wait_for(at(0), DISORDER, [3].into_iter());
        assert_eq!(scheduler.due(), Some(at(4)));
        assert!(scheduler.poll(at(3), min_delay).is_empty());
        assert_eq!(scheduler.poll(at(4), min_delay), [3]);
        scheduler.wait_for(at(20), DISORDER, [3, 7, 9].into_iter());
        assert_eq!(scheduler.due(), Some(at(24)));
        assert_eq!(scheduler.poll(at(24), min_delay), [7, 9]);
        assert_eq!(scheduler.due(), Some(at(129)));
        // Packets 3 and 9 arrived; packet 7 is requested again after its own pause.
        scheduler.wait_for(at(129), DISORDER, [7].into_iter());
        assert_eq!(scheduler.due(), Some(at(149)));
        assert_eq!(scheduler.poll(at(149), min_delay), [7]);
        assert_eq!(scheduler.due(), Some(at(149 + 250)));
        scheduler.wait_for(at(150), DISORDER, [].into_iter());
        assert_eq!(scheduler.due(), None);
        scheduler.wait_for(at(160), Span::ZERO, [12].into_iter());
        assert_eq!(scheduler.poll(at(160), min_delay), [12]);
    }
    #[test]
    fn many_lost_packets_are_reported_at_once_in_several_reports() {
        let mut scheduler = NackScheduler::new();
        scheduler.wait_for(at(0), Span::ZERO, 0..150);
        for (ms, count) in [(0, 64), (4, 64), (8, 22), (12, 0)] {
            let due = scheduler.due().filter(|due| *due <= at(ms));
            assert_eq!(due.is_some(), count > 0, "{ms} ms");
            let reported = scheduler.poll(at(ms), Span::from_millis(100));
            assert_eq!(reported.len(), count, "{ms} ms");
        }
        assert_eq!(scheduler.due(), Some(at(100)));
    }
}
