//! Whether a member's link carries its stream, and which tier it should have
//!
//! Decides from measured reports alone; reads no clock and moves nobody itself. Invariant: a move is never undone before
//! a pause that doubles each time the undoing did not last, so that a link between two tiers does not make a member flap.

use rhumb_protocol::message::{Moves, StreamChoice};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::{Instant, LinkReport, Span};
use rhumb_reckoning::{LengthBound, Tolerance};

/// What a member asked for, what its link did lately, and where it was moved for that.
#[derive(Debug)]
pub(crate) struct ThinLink {
    chosen: StreamChoice,
    moves: Moves,
    /// The least round trip, which grows slowly so that another path is not taken for a full queue for ever.
    least_ns: Option<u64>,
    /// Since when what is sent comes late, and since when it comes in time.
    late_since: Option<Instant>,
    good_since: Option<Instant>,
    /// The stream of a move that the member has not caught up with yet.
    pending: Option<StreamId>,
    /// When it was moved last, or joined.
    settled_at: Option<Instant>,
    /// When a finer tier was tried again last.
    tried_at: Option<Instant>,
    /// For how long a link must do well before the finer tier is tried.
    hold: Span,
}

/// The tiers that members are moved among, finest first.
const TIERS: [Tolerance; 4] = [
    Tolerance::EXACT,
    Tolerance::FINE,
    Tolerance::NORMAL,
    Tolerance::COARSE,
];

/// What comes later than this is late: a quarter of a second beside the way itself.
const LATE: Span = Span::from_millis(250);
/// For so long it must be late before the link counts as thin.
const LATE_FOR: Span = Span::from_millis(500);
/// What comes within this is in time.
const GOOD: Span = Span::from_millis(80);
/// A link is not judged for so long after a move or a joining: the snapshot fills it.
const GRACE: Span = Span::from_millis(2_000);
/// The first pause before a finer tier is tried again, and the longest.
const HOLD: Span = Span::from_millis(5_000);
/// See [`HOLD`].
const HOLD_MOST: Span = Span::from_millis(160_000);
/// A trial that is given up within this failed.
const TRIAL: Span = Span::from_millis(20_000);
/// The least rate that a queue is taken to drain at, bytes a second.
const RATE_LEAST: u64 = 1_000;

/// Which way to go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    Coarser(StreamChoice),
    Finer(StreamChoice),
}

impl ThinLink {
    /// Of who has just joined.
    pub(crate) const fn new(chosen: StreamChoice) -> Self {
        let Tolerance::Surface(coarsest) = Tolerance::COARSE else {
            panic!("the coarse tier is a length");
        };
        Self {
            chosen,
            moves: Moves::UpTo(coarsest),
            least_ns: None,
            late_since: None,
            good_since: None,
            pending: None,
            settled_at: None,
            tried_at: None,
            hold: HOLD,
        }
    }

    /// The member chose its stream itself.
    pub(crate) fn choose(&mut self, chosen: StreamChoice) {
        *self = Self {
            moves: self.moves,
            least_ns: self.least_ns,
            ..Self::new(chosen)
        };
    }

    /// The member says where it may be moved.
    pub(crate) const fn allow(&mut self, moves: Moves) {
        self.moves = moves;
    }

    /// The member has caught up with a stream.
    pub(crate) fn caught_up(&mut self, with: StreamId) {
        if self.pending == Some(with) {
            self.pending = None;
            self.settled_at = None;
        }
    }

    /// A verdict was followed: the member is on its way to this stream.
    pub(crate) fn moved(&mut self, now: Instant, verdict: Verdict, stream: StreamId) {
        self.pending = Some(stream);
        (self.late_since, self.good_since) = (None, None);
        match verdict {
            Verdict::Finer(_) => self.tried_at = Some(now),
            Verdict::Coarser(_) => {
                let failed = self.tried_at.is_some_and(|tried| now.since(tried) < TRIAL);
                let doubled = Span::from_nanos(self.hold.as_nanos() * 2).min(HOLD_MOST);
                self.hold = if failed { doubled } else { HOLD };
                self.tried_at = None;
            }
        }
    }

    /// Takes in how the link did; says where the member should be moved from its present stream, if anywhere.
    pub(crate) fn judge(
        &mut self,
        now: Instant,
        report: &LinkReport,
        present: StreamChoice,
    ) -> Option<Verdict> {
        let late = self.lateness(report);
        let settled_at = *self.settled_at.get_or_insert(now);
        if self.pending.is_some() || now.since(settled_at) < GRACE {
            return None;
        }
        if late > LATE {
            self.good_since = None;
            let since = *self.late_since.get_or_insert(now);
            if now.since(since) < LATE_FOR {
                return None;
            }
            return self.coarser(present).map(Verdict::Coarser);
        }
        self.late_since = None;
        if late > GOOD {
            self.good_since = None;
            return None;
        }
        let since = *self.good_since.get_or_insert(now);
        if now.since(since) < self.hold {
            return None;
        }
        self.finer(present).map(Verdict::Finer)
    }

