//! What was seen of a scene in its last ticks: what its streams share.
//!
//! One per scene, whoever publishes from it. Invariant: ticks follow one another without a gap; what breaks that begins
//! anew.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, Tick, Ticks};

use super::observation::Observation;

/// The most ticks that a publisher may look back before it speaks.
pub const HINDSIGHT_MAX: Ticks = Ticks::new(6);
/// Ticks before the one that is spoken of, from which a body's course is judged.
const PAST: usize = 2;

/// The observations of the last ticks.
#[derive(Debug)]
pub struct Witness {
    /// Oldest first; each in order of index.
    ticks: VecDeque<Vec<Observation>>,
    newest: Tick,
    hindsight: Ticks,
}

impl Witness {
    /// Nothing was seen yet. `hindsight`: how far its publishers look back, at most [`HINDSIGHT_MAX`].
    #[must_use]
    pub fn new(hindsight: Ticks) -> Self {
        Self {
            ticks: VecDeque::new(),
            newest: Tick::ZERO,
            hindsight: hindsight.min(HINDSIGHT_MAX),
        }
    }

    /// Takes in what an engine says after a tick: bodies that move, and once each that fell asleep, in order of index.
    pub fn observe(&mut self, tick: Tick, observations: &[Observation]) {
        if self.newest.next() != tick {
            self.ticks.clear();
        }
        self.newest = tick;
        let kept = PAST + 1 + self.hindsight.count() as usize;
        let mut seen = if self.ticks.len() >= kept {
            self.ticks.pop_front().unwrap_or_default()
        } else {
            Vec::new()
        };
        seen.clear();
        seen.extend_from_slice(observations);
        self.ticks.push_back(seen);
    }

    /// The tick that is spoken of: as far back as hindsight says. `None` while too little was seen.
    #[must_use]
    pub fn present(&self) -> Option<Tick> {
        let tick = self.newest.before(self.hindsight)?;
        self.at(tick).map(|_| tick)
    }

    /// What was seen at a tick.
    #[must_use]
    pub fn at(&self, tick: Tick) -> Option<&[Observation]> {
        let age = self.newest.since(tick)?.count() as usize;
        let place = self.ticks.len().checked_sub(age + 1)?;
        self.ticks.get(place).map(Vec::as_slice)
    }

    /// What was seen of a body at a tick.
    #[must_use]
    pub fn of(&self, id: BodyId, tick: Tick) -> Option<&Observation> {
        let seen = self.at(tick)?;
        let place = seen
            .binary_search_by_key(&id.index(), |observation| observation.id.index())
            .ok()?;
        Some(&seen[place]).filter(|observation| observation.id == id)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::Activity;
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
        let mut witness = Witness::new(Ticks::new(2));
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
    fn a_gap_begins_anew() {
        let mut witness = Witness::new(Ticks::ZERO);
        witness.observe(Tick::new(1), &[seen(0, 1.0)]);
        witness.observe(Tick::new(5), &[seen(0, 5.0)]);
        assert_eq!(witness.at(Tick::new(1)), None);
        assert_eq!(witness.present(), Some(Tick::new(5)));
    }
}
