//! What the listeners of a stream lose, and how much redundancy that is worth.
//!
//! Counts of packets only: how long anything took is not known here, so that a slow link is never taken for a lossy one.

use alloc::collections::BTreeMap;
use alloc::collections::btree_map::Entry;
use alloc::vec::Vec;

use super::redundancy::{LossRate, Redundancy};
use crate::packet::LossReport;

/// A loss is that of the last packets: of one to two such windows.
const WINDOW: u64 = 256;
/// So many packets came through before the first loss that anybody tells of, if so many were sent.
const BEFORE: u64 = 192;
/// What is predicted_motion beforehand: one packet lost of so many.
const PRIOR: u64 = 32;
/// So many listeners, one more each time, may lose more than what the stream is made for.
const SPARED: usize = 16;
/// Listeners of whom receiver is kept at one time.
const RECEIVERS_MAX: usize = 256;

/// One listener, by what its loss_reports said.
#[derive(Clone, Copy, Debug)]
struct ReceiverLosses {
    /// Where counting began.
    since: LossSample,
    /// A later point, at which it will begin when it has become old enough.
    middle: LossSample,
    newest: LossSample,
    /// While it loses packets: the number of the stream's next packet when it was first known to.
    loses_from: Option<u64>,
}

/// A moment of a stream at a listener.
#[derive(Clone, Copy, Debug)]
struct LossSample {
    /// Packets that were sent up to it.
    sent: u64,
    /// Of these, those that did not arrive.
    lost: u64,
}

/// What the listeners of one stream lose.
#[derive(Clone, Debug, Default)]
pub struct LossTracker {
    receivers: BTreeMap<u64, ReceiverLosses>,
    redundancy: Redundancy,
}

impl LossTracker {
    /// A listener said how far it heard of a stream whose next packet is number `next`. What cannot be is not predicted_motion.
    pub fn hear(&mut self, listener: u64, loss_report: &LossReport, next: u64) {
        let sent = loss_report.next.expand(next);
        if sent > next {
            return;
        }
        let full = self.receivers.len() >= RECEIVERS_MAX;
        let receiver = match self.receivers.entry(listener) {
            Entry::Occupied(known) => {
                let receiver = known.into_mut();
                receiver.hear(sent, loss_report);
                receiver
            }
            Entry::Vacant(_) if full => return,
            Entry::Vacant(place) => place.insert(ReceiverLosses::of(sent, loss_report)),
        };
        receiver.note_loss(next);
    }

    /// A listener hears the stream no more, or anew: of what it lost so far nothing follows.
    pub fn forget(&mut self, listener: u64) {
        self.receivers.remove(&listener);
    }

    /// Whether a listener lost any of its last packets.
    #[must_use]
    pub fn loses(&self, listener: u64) -> bool {
        self.loses_from(listener).is_some()
    }

    /// Of a listener that lost any of its last packets, the number of the stream's next packet when that was first known.
    #[must_use]
    pub fn loses_from(&self, listener: u64) -> Option<u64> {
        self.receivers.get(&listener)?.loses_from
    }

    /// How much redundancy a stream with so many listeners is worth, whose next packet is number `next`.
    pub fn redundancy(&mut self, listeners: usize, next: u64) -> Redundancy {
        // Who says nothing loses nothing.
        let speaks =
            |receiver: &ReceiverLosses| next.saturating_sub(receiver.newest.sent) < 2 * WINDOW;
        self.receivers.retain(|_, receiver| speaks(receiver));
        if self.receivers.is_empty() && self.redundancy == Redundancy::Off {
            return Redundancy::Off;
        }
        let mut losses: Vec<LossRate> = self
            .receivers
            .values()
            .map(|receiver| receiver.loss(next))
            .collect();
        losses.sort_unstable();
        let spared = listeners.saturating_sub(1) / SPARED;
        let worst = losses.iter().rev().nth(spared).copied().unwrap_or_default();
        self.redundancy = self.redundancy.for_loss(worst);
        self.redundancy
    }
}

impl ReceiverLosses {
    /// Of a listener that was not heard before, or begins anew.
    fn of(sent: u64, loss_report: &LossReport) -> Self {
        // Of what it lost long ago nothing follows: what it still lacks it lost just now.
        let lost = u64::from(loss_report.gone.0);
        let just_now = lost.min(loss_report.lost.len() as u64);
        Self::begin(LossSample { sent, lost }, just_now)
    }

    /// After a silence, in which nothing was lost but what is told of now.
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

