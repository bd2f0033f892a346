//! What was seen of a body around a tick that is spoken of.
//!
//! Motions only, widened once for all who ask; what they are good for is not known here.

use rhumb_reckoning::{BodyId, Motion, Tick, Ticks};

use crate::stream::observation_history::{LOOKAHEAD_MAX, ObservationHistory};

/// What was seen of a body around a tick.
pub(super) struct ObservationWindow {
    /// What it did one and two ticks before.
    pub(super) last: [Option<Motion>; 2],
    /// What it did one and two strides before: ticks where it was not seen so long ago.
    pub(super) past: [Option<Motion>; 2],
    pub(super) stride: Ticks,
    /// None without lookahead.
    ahead: Option<Ahead>,
}

/// What a body will do, as far as lookahead knows.
struct Ahead {
    /// As many as `known`.
    motions: [Motion; LOOKAHEAD_MAX.count() as usize],
    known: usize,
    /// Whether nothing is seen of it after that, as far as that is known.
    ends: bool,
}

impl ObservationWindow {
    /// Of a body that stands about there among those that were seen.
    pub(super) fn of(
        observation_history: &ObservationHistory,
        id: BodyId,
        tick: Tick,
        place: usize,
    ) -> Self {
        let motion = |tick: Tick| {
            let seen = observation_history.near(id, tick, place);
            seen.map(|seen| seen.motion.motion())
        };
        let before = |ticks| tick.before(Ticks::new(ticks)).and_then(motion);
        let last = [before(1), before(2)];
        let stride = observation_history.stride().count();
        let (past, stride) = match (stride > 1).then(|| before(stride)).flatten() {
            None => (last, 1),
            seen => ([seen, before(2 * stride)], stride),
        };
        let has_lookahead = observation_history.lookahead() > Ticks::ZERO;
        Self {
            last,
            past,
            stride: Ticks::new(stride),
            ahead: has_lookahead.then(|| Ahead::of(observation_history, id, tick, place)),
        }
    }

    /// What it will do.
    pub(super) fn ahead(&self) -> &[Motion] {
        self.ahead
            .as_ref()
            .map_or(&[], |ahead| &ahead.motions[..ahead.known])
    }

    /// Whether it is known that nothing is seen of it after that.
    pub(super) fn ends(&self) -> bool {
        self.ahead.as_ref().is_some_and(|ahead| ahead.ends)
    }
}

impl Ahead {
    fn of(observation_history: &ObservationHistory, id: BodyId, tick: Tick, place: usize) -> Self {
        let mut ahead = Self {
            motions: [Motion::IDENTITY; LOOKAHEAD_MAX.count() as usize],
            known: 0,
            ends: false,
        };
        for (ticks, motion) in (1..).zip(&mut ahead.motions) {
            let then = tick + Ticks::new(ticks);
            let Some(seen) = observation_history.near(id, then, place) else {
                ahead.ends = observation_history.at(then).is_some();
                break;
            };
            *motion = seen.motion.motion();
            ahead.known += 1;
        }
        ahead
    }
}
