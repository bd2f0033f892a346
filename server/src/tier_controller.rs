//! Tier controller: chooses the tier that a member's link can carry.
//!
//! Decides from measured reports alone; reads no clock and moves no member itself. Invariants: a change is undone only
//! after a pause, which doubles after each failed trial: a link between two tiers does not make a member flap. No link
//! is judged while a snapshot is in transit.

use rhumb_protocol::message::{StreamChoice, TierPolicy};
use rhumb_protocol::packet::{Low16, StreamId};
use rhumb_protocol::{Instant, LinkReport, Span};
use rhumb_reckoning::{LengthBound, Tolerance};

/// A member's chosen stream, the state of its link, and the tier changes made for it.
#[derive(Debug)]
pub(crate) struct TierController {
    chosen: StreamChoice,
    tier_policy: TierPolicy,
    route_delay: RouteDelay,
    snapshot_progress: SnapshotProgress,
    /// Since when data queued here is late, since when it is late for any cause, and since when it is in time.
    stuck_since: Option<Instant>,
    late_since: Option<Instant>,
    good_since: Option<Instant>,
    /// Time of the last trial of a finer tier.
    tried_at: Option<Instant>,
    /// The time for which a link must do well before the finer tier is tried.
    retry_pause: Span,
}

/// The tiers of tier changes, finest first.
const TIERS: [Tolerance; 4] = [
    Tolerance::EXACT,
    Tolerance::FINE,
    Tolerance::NORMAL,
    Tolerance::COARSE,
];

/// Delay from which on data is late: a quarter of a second beyond the route delay.
const LATE: Span = Span::from_millis(250);
/// The time for which the queue here must be beyond [`LATE`] before the link counts as congested.
const STUCK_FOR: Span = Span::from_millis(500);
/// The time for which data must be late with hardly any queue here: a longer route is recognised by then.
const LATE_FOR: Span = Span::from_millis(5_000);
/// Delay up to which data is in time.
const GOOD: Span = Span::from_millis(80);
/// First pause before a finer tier is tried again; [`RETRY_PAUSE_MOST`] is the longest.
const RETRY_PAUSE: Span = Span::from_millis(5_000);
/// See [`RETRY_PAUSE`].
const RETRY_PAUSE_MOST: Span = Span::from_millis(160_000);
/// A trial that ends within this time has failed.
const TRIAL: Span = Span::from_millis(20_000);

/// A tier change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TierDecision {
    Coarser(StreamChoice),
    Finer(StreamChoice),
}

impl TierController {
    /// Controller of a new member.
    pub(crate) const fn new(chosen: StreamChoice) -> Self {
        let Tolerance::Surface(coarsest) = Tolerance::COARSE else {
            panic!("the coarse tier is a length");
        };
        Self {
            chosen,
            tier_policy: TierPolicy::UpTo(coarsest),
            route_delay: RouteDelay::new(),
            snapshot_progress: SnapshotProgress::awaiting(Confirmation::AnyMessage),
            stuck_since: None,
            late_since: None,
            good_since: None,
            tried_at: None,
            retry_pause: RETRY_PAUSE,
        }
    }

    /// The member chose its stream, and gets its snapshot.
    pub(crate) fn choose(&mut self, chosen: StreamChoice, expected: Confirmation) {
        *self = Self {
            tier_policy: self.tier_policy,
            route_delay: self.route_delay,
            snapshot_progress: SnapshotProgress::awaiting(expected),
            ..Self::new(chosen)
        };
    }

    /// Sets the member's tier policy.
    pub(crate) const fn set_policy(&mut self, tier_policy: TierPolicy) {
        self.tier_policy = tier_policy;
    }

    /// Notes any message of the member.
    pub(crate) fn note_message(&mut self) {
        self.snapshot_progress.confirm(Confirmation::AnyMessage);
    }

    /// Handles a loss report: the member's count of packets lost from a stream.
    pub(crate) fn received_loss_report(&mut self, of: StreamId, lost: Low16) {
        self.snapshot_progress.confirm(Confirmation::LossReport(of));
        self.route_delay.handle_lost_count(lost);
    }

