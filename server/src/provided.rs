//! Scenes that a server provides: they begin when a client names them.
//!
//! A script commands such a scene before each step, as a member would: it may add and remove bodies, and the members
//! learn of it by scene events. A provided scene without members ends as any other, and begins anew for the next client.

use core::fmt;
use std::sync::Arc;

use rhumb_protocol::scene::{Command, SceneConfig, SceneName};

use crate::scene::Scene;

/// Commands a scene before each step, and once before its first member joins.
pub struct SceneScript(Box<dyn Commanding>);

/// The function type of a script.
trait Commanding: FnMut(&Scene, &mut Vec<Command>) + Send {}

impl<F: FnMut(&Scene, &mut Vec<Command>) + Send> Commanding for F {}

impl SceneScript {
    /// A script that adds commands of any kind. It assigns the ids of its bodies, and of its shapes and joints, from zero
    /// upward, and the first time it runs it adds the body with the greatest index that it will ever use.
    pub fn new(act: impl FnMut(&Scene, &mut Vec<Command>) + Send + 'static) -> Self {
        Self(Box::new(act))
    }

    /// The commands before the next step.
    pub fn commands(&mut self, scene: &Scene) -> Vec<Command> {
        let mut commands = Vec::new();
        (self.0)(scene, &mut commands);
        commands
    }
}

impl fmt::Debug for SceneScript {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SceneScript")
    }
}

/// A scene to begin.
#[derive(Debug)]
pub struct ProvidedScene {
    /// Its config.
    pub config: SceneConfig,
    /// Its script.
    pub script: SceneScript,
}

/// Provides scenes by their names; all clones are one.
#[derive(Clone)]
pub struct ProvidedScenes(Arc<dyn Provide>);

/// The function type of [`ProvidedScenes`].
trait Provide: Fn(&SceneName) -> Option<ProvidedScene> + Send + Sync {}

impl<F: Fn(&SceneName) -> Option<ProvidedScene> + Send + Sync> Provide for F {}

impl ProvidedScenes {
    /// `provide` is called whenever a client names a scene that does not exist.
    pub fn new(
        provide: impl Fn(&SceneName) -> Option<ProvidedScene> + Send + Sync + 'static,
    ) -> Self {
        Self(Arc::new(provide))
    }

    pub(crate) fn of(&self, name: &SceneName) -> Option<ProvidedScene> {
        (self.0)(name)
    }
}

impl fmt::Debug for ProvidedScenes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ProvidedScenes")
    }
}
