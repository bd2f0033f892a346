//! Bodies whose publishers are silent.
//!
//! The server predicts such a body and then holds it. Its stream describes that guess, not the publisher's body.
//! Invariant: sorted by id, each body once, at most one span for each.

use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, Tick};

/// The ticks at which poses of bodies are guesses.
#[derive(Clone, Debug, Default)]
pub(super) struct SilentPublishers {
    spans: Vec<GuessedSpan>,
}

#[derive(Clone, Copy, Debug)]
struct GuessedSpan {
    id: BodyId,
    since: Tick,
    /// The first tick that is no guess; `None` while the publisher is silent.
    until: Option<Tick>,
}

impl SilentPublishers {
    /// True if the pose of a body at a tick is a guess.
    pub(super) fn guesses(&self, id: BodyId, tick: Tick) -> bool {
        // Almost always there is none.
        if self.spans.is_empty() {
            return false;
        }
        let place = self.spans.binary_search_by_key(&id, |span| span.id);
        place.is_ok_and(|place| {
            let span = &self.spans[place];
            span.since <= tick && span.until.is_none_or(|until| tick < until)
        })
    }

    /// Notes that a body is not confirmed from a tick on. An earlier span of it that is still kept goes on.
    pub(super) fn silence(&mut self, id: BodyId, since: Tick) {
        match self.spans.binary_search_by_key(&id, |span| span.id) {
            Ok(place) => {
                let span = &mut self.spans[place];
                span.since = span.since.min(since);
                span.until = None;
            }
            Err(place) => {
                let until = None;
                self.spans.insert(place, GuessedSpan { id, since, until });
            }
        }
    }

    /// Notes that a body is confirmed again from a tick on.
    pub(super) fn confirm(&mut self, id: BodyId, tick: Tick) {
        if let Ok(place) = self.spans.binary_search_by_key(&id, |span| span.id) {
            self.spans[place].until = Some(tick);
        }
    }

    /// Drops the span of a body that no view shows any more.
    pub(super) fn forget(&mut self, id: BodyId) {
        if let Ok(place) = self.spans.binary_search_by_key(&id, |span| span.id) {
            self.spans.remove(place);
        }
    }

    /// Drops spans that ended at this tick or before it, and those of bodies that are gone.
    pub(super) fn forget_before(&mut self, tick: Tick, is_known: impl Fn(BodyId) -> bool) {
        self.spans
            .retain(|span| span.until.is_none_or(|until| until > tick) && is_known(span.id));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BALL: BodyId = BodyId::new(3, 0);
    const OTHER: BodyId = BodyId::new(1, 0);

    #[test]
    fn a_body_is_guessed_from_the_silence_until_its_publisher_is_active() {
        let mut silent = SilentPublishers::default();
        silent.silence(BALL, Tick::new(10));
        silent.silence(OTHER, Tick::new(12));
        let guessed = |silent: &SilentPublishers, id, ticks: [u64; 4]| {
            ticks.map(|tick| silent.guesses(id, Tick::new(tick)))
        };
        assert_eq!(
            guessed(&silent, BALL, [9, 10, 11, 99]),
            [false, true, true, true]
        );
        assert_eq!(
            guessed(&silent, OTHER, [9, 11, 12, 99]),
            [false, false, true, true]
        );
        silent.confirm(BALL, Tick::new(20));
        assert_eq!(
            guessed(&silent, BALL, [9, 19, 20, 99]),
            [false, true, false, false]
        );
        silent.forget_before(Tick::new(19), |_| true);
        assert!(
            silent.guesses(BALL, Tick::new(19)),
            "a delayed view shows it"
        );
        // A second silence before a delayed view has passed the first one.
        silent.silence(BALL, Tick::new(25));
        assert!(silent.guesses(BALL, Tick::new(22)));
        silent.confirm(BALL, Tick::new(30));
        silent.forget_before(Tick::new(30), |id| id != OTHER);
        assert!(silent.spans.is_empty(), "one is over, one is gone");
    }
}