    /// The member has caught up with a stream.
    pub(crate) fn caught_up(&mut self, with: StreamId) {
        self.snapshot_progress
            .confirm(Confirmation::Subscribed(with));
    }

    /// A decision was carried out: the member changes to another stream.
    pub(crate) fn note_tier_changed(
        &mut self,
        now: Instant,
        decision: TierDecision,
        expected: Confirmation,
    ) {
        self.snapshot_progress = SnapshotProgress::awaiting(expected);
        (self.stuck_since, self.late_since, self.good_since) = (None, None, None);
        match decision {
            TierDecision::Finer(_) => self.tried_at = Some(now),
            TierDecision::Coarser(_) => {
                let failed = self.tried_at.is_some_and(|tried| now.since(tried) < TRIAL);
                let doubled =
                    Span::from_nanos(self.retry_pause.as_nanos() * 2).min(RETRY_PAUSE_MOST);
                self.retry_pause = if failed { doubled } else { RETRY_PAUSE };
                self.tried_at = None;
            }
        }
    }

    /// Handles a link report; returns a tier change for the member, if one is needed.
    pub(crate) fn decide(
        &mut self,
        now: Instant,
        report: &LinkReport,
        present: StreamChoice,
    ) -> Option<TierDecision> {
        let queue_delay = wait(report);
        let longer = self
            .route_delay
            .excess_delay(now, report.round_trip, queue_delay);
        let late = Span::from_nanos(queue_delay.as_nanos().saturating_add(longer.as_nanos()));
        let converged = self
            .snapshot_progress
            .is_over(now, report.waiting_bytes, queue_delay);
        if !converged {
            return None;
        }
        let stuck_for = lasts(&mut self.stuck_since, now, queue_delay > LATE);
        let late_for = lasts(&mut self.late_since, now, late > LATE);
        let good_for = lasts(&mut self.good_since, now, late <= GOOD);
        if stuck_for >= Some(STUCK_FOR) || late_for >= Some(LATE_FOR) {
            self.coarser(present).map(TierDecision::Coarser)
        } else if good_for >= Some(self.retry_pause) {
            self.finer(present).map(TierDecision::Finer)
        } else {
            None
        }
    }

    /// The next coarser tier, if the member's policy allows it.
    fn coarser(&self, present: StreamChoice) -> Option<StreamChoice> {
        let (TierPolicy::UpTo(coarsest), present) = (self.tier_policy, length(present)?) else {
            return None;
        };
        let tiers = TIERS
            .into_iter()
            .filter_map(|tier| length(StreamChoice::Within(tier)));
        let next = tiers
            .filter(|tier| *tier > present && *tier <= coarsest)
            .min()?;
        Some(StreamChoice::Within(Tolerance::Surface(next)))
    }

    /// The next finer tier, no finer than the member's choice.
    fn finer(&self, present: StreamChoice) -> Option<StreamChoice> {
        let (chosen, present) = (length(self.chosen)?, length(present)?);
        let tiers = TIERS
            .into_iter()
            .filter_map(|tier| length(StreamChoice::Within(tier)));
        let next = tiers.filter(|tier| *tier < present && *tier > chosen).max();
        let next = next.or((chosen < present).then_some(chosen))?;
        Some(StreamChoice::Within(Tolerance::Surface(next)))
    }
}

/// The length of a stream that takes part in tier changes; `None` for two bounds, full streams and budgets.
const fn length(choice: StreamChoice) -> Option<LengthBound> {
    match choice {
        StreamChoice::Within(Tolerance::Surface(length)) => Some(length),
        _ => None,
    }
}

/// The time for which a condition has held, if it holds now.
fn lasts(since: &mut Option<Instant>, now: Instant, holds: bool) -> Option<Span> {
    *since = holds.then(|| since.unwrap_or(now));
    since.map(|since| now.since(since))
}

