//! Which body could hold another, and how many each holds.

use glam::Vec3;
use rhumb_reckoning::{BodyId, Ticks};

use super::Publisher;
use crate::stream::observation::Observation;
use crate::stream::witness::Witness;

/// Bodies that others may be held by, at one tick: the largest that move.
pub(super) const HOLDERS_MAX: usize = 16;
/// A holder is larger than what it holds by this factor at least.
pub(super) const HOLDER_RATIO: f64 = 1.2;
/// A body is held within this many radii of its holder.
const HOLDER_REACH: f64 = 3.0;
/// With hindsight, who holds others is followed within this share of its tolerance: all that it holds is off with it.
const HOLDER_CLOSENESS: f64 = 0.5;

/// A body that could hold others, at one tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Large {
    /// Its place among those that were seen.
    pub(super) place: usize,
    pub(super) position: Vec3,
    /// Metres.
    pub(super) radius: f64,
}

impl Publisher {
    /// Within what share of its tolerance a body is followed.
    pub(super) fn closeness(&self, witness: &Witness, index: u32) -> f64 {
        let foreseen = self.features.foresight && witness.hindsight() > Ticks::ZERO;
        if foreseen && self.holds(index) {
            HOLDER_CLOSENESS
        } else {
            1.0
        }
    }

    /// The place of the body that could hold another: the one that does, or the nearest within reach.
    pub(super) fn holder_of(
        &self,
        observation: &Observation,
        holders: &[Large],
        observations: &[Observation],
    ) -> Option<usize> {
        let slot = self.tracks.slot(observation.id.index())?;
        if let Some(carrier) = slot.carrier() {
            let holds = |holder: &&Large| observations[holder.place].id == carrier;
            return holders.iter().find(holds).map(|holder| holder.place);
        }
        let least = self.tracks.radius(slot).metres() * HOLDER_RATIO;
        let here = Vec3::from_array(observation.motion.position());
        let reaches = |holder: &&Large| {
            let far = f64::from(holder.position.distance(here));
            holder.radius >= least && far <= holder.radius * HOLDER_REACH
        };
        let far = |holder: &Large| holder.position.distance_squared(here);
        let near = holders.iter().filter(reaches);
        near.min_by(|a, b| far(a).total_cmp(&far(b)))
            .map(|holder| holder.place)
    }

    /// Whether a body holds another.
    pub(super) fn holds(&self, index: u32) -> bool {
        let known = |(holder, _): &(u32, u32)| *holder;
        self.burdens.binary_search_by_key(&index, known).is_ok()
    }

    /// A body was held by the one and is held by the other from now on.
    pub(super) fn shift_burden(&mut self, from: Option<BodyId>, to: Option<BodyId>) {
        let place = |burdens: &[(u32, u32)], id: BodyId| {
            burdens.binary_search_by_key(&id.index(), |(holder, _)| *holder)
        };
        if let Some(from) = from
            && let Ok(at) = place(&self.burdens, from)
        {
            self.burdens[at].1 -= 1;
            if self.burdens[at].1 == 0 {
                self.burdens.remove(at);
            }
        }
        if let Some(to) = to {
            match place(&self.burdens, to) {
                Ok(at) => self.burdens[at].1 += 1,
                Err(at) => self.burdens.insert(at, (to.index(), 1)),
            }
        }
    }
}
