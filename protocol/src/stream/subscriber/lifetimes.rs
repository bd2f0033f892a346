//! Bodies that came or went, and those whose publishers are silent.
//!
//! Knows no view: the caller passes the earliest tick that one shows. Invariant: a departed body is kept for a view alone
//! that may still show it, a delayed one or one of a lockstep scene's tick. The server predicts a body whose publisher is
//! silent, and then holds it: its stream describes that guess, not the publisher's body. Invariant: silent bodies are
//! sorted by id, each body once, at most one span for each.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, Tick};

use crate::stream::earlier_tracks::EarlierTrack;
use crate::stream::tracks::Slot;

/// Bodies of one index that are kept, such as those that came and went while the scene stood still.
const DEPARTED_PER_INDEX_MAX: usize = 64;

/// First ticks and last tracks of bodies.
#[derive(Clone, Debug, Default)]
pub(super) struct Lifetimes {
    /// By index; none of them is empty.
    changed: BTreeMap<u32, IndexLifetimes>,
    /// Labels of bodies that are gone and not kept.
    released: Vec<u32>,
}

/// The bodies under one index.
#[derive(Clone, Debug, Default)]
struct IndexLifetimes {
    /// The present body, and the first tick of its present description.
    arrived: Option<(BodyId, Tick)>,
    /// Oldest first.
    departed: Vec<Departed>,
}

impl IndexLifetimes {
    const fn is_empty(&self) -> bool {
        self.arrived.is_none() && self.departed.is_empty()
    }
}

/// A body as it was until it was removed or changed.
#[derive(Clone, Debug)]
pub(super) struct Departed {
    pub(super) id: BodyId,
    pub(super) slot: Slot,
    pub(super) label: Option<u32>,
    /// Its tracks, newest first.
    pub(super) tracks: Vec<EarlierTrack>,
    /// Its first tick.
    pub(super) since: Tick,
    pub(super) end: DepartureTick,
    /// The last tick for which the bound is known.
    pub(super) sure_until: Tick,
}

/// The first tick of a scene without a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DepartureTick {
    /// The last tick is known.
    At(Tick),
    /// No datagram that counts this scene event has arrived. A view shows the body until the tick, if there is one.
    After(u64, Option<Tick>),
}

impl Departed {
    fn is_at(&self, tick: Tick) -> bool {
        let is_gone = match self.end {
            DepartureTick::At(end) | DepartureTick::After(_, Some(end)) => tick >= end,
            DepartureTick::After(_, None) => false,
        };
        self.since <= tick && !is_gone
    }
}

impl Lifetimes {
    /// The first tick of the present body; zero if no view needs to know it.
    pub(super) fn since(&self, id: BodyId) -> Tick {
        // Almost always there is none.
        if self.changed.is_empty() {
            return Tick::ZERO;
        }
        match self.changed.get(&id.index()) {
            Some(IndexLifetimes {
                arrived: Some((arrived, since)),
                ..
            }) if *arrived == id => *since,
            _ => Tick::ZERO,
        }
    }

    /// The body that was under an index at a tick and has left since.
    pub(super) fn departed_at(&self, index: u32, tick: Tick) -> Option<&Departed> {
        let mut departed = self.changed.get(&index)?.departed.iter().rev();
        departed.find(|departed| departed.is_at(tick))
    }

    /// True if it is known that a description of a body ended at this tick or before it: the body went or was changed.
    pub(super) fn has_ended(&self, id: BodyId, tick: Tick) -> bool {
        let departed = self.changed.get(&id.index()).map(|of| &of.departed);
        let mut of_body = departed.into_iter().flatten().filter(|of| of.id == id);
        of_body.next_back().is_some_and(|of| match of.end {
            DepartureTick::At(end) => end <= tick,
            DepartureTick::After(..) => false,
        })
    }

    /// True if a body that is gone is kept.
    pub(super) fn has_departed(&self, id: BodyId) -> bool {
        let of_index = self.changed.get(&id.index());
        of_index.is_some_and(|of_index| of_index.departed.iter().any(|departed| departed.id == id))
    }

    /// True if no body came or went.
    pub(super) fn is_empty(&self) -> bool {
        self.changed.is_empty()
    }

    /// The indices of all bodies that came or went.
    pub(super) fn indices(&self, out: &mut Vec<u32>) {
        out.extend(self.changed.keys());
    }

    /// Notes the first tick of a body.
    pub(super) fn arrive(&mut self, id: BodyId, since: Tick) {
        self.changed.entry(id.index()).or_default().arrived = Some((id, since));
    }

    /// Keeps a body that goes.
    pub(super) fn depart(&mut self, departed: Departed, release: impl FnOnce(&Slot)) {
        let of_index = self.changed.entry(departed.id.index()).or_default();
        of_index.arrived = None;
        if of_index.departed.len() >= DEPARTED_PER_INDEX_MAX {
            // The oldest one is shown, and that before the newest may be.
            let between = of_index.departed.remove(1);
            release(&between.slot);
            self.released.extend(between.label);
        }
        of_index.departed.push(departed);
    }

    /// Notes the label of a body that is gone.
    pub(super) fn release_label(&mut self, label: Option<u32>) {
        self.released.extend(label);
    }

    /// Takes the labels of bodies that are gone.
    pub(super) fn take_released(&mut self) -> Vec<u32> {
        core::mem::take(&mut self.released)
    }

    /// Learns from a datagram that the first `scene_events` happened before a tick.
    pub(super) fn note_count(&mut self, scene_events: u64, tick: Tick) {
        let all = self.changed.values_mut();
        for departed in all.flat_map(|of_index| &mut of_index.departed) {
            if let DepartureTick::After(event, _) = departed.end
                && event <= scene_events
            {
                departed.end = DepartureTick::At(tick);
            }
        }
    }

    /// Drops what no tick from this one on needs. A body whose last tick is not known is shown for `news_after` ticks,
    /// within which a datagram tells it; `None`: until one does.
    pub(super) fn forget_before(
        &mut self,
        tick: Tick,
        news_after: Option<u64>,
        mut release: impl FnMut(&Slot),
    ) {
        let released = &mut self.released;
        self.changed.retain(|_, of_index| {
            of_index.arrived = of_index.arrived.filter(|(_, since)| *since > tick);
            of_index.departed.retain_mut(|departed| {
                let stays = match &mut departed.end {
                    DepartureTick::At(end) | DepartureTick::After(_, Some(end)) => *end > tick,
                    DepartureTick::After(_, end) => {
                        *end = news_after.map(|ticks| Tick::new(tick.value() + ticks));
                        true
                    }
                };
                if !stays {
                    release(&departed.slot);
                    released.extend(departed.label);
                }
                stays
            });
            !of_index.is_empty()
        });
    }

    /// Drops all departed bodies; `false` if there are none.
    pub(super) fn forget_departed(&mut self, mut release: impl FnMut(&Slot)) -> bool {
        let mut is_any = false;
        let released = &mut self.released;
        self.changed.retain(|_, of_index| {
            for departed in of_index.departed.drain(..) {
                is_any = true;
                release(&departed.slot);
                released.extend(departed.label);
            }
            !of_index.is_empty()
        });
        is_any
    }
}

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

    /// Notes that a body is not confirmed from a tick on. An earlier span of it that is still kept continues.
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

    /// Drops the span of a body that no view shows.
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
