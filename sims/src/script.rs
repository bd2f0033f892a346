//! The trait of scene scripts, and the scripts by name.
//!
//! Applies nothing: the caller sends a script's commands, steps the scene, and polls the script again.

use core::num::NonZeroU32;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{Command, Material, PublishSchedule, SceneConfig, Stepping};
use rhumb_reckoning::{BodyState, Damping, Integrator, Rate, Tick};

use crate::controller::Controller;
use crate::{
    Asteroids, BallPit, Cubes, Dominoes, FreeFall, Ragdolls, Rain, Rest, Spin, Stack, Tumbler, Zoo,
};

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

/// The scripts that [`by_name`] knows.
pub const NAMES: [&str; 12] = [
    "ball-pit",
    "asteroids",
    "asteroids-plain",
    "rest-10k",
    "cubes",
    "ragdolls",
    "stack",
    "dominoes",
    "tumbler",
    "rain",
    "free-fall",
    "zoo",
];

/// Default numbers of bodies of a script; the ball pit has several.
#[must_use]
pub fn default_bodies(name: &str) -> Option<&'static [u32]> {
    Some(match name {
        "ball-pit" => &[BallPit::BALLS_PER_CYCLE, 1_000, 2_000],
        "asteroids" | "asteroids-plain" => &[Asteroids::ROCKS],
        "rest-10k" => &[Rest::BOXES],
        "cubes" => &[Cubes::BODIES],
        "ragdolls" => &[Ragdolls::BODIES],
        "stack" => &[Stack::BODIES],
        "dominoes" => &[Dominoes::STONES],
        "tumbler" => &[Tumbler::BODIES],
        "rain" => &[Rain::PROJECTILES],
        "free-fall" => &[200],
        "zoo" => &[50],
        _ => return None,
    })
}

/// A script with about `bodies` moving bodies; see each script's constructor for how it uses the number.
#[must_use]
pub fn by_name(name: &str, bodies: u32, seed: u64) -> Option<Box<dyn Script>> {
    Some(match name {
        "ball-pit" => Box::new(BallPit::sized(bodies, seed)),
        "asteroids" => Box::new(Asteroids::new(bodies, seed, Spin::Gyroscopic)),
        "asteroids-plain" => Box::new(Asteroids::new(bodies, seed, Spin::Plain)),
        "rest-10k" => Box::new(Rest::new(bodies, seed)),
        "cubes" => Box::new(Cubes::new(bodies, seed)),
        "ragdolls" => Box::new(Ragdolls::new(bodies, seed)),
        "stack" => Box::new(Stack::new(bodies, seed)),
        "dominoes" => Box::new(Dominoes::new(bodies, seed)),
        "tumbler" => Box::new(Tumbler::new(bodies, seed)),
        "rain" => Box::new(Rain::new(bodies, seed)),
        "free-fall" => Box::new(FreeFall::new(bodies, seed)),
        "zoo" => Box::new(Zoo::new(bodies, seed)),
        _ => return None,
    })
}

/// Integrator of all scenes: 60 Hz, four substeps.
pub(crate) const INTEGRATOR: Integrator = Integrator {
    rate: Rate::HZ_60,
    substeps: NonZeroU32::new(4).expect("four is not zero"),
};

/// Earth's gravity, along y, m/s².
pub(crate) const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);

/// Default config of a scene: Earth's gravity, no damping.
pub(crate) const DEFAULT_CONFIG: SceneConfig = SceneConfig {
    integrator: INTEGRATOR,
    gravity: GRAVITY,
    stepping: Stepping::Lockstep,
    material: surface(0.5, 1_000.0),
    damping: Damping {
        linear: 0.0,
        angular: 0.0,
    },
    sleep: None,
    publish_schedule: PublishSchedule::EACH_TICK,
};

/// A material without bounce; density in kg/m³.
pub(crate) const fn surface(friction: f32, density: f32) -> Material {
    Material {
        friction,
        restitution: 0.0,
        density,
    }
}

/// A body state; the script guarantees finite parts and a unit quaternion.
pub(crate) fn motion(position: Vec3, rotation: Quat, linear: Vec3, angular: Vec3) -> BodyState {
    BodyState::new(
        position.to_array(),
        rotation.to_array(),
        linear.to_array(),
        angular.to_array(),
    )
    .expect("scripts place bodies at finite poses")
}

/// A state at rest.
pub(crate) fn still(position: Vec3) -> BodyState {
    motion(position, Quat::IDENTITY, Vec3::ZERO, Vec3::ZERO)
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::limits::{INDICES_MAX, JOINTS_MAX, SHAPES_MAX};

    use super::*;

    #[test]
    fn every_script_starts_within_the_limits_for_any_number_of_bodies() {
        for name in NAMES {
            let usual = default_bodies(name).expect("a name of the list")[0];
            for bodies in [0, 1, usual, 100_000] {
                let mut script = by_name(name, bodies, 1).expect("a name of the list");
                assert_eq!(script.name(), name);
                assert_eq!(script.config().check(), Ok(()));
                let mut commands = Vec::new();
                script.commands(Tick::ZERO, &mut commands);
                for command in &commands {
                    assert_eq!(command.check(), Ok(()), "{name} of {bodies}: {command:?}");
                    let named = match *command {
                        Command::AddShape { id, .. } => id.0 < SHAPES_MAX,
                        Command::AddBody { desc, .. } => desc.id.index() < INDICES_MAX,
                        Command::AddJoint { id, .. } => id.0 < JOINTS_MAX,
                        _ => true,
                    };
                    assert!(named, "{name} of {bodies}: {command:?}");
                }
            }
        }
        assert!(by_name("nothing", 1, 1).is_none() && default_bodies("nothing").is_none());
    }
}
