//! A recorded scene: its bodies, its ticks, and the engine's parameters.
//!
//! It is read from a file, or made from the truth of a script that ran in this process. Then gravity and damping come
//! from the script, and inertias from an engine that gets the script's bodies and never steps. Later changes by a
//! controller or a command are not covered: gravity is the scene's initial one.

use std::collections::BTreeMap;

use glam::Vec3;
use rhumb_protocol::scene::{BodyKind, Command};
use rhumb_protocol::stream::{Activity, PredictionParameters};
use rhumb_reckoning::{Anchor, BodyId, Damping, Inertia, Integrator, Predictor, Tick, Track};
use rhumb_scene::Scene;
use rhumb_sims::Script;
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
    /// The source of the velocities.
    pub velocities: Velocities,
    /// Sentences on what the file lacks, and on what was taken in its place.
    pub notes: Vec<String>,
}

/// The source of a recording's velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Velocities {
    /// The file, or the engine that ran.
    Recorded,
    /// The poses, to which they are fitted.
    Fitted,
}

/// Most frames of a recording: two days at 60 Hz. An empty frame takes two bytes and compresses to almost nothing.
pub(super) const FRAMES_MAX: u32 = 10_368_000;

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

impl Recording {
    /// Builds the recording; `script` must not have produced any tick yet.
    #[must_use]
    pub fn of_play(script: &mut dyn Script, truth: Truth) -> Self {
        let config = script.config();
        Self {
            name: script.name().to_owned(),
            played: None,
            inertias: inertias(script, truth.ticks.len() as u64),
            truth,
            integrator: config.integrator,
            gravity: config.gravity,
            damping: config.damping,
            velocities: Velocities::Recorded,
            notes: Vec::new(),
        }
    }
}

/// Inertia of each body with free rotation that a script adds within `ticks`.
fn inertias(script: &mut dyn Script, ticks: u64) -> BTreeMap<BodyId, Inertia> {
    let mut inertias = BTreeMap::new();
    let Ok(mut scene) = Scene::new(script.config()) else {
        return inertias;
    };
    let mut commands = Vec::new();
    for tick in 0..=ticks {
        script.commands(Tick::new(tick), &mut commands);
    }
    for command in commands {
        let creates = matches!(command, Command::AddShape { .. } | Command::AddBody { .. });
        // A command refused here has no body in the recording either.
        if creates
            && scene.apply(&command).is_ok()
            && let Command::AddBody { desc, .. } = command
            && let Some(inertia) = scene.inertia(desc.id)
        {
            inertias.insert(desc.id, inertia);
        }
    }
    inertias
}

/// The first track of a body, as a server's scene chooses it.
pub(crate) fn first_track(placed: &Placed, parameters: &PredictionParameters) -> Track {
    let is_torque_free = parameters.inertia.is_some();
    let predictor = match (placed.observation.activity, placed.desc.kind) {
        (Activity::Asleep, _) | (_, BodyKind::Fixed) => Predictor::Rest,
        (Activity::Awake, BodyKind::Dynamic) if is_torque_free => Predictor::BallisticTorqueFree,
        (Activity::Awake, BodyKind::Dynamic) => Predictor::Ballistic,
        (Activity::Awake, BodyKind::Kinematic) => Predictor::Uniform,
    };
    let motion = placed.observation.motion;
    let resting = predictor == Predictor::Rest;
    Track {
        origin: placed.tick,
        predictor,
        anchor: Anchor::Exact(if resting { motion.stilled() } else { motion }),
        parent: None,
    }
}
