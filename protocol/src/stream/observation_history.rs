//! The observations of a scene's recent ticks, shared by its streams.
//!
//! Observations are the publisher's ground truth. One history for each scene. Invariant: the observed ticks have no
//! gap; after a gap the history starts again. Ticks that no publisher needs are dropped. A window holds the
//! observations of one body around a published tick; the mode decision interprets them.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;
use core::num::NonZeroU32;

use glam::DVec3;
use rhumb_reckoning::{BodyId, BodyState, Motion, Tick, Ticks};

use crate::limits::LOOKAHEAD_TICKS_MAX;
use crate::scene::PublishSchedule;

/// The largest lookahead of a publisher.
pub const LOOKAHEAD_MAX: Ticks = Ticks::new(LOOKAHEAD_TICKS_MAX);
/// The distance between the earlier observations of a body that a publisher uses. It is half of the publish interval,
/// rounded down, at least one tick: events between two published ticks are then observed, and the latest count most.
const fn stride(publish_interval: NonZeroU32) -> Ticks {
    let half = publish_interval.get() / 2;
    Ticks::new(if half > 1 { half } else { 1 })
}

/// The observations of one tick.
#[derive(Debug)]
struct ObservedTick {
    tick: Tick,
    /// In order of index.
    bodies: Vec<Observation>,
}

/// The observations of recent ticks.
#[derive(Debug)]
pub struct ObservationHistory {
    /// Oldest first.
    ticks: Vec<ObservedTick>,
    /// Buffers of dropped ticks, for reuse.
    spare_buffers: Vec<Vec<Observation>>,
    newest: Tick,
    publish_schedule: PublishSchedule,
    /// By index: bodies that fell asleep in ticks that are not published. The next published tick includes them.
    passed_over: BTreeMap<u32, Observation>,
}

impl ObservationHistory {
    /// An empty history for publishers with this schedule, whose lookahead is at most [`LOOKAHEAD_MAX`].
    #[must_use]
    pub fn new(publish_schedule: PublishSchedule) -> Self {
        let lookahead = publish_schedule.lookahead.min(LOOKAHEAD_MAX);
        Self {
            ticks: Vec::new(),
            spare_buffers: Vec::new(),
            newest: Tick::ZERO,
            publish_schedule: PublishSchedule {
                lookahead,
                ..publish_schedule
            },
            passed_over: BTreeMap::new(),
        }
    }

    /// Adds the observations of a tick, in order of index: awake bodies, and each body that fell asleep, once.
    pub fn observe(&mut self, tick: Tick, observations: &[Observation]) {
        if self.newest.next() != tick {
            self.ticks.clear();
        }
        self.newest = tick;
        self.forget();
        let speaks = self.publish_schedule.publishes(tick);
        if !speaks {
            let asleep = observations
                .iter()
                .filter(|observed| observed.activity == Activity::Asleep);
            let asleep = asleep.map(|observed| (observed.id.index(), *observed));
            self.passed_over.extend(asleep);
            if !self.needed_ticks()(tick) {
                return;
            }
        }
        let mut observed = self.spare_buffers.pop().unwrap_or_default();
        observed.clear();
        if speaks && !self.passed_over.is_empty() {
            for observed in observations {
                self.passed_over.remove(&observed.id.index());
            }
            // Both are in the order of ids.
            let passed_over = core::mem::take(&mut self.passed_over);
            let mut passed_over = passed_over.into_values().peekable();
            for observation in observations {
                let is_before = |passed: &Observation| passed.id < observation.id;
                while let Some(passed) = passed_over.next_if(is_before) {
                    observed.push(passed);
                }
                observed.push(*observation);
            }
            observed.extend(passed_over);
        } else {
            observed.extend_from_slice(observations);
        }
        self.ticks.push(ObservedTick {
            tick,
            bodies: observed,
        });
    }

    /// Drops the ticks that no publisher needs.
    fn forget(&mut self) {
        let (is_looked_at, spare_buffers) = (self.needed_ticks(), &mut self.spare_buffers);
        self.ticks.retain_mut(|observed| {
            let is_kept = is_looked_at(observed.tick);
            if !is_kept {
                spare_buffers.push(core::mem::take(&mut observed.bodies));
            }
            is_kept
        });
    }

    /// Returns a test for ticks that a publisher needs, now or later: unpublished ticks of the schedule, some before
    /// each of them, the tick that is compared with the tracks now, and the ticks within the lookahead.
    fn needed_ticks(&self) -> impl Fn(Tick) -> bool + use<> {
        let publish_schedule = self.publish_schedule;
        let present = self
            .newest
            .before(publish_schedule.lookahead)
            .unwrap_or_default();
        let stride = self.stride().count();
        let needed_ticks = [0, 1, 2, stride, 2 * stride].map(Ticks::new);
        let is_published_yet = move |tick| tick >= present && publish_schedule.publishes(tick);
        move |tick| {
            tick >= present
                || needed_ticks
                    .iter()
                    .any(|ticks| is_published_yet(tick + *ticks))
        }
    }

