//! Limits the rate of replies to the loss reports of one receiver.
//!
//! Bounds the work that a receiver can cause: the sender pauses between answered reports, and refreshes no packet twice
//! within a round trip.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use crate::endpoint::{Instant, Span};

/// The least time between two answered reports of one receiver: half of the time that a receiver waits for reordered
/// packets before it reports a loss.
const REPORT_PAUSE: Span = Span::from_millis(2);

/// The times of the last replies to each receiver.
#[derive(Debug, Default)]
pub(super) struct ReplyLimiter {
    receivers: BTreeMap<u64, Answered>,
}

#[derive(Debug, Default)]
struct Answered {
    report: Option<Instant>,
    /// Numbers of the refreshed packets of the last round trip, and the times of their refreshes.
    refreshes: Vec<(u64, Instant)>,
}

impl ReplyLimiter {
    /// Drops the times of a receiver that left or starts again.
    pub(super) fn forget(&mut self, receiver: u64) {
        self.receivers.remove(&receiver);
    }

    /// True if to answer a loss report now. If so, the next reports within the pause are not answered.
    pub(super) fn allow_report(&mut self, now: Instant, receiver: u64) -> bool {
        let answered = self.receivers.entry(receiver).or_default();
        is_due(&mut answered.report, now, REPORT_PAUSE)
    }

    /// True if to refresh a packet now. If so, it is not refreshed again within a round trip.
    pub(super) fn allow_refresh(
        &mut self,
        now: Instant,
        receiver: u64,
        round_trip: Span,
        number: u64,
    ) -> bool {
        let answered = self.receivers.entry(receiver).or_default();
        answered.refreshes.retain(|(_, at)| now < *at + round_trip);
        let mut refreshed = answered.refreshes.iter();
        let allowed = refreshed.all(|(other, _)| *other != number);
        if allowed {
            answered.refreshes.push((number, now));
        }
        allowed
    }
}

/// True if the pause since `last` is over; if so, sets `last` to now.
fn is_due(last: &mut Option<Instant>, now: Instant, pause: Span) -> bool {
    let due = last.is_none_or(|last| now >= last + pause);
    if due {
        *last = Some(now);
    }
    due
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Instant {
        Instant::ZERO + Span::from_millis(ms)
    }

    #[test]
    fn the_pause_between_reports_is_per_listener() {
        let mut limiter = ReplyLimiter::default();
        let allowed = [(0, 1), (0, 2), (1, 1), (2, 1)];
        let allowed = allowed.map(|(ms, receiver)| limiter.allow_report(at(ms), receiver));
        assert_eq!(allowed, [true, true, false, true]);
    }

    #[test]
    fn no_packet_is_refreshed_twice_within_a_round_trip() {
        let mut limiter = ReplyLimiter::default();
        let allowed = [(0, 7), (29, 7), (29, 8), (30, 7)];
        let round_trip = Span::from_millis(30);
        let allowed =
            allowed.map(|(ms, number)| limiter.allow_refresh(at(ms), 1, round_trip, number));
        assert_eq!(allowed, [true, false, true, true]);
        assert!(limiter.allow_refresh(at(30), 2, Span::ZERO, 7));
        assert!(limiter.allow_refresh(at(30), 2, Span::ZERO, 7));
    }
}
