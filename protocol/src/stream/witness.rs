//! What was seen of a scene in its last ticks: what its streams share.
//!
//! One per scene, whoever publishes from it. Invariant: ticks are seen one after another without a gap; what breaks that
//! begins anew. Those that nobody will look at any more are forgotten.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;
use core::num::NonZeroU32;

use rhumb_reckoning::{BodyId, Tick, Ticks};

use super::observation::{Activity, Observation};
use crate::limits::HINDSIGHT_TICKS_MAX;
use crate::scene::Cadence;

/// The most ticks that a publisher may look back before it speaks.
pub const HINDSIGHT_MAX: Ticks = Ticks::new(HINDSIGHT_TICKS_MAX);
/// Ticks between two looks at what a body did before a tick that is spoken of, where each so-manyeth is: half of these or a
/// little less, so that what happens between two such ticks is seen, and what happened last counts most.
pub(super) const fn stride(every: NonZeroU32) -> Ticks {
    let half = every.get() / 2;
    Ticks::new(if half > 1 { half } else { 1 })
}

/// What was seen after a tick.
#[derive(Debug)]
struct Seen {
    tick: Tick,
    /// In order of index.
    bodies: Vec<Observation>,
}

/// The observations of the last ticks.
#[derive(Debug)]
pub struct Witness {
    /// Oldest first.
    ticks: Vec<Seen>,
    /// Room of those that were forgotten.
    room: Vec<Vec<Observation>>,
    newest: Tick,
    cadence: Cadence,
    /// By index, bodies that fell asleep at ticks that are passed over: the next one that is spoken of has them too.
    passed_over: BTreeMap<u32, Observation>,
}

