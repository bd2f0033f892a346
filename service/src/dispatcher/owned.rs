//! The scenes that the directory has given this server, with their files.
//!
//! Asks the directory nothing. Invariant: a scene that was given up is this server's again only by a later word of the
//! directory's thread than that it knows of it.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::scene::SceneName;

use crate::durable::Generation;

/// The scenes of one server.
#[derive(Debug, Default)]
pub(super) struct OwnedScenes {
    generations: BTreeMap<SceneName, Generation>,
    /// Scenes that were given up; the directory's thread has not taken that yet, and what it says of them is older.
    releasing: BTreeSet<SceneName>,
}

impl OwnedScenes {
    /// Takes that the directory gives a scene; false if that was said before the scene was given up.
    pub(super) fn give(&mut self, scene: &SceneName, generation: Generation) -> bool {
        let is_new = !self.releasing.contains(scene);
        if is_new {
            self.generations.insert(scene.clone(), generation);
        }
        is_new
    }

    /// Gives a scene up; false if it is not this server's.
    pub(super) fn release(&mut self, scene: &SceneName) -> bool {
        let is_owned = self.generations.remove(scene).is_some();
        if is_owned {
            self.releasing.insert(scene.clone());
        }
        is_owned
    }

    /// Takes that the directory's thread knows that a scene was given up.
    pub(super) fn note_released(&mut self, scene: &SceneName) {
        self.releasing.remove(scene);
    }

    /// Forgets all scenes, which have ended with their lease.
    pub(super) fn lose(&mut self) {
        self.generations.clear();
    }

    /// The number of a scene's files; `None` for a scene that is not this server's.
    pub(super) fn generation(&self, scene: &SceneName) -> Option<Generation> {
        self.generations.get(scene).copied()
    }
}
