//! Losses of a stream's receivers: their measure, and the answers to them.
//!
//! The tracker counts packets only and knows no times, so a slow link is never mistaken for a lossy one. The limiter
//! bounds the work that a receiver can cause: the sender pauses between answered reports, and refreshes no packet
//! twice within a round trip.

use alloc::collections::btree_map::Entry;
use alloc::collections::{BTreeMap, VecDeque};
use alloc::vec::Vec;

use bytes::Bytes;

use super::{LossRate, Redundancy};
use crate::endpoint::{Instant, Span};
use crate::limits::HISTORY_PACKETS;
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
    /// True if repair symbols are sent.
    pub(crate) fn has_redundancy(&self) -> bool {
        self.redundancy != Redundancy::Off
    }

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

/// Numbers packets and keeps the bodies of the newest ones.
#[derive(Clone, Debug, Default)]
pub(crate) struct SentPackets {
    next: u64,
    /// The bodies of the packets before `next`, oldest first.
    packets: VecDeque<Vec<u32>>,
}

impl SentPackets {
    /// The number of the next packet.
    pub(crate) const fn next(&self) -> u64 {
        self.next
    }

    /// Adds the next packet with its bodies, in rising order.
    pub(crate) fn record(&mut self, bodies: impl Iterator<Item = u32>) {
        let mut entry = if self.packets.len() == HISTORY_PACKETS {
            self.packets.pop_front().unwrap_or_default()
        } else {
            Vec::new()
        };
        entry.clear();
        entry.extend(bodies);
        self.packets.push_back(entry);
        self.next += 1;
    }

    /// The bodies of a packet; `None` if it was never sent or is no longer kept.
    pub(crate) fn bodies(&self, number: u64) -> Option<&[u32]> {
        let age = self.next.checked_sub(number)?;
        let place = (self.packets.len() as u64).checked_sub(age)?;
        self.packets.get(place as usize).map(Vec::as_slice)
    }
}

/// The bodies of the last packets that an edge has received, for refreshes.
#[derive(Clone, Debug, Default)]
pub(crate) struct RelayedPackets {
    bodies: BTreeMap<u64, Vec<u32>>,
}

impl RelayedPackets {
    /// Notes a packet that has arrived, or was refreshed.
    pub(crate) fn note_packet(&mut self, number: u64) {
        self.bodies.entry(number).or_default();
        while self.bodies.len() > HISTORY_PACKETS {
            self.bodies.pop_first();
        }
    }

    /// Notes a body of a packet.
    pub(crate) fn note_body(&mut self, number: u64, index: u32) {
        if let Some(bodies) = self.bodies.get_mut(&number)
            && let Err(place) = bodies.binary_search(&index)
        {
            bodies.insert(place, index);
        }
    }

    /// The bodies of a packet; `None` if they are not known.
    pub(crate) fn bodies(&self, number: u64) -> Option<&[u32]> {
        self.bodies.get(&number).map(Vec::as_slice)
    }
}

/// Refreshes for the receivers of one stream: each is encoded once between two ticks, and none is sent to one receiver twice
/// within a round trip.
#[derive(Debug, Default)]
pub struct RefreshReplies {
    /// By number of the lost packet and count of scene events.
    encoded: BTreeMap<(u64, u64), Vec<Bytes>>,
    limiter: ReplyLimiter,
}

impl RefreshReplies {
    /// Encodes refreshes anew from now on: the tracks are others.
    pub fn begin_tick(&mut self) {
        self.encoded.clear();
    }

    /// Drops the times of a receiver that left or starts again.
    pub fn forget(&mut self, receiver: u64) {
        self.limiter.forget(receiver);
    }

    /// True if a loss report is answered now. If so, the next reports within a short pause are not answered.
    pub fn allow_report(&mut self, now: Instant, receiver: u64) -> bool {
        self.limiter.allow_report(now, receiver)
    }

    /// Appends the refreshes of lost packets. `encode` makes the datagrams of one, and `None` for a packet that is too old.
    pub fn refresh(
        &mut self,
        now: Instant,
        to: Recipient,
        (mut lost, scene_events): (Vec<u64>, u64),
        encode: impl Fn(u64) -> Option<Vec<Bytes>>,
        out: &mut Vec<Bytes>,
    ) {
        lost.sort_unstable();
        lost.dedup();
        for number in lost {
            // A packet that is too old has no refresh. The watermark then tells the receiver how much it missed, and it
            // requests a snapshot.
            if let Some(refresh) = self.encoded(number, scene_events, &encode).cloned()
                && (self.limiter).allow_refresh(now, to.id, to.round_trip, number)
            {
                out.extend(refresh);
            }
        }
    }

    fn encoded(
        &mut self,
        number: u64,
        scene_events: u64,
        encode: impl Fn(u64) -> Option<Vec<Bytes>>,
    ) -> Option<&Vec<Bytes>> {
        if self.encoded.len() >= HISTORY_PACKETS {
            self.encoded.clear();
        }
        match self.encoded.entry((number, scene_events)) {
            Entry::Occupied(known) => Some(known.into_mut()),
            Entry::Vacant(place) => Some(place.insert(encode(number)?)),
        }
    }
}

/// A subscriber that reports a loss.
#[derive(Clone, Copy, Debug)]
pub struct Recipient {
    /// The caller's number for the subscriber.
    pub id: u64,
    /// No packet is refreshed for it twice within this span; zero if the round trip is unknown.
    pub round_trip: Span,
}

/// The least time between two answered reports of one receiver: half of the time that a receiver waits for reordered
/// packets before it reports a loss.
const REPORT_PAUSE: Span = Span::from_millis(2);

/// The times of the last replies to each receiver.
#[derive(Debug, Default)]
struct ReplyLimiter {
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
    fn forget(&mut self, receiver: u64) {
        self.receivers.remove(&receiver);
    }

    /// True if a loss report is answered now. If so, the next reports within the pause are not answered.
    fn allow_report(&mut self, now: Instant, receiver: u64) -> bool {
        let answered = self.receivers.entry(receiver).or_default();
        is_due(&mut answered.report, now, REPORT_PAUSE)
    }

    /// True if a packet is refreshed now. If so, it is not refreshed again within a round trip.
    fn allow_refresh(
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

    #[test]
    fn only_the_newest_packets_are_kept() {
        let mut sent_packets = SentPackets::default();
        let sent = HISTORY_PACKETS as u64 + 10;
        for number in 0..sent {
            assert_eq!(sent_packets.next(), number);
            sent_packets.record([number as u32].into_iter());
        }
        assert_eq!(sent_packets.bodies(9), None);
        assert_eq!(sent_packets.bodies(10), Some(&[10][..]));
        assert_eq!(sent_packets.bodies(sent - 1), Some(&[sent as u32 - 1][..]));
        assert_eq!(sent_packets.bodies(sent), None);
    }

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
