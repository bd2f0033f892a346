//! How long the ticks take that a client asks for.

use rhumb_reckoning::Tick;

use crate::time::{Instant, Span};

/// How long the last ticks took, so that a step that takes long is not asked after as if it were lost.
#[derive(Clone, Copy, Debug)]
pub(super) struct ResponseTimes {
    /// The tick that is timed, and when it was asked for.
    asked: Option<(Tick, Instant)>,
    /// What the last two took. The quicker one counts: one that a loss delayed makes nobody wait longer for the next.
    took: [Span; 2],
}

impl ResponseTimes {
    pub(super) const fn new() -> Self {
        Self {
            asked: None,
            took: [Span::ZERO; 2],
        }
    }

    /// A tick is asked for; one is timed at a time.
    pub(super) fn note_requested(&mut self, now: Instant, tick: Tick) {
        self.asked.get_or_insert((tick, now));
    }

    /// All is known up to a tick.
    pub(super) fn note_complete(&mut self, now: Instant, complete: Tick) {
        if let Some((_, at)) = self.asked.take_if(|(tick, _)| *tick <= complete) {
            self.took = [now.since(at), self.took[0]];
        }
    }

    /// What the next may take before it is asked after: twice what the quicker of the last two took, and never more than
    /// `most`.
    pub(super) fn timeout(&self, most: Span) -> Span {
        let [last, before] = self.took;
        Span::from_nanos(last.min(before).as_nanos() * 2).min(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST: Span = Span::from_millis(2_000);

    /// Asks for some ticks in turn, of which each takes so many milliseconds.
    fn after(took: &[u64]) -> ResponseTimes {
        let (mut answers, mut now) = (ResponseTimes::new(), Instant::ZERO);
        for (tick, millis) in (1..).map(Tick::new).zip(took) {
            answers.note_requested(now, tick);
            now = now + Span::from_millis(*millis);
            answers.note_complete(now, tick);
        }
        answers
    }

    #[test]
    fn the_timeout_is_twice_the_quicker_of_the_last_two() {
        let timeout = |took: &[u64]| after(took).timeout(MOST);
        assert_eq!(timeout(&[]), Span::ZERO);
        assert_eq!(timeout(&[300]), Span::ZERO);
        assert_eq!(timeout(&[300, 200]), Span::from_millis(400));
        assert_eq!(timeout(&[300, 30]), Span::from_millis(60));
        assert_eq!(timeout(&[30, 300]), Span::from_millis(60));
        assert_eq!(timeout(&[3_000, 3_000]), MOST);
    }

    #[test]
    fn a_tick_is_timed_from_its_first_request_to_completion() {
        let mut answers = after(&[10, 10]);
        let begun = Instant::ZERO;
        answers.note_requested(begun, Tick::new(7));
        answers.note_requested(begun + Span::from_millis(50), Tick::new(8));
        answers.note_complete(begun + Span::from_millis(60), Tick::new(6));
        assert_eq!(answers.timeout(MOST), Span::from_millis(20));
        answers.note_complete(begun + Span::from_millis(80), Tick::new(8));
        answers.note_requested(begun, Tick::new(9));
        answers.note_complete(begun + Span::from_millis(90), Tick::new(9));
        assert_eq!(answers.timeout(MOST), Span::from_millis(160));
    }
}