    fn hear(&mut self, sent: u64, loss_report: &LossReport) {
        let before = self.newest;
        let lost = loss_report.gone.expand(before.lost);
        let span = sent.saturating_sub(before.sent);
        let more = lost.saturating_sub(before.lost);
        if sent < before.sent || more > span {
            return;
        }
        let newest = LossSample { sent, lost };
        // Less is gone than when counting began: the listener counts anew.
        let begun = lost < self.since.lost;
        if begun || span >= WINDOW {
            let anew = if begun {
                Self::of(sent, loss_report)
            } else {
                Self::begin(newest, more)
            };
            let loses_from = self.loses_from;
            *self = Self { loses_from, ..anew };
            return;
        }
        self.newest = newest;
        if sent - self.middle.sent >= WINDOW {
            self.since = self.middle;
            self.middle = newest;
        }
    }

    /// Notes whether any of the last packets were lost, now that the stream's next one is number `next`.
    fn note_loss(&mut self, next: u64) {
        let loses = self.newest.lost > self.since.lost;
        self.loses_from = loses.then(|| self.loses_from.unwrap_or(next));
    }

    /// The share that was lost since counting began.
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

    /// What a listener makes of a stream that loses each packet of which `is_lost` is true, if it tells every 30 packets
    /// what it lost since; by packet.
    fn mode(packets: u64, is_lost: impl Fn(u64) -> bool) -> Vec<Redundancy> {
        let mut losses = LossTracker::default();
        let (mut gone, mut told) = (0_u64, 0);
        let mut all = Vec::new();
        for number in 0..packets {
            gone += u64::from(is_lost(number));
            let next = number + 1;
            if gone > told && next.is_multiple_of(30) {
                told = gone;
                losses.hear(7, &loss_report(next, gone), next);
            }
            all.push(losses.redundancy(1, next));
        }
        all
    }

    fn loss_report(next: u64, gone: u64) -> LossReport {
        LossReport {
            next: Low16::of(next),
            gone: Low16::of(gone),
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
    fn less_than_a_packet_in_a_hundred_is_worth_no_redundancy() {
        let mode = mode(5_000, |number| number % 250 == 249);
        assert!(mode.iter().all(|level| *level == Redundancy::Off));
    }

    #[test]
    fn much_loss_is_worth_much_redundancy() {
        let mode = mode(2_000, |number| number % 5 == 0);
        assert_eq!(mode.last(), Some(&Redundancy::Thick));
    }

    #[test]
    fn the_worst_listener_decides_unless_there_are_many() {
        for (listeners, worth) in [(16, Redundancy::Plain), (17, Redundancy::Off)] {
            let mut losses = LossTracker::default();
            losses.hear(1, &loss_report(60, 4), 60);
            assert_eq!(losses.redundancy(listeners, 60), worth, "{listeners}");
        }
    }

    #[test]
    fn old_losses_expire() {
        let mut losses = LossTracker::default();
        losses.hear(1, &loss_report(60, 0), 60);
        losses.hear(2, &loss_report(60, 1), 60);
        assert!(!losses.loses(1) && losses.loses(2) && !losses.loses(3));
        assert_eq!(losses.loses_from(2), Some(60));
        for next in (100..1_000).step_by(100) {
            losses.hear(2, &loss_report(next, 1), next);
        }
        assert!(!losses.loses(2));
    }

    #[test]
    fn reset_receivers_start_anew() {
        let new_body = {
            let mut losses = LossTracker::default();
            losses.hear(1, &loss_report(1_000, 4), 1_000);
            losses.redundancy(1, 1_000)
        };
        assert_eq!(new_body, Redundancy::Thin);
        let before = || {
            let mut losses = LossTracker::default();
            for next in (100..=900).step_by(50) {
                losses.hear(1, &loss_report(next, next / 5), next);
            }
            assert!(losses.redundancy(1, 900) > Redundancy::Plain);
            losses
        };
        // It was told the scene again, and has lost four packets since: of these it tells at once.
        let mut losses = before();
        losses.hear(1, &loss_report(1_000, 4), 1_000);
        assert!(losses.loses(1));
        assert!(losses.redundancy(1, 1_000) >= new_body);
        let mut losses = before();
        losses.forget(1);
        assert!(!losses.loses(1));
        assert_eq!(losses.redundancy(1, 900), Redundancy::Off);
        losses.hear(1, &loss_report(1_000, 4), 1_000);
        assert_eq!(losses.redundancy(1, 1_000), new_body);
    }

    #[test]
    fn impossible_reports_are_ignored() {
        let mut losses = LossTracker::default();
        losses.hear(1, &loss_report(50, 2), 20);
        assert_eq!(losses.redundancy(1, 20), Redundancy::Off);
        losses.hear(1, &loss_report(20, 0), 20);
        losses.hear(1, &loss_report(22, 20), 22);
        assert_eq!(losses.redundancy(1, 22), Redundancy::Off);
        for listener in 0..2 * RECEIVERS_MAX as u64 {
            losses.hear(listener, &loss_report(22, 1), 22);
        }
        assert!(losses.receivers.len() <= RECEIVERS_MAX);
    }
}
