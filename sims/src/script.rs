//! What a scene's script is, and which there are by name.
//!
//! Applies nothing: whoever runs a script sends its commands, steps, and asks again.

use core::num::NonZeroU32;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{Command, SceneTerms};
use rhumb_reckoning::{Integrator, Rate, Tick, Verbatim};

use crate::{BallPit, FreeFall, Zoo};

/// A scene as a sequence of commands.
///
/// It names shapes and bodies by numbers of its own from zero upward; all of its commands are meant to be accepted by a
/// scene that nobody else changes.
pub trait Script: Send {
    /// As on a command line.
    fn name(&self) -> &'static str;

    /// What the scene is created with.
    fn terms(&self) -> SceneTerms;

    /// Adds the commands that come before the step which leaves `tick`.
    ///
    /// Called once for each tick, from [`Tick::ZERO`] on without a gap.
    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>);
}

/// The scripts that [`by_name`] knows.
pub const NAMES: [&str; 3] = ["ball-pit", "free-fall", "zoo"];

/// A script with about so many moving bodies; what a ball pit makes of the number is said at [`BallPit::sized`].
#[must_use]
pub fn by_name(name: &str, bodies: u32, seed: u64) -> Option<Box<dyn Script>> {
    match name {
        "ball-pit" => Some(Box::new(BallPit::sized(bodies, seed))),
        "free-fall" => Some(Box::new(FreeFall::new(bodies, seed))),
        "zoo" => Some(Box::new(Zoo::new(bodies, seed))),
        _ => None,
    }
}

/// Sixty ticks a second in four substeps, as all scenes here step.
pub(crate) const INTEGRATOR: Integrator = Integrator {
    rate: Rate::HZ_60,
    substeps: NonZeroU32::new(4).expect("four is not zero"),
};

/// The Earth's, along y, m/s².
pub(crate) const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);

/// A motion whose parts the script knows to be finite and of unit length.
pub(crate) fn motion(position: Vec3, rotation: Quat, linear: Vec3, angular: Vec3) -> Verbatim {
    Verbatim::new(
        position.to_array(),
        rotation.to_array(),
        linear.to_array(),
        angular.to_array(),
    )
    .expect("scripts place bodies at finite poses")
}

/// A place without movement.
pub(crate) fn still(position: Vec3) -> Verbatim {
    motion(position, Quat::IDENTITY, Vec3::ZERO, Vec3::ZERO)
}
