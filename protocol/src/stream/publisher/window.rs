//! The observations of one body around a published tick.
//!
//! States and motions only. The mode decision interprets them.

use glam::DVec3;
use rhumb_reckoning::{BodyId, BodyState, Motion, Tick, Ticks};

use crate::stream::observation::Observation;
use crate::stream::observation_history::{LOOKAHEAD_MAX, ObservationHistory, near};

/// The observations of all bodies around a tick, looked up once for all windows.
#[derive(Clone, Copy, Debug)]
pub(super) struct ObservedTicks<'h> {
    pub(super) history: &'h ObservationHistory,
    pub(super) tick: Tick,
    /// The observations of the tick itself.
    pub(super) present: &'h [Observation],
    /// One and two strides before, and one and two ticks before. Empty for ticks without observations.
    strides: [&'h [Observation]; 2],
    ticks: [&'h [Observation]; 2],
}

impl<'h> ObservedTicks<'h> {
    pub(super) fn around(history: &'h ObservationHistory, tick: Tick) -> Self {
        let before = |ticks: u32| {
            let tick = tick.before(Ticks::new(ticks));
            tick.and_then(|tick| history.at(tick)).unwrap_or_default()
        };
        let stride = history.stride().count();
        Self {
            history,
            tick,
            present: history.at(tick).unwrap_or_default(),
            strides: [before(stride), before(2 * stride)],
            ticks: [before(1), before(2)],
        }
    }
}

/// The observations of a body before a tick.
#[derive(Clone, Debug)]
pub(super) struct ObservationWindow<'h> {
    /// Its linear velocities one and two ticks before, m/s.
    pub(super) velocities: Option<[DVec3; 2]>,
    /// Its states one and two strides before, or ticks if it was not observed that long.
    pub(super) past: [Option<&'h BodyState>; 2],
    pub(super) stride: Ticks,
}

/// The motions of a body after the tick, within the lookahead.
#[derive(Clone, Debug)]
pub(super) struct Ahead {
    /// Only the first `known` entries are valid.
    motions: [Motion; LOOKAHEAD_MAX.count() as usize],
    known: usize,
    /// True if it is certain that no observation follows the last motion.
    pub(super) ends: bool,
}

impl<'h> ObservationWindow<'h> {
    /// The window of a body whose position among the observations is near `place`.
    pub(super) fn of(observed: &ObservedTicks<'h>, id: BodyId, place: usize) -> Self {
        let states = |[one, two]: [&'h [Observation]; 2]| {
            let state = |observed| near(observed, id, place).map(|observed| &observed.motion);
            [state(one), state(two)]
        };
        let mut stride = observed.history.stride().count();
        let mut past = states(observed.strides);
        if stride > 1 && past[0].is_none() {
            (past, stride) = (states(observed.ticks), 1);
        }
        let [one, two] = if stride == 1 {
            past
        } else {
            states(observed.ticks)
        };
        let velocities = one.zip(two);
        Self {
            velocities: velocities.map(|(one, two)| [linear(one), linear(two)]),
            past,
            stride: Ticks::new(stride),
        }
    }
}

impl Ahead {
    /// The known motions.
    pub(super) fn motions(&self) -> &[Motion] {
        &self.motions[..self.known]
    }

    /// `None` without lookahead.
    pub(super) fn of(observed: &ObservedTicks<'_>, id: BodyId, place: usize) -> Option<Self> {
        if observed.history.lookahead() == Ticks::ZERO {
            return None;
        }
        let mut ahead = Self {
            motions: [Motion::IDENTITY; LOOKAHEAD_MAX.count() as usize],
            known: 0,
            ends: false,
        };
        for (ticks, motion) in (1..).zip(&mut ahead.motions) {
            let then = observed.history.at(observed.tick + Ticks::new(ticks));
            let Some(observed) = then.and_then(|then| near(then, id, place)) else {
                ahead.ends = then.is_some();
                break;
            };
            *motion = observed.motion.motion();
            ahead.known += 1;
        }
        Some(ahead)
    }
}

/// The linear velocity of a state, m/s.
fn linear(state: &BodyState) -> DVec3 {
    let [.., x, y, z, _, _, _] = state.parts();
    DVec3::new(x.into(), y.into(), z.into())
}