/// Least assumed drain rate of a queue, bytes a second.
const RATE_LEAST: u64 = 1_000;

/// The delay in this queue of data that is handed over now.
fn wait(report: &LinkReport) -> Span {
    let over = u128::from(report.over.as_nanos().max(1));
    let rate = u128::from(report.sent_bytes) * 1_000_000_000 / over;
    let rate = rate.max(u128::from(RATE_LEAST));
    let queue_delay = u128::from(report.waiting_bytes) * 1_000_000_000 / rate;
    Span::from_nanos(u64::try_from(queue_delay).unwrap_or(u64::MAX))
}

/// Estimate of the route's own round trip.
///
/// A round trip grows because data is queued on the route, or because the route has changed. A queue grows, loses packets
/// when full, or backs up to this end; another route does none of these and soon becomes the base.
#[derive(Clone, Copy, Debug)]
struct RouteDelay {
    /// The base round trip; `None` before the first report.
    base_ns: Option<u64>,
    second: Option<Second>,
    /// Least round trip of the last second, if it was calm: no standing queue at this end, and no loss.
    quiet_ns: Option<u64>,
    /// Count of lost packets, and whether it grew in the present second.
    lost: Low16,
    loses: bool,
}

/// Minima of the present second.
#[derive(Clone, Copy, Debug)]
struct Second {
    began: Instant,
    round_trip_ns: u64,
    queue_delay: Span,
}

/// Length of one observation.
const SECOND: Span = Span::from_millis(1_000);
/// A queue at this end whose least delay in a second exceeds this is standing.
const STANDING: Span = Span::from_millis(80);
/// A round trip that grows faster than this in a second is not steady.
const STEADY_NS: u64 = 10_000_000;

impl RouteDelay {
    /// An estimate before the first report.
    const fn new() -> Self {
        Self {
            base_ns: None,
            second: None,
            quiet_ns: None,
            lost: Low16(0),
            loses: false,
        }
    }

    /// Takes the member's count of lost packets.
    fn handle_lost_count(&mut self, lost: Low16) {
        self.loses |= self.lost != lost;
        self.lost = lost;
    }

    /// Delay of a round trip beyond the route's own, with this queue delay at this end.
    fn excess_delay(&mut self, now: Instant, round_trip: Span, queue_delay: Span) -> Span {
        let round_trip_ns = round_trip.as_nanos();
        // The base grows slowly by itself: a changed route that is never calm does not count as a full queue for ever.
        let usual = self.base_ns.get_or_insert(round_trip_ns);
        *usual = round_trip_ns.min(*usual + round_trip_ns.saturating_sub(*usual) / 512);
        let second = self.second.get_or_insert(Second {
            began: now,
            round_trip_ns,
            queue_delay,
        });
        second.round_trip_ns = second.round_trip_ns.min(round_trip_ns);
        second.queue_delay = second.queue_delay.min(queue_delay);
        if let Some(over) = self
            .second
            .take_if(|second| now.since(second.began) >= SECOND)
        {
            self.scan_back(over);
        }
        let usual = self.base_ns.unwrap_or(round_trip_ns);
        Span::from_nanos(round_trip_ns.saturating_sub(usual))
    }

    /// After two calm seconds, the later no slower, their round trip becomes the base.
    fn scan_back(&mut self, over: Second) {
        let loses = std::mem::take(&mut self.loses);
        let quiet_ns = (over.queue_delay <= STANDING && !loses).then_some(over.round_trip_ns);
        if let (Some(before), Some(last)) = (self.quiet_ns, quiet_ns)
            && last <= before + STEADY_NS
        {
            self.base_ns = self.base_ns.max(Some(last));
        }
        self.quiet_ns = quiet_ns;
    }
}

/// Messages that confirm the snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Confirmation {
    /// Any message: a joining member sends nothing before.
    AnyMessage,
    /// A loss report of the new stream, or the confirmation of its subscription.
    LossReport(StreamId),
    /// The confirmation of a subscription; loss reports of the stream may concern the former copy.
    Subscribed(StreamId),
}

