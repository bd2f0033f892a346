//! What acts on a scene beside its engine, before each step.
//!
//! For whoever embeds a server: thrusters, drivers, players of a script. A hook moves bodies and nothing else; what a
//! scene consists of is its members' matter, who hear of it by scene_events.

use core::fmt;

use rhumb_protocol::scene::{Command, CommandError, SceneConfig, SceneName};

use crate::scene::Scene;

/// Looks at a scene before each step, and says how its bodies are to be pushed, set going or put elsewhere.
///
/// A run stays a function of its commands as long as a hook is one of the scene that it sees.
pub struct Hook(Box<dyn Act>);

/// What a hook is made of.
trait Act: FnMut(&Scene, &mut Vec<Command>) + Send {}

impl<F: FnMut(&Scene, &mut Vec<Command>) + Send> Act for F {}

impl Hook {
    /// A hook that adds commands: `SetPose`, `SetVelocity`, `Force`, `Torque` and the impulses.
    pub fn new(act: impl FnMut(&Scene, &mut Vec<Command>) + Send + 'static) -> Self {
        Self(Box::new(act))
    }

    pub(crate) fn act(&mut self, scene: &Scene, out: &mut Vec<Command>) {
        (self.0)(scene, out);
    }
}

impl fmt::Debug for Hook {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Hook")
    }
}

/// Gives a scene its hook when it is created.
pub struct Hooks(Box<dyn Give>);

/// What gives hooks.
trait Give: FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send {}

impl<F: FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send> Give for F {}

impl Hooks {
    /// Asked once for each scene that is created.
    pub fn new(
        make: impl FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send + 'static,
    ) -> Self {
        Self(Box::new(make))
    }

    pub(crate) fn of(&mut self, name: &SceneName, config: &SceneConfig) -> Option<Hook> {
        (self.0)(name, config)
    }
}

impl fmt::Debug for Hooks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Hooks")
    }
}

/// Why a command of a hook was not done. Nothing of it was applied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HookError {
    /// The scene refuses it.
    Refused(CommandError),
    /// It would change what the scene consists of, or its gravity.
    NotAMotion,
}

impl fmt::Display for HookError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(error) => write!(f, "a hook's command was refused: {error}"),
            Self::NotAMotion => f.write_str("a hook's command is its members' alone to give"),
        }
    }
}

impl core::error::Error for HookError {}
