//! What was seen of a scene in its last ticks: what its streams share.
//!
//! One per scene, whoever publishes from it. Invariant: ticks are seen one after another without a gap; what breaks that
//! begins anew. Those that nobody will look at any more are forgotten.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;
use core::num::NonZeroU32;

use rhumb_reckoning::{BodyId, Tick, Ticks};

use super::observation::{Activity, Observation};
use crate::limits::LOOKAHEAD_TICKS_MAX;
use crate::scene::PublishSchedule;

/// The most ticks that a publisher may look back before it speaks.
pub const LOOKAHEAD_MAX: Ticks = Ticks::new(LOOKAHEAD_TICKS_MAX);
/// Ticks between two needed_ticks at what a body did before a tick that is spoken of, where each so-manyeth is: half of these or a
/// little less, so that what happens between two such ticks is seen, and what happened last counts most.
pub(super) const fn stride(publish_interval: NonZeroU32) -> Ticks {
    let half = publish_interval.get() / 2;
    Ticks::new(if half > 1 { half } else { 1 })
}

/// What was seen after a tick.
#[derive(Debug)]
struct ObservedTick {
    tick: Tick,
    /// In order of index.
    bodies: Vec<Observation>,
}

/// The observations of the last ticks.
#[derive(Debug)]
pub struct ObservationHistory {
    /// Oldest first.
    ticks: Vec<ObservedTick>,
    /// Room of those that were forgotten.
    spare_buffers: Vec<Vec<Observation>>,
    newest: Tick,
    publish_schedule: PublishSchedule,
    /// By index, bodies that fell asleep at ticks that are passed over: the next one that is spoken of has them too.
    passed_over: BTreeMap<u32, Observation>,
}

impl ObservationHistory {
    /// Nothing was seen yet. `publish_schedule`: when its publishers speak; they look back at most [`LOOKAHEAD_MAX`].
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

    /// Takes in what an engine says after a tick: bodies that move, and once each that fell asleep, in order of index.
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
                .filter(|seen| seen.activity == Activity::Asleep);
            let asleep = asleep.map(|seen| (seen.id.index(), *seen));
            self.passed_over.extend(asleep);
            if !self.needed_ticks()(tick) {
                return;
            }
        }
        let mut seen = self.spare_buffers.pop().unwrap_or_default();
        seen.clear();
        seen.extend_from_slice(observations);
        if speaks && !self.passed_over.is_empty() {
            for seen in observations {
                self.passed_over.remove(&seen.id.index());
            }
            seen.extend(core::mem::take(&mut self.passed_over).into_values());
            seen.sort_unstable_by_key(|seen| seen.id.index());
        }
        self.ticks.push(ObservedTick { tick, bodies: seen });
    }

    /// Forgets what nobody will look at any more.
    fn forget(&mut self) {
        let (is_looked_at, spare_buffers) = (self.needed_ticks(), &mut self.spare_buffers);
        self.ticks.retain_mut(|seen| {
            let is_kept = is_looked_at(seen.tick);
            if !is_kept {
                spare_buffers.push(core::mem::take(&mut seen.bodies));
            }
            is_kept
        });
    }

    /// Tells at which ticks somebody may look, now or later: at those that are spoken of yet, at some before each, and at all
    /// that lookahead knows of.
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
            tick > present
                || needed_ticks
                    .iter()
                    .any(|ticks| is_published_yet(tick + *ticks))
        }
    }

    /// The tick that is spoken of now: as far back as lookahead says. `None` while too little was seen, and at the ticks
    /// between two that are spoken of.
    #[must_use]
    pub fn present(&self) -> Option<Tick> {
        let tick = self.newest.before(self.publish_schedule.lookahead)?;
        let seen = self.publish_schedule.publishes(tick) && self.at(tick).is_some();
        seen.then_some(tick)
    }

    /// How many ticks later each is spoken of.
    pub(super) const fn lookahead(&self) -> Ticks {
        self.publish_schedule.lookahead
    }

    /// See [`stride`].
    pub(super) const fn stride(&self) -> Ticks {
        stride(self.publish_schedule.publish_interval)
    }

    /// What was seen at a tick.
    #[must_use]
    pub fn at(&self, tick: Tick) -> Option<&[Observation]> {
        let mut newest_first = self.ticks.iter().rev();
        let seen = newest_first.find(|seen| seen.tick == tick)?;
        Some(&seen.bodies)
    }

    /// What was seen of a body at a tick.
    #[must_use]
    pub fn of(&self, id: BodyId, tick: Tick) -> Option<&Observation> {
        let seen = self.at(tick)?;
        // Where all bodies move, each stands as far from the first as their indices are apart.
        let first = seen.first()?.id.index();
        self.near(id, tick, id.index().saturating_sub(first) as usize)
    }

    /// The same, of a body that stands about there among those that were seen.
    pub(super) fn near(&self, id: BodyId, tick: Tick, place: usize) -> Option<&Observation> {
        let seen = self.at(tick)?;
        let place = find(seen, id.index(), place)?;
        Some(&seen[place]).filter(|observation| observation.id == id)
    }
}