/// The progress of a member's snapshot, and of the queue behind it, through the link.
///
/// Invariant: a queue that does not shrink is not a snapshot in transit, whatever the member confirms.
#[derive(Clone, Copy, Debug)]
struct SnapshotProgress {
    /// `None` once it was confirmed.
    expected: Option<Confirmation>,
    /// The time at which the link was first observed with the snapshot in transit.
    begun: Option<Instant>,
    /// The time at which the queue behind the snapshot has passed, too.
    over: Option<Instant>,
    /// Least queue since the snapshot passed, in bytes, and its time.
    least: Option<(u64, Instant)>,
}

/// Grace after a snapshot, or as long as the snapshot took: the queue behind it must pass, too.
const GRACE: Span = Span::from_millis(2_000);
/// Longest grace after a snapshot.
const GRACE_MOST: Span = Span::from_millis(10_000);
/// No grace for a queue of this delay that does not shrink by a sixty-fourth in [`GRACE`]: an overloaded link may
/// delay the very snapshot.
const SNAPSHOT_STANDING: Span = Span::from_millis(250);
/// A member without a confirmation is judged after this time: not every client sends one.
const SNAPSHOT_MOST: Span = Span::from_millis(60_000);

impl SnapshotProgress {
    /// A snapshot that is sent now.
    const fn awaiting(expected: Confirmation) -> Self {
        Self {
            expected: Some(expected),
            begun: None,
            over: None,
            least: None,
        }
    }

    /// Handles a message of the member.
    fn confirm(&mut self, received: Confirmation) {
        let shows = match (self.expected, received) {
            (None, _) => false,
            (Some(Confirmation::AnyMessage), _) => true,
            (
                Some(Confirmation::LossReport(of)),
                Confirmation::LossReport(stream) | Confirmation::Subscribed(stream),
            )
            | (Some(Confirmation::Subscribed(of)), Confirmation::Subscribed(stream)) => {
                of == stream
            }
            (Some(Confirmation::LossReport(_) | Confirmation::Subscribed(_)), _) => false,
        };
        if shows {
            self.expected = None;
        }
    }

    /// True if the link can be judged, with this queue in bytes and in delay.
    fn is_over(&mut self, now: Instant, waiting_bytes: u64, queue_delay: Span) -> bool {
        let took = now.since(*self.begun.get_or_insert(now));
        if self.stands(now, waiting_bytes, queue_delay) {
            (self.expected, self.over) = (None, Some(now));
        }
        if self.expected.is_some() && took < SNAPSHOT_MOST {
            return false;
        }
        let passes = took.clamp(GRACE, GRACE_MOST);
        now >= *self.over.get_or_insert(now + passes)
    }

