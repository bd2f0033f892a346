//! What a scene's script is, and which there are by name.
//!
//! Applies nothing: whoever runs a script sends its commands, steps, and asks again.

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
/// It names shapes and bodies by numbers of its own from zero upward; all of its commands are meant to be accepted by a
/// scene that nobody else changes.
pub trait Script: Send {
    /// As on a command line.
    fn name(&self) -> &'static str;

    /// What the scene is created with.
    fn config(&self) -> SceneConfig;

    /// Adds the commands that come before the step which leaves `tick`.
    ///
    /// Called once for each tick, from [`Tick::ZERO`] on without a gap.
    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>);

    /// What acts beside the engine, if anything does; the same each time it is asked for.
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

/// How many bodies a script of this name has unless somebody says otherwise; the ball pit has several such numbers.
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

/// A script with about so many moving bodies; what a script makes of the number is said where it is made.
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

/// Sixty ticks a second in four substeps, as all scenes here step.
pub(crate) const INTEGRATOR: Integrator = Integrator {
    rate: Rate::HZ_60,
    substeps: NonZeroU32::new(4).expect("four is not zero"),
};

/// The Earth's, along y, m/s².
pub(crate) const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);

/// What a scene has unless its script says otherwise: the Earth's gravity, and bodies that nothing damps.
pub(crate) const TERMS: SceneConfig = SceneConfig {
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

/// A material from which nothing bounces, kg/m³.
pub(crate) const fn surface(friction: f32, density: f32) -> Material {
    Material {
        friction,
        restitution: 0.0,
        density,
    }
}

/// A motion whose parts the script knows to be finite and of unit length.
pub(crate) fn motion(position: Vec3, rotation: Quat, linear: Vec3, angular: Vec3) -> BodyState {
    BodyState::new(
        position.to_array(),
        rotation.to_array(),
        linear.to_array(),
        angular.to_array(),
    )
    .expect("scripts place bodies at finite poses")
}

/// A place without movement.
pub(crate) fn still(position: Vec3) -> BodyState {
    motion(position, Quat::IDENTITY, Vec3::ZERO, Vec3::ZERO)
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::limits::{INDICES_MAX, JOINTS_MAX, SHAPES_MAX};

    use super::*;

    #[test]
    fn every_script_begins_within_the_limits_however_many_bodies_are_asked_for() {
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
