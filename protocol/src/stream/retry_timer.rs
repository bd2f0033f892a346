//! The retry timer of an unanswered message, with growing pauses.

use crate::endpoint::{Instant, Span};

/// The timer of one message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RetryTimer {
    due: Option<Instant>,
    span: Span,
    least: Span,
    most: Span,
}

impl RetryTimer {
    /// A timer with a first pause of `least`; later pauses are at most `most`.
    pub(crate) const fn new(least: Span, most: Span) -> Self {
        Self {
            due: None,
            span: least,
            least,
            most,
        }
    }

    /// The time at which the message is due again; None while the timer is stopped.
    pub(crate) const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Starts, unless it runs already.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.begin_for(now, Span::ZERO);
    }

    /// Starts as [`Self::begin`], with a first pause of at least this span; later pauses double it.
    pub(crate) fn begin_for(&mut self, now: Instant, span: Span) {
        if self.due.is_none() {
            self.span = self.span.max(span);
            self.due = Some(now + self.span);
        }
    }

    /// Stops: the message is answered, or needs no answer.
    pub(crate) fn end(&mut self) {
        self.due = None;
        self.span = self.least;
    }

    /// True if the message is due; the next pause is then twice as long, and at least `round_trip`.
    pub(crate) fn fire(&mut self, now: Instant, round_trip: Span) -> bool {
        if self.due.is_none_or(|due| due > now) {
            return false;
        }
        let doubled = Span::from_nanos(self.span.as_nanos() * 2);
        self.span = doubled.max(round_trip).min(self.most);
        self.due = Some(now + self.span);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_longer_first_timeout_doubles_too() {
        let mut timer = RetryTimer::new(Span::from_millis(5), Span::from_millis(70));
        let mut now = Instant::ZERO;
        timer.begin_for(now, Span::from_millis(20));
        for millis in [20, 40, 70] {
            let due = timer.due().unwrap();
            assert_eq!(due, now + Span::from_millis(millis));
            now = due;
            assert!(timer.fire(now, Span::ZERO));
        }
        timer.end();
        timer.begin_for(now, Span::from_millis(1));
        assert_eq!(timer.due(), Some(now + Span::from_millis(5)));
    }

    #[test]
    fn retries_back_off_until_answered() {
        let mut timer = RetryTimer::new(Span::from_millis(5), Span::from_millis(40));
        let mut now = Instant::ZERO;
        timer.begin(now);
        let mut spans = [0; 5];
        for span in &mut spans {
            let due = timer.due().unwrap();
            *span = due.since(now).as_nanos() / 1_000_000;
            assert!(!timer.fire(now, Span::ZERO));
            now = due;
            assert!(timer.fire(now, Span::from_millis(15)));
        }
        assert_eq!(spans, [5, 15, 30, 40, 40]);
        timer.end();
        assert_eq!(timer.due(), None);
        timer.begin(now);
        assert_eq!(timer.due(), Some(now + Span::from_millis(5)));
    }
}
