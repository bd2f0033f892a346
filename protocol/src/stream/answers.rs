//! How often one listener is answered.
//!
//! Bounds what a listener can make its sender do: reports have a pause between them, and no packet is refreshed twice
//! within a round trip.

use alloc::collections::BTreeMap;

use crate::time::{Instant, Span};

/// Reports of one listener that follow each other faster are not answered: half of the time that a receiver allows for
/// disorder before it reports a loss.
const REPORT_PAUSE: Span = Span::from_millis(2);

/// When each listener was answered last.
#[derive(Debug, Default)]
pub(super) struct Answers {
    listeners: BTreeMap<u64, Answered>,
}

#[derive(Debug, Default)]
struct Answered {
    report: Option<Instant>,
    /// By number of packet.
    refreshes: BTreeMap<u64, Instant>,
}

impl Answers {
    /// A listener has gone, or begins anew.
    pub(super) fn forget(&mut self, listener: u64) {
        self.listeners.remove(&listener);
    }

    /// Whether a loss report is to be answered now; if so, the next one is not for a while.
    pub(super) fn allow_report(&mut self, now: Instant, listener: u64) -> bool {
        let answered = self.listeners.entry(listener).or_default();
        is_due(&mut answered.report, now, REPORT_PAUSE)
    }

    /// Whether a packet is to be refreshed now; if so, it is not again for a round trip.
    pub(super) fn allow_refresh(
        &mut self,
        now: Instant,
        listener: u64,
        round_trip: Span,
        number: u64,
    ) -> bool {
        let answered = self.listeners.entry(listener).or_default();
        answered.refreshes.retain(|_, at| now < *at + round_trip);
        let allowed = !answered.refreshes.contains_key(&number);
        if allowed {
            answered.refreshes.insert(number, now);
        }
        allowed
    }
}

/// Whether a pause since the last time is over; if so, this is the last time.
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
    fn reports_of_each_listener_have_a_pause_of_their_own() {
        let mut answers = Answers::default();
        let allowed = [(0, 1), (0, 2), (1, 1), (2, 1)];
        let allowed = allowed.map(|(ms, listener)| answers.allow_report(at(ms), listener));
        assert_eq!(allowed, [true, true, false, true]);
    }

    #[test]
    fn no_packet_is_refreshed_twice_within_a_round_trip() {
        let mut answers = Answers::default();
        let allowed = [(0, 7), (29, 7), (29, 8), (30, 7)];
        let round_trip = Span::from_millis(30);
        let allowed =
            allowed.map(|(ms, number)| answers.allow_refresh(at(ms), 1, round_trip, number));
        assert_eq!(allowed, [true, false, true, true]);
        assert!(answers.allow_refresh(at(30), 2, Span::ZERO, 7));
        assert!(answers.allow_refresh(at(30), 2, Span::ZERO, 7));
    }
}
