//! The look at what was seen: tracks in doubt, and bodies that may hold others
//!
//! One pass over the observations; whatever it is sure of costs nothing more. It changes no track.

use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{Gate, Integrator, Tick, Tolerance};

use super::Publisher;
use super::holding::{HOLDER_RATIO, HOLDERS_MAX, Large};
use crate::stream::observation::{Activity, Observation};

/// What a look at the observations of a tick found; places among them. It keeps its room from tick to tick.
#[derive(Clone, Debug)]
pub(super) struct Survey {
    gate: Gate,
    /// Bodies whose tracks may not hold, in order.
    pub(super) doubtful: Vec<u32>,
    /// Bodies that could hold others, the largest first.
    pub(super) holders: Vec<Large>,
    /// Doubtful bodies that hold others and are not among those, in order.
    pub(super) burdened: Vec<u32>,
    /// The largest so far, with their radii.
    largest: Vec<(f64, usize)>,
}

impl Survey {
    pub(super) fn new(tolerance: Tolerance, integrator: Integrator) -> Self {
        Self {
            gate: Gate::new(tolerance, integrator),
            doubtful: Vec::new(),
            holders: Vec::new(),
            burdened: Vec::new(),
            largest: Vec::with_capacity(HOLDERS_MAX + 1),
        }
    }

    /// Whether a body is spoken of before those that could be held.
    pub(super) fn is_before(&self, place: u32) -> bool {
        let holds = |holder: &Large| holder.place == place as usize;
        self.holders.iter().any(holds) || self.burdened.binary_search(&place).is_ok()
    }

    /// Keeps the largest bodies that move and are not held.
    fn consider(&mut self, radius: f64, place: usize) {
        let full = self.largest.len() == HOLDERS_MAX;
        if full && self.largest[HOLDERS_MAX - 1].0 >= radius {
            return;
        }
        let at = self.largest.partition_point(|(other, _)| *other >= radius);
        self.largest.insert(at, (radius, place));
        self.largest.truncate(HOLDERS_MAX);
    }
}

impl Publisher {
    /// Looks at what was seen at a tick.
    pub(super) fn survey(&mut self, tick: Tick, observations: &[Observation], survey: &mut Survey) {
        survey.doubtful.clear();
        survey.largest.clear();
        survey.holders.clear();
        let mut least = f64::INFINITY;
        self.statistics.looked += observations.len() as u64;
        for (place, observation) in observations.iter().enumerate() {
            let Some(slot) = self.seen_slot(observation) else {
                continue;
            };
            let radius = self.tracks.radius(slot).metres();
            least = least.min(radius);
            if self.features.held && slot.carrier().is_none() {
                survey.consider(radius, place);
            }
            let place = place as u32;
            if observation.activity == Activity::Asleep || !self.features.gate {
                survey.doubtful.push(place);
                continue;
            }
            let Survey { gate, doubtful, .. } = survey;
            let seen = (place, &observation.motion);
            self.tracks.look(slot, tick, seen, gate, doubtful);
        }
        survey.gate.finish(&mut survey.doubtful);
        // Answers about moving bodies come four at a time.
        survey.doubtful.sort_unstable();
        let large = |(radius, _): &&(f64, usize)| *radius >= least * HOLDER_RATIO;
        let largest = survey.largest.iter().take_while(large);
        survey.holders.extend(largest.map(|(radius, place)| Large {
            place: *place,
            position: Vec3::from_array(observations[*place].motion.position()),
            radius: *radius,
        }));
    }

    /// Notes who of the doubtful holds others, and is not among those who could.
    pub(super) fn survey_burdened(&self, observations: &[Observation], survey: &mut Survey) {
        let (holders, doubtful) = (&survey.holders, &survey.doubtful);
        let burdened = |place: &u32| {
            let place = *place as usize;
            let holds = |holder: &Large| holder.place == place;
            self.holds(observations[place].id.index()) && !holders.iter().any(holds)
        };
        survey.burdened.clear();
        survey
            .burdened
            .extend(doubtful.iter().copied().filter(burdened));
    }
}