/// The place of a body, looked for from another on, in ever wider steps.
fn find(seen: &[Observation], index: u32, from: usize) -> Option<usize> {
    let index_at = |place: usize| seen[place].id.index();
    let from = from.min(seen.len().checked_sub(1)?);
    if index_at(from) == index {
        return Some(from);
    }
    let mut step = 1;
    let (low, high) = if index_at(from) < index {
        let mut low = from + 1;
        while low + step < seen.len() && index_at(low + step) < index {
            (low, step) = (low + step, step * 2);
        }
        (low, seen.len().min(low + step + 1))
    } else {
        let mut high = from;
        while high > step && index_at(high - step) > index {
            (high, step) = (high - step, step * 2);
        }
        (high.saturating_sub(step), high)
    };
    let found = seen[low..high].binary_search_by_key(&index, |observation| observation.id.index());
    Some(low + found.ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_reckoning::BodyState;

    fn seen(index: u32, x: f32) -> Observation {
        Observation {
            id: BodyId::new(index, 0),
            motion: BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
                .unwrap(),
            activity: Activity::Awake,
        }
    }

    #[test]
    fn the_present_lies_as_far_back_as_lookahead_says() {
        let mut observation_history = ObservationHistory::new(PublishSchedule {
            lookahead: Ticks::new(2),
            ..PublishSchedule::EACH_TICK
        });
        for tick in 1..=10 {
            observation_history.observe(Tick::new(tick), &[seen(3, tick as f32)]);
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
    fn before_a_tick_that_is_spoken_of_the_last_two_are_seen_and_two_looks_back() {
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
                observation_history.observe(Tick::new(tick), &[seen(3, tick as f32)]);
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
                        panic!("one body is seen");
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
            observation_history.observe(Tick::new(tick), &[seen(3, tick as f32)]);
            let is_kept = observation_history.at(Tick::new(tick)).is_some();
            assert_eq!(is_kept, [0, 3, 4, 5].contains(&(tick % 6)), "{tick}");
        }
    }

    #[test]
    fn bodies_are_found_from_any_start() {
        for step in [1, 3] {
            let all: Vec<_> = (0..40).map(|place| seen(5 + place * step, 0.0)).collect();
            for count in [0, 1, 2, 7, 40] {
                let all = &all[..count];
                for index in 0..130 {
                    let expected = all.iter().position(|seen| seen.id.index() == index);
                    for from in 0..45 {
                        assert_eq!(find(all, index, from), expected, "{index} from {from}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_gap_begins_anew() {
        let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
        observation_history.observe(Tick::new(1), &[seen(0, 1.0)]);
        observation_history.observe(Tick::new(5), &[seen(0, 5.0)]);
        assert_eq!(observation_history.at(Tick::new(1)), None);
        assert_eq!(observation_history.present(), Some(Tick::new(5)));
    }

    #[test]
    fn sleep_between_published_ticks_is_seen_at_the_next() {
        let publish_interval = NonZeroU32::new(3).unwrap();
        let lookahead = Ticks::new(2);
        let mut observation_history = ObservationHistory::new(PublishSchedule {
            publish_interval,
            lookahead,
        });
        let asleep = |index, x| Observation {
            activity: Activity::Asleep,
            ..seen(index, x)
        };
        let ticks: [&[Observation]; 8] = [
            &[seen(4, 1.0), asleep(9, 1.0)],
            &[asleep(4, 2.0)],
            &[asleep(1, 3.0)],
            &[seen(4, 4.0)],
            &[asleep(4, 5.0)],
            &[seen(4, 6.0)],
            &[],
            &[],
        ];
        for (place, observations) in ticks.into_iter().enumerate() {
            let tick = Tick::new(place as u64 + 1);
            observation_history.observe(tick, observations);
            let spoken = match tick.value() {
                5 => Some(Tick::new(3)),
                8 => Some(Tick::new(6)),
                _ => None,
            };
            assert_eq!(observation_history.present(), spoken, "{tick}");
        }
        let at = |tick| observation_history.at(Tick::new(tick)).unwrap();
        assert_eq!(at(6), [seen(4, 6.0)]);
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
