//! Hooks: application code that acts on a scene before each step.
//!
//! For programs that embed a server: thrusters, drivers, scripts. A hook moves bodies and nothing else; only members
//! change the bodies of a scene, and learn of it by scene events.

use core::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use rhumb_protocol::scene::{Command, CommandError, SceneConfig, SceneName};

use crate::scene::Scene;

/// Reads a scene before each step and commands its bodies: forces, velocities, poses.
///
/// A run stays a function of its commands as long as the hook is a function of the scene.
pub struct Hook {
    act: Box<dyn Act>,
    /// The commands of one step, kept for their memory.
    commands: Vec<Command>,
}

/// The function type of a hook.
trait Act: FnMut(&Scene, &mut Vec<Command>) + Send {}

impl<F: FnMut(&Scene, &mut Vec<Command>) + Send> Act for F {}

impl Hook {
    /// A hook that adds commands that move bodies: `SetPose`, `SetVelocity`, `Force`, `Torque`, the impulses, `Sleep`,
    /// `Wake`, `Jump` and `SetWheels`.
    pub fn new(act: impl FnMut(&Scene, &mut Vec<Command>) + Send + 'static) -> Self {
        Self {
            act: Box::new(act),
            commands: Vec::new(),
        }
    }

    /// Acts on a scene before its next step; returns why commands were not done.
    ///
    /// A scene whose engine failed is left alone.
    pub fn act(&mut self, scene: &mut Scene) -> Vec<HookError> {
        let mut refused = Vec::new();
        if scene.is_sound() {
            (self.act)(scene, &mut self.commands);
            for command in self.commands.drain(..) {
                refused.extend(apply(scene, &command).err());
            }
        }
        refused
    }
}

/// Applies a command that moves a body.
fn apply(scene: &mut Scene, command: &Command) -> Result<(), HookError> {
    match command {
        Command::SetPose { .. }
        | Command::SetVelocity { .. }
        | Command::Force { .. }
        | Command::Torque { .. }
        | Command::Impulse { .. }
        | Command::TorqueImpulse { .. }
        | Command::ForceAt { .. }
        | Command::ImpulseAt { .. }
        | Command::Sleep { .. }
        | Command::Wake { .. }
        | Command::Jump { .. }
        | Command::SetWheels { .. } => scene.apply(command).map_err(HookError::Refused),
        Command::AddShape { .. }
        | Command::RemoveShape { .. }
        | Command::AddBody { .. }
        | Command::RemoveBody { .. }
        | Command::SetGravity { .. }
        | Command::ChangeBody { .. }
        | Command::AddJoint { .. }
        | Command::ChangeJoint { .. }
        | Command::RemoveJoint { .. }
        | Command::SetEvents { .. }
        | Command::SetLocomotion { .. } => Err(HookError::NotAMotion),
    }
}

impl fmt::Debug for Hook {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Hook")
    }
}

/// Gives a scene its hook when it is created; all clones are one.
#[derive(Clone)]
pub struct Hooks(Arc<Mutex<dyn Give>>);

/// The function type of [`Hooks`].
trait Give: FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send {}

impl<F: FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send> Give for F {}

impl Hooks {
    /// `make` is called once for each new scene.
    pub fn new(
        make: impl FnMut(&SceneName, &SceneConfig) -> Option<Hook> + Send + 'static,
    ) -> Self {
        Self(Arc::new(Mutex::new(make)))
    }

    pub(crate) fn of(&self, name: &SceneName, config: &SceneConfig) -> Option<Hook> {
        // A call that panicked before has ended its own scene only.
        let mut make = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        make(name, config)
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
