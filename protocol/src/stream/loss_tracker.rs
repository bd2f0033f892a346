//! Measures the losses of a stream's receivers and chooses the redundancy.
//!
//! Counts packets only and knows no times, so a slow link is never mistaken for a lossy one.

use alloc::collections::BTreeMap;
use alloc::collections::btree_map::Entry;
use alloc::vec::Vec;

use super::redundancy::{LossRate, Redundancy};
use crate::packet::LossReport;

/// The loss rate covers the last one to two windows of this many packets.
const WINDOW: u64 = 256;
/// The number of packets assumed received before a receiver's first report of a loss, if that many were sent.
const BEFORE: u64 = 192;
/// The prior: one lost packet in this many received.
const PRIOR: u64 = 32;
/// One receiver in this many may lose more than the redundancy is made for.
const RECEIVERS_PER_EXCEPTION: usize = 16;
/// The most receivers that are tracked at one time.
const RECEIVERS_MAX: usize = 256;

/// The losses of one receiver, from its loss reports.
#[derive(Clone, Copy, Debug)]
struct ReceiverLosses {
    /// The start of the window.
    since: LossSample,
    /// A later sample, which becomes the start when it is old enough.
    middle: LossSample,
    newest: LossSample,
    /// While the receiver loses packets: the number of the next packet when its loss became known.
    loses_from: Option<u64>,
}

/// The counters of a receiver at one time.
#[derive(Clone, Copy, Debug)]
struct LossSample {
    /// Packets sent so far.
    sent: u64,
    /// Packets among them that did not arrive.
    lost: u64,
}

/// The losses of the receivers of one stream.
#[derive(Clone, Debug, Default)]
pub(crate) struct LossTracker {
    receivers: BTreeMap<u64, ReceiverLosses>,
    redundancy: Redundancy,
}

impl LossTracker {
    /// Takes a receiver's report about a stream whose next packet is number `next`. An impossible report is ignored.
    pub(crate) fn add_report(&mut self, receiver: u64, loss_report: &LossReport, next: u64) {
        let sent = loss_report.next.expand(next);
        if sent > next {
            return;
        }
        let full = self.receivers.len() >= RECEIVERS_MAX;
        let receiver = match self.receivers.entry(receiver) {
            Entry::Occupied(known) => {
                let receiver = known.into_mut();
                receiver.add_report(sent, loss_report);
                receiver
            }
            Entry::Vacant(_) if full => return,
            Entry::Vacant(place) => place.insert(ReceiverLosses::of(sent, loss_report)),
        };
        receiver.note_loss(next);
    }

    /// Drops the losses of a receiver that left or starts again.
    pub(crate) fn forget(&mut self, receiver: u64) {
        self.receivers.remove(&receiver);
    }

    /// True if the receiver lost any of its recent packets.
    #[must_use]
    pub(crate) fn loses(&self, receiver: u64) -> bool {
        self.loses_from(receiver).is_some()
    }

    /// For a receiver that lost recent packets: the number of the next packet when that became known.
    #[must_use]
    pub(crate) fn loses_from(&self, receiver: u64) -> Option<u64> {
        self.receivers.get(&receiver)?.loses_from
    }

    /// The redundancy for a stream with this many receivers, whose next packet is number `next`.
    pub(crate) fn redundancy(&mut self, receivers: usize, next: u64) -> Redundancy {
        // A receiver without reports has no losses.
        let reports =
            |receiver: &ReceiverLosses| next.saturating_sub(receiver.newest.sent) < 2 * WINDOW;
        self.receivers.retain(|_, receiver| reports(receiver));
        if self.receivers.is_empty() && self.redundancy == Redundancy::Off {
            return Redundancy::Off;
        }
        let losses = self.receivers.values();
        let mut losses: Vec<u32> = losses.map(|receiver| receiver.loss(next).0).collect();
        losses.sort_unstable();
        let exceptions = receivers.saturating_sub(1) / RECEIVERS_PER_EXCEPTION;
        let worst = losses.iter().rev().nth(exceptions);
        let worst = LossRate(worst.copied().unwrap_or_default());
        self.redundancy = self.redundancy.for_loss(worst);
        self.redundancy
    }
}

impl ReceiverLosses {
    /// The state of a receiver at its first report.
    fn of(sent: u64, loss_report: &LossReport) -> Self {
        // Only current losses count: the packets that are missing now. Earlier losses may be long ago.
        let lost = u64::from(loss_report.abandoned.0);
        let just_now = lost.min(loss_report.lost.len() as u64);
        Self::begin(LossSample { sent, lost }, just_now)
    }

    /// The state after a silence: the only losses are those reported now.
    const fn begin(newest: LossSample, lost: u64) -> Self {
        let since = LossSample {
            sent: newest.sent.saturating_sub(BEFORE),
            lost: newest.lost - lost,
        };
        Self {
            since,
            middle: since,
            newest,
            loses_from: None,
        }
    }

    fn add_report(&mut self, sent: u64, loss_report: &LossReport) {
        let before = self.newest;
        let lost = loss_report.abandoned.expand(before.lost);
        let span = sent.saturating_sub(before.sent);
        let more = lost.saturating_sub(before.lost);
        if sent < before.sent || more > span {
            return;
        }
        let newest = LossSample { sent, lost };
        // A smaller total than at the start of the window: the receiver started again.
        let has_restarted = lost < self.since.lost;
        if has_restarted || span >= WINDOW {
            let restarted = if has_restarted {
                Self::of(sent, loss_report)
            } else {
                Self::begin(newest, more)
            };
            let loses_from = self.loses_from;
            *self = Self {
                loses_from,
                ..restarted
            };
            return;
        }
        self.newest = newest;
        if sent - self.middle.sent >= WINDOW {
            self.since = self.middle;
            self.middle = newest;
        }
    }

