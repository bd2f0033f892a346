//! Whether a member's link carries its stream, and which tier it should have
//!
//! Decides from measured reports alone; reads no clock and moves nobody itself. Invariants: a move is never undone before
//! a pause that doubles each time the undoing did not last, so that a link between two tiers does not make a member flap;
//! and no link is judged by a snapshot on its way.

mod settling;
mod way;

use rhumb_protocol::message::{Moves, StreamChoice};
use rhumb_protocol::packet::{Low16, StreamId};
use rhumb_protocol::{Instant, LinkReport, Span};
use rhumb_reckoning::{LengthBound, Tolerance};

pub(crate) use self::settling::Awaited;
use self::settling::Settling;
use self::way::Way;

/// What a member asked for, what its link did lately, and where it was moved for that.
#[derive(Debug)]
pub(crate) struct ThinLink {
    chosen: StreamChoice,
    moves: Moves,
    way: Way,
    settling: Settling,
    /// Since when what is handed over is stuck, since when it comes late for whatever cause, and since when in time.
    stuck_since: Option<Instant>,
    late_since: Option<Instant>,
    good_since: Option<Instant>,
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
/// What comes so late is stuck, wherever it waits.
const STUCK: Span = Span::from_millis(1_000);
/// For so long it must wait here beyond [`LATE`], or be stuck, before the link counts as thin.
const STUCK_FOR: Span = Span::from_millis(500);
/// For so long it must be late where hardly anything waits here: by then a longer way is known for one.
const LATE_FOR: Span = Span::from_millis(5_000);
/// What comes within this is in time.
const GOOD: Span = Span::from_millis(80);
/// The first pause before a finer tier is tried again, and the longest.
const HOLD: Span = Span::from_millis(5_000);
/// See [`HOLD`].
const HOLD_MOST: Span = Span::from_millis(160_000);
/// A trial that is given up within this failed.
const TRIAL: Span = Span::from_millis(20_000);

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
            way: Way::new(),
            settling: Settling::until(Awaited::Word),
            stuck_since: None,
            late_since: None,
            good_since: None,
            tried_at: None,
            hold: HOLD,
        }
    }

    /// The member chose its stream itself, and is told its snapshot.
    pub(crate) fn choose(&mut self, chosen: StreamChoice, awaited: Awaited) {
        *self = Self {
            moves: self.moves,
            way: self.way,
            settling: Settling::until(awaited),
            ..Self::new(chosen)
        };
    }

    /// The member says where it may be moved.
    pub(crate) const fn allow(&mut self, moves: Moves) {
        self.moves = moves;
    }

    /// The member said something, whatever it was.
    pub(crate) fn heard(&mut self) {
        self.settling.hear(Awaited::Word);
    }

    /// The member tells of a stream how far it heard, and how many packets of it did not come so far.
    pub(crate) fn heard_echo(&mut self, of: StreamId, gone: Low16) {
        self.settling.hear(Awaited::Echo(of));
        self.way.hear_gone(gone);
    }

    /// The member has caught up with a stream.
    pub(crate) fn caught_up(&mut self, with: StreamId) {
        self.settling.hear(Awaited::Followed(with));
    }

    /// A verdict was followed: the member is on its way to another stream.
    pub(crate) fn moved(&mut self, now: Instant, verdict: Verdict, awaited: Awaited) {
        self.settling = Settling::until(awaited);
        (self.stuck_since, self.late_since, self.good_since) = (None, None, None);
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
        let waits = wait(report);
        let longer = self.way.longer(now, report.round_trip, waits);
        let late = Span::from_nanos(waits.as_nanos().saturating_add(longer.as_nanos()));
        let settled = self.settling.is_over(now, report.waiting_bytes, waits);
        if !settled {
            return None;
        }
        let stuck_for = lasts(&mut self.stuck_since, now, waits > LATE || late > STUCK);
        let late_for = lasts(&mut self.late_since, now, late > LATE);
        let good_for = lasts(&mut self.good_since, now, late <= GOOD);
        if stuck_for >= Some(STUCK_FOR) || late_for >= Some(LATE_FOR) {
            self.coarser(present).map(Verdict::Coarser)
        } else if good_for >= Some(self.hold) {
            self.finer(present).map(Verdict::Finer)
        } else {
            None
        }
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

/// For how long something has held, if it holds now.
fn lasts(since: &mut Option<Instant>, now: Instant, holds: bool) -> Option<Span> {
    *since = holds.then(|| since.unwrap_or(now));
    since.map(|since| now.since(since))
}

/// The least rate that a queue is taken to drain at, bytes a second.
const RATE_LEAST: u64 = 1_000;

/// How long what is handed over now waits here.
fn wait(report: &LinkReport) -> Span {
    let over = u128::from(report.over.as_nanos().max(1));
    let rate = u128::from(report.sent_bytes) * 1_000_000_000 / over;
    let rate = rate.max(u128::from(RATE_LEAST));
    let waits = u128::from(report.waiting_bytes) * 1_000_000_000 / rate;
    Span::from_nanos(u64::try_from(waits).unwrap_or(u64::MAX))
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
        /// Milliseconds.
        round_trip: u64,
        moves: Vec<StreamChoice>,
    }

    impl Pretended {
        fn new(chosen: StreamChoice) -> Self {
            let mut link = ThinLink::new(chosen);
            link.heard();
            Self {
                link,
                present: chosen,
                now: Instant::ZERO,
                queue: 0,
                round_trip: 50,
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
            if let Some(verdict) = self.link.judge(self.now, &report, self.present) {
                let (Verdict::Coarser(to) | Verdict::Finer(to)) = verdict;
                let stream = StreamId(self.moves.len() as u32);
                self.link.moved(self.now, verdict, Awaited::Echo(stream));
                self.link.caught_up(stream);
                self.queue = 0;
                self.present = to;
                self.moves.push(to);
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
            member.link.choose(choice, Awaited::Echo(StreamId(1)));
            assert_eq!(member.link.finer(choice), None);
        }
    }

    #[test]
    fn no_link_is_judged_by_a_snapshot_on_its_way_nor_by_what_waits_behind_it() {
        let (of, exact) = (StreamId(3), tier(Tolerance::EXACT));
        let begin = |awaited: Awaited| {
            let mut member = Pretended::new(exact);
            match awaited {
                Awaited::Word => member.link = ThinLink::new(exact),
                _ => member.link.choose(exact, awaited),
            }
            // A snapshot that takes 20 s.
            member.queue = 2_000_000;
            member.run(20, 120_000);
            assert_eq!(member.moves, [], "{awaited:?}");
            member
        };
        for awaited in [Awaited::Word, Awaited::Echo(of), Awaited::Followed(of)] {
            let mut member = begin(awaited);
            member.link.caught_up(of);
            // The stream takes two thirds of what passes: 1.2 MB wait behind the snapshot.
            member.run(5, 120_000);
            assert_eq!(member.moves, [], "{awaited:?}");
            member.queue = 0;
            member.run(20, 100_000);
            assert_eq!(member.moves, [], "{awaited:?}");
            member.run(20, 5_000);
            assert!(!member.moves.is_empty(), "{awaited:?}: judged from then on");
        }
    }

    #[test]
    fn a_stream_that_holds_up_the_very_snapshot_is_left_soon() {
        let (of, exact) = (StreamId(3), tier(Tolerance::EXACT));
        for awaited in [Awaited::Word, Awaited::Echo(of), Awaited::Followed(of)] {
            let mut member = Pretended::new(exact);
            member.link.choose(exact, awaited);
            member.queue = 100_000;
            member.run(4, 70_000);
            assert_eq!(member.moves, [tier(Tolerance::FINE)], "{awaited:?}");
        }
    }

    #[test]
    fn who_never_says_that_it_has_the_snapshot_is_judged_in_the_end() {
        let fine = tier(Tolerance::FINE);
        let mut member = Pretended::new(tier(Tolerance::EXACT));
        member.present = fine;
        let verdict = Verdict::Coarser(fine);
        member
            .link
            .moved(member.now, verdict, Awaited::Followed(StreamId(3)));
        member.link.heard();
        member.link.heard_echo(StreamId(3), Low16(0));
        member.run(60, 200_000);
        assert_eq!(member.moves, [], "an echo may be of the copy before");
        member.run(20, 200_000);
        assert_eq!(member.moves, [tier(Tolerance::EXACT)]);
    }

    #[test]
    fn a_longer_way_is_not_a_thin_link() {
        let mut member = Pretended::new(tier(Tolerance::FINE));
        member.run(10, 50_000);
        member.round_trip = 350;
        member.run(120, 50_000);
        assert_eq!(member.moves, []);
        // Nor if it is seen little by little, as a smoothed round trip shows it.
        for _ in 0..100 {
            member.round_trip += (650 - member.round_trip) / 8;
            member.step(50_000);
        }
        member.run(60, 50_000);
        assert_eq!(member.moves, []);
    }

    #[test]
    fn what_waits_on_the_way_is_a_thin_link_though_nothing_waits_here() {
        // A queue that grows by a fifth of a second in each.
        let mut member = Pretended::new(tier(Tolerance::FINE));
        member.run(10, 50_000);
        while member.moves.is_empty() {
            member.round_trip += 200;
            member.run(1, 50_000);
            assert!(member.round_trip < 2_000);
        }
        // One that is full after a second and a half, and loses what does not fit.
        let mut member = Pretended::new(tier(Tolerance::FINE));
        member.run(10, 50_000);
        for second in 0..10 {
            member.round_trip = (member.round_trip + 200).min(350);
            member.link.heard_echo(StreamId(0), Low16(second));
            member.run(1, 50_000);
        }
        assert_eq!(member.moves, [tier(Tolerance::NORMAL)]);
    }
}