impl Witness {
    /// Nothing was seen yet. `cadence`: when its publishers speak; they look back at most [`HINDSIGHT_MAX`].
    #[must_use]
    pub fn new(cadence: Cadence) -> Self {
        let hindsight = cadence.hindsight.min(HINDSIGHT_MAX);
        Self {
            ticks: Vec::new(),
            room: Vec::new(),
            newest: Tick::ZERO,
            cadence: Cadence {
                hindsight,
                ..cadence
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
        let speaks = self.cadence.speaks_of(tick);
        if !speaks {
            let asleep = observations
                .iter()
                .filter(|seen| seen.activity == Activity::Asleep);
            let asleep = asleep.map(|seen| (seen.id.index(), *seen));
            self.passed_over.extend(asleep);
            if !self.looks()(tick) {
                return;
            }
        }
        let mut seen = self.room.pop().unwrap_or_default();
        seen.clear();
        seen.extend_from_slice(observations);
        if speaks && !self.passed_over.is_empty() {
            for seen in observations {
                self.passed_over.remove(&seen.id.index());
            }
            seen.extend(core::mem::take(&mut self.passed_over).into_values());
            seen.sort_unstable_by_key(|seen| seen.id.index());
        }
        self.ticks.push(Seen { tick, bodies: seen });
    }

    /// Forgets what nobody will look at any more.
    fn forget(&mut self) {
        let (is_looked_at, room) = (self.looks(), &mut self.room);
        self.ticks.retain_mut(|seen| {
            let is_kept = is_looked_at(seen.tick);
            if !is_kept {
                room.push(core::mem::take(&mut seen.bodies));
            }
            is_kept
        });
    }

    /// Tells at which ticks somebody may look, now or later: at those that are spoken of yet, at some before each, and at all
    /// that hindsight knows of.
    fn looks(&self) -> impl Fn(Tick) -> bool + use<> {
        let cadence = self.cadence;
        let present = self.newest.before(cadence.hindsight).unwrap_or_default();
        let stride = self.stride().count();
        let looks = [0, 1, 2, stride, 2 * stride].map(Ticks::new);
        let is_spoken_of_yet = move |tick| tick >= present && cadence.speaks_of(tick);
        move |tick| tick > present || looks.iter().any(|ticks| is_spoken_of_yet(tick + *ticks))
    }

    /// The tick that is spoken of now: as far back as hindsight says. `None` while too little was seen, and at the ticks
    /// between two that are spoken of.
    #[must_use]
    pub fn present(&self) -> Option<Tick> {
        let tick = self.newest.before(self.cadence.hindsight)?;
        let seen = self.cadence.speaks_of(tick) && self.at(tick).is_some();
        seen.then_some(tick)
    }

    /// How many ticks later each is spoken of.
    pub(super) const fn hindsight(&self) -> Ticks {
        self.cadence.hindsight
    }

    /// See [`stride`].
    pub(super) const fn stride(&self) -> Ticks {
        stride(self.cadence.every)
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
    use rhumb_reckoning::Verbatim;

    fn seen(index: u32, x: f32) -> Observation {
        Observation {
            id: BodyId::new(index, 0),
            motion: Verbatim::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).unwrap(),
            activity: Activity::Awake,
        }
    }

    #[test]
    fn the_present_lies_as_far_back_as_hindsight_says() {
        let mut witness = Witness::new(Cadence {
            hindsight: Ticks::new(2),
            ..Cadence::EACH_TICK
        });
        for tick in 1..=10 {
            witness.observe(Tick::new(tick), &[seen(3, tick as f32)]);
            let expected = tick.checked_sub(2).filter(|t| *t > 0).map(Tick::new);
            assert_eq!(witness.present(), expected);
        }
        let id = BodyId::new(3, 0);
        for tick in 6..=10 {
            let position = witness.of(id, Tick::new(tick)).unwrap().motion.position();
            assert_eq!(position[0], tick as f32);
        }
        assert_eq!(witness.of(id, Tick::new(5)), None);
        assert_eq!(witness.of(BodyId::new(3, 1), Tick::new(8)), None);
        assert_eq!(witness.at(Tick::new(11)), None);
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
        for (every, hindsight, most) in cases {
            let every = NonZeroU32::new(every).unwrap();
            let hindsight = Ticks::new(hindsight);
            let mut witness = Witness::new(Cadence { every, hindsight });
            for tick in 1..=60 {
                witness.observe(Tick::new(tick), &[seen(3, tick as f32)]);
                assert!(witness.ticks.len() <= most, "each {every}th: {most}");
                let Some(present) = witness.present().filter(|present| present.value() > 12) else {
                    continue;
                };
                let stride = witness.stride().count();
                for ago in [0, 1, 2, stride, 2 * stride] {
                    let then = present.before(Ticks::new(ago)).unwrap();
                    let [body] = witness.at(then).unwrap() else {
                        panic!("one body is seen");
                    };
                    assert_eq!(body.motion.position()[0], then.value() as f32);
                }
            }
        }
    }

    #[test]
    fn what_nobody_will_look_at_is_not_kept_at_all() {
        let every = NonZeroU32::new(6).unwrap();
        let hindsight = Ticks::ZERO;
        let mut witness = Witness::new(Cadence { every, hindsight });
        for tick in 1..=60 {
            witness.observe(Tick::new(tick), &[seen(3, tick as f32)]);
            let is_kept = witness.at(Tick::new(tick)).is_some();
            assert_eq!(is_kept, [0, 3, 4, 5].contains(&(tick % 6)), "{tick}");
        }
    }

    #[test]
    fn a_body_is_found_from_wherever_it_is_looked_for() {
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
        let mut witness = Witness::new(Cadence::EACH_TICK);
        witness.observe(Tick::new(1), &[seen(0, 1.0)]);
        witness.observe(Tick::new(5), &[seen(0, 5.0)]);
        assert_eq!(witness.at(Tick::new(1)), None);
        assert_eq!(witness.present(), Some(Tick::new(5)));
    }

    #[test]
    fn who_falls_asleep_between_two_spoken_ticks_is_seen_at_the_second() {
        let every = NonZeroU32::new(3).unwrap();
        let hindsight = Ticks::new(2);
        let mut witness = Witness::new(Cadence { every, hindsight });
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
            witness.observe(tick, observations);
            let spoken = match tick.value() {
                5 => Some(Tick::new(3)),
                8 => Some(Tick::new(6)),
                _ => None,
            };
            assert_eq!(witness.present(), spoken, "{tick}");
        }
        let at = |tick| witness.at(Tick::new(tick)).unwrap();
        assert_eq!(at(6), [seen(4, 6.0)]);
        let mut witness = Witness::new(Cadence { every, hindsight });
        for (place, observations) in ticks[..3].iter().enumerate() {
            witness.observe(Tick::new(place as u64 + 1), observations);
        }
        let third = [asleep(1, 3.0), asleep(4, 2.0), asleep(9, 1.0)];
        assert_eq!(witness.at(Tick::new(3)).unwrap(), third);
    }
}
