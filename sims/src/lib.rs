//! Scenes as scripts, by name: commands before each tick, and a seed.
//!
//! Knows neither engine nor network, so a script runs in one process or remote. Invariant: name, number of bodies and
//! seed determine every bit of every command on every platform.
#![forbid(unsafe_code)]

mod asteroids;
mod ball_pit;
mod cubes;
mod free_fall;
mod ragdolls;
mod script;
mod standing;
mod tumbler;
mod zoo;

pub use asteroids::{Asteroids, Spin};
pub use ball_pit::{BallPit, Crowd};
pub use cubes::Cubes;
pub use free_fall::{FreeFall, Rain};
pub use ragdolls::Ragdolls;
pub use script::{Controller, Script};
pub use standing::{Dominoes, Rest, Stack};
pub use tumbler::Tumbler;
pub use zoo::Zoo;

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

#[cfg(test)]
mod tests {
    use rhumb_protocol::limits::{INDICES_MAX, JOINTS_MAX, SHAPES_MAX};
    use rhumb_protocol::scene::Command;
    use rhumb_reckoning::Tick;

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