    /// The tick to publish now, `lookahead` ticks before the newest one. `None` before enough ticks are observed, and
    /// between two published ticks.
    #[must_use]
    pub fn present(&self) -> Option<Tick> {
        let tick = self.newest.before(self.publish_schedule.lookahead)?;
        let observed = self.publish_schedule.publishes(tick) && self.at(tick).is_some();
        observed.then_some(tick)
    }

    /// The same for a stream that is published up to a tick: `None` also if that covers the tick to publish now, as in
    /// a stream that began after it.
    pub(super) fn due_after(&self, published: Tick) -> Option<Tick> {
        self.present().filter(|tick| *tick > published)
    }

    /// The tick that would be published now if it were not between two published ones; `None` at those, and for a tick that
    /// a stream has passed.
    pub(super) fn passing_after(&self, published: Tick) -> Option<Tick> {
        let tick = self.newest.before(self.publish_schedule.lookahead)?;
        let passes = !self.publish_schedule.publishes(tick) && tick > published;
        (passes && self.at(tick).is_some()).then_some(tick)
    }

    /// The delay between a tick and its publication.
    pub(super) const fn lookahead(&self) -> Ticks {
        self.publish_schedule.lookahead
    }

    /// See [`stride`].
    const fn stride(&self) -> Ticks {
        stride(self.publish_schedule.publish_interval)
    }

    /// The observations of a tick, in order of index.
    #[must_use]
    pub fn at(&self, tick: Tick) -> Option<&[Observation]> {
        let mut newest_first = self.ticks.iter().rev();
        let observed = newest_first.find(|observed| observed.tick == tick)?;
        Some(&observed.bodies)
    }

    /// The observation of a body at a tick.
    #[must_use]
    pub fn of(&self, id: BodyId, tick: Tick) -> Option<&Observation> {
        let observed = self.at(tick)?;
        // If all bodies are awake, the position of a body is the difference of its index and the first one.
        let first = observed.first()?.id.index();
        near(observed, id, id.index().saturating_sub(first) as usize)
    }
}

/// The observation of a body whose position is near `place`.
#[inline]
fn near(observed: &[Observation], id: BodyId, place: usize) -> Option<&Observation> {
    let place = match observed.get(place) {
        Some(observation) if observation.id == id => return Some(observation),
        _ => find(observed, id.index(), place)?,
    };
    Some(&observed[place]).filter(|observation| observation.id == id)
}

/// Searches for the position of a body from a start position outwards, in growing steps.
fn find(observed: &[Observation], index: u32, from: usize) -> Option<usize> {
    let index_at = |place: usize| observed[place].id.index();
    let from = from.min(observed.len().checked_sub(1)?);
    if index_at(from) == index {
        return Some(from);
    }
    let mut step = 1;
    let (low, high) = if index_at(from) < index {
        let mut low = from + 1;
        while low + step < observed.len() && index_at(low + step) < index {
            (low, step) = (low + step, step * 2);
        }
        (low, observed.len().min(low + step + 1))
    } else {
        let mut high = from;
        while high > step && index_at(high - step) > index {
            (high, step) = (high - step, step * 2);
        }
        (high.saturating_sub(step), high)
    };
    let found =
        observed[low..high].binary_search_by_key(&index, |observation| observation.id.index());
    Some(low + found.ok()?)
}

/// The engine's state of a body: stepped, or asleep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Activity {
    /// The engine steps the body.
    Awake,
    /// The engine has put the body to sleep in this pose and does not move it until something touches it.
    Asleep,
}

/// The state of one body after one tick.
///
/// An engine reports the bodies that are awake and, once, each that fell asleep in this tick, in order of id. A body
/// without an observation has not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Observation {
    /// The observed body.
    pub id: BodyId,
    /// Its state, the engine's own bits.
    pub motion: BodyState,
    /// The engine's state of the body.
    pub activity: Activity,
}

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

#[cfg(test)]
mod tests {
    use rhumb_reckoning::BodyState;

    use super::*;

    fn awake(index: u32, x: f32) -> Observation {
        Observation {
            id: BodyId::new(index, 0),
            motion: BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
                .unwrap(),
            activity: Activity::Awake,
        }
    }

    #[test]
    fn the_published_tick_lags_the_newest_by_the_lookahead() {
        let mut observation_history = ObservationHistory::new(PublishSchedule {
            lookahead: Ticks::new(2),
            ..PublishSchedule::EACH_TICK
        });
        for tick in 1..=10 {
            observation_history.observe(Tick::new(tick), &[awake(3, tick as f32)]);
            let expected = tick.checked_sub(2).filter(|t| *t > 0).map(Tick::new);
            assert_eq!(observation_history.present(), expected);
        }
        let id = BodyId::new(3, 0);
        for tick in 6..=10 {
            let position = observation_history
                .of(id, Tick::new(tick))
                .unwrap()
                .motion
                .position();
            assert_eq!(position[0], tick as f32);
        }
        assert_eq!(observation_history.of(id, Tick::new(5)), None);
        assert_eq!(
            observation_history.of(BodyId::new(3, 1), Tick::new(8)),
            None
        );
        assert_eq!(observation_history.at(Tick::new(11)), None);
    }

