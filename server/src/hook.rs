//! Hooks: application code that acts on a scene before each step.
//!
//! For programs that embed a server: thrusters, drivers, scripts. A hook moves bodies and nothing else; only members
//! change the bodies of a scene, and learn of it by scene events.

use core::fmt;

use rhumb_protocol::scene::{Command, CommandError, SceneConfig, SceneName};

use crate::scene::Scene;

/// Reads a scene before each step and commands its bodies: forces, velocities, poses.
///
/// A run stays a function of its commands as long as the hook is a function of the scene.
pub struct Hook(Box<dyn Act>);

/// The function type of a hook.
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

/// The function type of [`Hooks`].
trait Give: FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send {}

impl<F: FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send> Give for F {}

impl Hooks {
    /// `make` is called once for each new scene.
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

/// Reason why a hook's command was refused; it had no effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HookError {
    /// The scene refuses the command.
    Refused(CommandError),
    /// The command would change the bodies of the scene, or its gravity.
    NotAMotion,
}

impl fmt::Display for HookError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(error) => write!(f, "a hook's command was refused: {error}"),
            Self::NotAMotion => f.write_str("a hook's command is reserved for members"),
        }
    }
}

impl core::error::Error for HookError {}