    /// Notes whether recent packets were lost. The stream's next packet is number `next`.
    fn note_loss(&mut self, next: u64) {
        let loses = self.newest.lost > self.since.lost;
        self.loses_from = loses.then(|| self.loses_from.unwrap_or(next));
    }

    /// The loss rate since the start of the window.
    fn loss(&self, next: u64) -> LossRate {
        let sent = next.saturating_sub(self.since.sent);
        let lost = self.newest.lost.saturating_sub(self.since.lost);
        if lost == 0 {
            return LossRate(0);
        }
        let share = (lost + 1) * 1_000_000 / (sent + PRIOR);
        LossRate(share.min(1_000_000) as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::Low16;

    /// The redundancy for each packet of a stream that loses packets as `is_lost` says. The receiver reports its losses
    /// every 30 packets.
    fn mode(packets: u64, is_lost: impl Fn(u64) -> bool) -> Vec<Redundancy> {
        let mut losses = LossTracker::default();
        let (mut abandoned, mut reported) = (0_u64, 0);
        let mut all = Vec::new();
        for number in 0..packets {
            abandoned += u64::from(is_lost(number));
            let next = number + 1;
            if abandoned > reported && next.is_multiple_of(30) {
                reported = abandoned;
                losses.add_report(7, &loss_report(next, abandoned), next);
            }
            all.push(losses.redundancy(1, next));
        }
        all
    }

    fn loss_report(next: u64, abandoned: u64) -> LossReport {
        LossReport {
            next: Low16::of(next),
            abandoned: Low16::of(abandoned),
            repair_symbols: 0,
            lost: alloc::vec![Low16(0); 4],
        }
    }

    #[test]
    fn redundancy_follows_loss_and_ends_with_it() {
        let mode = mode(3_000, |number| {
            (500..1_500).contains(&number) && number % 20 == 3
        });
        assert!(mode[..500].iter().all(|level| *level == Redundancy::Off));
        assert!(
            mode[800..1_500]
                .iter()
                .all(|level| *level == Redundancy::Plain)
        );
        assert!(mode[2_200..].iter().all(|level| *level == Redundancy::Off));
    }

    #[test]
    fn a_loss_below_one_percent_gets_no_redundancy() {
        let mode = mode(5_000, |number| number % 250 == 249);
        assert!(mode.iter().all(|level| *level == Redundancy::Off));
    }

    #[test]
    fn more_loss_gets_more_redundancy() {
        let mode = mode(2_000, |number| number % 5 == 0);
        assert_eq!(mode.last(), Some(&Redundancy::Thick));
    }

    #[test]
    fn the_worst_receiver_decides_unless_there_are_many() {
        for (receivers, worth) in [(16, Redundancy::Plain), (17, Redundancy::Off)] {
            let mut losses = LossTracker::default();
            losses.add_report(1, &loss_report(60, 4), 60);
            assert_eq!(losses.redundancy(receivers, 60), worth, "{receivers}");
        }
    }

    #[test]
    fn old_losses_expire() {
        let mut losses = LossTracker::default();
        losses.add_report(1, &loss_report(60, 0), 60);
        losses.add_report(2, &loss_report(60, 1), 60);
        assert!(!losses.loses(1) && losses.loses(2) && !losses.loses(3));
        assert_eq!(losses.loses_from(2), Some(60));
        for next in (100..1_000).step_by(100) {
            losses.add_report(2, &loss_report(next, 1), next);
        }
        assert!(!losses.loses(2));
    }

    #[test]
    fn reset_receivers_start_anew() {
        let new_body = {
            let mut losses = LossTracker::default();
            losses.add_report(1, &loss_report(1_000, 4), 1_000);
            losses.redundancy(1, 1_000)
        };
        assert_eq!(new_body, Redundancy::Thin);
        let before = || {
            let mut losses = LossTracker::default();
            for next in (100..=900).step_by(50) {
                losses.add_report(1, &loss_report(next, next / 5), next);
            }
            assert!(losses.redundancy(1, 900) > Redundancy::Plain);
            losses
        };
        // It was sent a new snapshot and has lost four packets since, which it reports at once.
        let mut losses = before();
        losses.add_report(1, &loss_report(1_000, 4), 1_000);
        assert!(losses.loses(1));
        assert!(losses.redundancy(1, 1_000) >= new_body);
        let mut losses = before();
        losses.forget(1);
        assert!(!losses.loses(1));
        assert_eq!(losses.redundancy(1, 900), Redundancy::Off);
        losses.add_report(1, &loss_report(1_000, 4), 1_000);
        assert_eq!(losses.redundancy(1, 1_000), new_body);
    }

    #[test]
    fn impossible_reports_are_ignored() {
        let mut losses = LossTracker::default();
        losses.add_report(1, &loss_report(50, 2), 20);
        assert_eq!(losses.redundancy(1, 20), Redundancy::Off);
        losses.add_report(1, &loss_report(20, 0), 20);
        losses.add_report(1, &loss_report(22, 20), 22);
        assert_eq!(losses.redundancy(1, 22), Redundancy::Off);
        for receiver in 0..2 * RECEIVERS_MAX as u64 {
            losses.add_report(receiver, &loss_report(22, 1), 22);
        }
        assert!(losses.receivers.len() <= RECEIVERS_MAX);
    }
}
