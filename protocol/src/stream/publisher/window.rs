//! The observations of one body around a published tick.
//!
//! Motions only, converted once for all users. The mode decision interprets them.

use glam::DVec3;
use rhumb_reckoning::{BodyId, Motion, Tick, Ticks};

use crate::stream::observation_history::{LOOKAHEAD_MAX, ObservationHistory};

/// The observations of a body around a tick.
#[derive(Clone, Debug)]
pub(super) struct ObservationWindow {
    /// Its linear velocities one and two ticks before, m/s.
    pub(super) velocities: Option<[DVec3; 2]>,
    /// Its motions one and two strides before, or ticks if it was not observed that long.
    pub(super) past: [Option<Motion>; 2],
    pub(super) stride: Ticks,
    /// None without lookahead.
    ahead: Option<Ahead>,
}

/// The motions of a body after the tick, within the lookahead.
#[derive(Clone, Debug)]
struct Ahead {
    /// Only the first `known` entries are valid.
    motions: [Motion; LOOKAHEAD_MAX.count() as usize],
    known: usize,
    /// True if it is certain that no observation follows the last motion.
    ends: bool,
}

impl ObservationWindow {
    /// The window of a body whose position among the observations is near `place`.
    pub(super) fn of(
        observation_history: &ObservationHistory,
        id: BodyId,
        tick: Tick,
        place: usize,
    ) -> Self {
        let motion = |tick: Tick| {
            let observed = observation_history.near(id, tick, place);
            observed.map(|observed| observed.motion.motion())
        };
        let before = |ticks| tick.before(Ticks::new(ticks)).and_then(motion);
        let mut stride = observation_history.stride().count();
        let mut past = [before(stride), before(2 * stride)];
        if stride > 1 && past[0].is_none() {
            (past, stride) = ([before(1), before(2)], 1);
        }
        let linear = |motion: &Option<Motion>| motion.as_ref().map(|motion| motion.twist().linear);
        let velocities = if stride == 1 {
            [linear(&past[0]), linear(&past[1])]
        } else {
            [linear(&before(1)), linear(&before(2))]
        };
        let has_lookahead = observation_history.lookahead() > Ticks::ZERO;
        Self {
            velocities: velocities[0].zip(velocities[1]).map(<[DVec3; 2]>::from),
            past,
            stride: Ticks::new(stride),
            ahead: has_lookahead.then(|| Ahead::of(observation_history, id, tick, place)),
        }
    }

    /// The motions after the tick.
    pub(super) fn ahead(&self) -> &[Motion] {
        self.ahead
            .as_ref()
            .map_or(&[], |ahead| &ahead.motions[..ahead.known])
    }

    /// True if it is certain that no observation follows the last motion of `ahead`.
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
            let Some(observed) = observation_history.near(id, then, place) else {
                ahead.ends = observation_history.at(then).is_some();
                break;
            };
            *motion = observed.motion.motion();
            ahead.known += 1;
        }
        ahead
    }
}
