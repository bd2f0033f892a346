//! The trait of scene scripts.
//!
//! Applies nothing: the caller sends a script's commands, steps the scene, and polls the script again.

use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_reckoning::Tick;

use crate::controller::Controller;

/// A scene as a sequence of commands.
///
/// A script assigns ids of shapes and bodies from zero upward. A scene that receives no other commands accepts all of
/// the script's.
pub trait Script: Send {
    /// Name on the command line.
    fn name(&self) -> &'static str;

    /// Config with which the scene is created.
    fn config(&self) -> SceneConfig;

    /// Appends the commands that precede the step from `tick`.
    ///
    /// Called once for each tick, from [`Tick::ZERO`] on without a gap.
    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>);

    /// The scene's controller, if it has one; equal on every call.
    fn controller(&self) -> Option<Box<dyn Controller>> {
        None
    }
}
