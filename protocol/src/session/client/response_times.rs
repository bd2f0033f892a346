//! Response times of the ticks that a client requests.

use rhumb_reckoning::Tick;

use crate::endpoint::{Instant, Span};

/// The latest response times. A tick that takes long to step is not reported as lost.
#[derive(Clone, Copy, Debug)]
pub(super) struct ResponseTimes {
    /// The tick being timed and the time of its request.
    pending: Option<(Tick, Instant)>,
    /// The last two response times. The shorter one counts, because a loss may have lengthened the other.
    response_times: [Span; 2],
}

impl ResponseTimes {
    pub(super) const fn new() -> Self {
        Self {
            pending: None,
            response_times: [Span::ZERO; 2],
        }
    }

    /// Starts timing a requested tick, unless another one is being timed.
    pub(super) fn note_requested(&mut self, now: Instant, tick: Tick) {
        self.pending.get_or_insert((tick, now));
    }

    /// Notes that all ticks up to this one are complete.
    pub(super) fn note_complete(&mut self, now: Instant, complete: Tick) {
        if let Some((_, at)) = self.pending.take_if(|(tick, _)| *tick <= complete) {
            self.response_times = [now.since(at), self.response_times[0]];
        }
    }

    /// The timeout for the next tick: twice the shorter of the last two response times, at most `most`.
    pub(super) fn timeout(&self, most: Span) -> Span {
        let [last, before] = self.response_times;
        Span::from_nanos(last.min(before).as_nanos() * 2).min(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOST: Span = Span::from_millis(2_000);

    /// Requests some ticks in turn; each takes the given number of milliseconds.
    fn after(response_times: &[u64]) -> ResponseTimes {
        let (mut answers, mut now) = (ResponseTimes::new(), Instant::ZERO);
        for (tick, millis) in (1..).map(Tick::new).zip(response_times) {
            answers.note_requested(now, tick);
            now = now + Span::from_millis(*millis);
            answers.note_complete(now, tick);
        }
        answers
    }

    #[test]
    fn the_timeout_is_twice_the_quicker_of_the_last_two() {
        let timeout = |response_times: &[u64]| after(response_times).timeout(MOST);
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
        let start = Instant::ZERO;
        answers.note_requested(start, Tick::new(7));
        answers.note_requested(start + Span::from_millis(50), Tick::new(8));
        answers.note_complete(start + Span::from_millis(60), Tick::new(6));
        assert_eq!(answers.timeout(MOST), Span::from_millis(20));
        answers.note_complete(start + Span::from_millis(80), Tick::new(8));
        answers.note_requested(start, Tick::new(9));
        answers.note_complete(start + Span::from_millis(90), Tick::new(9));
        assert_eq!(answers.timeout(MOST), Span::from_millis(160));
    }
}
