//! Recording made from the truth of a script that ran in this process.
//!
//! Gravity and damping come from the script. Inertias come from an engine that gets the script's bodies and never
//! steps. Later changes by a controller or a command are not covered: gravity is the scene's initial one.

use std::collections::BTreeMap;

use rhumb_protocol::scene::Command;
use rhumb_reckoning::{BodyId, Inertia, Tick};
use rhumb_server::Scene;
use rhumb_sims::Script;

use super::recorded::Recording;
use crate::record::Truth;

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
