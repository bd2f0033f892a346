//! A recorded scene: its bodies, its ticks, and the engine's parameters.

use std::collections::BTreeMap;

use glam::Vec3;
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::PredictionParameters;
use rhumb_reckoning::{BodyId, Damping, Inertia, Integrator};
use rhumb_trace::SceneFacts;

use crate::record::{Placed, Truth};

/// A recorded scene.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Name: a scene, or the file name without its extension.
    pub name: String,
    /// Arguments of its script; none for a foreign recording.
    pub played: Option<ScriptOrigin>,
    /// Every body and every tick.
    pub truth: Truth,
    /// Integrator of the engine.
    pub integrator: Integrator,
    /// Gravity, m/s², world frame.
    pub gravity: Vec3,
    /// Damping of every body.
    pub damping: Damping,
    /// Inertia of bodies with free rotation, as far as known and not in their placements.
    pub inertias: BTreeMap<BodyId, Inertia>,
    /// Sentences on what the file lacks, and on what was taken in its place.
    pub notes: Vec<String>,
}

/// Arguments that reproduce a script, besides its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScriptOrigin {
    /// Requested number of bodies.
    pub bodies: u32,
    /// Its seed.
    pub seed: u64,
}

impl Recording {
    /// Prediction parameters of a body.
    pub(crate) fn parameters(&self, placed: &Placed) -> PredictionParameters {
        let known = || self.inertias.get(&placed.desc.id).copied();
        let inertia = placed.inertia.or_else(known);
        PredictionParameters::of(&placed.desc, &placed.shape, self.damping, inertia)
    }

    /// Number of bodies requested from the script; for a foreign recording, its number of dynamic bodies.
    #[must_use]
    pub fn bodies(&self) -> u32 {
        if let Some(played) = self.played {
            return played.bodies;
        }
        let placed = self.truth.placed.iter();
        let dynamic = placed.filter(|placed| placed.desc.kind == BodyKind::Dynamic);
        dynamic.count() as u32
    }

    /// The settings of its engine that predictions need.
    #[must_use]
    pub const fn facts(&self) -> SceneFacts {
        SceneFacts {
            integrator: self.integrator,
            gravity: self.gravity,
            damping: self.damping,
        }
    }

    /// Ticks after the first state.
    #[must_use]
    pub fn ticks(&self) -> u32 {
        self.truth.ticks.len() as u32
    }
}