    #[test]
    fn before_a_published_tick_two_ticks_and_two_strides_are_kept() {
        let cases = [
            (1, 0, 3),
            (2, 0, 3),
            (3, 0, 3),
            (5, 0, 4),
            (6, 0, 5),
            (1, 6, 9),
            (4, 6, 10),
            (5, 6, 10),
            (6, 4, 10),
        ];
        for (publish_interval, lookahead, most) in cases {
            let publish_interval = NonZeroU32::new(publish_interval).unwrap();
            let lookahead = Ticks::new(lookahead);
            let mut observation_history = ObservationHistory::new(PublishSchedule {
                publish_interval,
                lookahead,
            });
            for tick in 1..=60 {
                observation_history.observe(Tick::new(tick), &[awake(3, tick as f32)]);
                assert!(
                    observation_history.ticks.len() <= most,
                    "each {publish_interval}th: {most}"
                );
                let Some(present) = observation_history
                    .present()
                    .filter(|present| present.value() > 12)
                else {
                    continue;
                };
                let stride = observation_history.stride().count();
                for ago in [0, 1, 2, stride, 2 * stride] {
                    let then = present.before(Ticks::new(ago)).unwrap();
                    let [body] = observation_history.at(then).unwrap() else {
                        panic!("one body is observed");
                    };
                    assert_eq!(body.motion.position()[0], then.value() as f32);
                }
            }
        }
    }

    #[test]
    fn unneeded_ticks_are_not_kept() {
        let publish_interval = NonZeroU32::new(6).unwrap();
        let lookahead = Ticks::ZERO;
        let mut observation_history = ObservationHistory::new(PublishSchedule {
            publish_interval,
            lookahead,
        });
        for tick in 1..=60 {
            observation_history.observe(Tick::new(tick), &[awake(3, tick as f32)]);
            // The present one is compared with the tracks, published or not.
            assert!(observation_history.at(Tick::new(tick)).is_some());
            let before = tick - 1;
            let is_kept = observation_history.at(Tick::new(before)).is_some();
            let is_needed = before > 0 && [0, 3, 4, 5].contains(&(before % 6));
            assert_eq!(is_kept, is_needed, "{before}");
        }
    }

    #[test]
    fn bodies_are_found_from_any_start() {
        for step in [1, 3] {
            let all: Vec<_> = (0..40).map(|place| awake(5 + place * step, 0.0)).collect();
            for count in [0, 1, 2, 7, 40] {
                let all = &all[..count];
                for index in 0..130 {
                    let expected = all.iter().position(|observed| observed.id.index() == index);
                    for from in 0..45 {
                        assert_eq!(find(all, index, from), expected, "{index} from {from}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_gap_restarts_the_history() {
        let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
        observation_history.observe(Tick::new(1), &[awake(0, 1.0)]);
        observation_history.observe(Tick::new(5), &[awake(0, 5.0)]);
        assert_eq!(observation_history.at(Tick::new(1)), None);
        assert_eq!(observation_history.present(), Some(Tick::new(5)));
    }

    #[test]
    fn a_body_that_falls_asleep_between_published_ticks_is_in_the_next() {
        let publish_interval = NonZeroU32::new(3).unwrap();
        let lookahead = Ticks::new(2);
        let mut observation_history = ObservationHistory::new(PublishSchedule {
            publish_interval,
            lookahead,
        });
        let asleep = |index, x| Observation {
            activity: Activity::Asleep,
            ..awake(index, x)
        };
        let ticks: [&[Observation]; 8] = [
            &[awake(4, 1.0), asleep(9, 1.0)],
            &[asleep(4, 2.0)],
            &[asleep(1, 3.0)],
            &[awake(4, 4.0)],
            &[asleep(4, 5.0)],
            &[awake(4, 6.0)],
            &[],
            &[],
        ];
        for (place, observations) in ticks.into_iter().enumerate() {
            let tick = Tick::new(place as u64 + 1);
            observation_history.observe(tick, observations);
            let published = match tick.value() {
                5 => Some(Tick::new(3)),
                8 => Some(Tick::new(6)),
                _ => None,
            };
            assert_eq!(observation_history.present(), published, "{tick}");
        }
        let at = |tick| observation_history.at(Tick::new(tick)).unwrap();
        assert_eq!(at(6), [awake(4, 6.0)]);
        let mut observation_history = ObservationHistory::new(PublishSchedule {
            publish_interval,
            lookahead,
        });
        for (place, observations) in ticks[..3].iter().enumerate() {
            observation_history.observe(Tick::new(place as u64 + 1), observations);
        }
        let third = [asleep(1, 3.0), asleep(4, 2.0), asleep(9, 1.0)];
        assert_eq!(observation_history.at(Tick::new(3)).unwrap(), third);
    }
}
