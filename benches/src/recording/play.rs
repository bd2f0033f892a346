//! The truth of a script that was run here.
//!
//! What pulled and damped comes from the script, and how each body is_torque_free from an engine that is given the script's bodies
//! and never stepped. What a controller or a command changed later is not in it: gravity is taken as the scene began.

use std::collections::BTreeMap;

use rhumb_protocol::scene::Command;
use rhumb_reckoning::{BodyId, Inertia, Tick};
use rhumb_server::Scene;
use rhumb_sims::Script;

use super::Recording;
use crate::record::Truth;

impl Recording {
    /// What a script, of which no tick was taken yet, came to.
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
        }
    }
}

/// How the bodies tumble that a script adds in so many ticks.
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
        let makes = matches!(command, Command::AddShape { .. } | Command::AddBody { .. });
        // What is refused here is no body of the recording either.
        if makes
            && scene.apply(&command).is_ok()
            && let Command::AddBody { desc, .. } = command
            && let Some(inertia) = scene.inertia(desc.id)
        {
            inertias.insert(desc.id, inertia);
        }
    }
    inertias
}
