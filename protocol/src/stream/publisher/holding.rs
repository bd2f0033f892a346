//! Which bodies could hold others, and what each holds.

use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::BodyId;

use super::Publisher;
use crate::stream::observation::Observation;

/// Bodies that others may be held by, at one tick: the largest that move.
const HOLDERS_MAX: usize = 16;
/// A holder is larger than what it holds by this factor at least.
const HOLDER_RATIO: f64 = 1.2;
/// A body is held within this many radii of its holder.
const HOLDER_REACH: f64 = 3.0;

impl Publisher {
    /// Places among the observations of the largest bodies that move and are not held.
    pub(super) fn holders(&self, observations: &[Observation]) -> Vec<usize> {
        let mut largest: Vec<(f64, usize)> = Vec::with_capacity(HOLDERS_MAX + 1);
        let mut least = f64::INFINITY;
        for (place, observation) in observations.iter().enumerate() {
            let Some(slot) = self.seen_slot(observation) else {
                continue;
            };
            let radius = slot.radius.metres();
            least = least.min(radius);
            let full = largest.len() == HOLDERS_MAX;
            if slot.track.carrier.is_some() || full && largest[HOLDERS_MAX - 1].0 >= radius {
                continue;
            }
            let at = largest.partition_point(|(other, _)| *other >= radius);
            largest.insert(at, (radius, place));
            largest.truncate(HOLDERS_MAX);
        }
        largest.retain(|(radius, _)| *radius >= least * HOLDER_RATIO);
        largest.into_iter().map(|(_, place)| place).collect()
    }

    /// The place of the body that could hold another: the one that does, or the nearest within reach.
    pub(super) fn holder_of(
        &self,
        observation: &Observation,
        holders: &[usize],
        observations: &[Observation],
    ) -> Option<usize> {
        let slot = self.tracks.slot(observation.id.index())?;
        let position = |place: &usize| Vec3::from_array(observations[*place].motion.position());
        let here = Vec3::from_array(observation.motion.position());
        if let Some(carrier) = slot.track.carrier {
            return holders
                .iter()
                .copied()
                .find(|place| observations[*place].id == carrier);
        }
        let radius_of = |place: &usize| {
            let index = observations[*place].id.index();
            self.tracks
                .slot(index)
                .map_or(0.0, |slot| slot.radius.metres())
        };
        holders
            .iter()
            .copied()
            .filter(|place| {
                let radius = radius_of(place);
                let far = f64::from(position(place).distance(here));
                radius >= slot.radius.metres() * HOLDER_RATIO && far <= radius * HOLDER_REACH
            })
            .min_by(|a, b| {
                let far = |place: &usize| position(place).distance_squared(here);
                far(a).total_cmp(&far(b))
            })
    }

    /// A body was held by the one and is held by the other from now on.
    pub(super) fn shift_burden(&mut self, from: Option<BodyId>, to: Option<BodyId>) {
        if let Some(from) = from {
            let burden = &mut self.burdens[from.index() as usize];
            *burden = burden.saturating_sub(1);
        }
        if let Some(to) = to {
            let place = to.index() as usize;
            if place >= self.burdens.len() {
                self.burdens.resize(place + 1, 0);
            }
            self.burdens[place] += 1;
        }
    }
}