    /// True if the queue has not shrunk for a while.
    fn stands(&mut self, now: Instant, waiting_bytes: u64, queue_delay: Span) -> bool {
        let (least, since) = *self.least.get_or_insert((waiting_bytes, now));
        if queue_delay <= SNAPSHOT_STANDING || waiting_bytes < least - least / 64 {
            self.least = Some((waiting_bytes, now));
            return false;
        }
        now.since(since) >= GRACE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAUSE: u64 = 100;

    fn tier(tolerance: Tolerance) -> StreamChoice {
        StreamChoice::Within(tolerance)
    }

    /// A member on a link of a rate; its tiers need the rates of `demand`.
    struct SimulatedLink {
        link: TierController,
        present: StreamChoice,
        now: Instant,
        queue: u64,
        /// Round trip, milliseconds.
        round_trip: u64,
        tier_policy: Vec<StreamChoice>,
    }

    impl SimulatedLink {
        fn new(chosen: StreamChoice) -> Self {
            let mut link = TierController::new(chosen);
            link.note_message();
            Self {
                link,
                present: chosen,
                now: Instant::ZERO,
                queue: 0,
                round_trip: 50,
                tier_policy: Vec::new(),
            }
        }

        /// Bytes a second that a stream takes.
        fn demand(choice: StreamChoice) -> u64 {
            let metres = choice.tolerance().length().unwrap().metres();
            (400.0 / metres) as u64
        }

        fn run(&mut self, seconds: u64, rate: u64) {
            for _ in 0..seconds * 1_000 / PAUSE {
                self.step(rate);
            }
        }

        fn step(&mut self, rate: u64) {
            self.now = self.now + Span::from_millis(PAUSE);
            self.queue += Self::demand(self.present) * PAUSE / 1_000;
            let sent = self.queue.min(rate * PAUSE / 1_000);
            self.queue -= sent;
            let report = LinkReport {
                waiting_bytes: self.queue,
                sent_bytes: sent,
                over: Span::from_millis(PAUSE),
                round_trip: Span::from_millis(self.round_trip),
            };
            if let Some(decision) = self.link.decide(self.now, &report, self.present) {
                let (TierDecision::Coarser(to) | TierDecision::Finer(to)) = decision;
                let stream = StreamId(self.tier_policy.len() as u32);
                self.link
                    .note_tier_changed(self.now, decision, Confirmation::LossReport(stream));
                self.link.caught_up(stream);
                self.queue = 0;
                self.present = to;
                self.tier_policy.push(to);
            }
        }
    }

    #[test]
    fn a_fast_enough_link_keeps_its_tier() {
        let mut member = SimulatedLink::new(tier(Tolerance::FINE));
        member.run(300, 20_001);
        assert_eq!(member.tier_policy, []);
    }

    #[test]
    fn a_congested_link_gets_a_coarser_tier_and_later_its_choice_again() {
        let mut member = SimulatedLink::new(tier(Tolerance::EXACT));
        member.run(4, 100_000);
        member.run(20, 9_000);
        assert!(
            member.present == tier(Tolerance::NORMAL),
            "{:?}",
            member.tier_policy
        );
        member.run(200, 100_000);
        assert_eq!(member.present, tier(Tolerance::EXACT));
        let count = member.tier_policy.len();
        member.run(600, 100_000);
        assert_eq!(member.tier_policy.len(), count);
    }

    #[test]
    fn a_link_between_two_tiers_does_not_flap() {
        let mut member = SimulatedLink::new(tier(Tolerance::FINE));
        member.run(3_600, 10_000);
        // Each trial fails and doubles the pause, up to 160 s: some 24 trials an hour, and not 700.
        assert!(
            member.tier_policy.len() < 70,
            "{}",
            member.tier_policy.len()
        );
        assert!(member.tier_policy.len() > 10, "trials continue");
    }

    #[test]
    fn the_tier_policy_bounds_every_tier_change() {
        let mut member = SimulatedLink::new(tier(Tolerance::EXACT));
        member.link.set_policy(TierPolicy::Never);
        member.run(60, 1_000);
        assert_eq!(member.tier_policy, []);
        let mut member = SimulatedLink::new(tier(Tolerance::EXACT));
        let Tolerance::Surface(fine) = Tolerance::FINE else {
            panic!("the fine tier is a length");
        };
        member.link.set_policy(TierPolicy::UpTo(fine));
        member.run(60, 1_000);
        assert_eq!(member.tier_policy, [tier(Tolerance::FINE)]);
    }

    #[test]
    fn streams_that_are_no_tiers_stay() {
        let budget = rhumb_protocol::stream::Budget::per_second(1_000).unwrap();
        let capped = StreamChoice::Capped {
            tolerance: Tolerance::EXACT,
            budget,
        };
        for choice in [StreamChoice::Full, capped] {
            let mut member = SimulatedLink::new(choice);
            assert_eq!(member.link.coarser(choice), None);
            member
                .link
                .choose(choice, Confirmation::LossReport(StreamId(1)));
            assert_eq!(member.link.finer(choice), None);
        }
    }

    #[test]
    fn a_snapshot_in_flight_changes_no_tier() {
        let (of, exact) = (StreamId(3), tier(Tolerance::EXACT));
        let begin = |expected: Confirmation| {
            let mut member = SimulatedLink::new(exact);
            match expected {
                Confirmation::AnyMessage => member.link = TierController::new(exact),
                _ => member.link.choose(exact, expected),
            }
            // A snapshot that takes 20 s.
            member.queue = 2_000_000;
            member.run(20, 120_000);
            assert_eq!(member.tier_policy, [], "{expected:?}");
            member
        };
        for expected in [
            Confirmation::AnyMessage,
            Confirmation::LossReport(of),
            Confirmation::Subscribed(of),
        ] {
            let mut member = begin(expected);
            member.link.caught_up(of);
            // The stream takes two thirds of the rate: 1.2 MB wait behind the snapshot.
            member.run(5, 120_000);
            assert_eq!(member.tier_policy, [], "{expected:?}");
            member.queue = 0;
            member.run(20, 100_000);
            assert_eq!(member.tier_policy, [], "{expected:?}");
            member.run(20, 5_000);
            assert!(
                !member.tier_policy.is_empty(),
                "{expected:?}: judged from then on"
            );
        }
    }

    #[test]
    fn a_stream_that_delays_its_own_snapshot_is_left_soon() {
        let (of, exact) = (StreamId(3), tier(Tolerance::EXACT));
        for expected in [
            Confirmation::AnyMessage,
            Confirmation::LossReport(of),
            Confirmation::Subscribed(of),
        ] {
            let mut member = SimulatedLink::new(exact);
            member.link.choose(exact, expected);
            member.queue = 100_000;
            member.run(4, 70_000);
            assert_eq!(member.tier_policy, [tier(Tolerance::FINE)], "{expected:?}");
        }
    }

    #[test]
    fn a_client_that_never_confirms_a_snapshot_is_judged_in_the_end() {
        let fine = tier(Tolerance::FINE);
        let mut member = SimulatedLink::new(tier(Tolerance::EXACT));
        member.present = fine;
        let decision = TierDecision::Coarser(fine);
        member
            .link
            .note_tier_changed(member.now, decision, Confirmation::Subscribed(StreamId(3)));
        member.link.note_message();
        member.link.received_loss_report(StreamId(3), Low16(0));
        member.run(60, 200_000);
        assert_eq!(
            member.tier_policy,
            [],
            "an loss_report may be of the copy before"
        );
        member.run(20, 200_000);
        assert_eq!(member.tier_policy, [tier(Tolerance::EXACT)]);
    }

    #[test]
    fn a_longer_route_is_no_congestion() {
        let mut member = SimulatedLink::new(tier(Tolerance::FINE));
        member.run(10, 50_000);
        member.round_trip = 350;
        member.run(120, 50_000);
        assert_eq!(member.tier_policy, []);
        // Nor does it when the round trip grows little by little, as a smoothed estimate does.
        for _ in 0..100 {
            member.round_trip += (650 - member.round_trip) / 8;
            member.step(50_000);
        }
        member.run(60, 50_000);
        assert_eq!(member.tier_policy, []);
    }

    #[test]
    fn queueing_in_the_network_is_congestion() {
        // A queue that grows by a fifth of a second in each second.
        let mut member = SimulatedLink::new(tier(Tolerance::FINE));
        member.run(10, 50_000);
        while member.tier_policy.is_empty() {
            member.round_trip += 200;
            member.run(1, 50_000);
            assert!(member.round_trip < 2_000);
        }
        // A queue that is full after a second and a half, and then loses packets.
        let mut member = SimulatedLink::new(tier(Tolerance::FINE));
        member.run(10, 50_000);
        for second in 0..10 {
            member.round_trip = (member.round_trip + 200).min(350);
            member.link.received_loss_report(StreamId(0), Low16(second));
            member.run(1, 50_000);
        }
        assert_eq!(member.tier_policy, [tier(Tolerance::NORMAL)]);
    }
}