    /// How late what is handed over now would come, beside the way itself.
    fn lateness(&mut self, report: &LinkReport) -> Span {
        let round_trip = report.round_trip.as_nanos();
        let least = self.least_ns.get_or_insert(round_trip);
        *least = round_trip.min(*least + round_trip.saturating_sub(*least) / 512);
        let over = u128::from(report.over.as_nanos().max(1));
        let rate = u128::from(report.sent_bytes) * 1_000_000_000 / over;
        let rate = rate.max(u128::from(RATE_LEAST));
        let waits = u128::from(report.waiting_bytes) * 1_000_000_000 / rate;
        let waits = u64::try_from(waits).unwrap_or(u64::MAX);
        Span::from_nanos(waits.saturating_add(round_trip - *least))
    }

    /// The next coarser tier than a stream's, if the member may be moved there.
    fn coarser(&self, present: StreamChoice) -> Option<StreamChoice> {
        let (Moves::UpTo(coarsest), present) = (self.moves, length(present)?) else {
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

    /// The next finer tier, none finer than the member chose.
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

/// The length of a stream among which members are moved: one of two bounds, a full one, and one with a budget are not.
const fn length(choice: StreamChoice) -> Option<LengthBound> {
    match choice {
        StreamChoice::Within(Tolerance::Surface(length)) => Some(length),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAUSE: u64 = 100;

    fn tier(tolerance: Tolerance) -> StreamChoice {
        StreamChoice::Within(tolerance)
    }

    /// A member on a link of a rate, whose tiers need these rates.
    struct Pretended {
        link: ThinLink,
        present: StreamChoice,
        now: Instant,
        queue: u64,
        moves: Vec<StreamChoice>,
    }

    impl Pretended {
        fn new(chosen: StreamChoice) -> Self {
            Self {
                link: ThinLink::new(chosen),
                present: chosen,
                now: Instant::ZERO,
                queue: 0,
                moves: Vec::new(),
            }
        }

        /// Bytes a second that a stream takes.
        fn demand(choice: StreamChoice) -> u64 {
            let metres = choice.tolerance().length().unwrap().metres();
            (400.0 / metres) as u64
        }

        fn run(&mut self, seconds: u64, rate: u64) {
            for _ in 0..seconds * 1_000 / PAUSE {
                self.now = self.now + Span::from_millis(PAUSE);
                self.queue += Self::demand(self.present) * PAUSE / 1_000;
                let sent = self.queue.min(rate * PAUSE / 1_000);
                self.queue -= sent;
                let report = LinkReport {
                    waiting_bytes: self.queue,
                    sent_bytes: sent,
                    over: Span::from_millis(PAUSE),
                    round_trip: Span::from_millis(50),
                };
                if let Some(verdict) = self.link.judge(self.now, &report, self.present) {
                    let (Verdict::Coarser(to) | Verdict::Finer(to)) = verdict;
                    let stream = StreamId(self.moves.len() as u32);
                    self.link.moved(self.now, verdict, stream);
                    self.link.caught_up(stream);
                    self.queue = 0;
                    self.present = to;
                    self.moves.push(to);
                }
            }
        }
    }

    #[test]
    fn a_link_that_carries_its_stream_moves_nobody() {
        let mut member = Pretended::new(tier(Tolerance::FINE));
        member.run(300, 20_001);
        assert_eq!(member.moves, []);
    }

    #[test]
    fn a_thin_link_is_given_what_it_carries_and_the_choice_when_it_is_wide_again() {
        let mut member = Pretended::new(tier(Tolerance::EXACT));
        member.run(4, 100_000);
        member.run(20, 9_000);
        assert!(
            member.present == tier(Tolerance::NORMAL),
            "{:?}",
            member.moves
        );
        member.run(200, 100_000);
        assert_eq!(member.present, tier(Tolerance::EXACT));
        let count = member.moves.len();
        member.run(600, 100_000);
        assert_eq!(member.moves.len(), count);
    }

    #[test]
    fn a_link_between_two_tiers_does_not_make_a_member_flap() {
        let mut member = Pretended::new(tier(Tolerance::FINE));
        member.run(3_600, 10_000);
        // Each trial fails and doubles the pause, up to 160 s: some 24 trials an hour, and not 700.
        assert!(member.moves.len() < 70, "{}", member.moves.len());
        assert!(member.moves.len() > 10, "it is tried all the same");
    }

    #[test]
    fn who_forbids_it_is_not_moved_and_nobody_beyond_what_they_take() {
        let mut member = Pretended::new(tier(Tolerance::EXACT));
        member.link.allow(Moves::Never);
        member.run(60, 1_000);
        assert_eq!(member.moves, []);
        let mut member = Pretended::new(tier(Tolerance::EXACT));
        let Tolerance::Surface(fine) = Tolerance::FINE else {
            panic!("the fine tier is a length");
        };
        member.link.allow(Moves::UpTo(fine));
        member.run(60, 1_000);
        assert_eq!(member.moves, [tier(Tolerance::FINE)]);
    }

    #[test]
    fn streams_that_are_no_tiers_are_left_alone() {
        let budget = rhumb_protocol::stream::Budget::per_second(1_000).unwrap();
        let capped = StreamChoice::Capped {
            tolerance: Tolerance::EXACT,
            budget,
        };
        for choice in [StreamChoice::Full, capped] {
            let mut member = Pretended::new(choice);
            assert_eq!(member.link.coarser(choice), None);
            member.link.choose(choice);
            assert_eq!(member.link.finer(choice), None);
        }
    }
}
