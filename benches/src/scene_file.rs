//! `rhumb-bench dev scene`: a script's bodies as JSON, for other engines.
//!
//! The file is the JSON scene of `rhumb-scene-files`, which reads it back. A script with more than bodies and joints is
//! refused with the reason, since another engine would run a different scene.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use rhumb_scene_files::{LoadedScene, SceneFile};

use crate::output;
use crate::task::{Failure, ended};

/// Arguments: which scene, and where to write it.
#[derive(Clone, Debug, Args)]
pub struct SceneArguments {
    /// Name of the script.
    #[arg(default_value = "ball-pit", value_parser = clap::builder::PossibleValuesParser::new(rhumb_sims::NAMES))]
    scene: String,
    /// Number of bodies.
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    bodies: u32,
    /// Number of ticks in which the script may place bodies.
    #[arg(long, default_value_t = 600)]
    ticks: u32,
    /// Seed of the script.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Output file.
    #[arg(long, default_value = "results/scene.json")]
    out: PathBuf,
}

/// Writes a scene. Exit code 0 when it was written, 1 otherwise.
pub fn scene(arguments: &SceneArguments) -> ExitCode {
    ended(write(arguments))
}

fn write(arguments: &SceneArguments) -> Result<(), Failure> {
    let file = file(arguments)?;
    let folder = arguments.out.parent().unwrap_or(&arguments.out);
    output::make_folder(folder)?;
    output::write_json(&arguments.out, &file)?;
    let line = format!(
        "{} bodies: {}\n",
        file.bodies.len(),
        arguments.out.display()
    );
    Ok(output::print_text(&line)?)
}

/// The file of a script.
fn file(arguments: &SceneArguments) -> Result<SceneFile, String> {
    let name = &arguments.scene;
    let script = rhumb_sims::by_name(name, arguments.bodies, arguments.seed);
    let mut script = script.expect("the parser accepts only known names");
    let scene = LoadedScene::of_script(&mut *script, name, u64::from(arguments.ticks));
    let scene = scene.map_err(|why| format!("{name} cannot be written as a file: {why}"))?;
    Ok(SceneFile {
        seed: arguments.seed,
        ..SceneFile::of(&scene)
    })
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::scene::Command;
    use rhumb_scene_files::{FreeIds, LoadOptions, MemoryFiles, SceneFileShape, load_text};

    use super::*;

    /// True for commands that differ by the rounding of a rotation alone.
    fn is_near(one: &Command, other: &Command) -> bool {
        let (
            Command::AddBody { desc, motion },
            Command::AddBody {
                desc: as_well,
                motion: beside,
            },
        ) = (one, other)
        else {
            return one == other;
        };
        let mut pairs = motion.parts().into_iter().zip(beside.parts());
        desc == as_well && pairs.all(|(one, other)| (one - other).abs() <= 1e-6 * (1.0 + one.abs()))
    }

    fn of(scene: &str) -> Result<SceneFile, String> {
        file(&SceneArguments {
            scene: scene.to_owned(),
            bodies: 20,
            ticks: 10,
            seed: 1,
            out: PathBuf::new(),
        })
    }

    #[test]
    fn a_ball_pit_consists_of_walls_and_balls() {
        let pit = of("ball-pit").unwrap();
        let balls = pit.bodies.iter().filter(|body| body.dynamic);
        assert!(
            balls
                .clone()
                .all(|ball| ball.shape == SceneFileShape::Ball { radius: 0.5 })
        );
        assert_eq!(balls.count(), 20);
        assert!(pit.bodies.len() > 100);
        assert_eq!((pit.friction, pit.angular_damping), (0.2, 0.05));
    }

    #[test]
    fn every_script_without_a_controller_reads_back_as_the_same_commands() {
        let mut written = 0;
        for name in rhumb_sims::NAMES {
            let file = match of(name) {
                Ok(file) => file,
                Err(why) => {
                    assert!(why.contains(name), "{why}");
                    continue;
                }
            };
            let text = serde_json::to_string(&file).unwrap();
            let options = LoadOptions::default();
            let scene = load_text(&MemoryFiles::default(), "scene.json", &text, &options).unwrap();
            assert!(scene.report.is_empty(), "{name}: {:?}", scene.report);
            let mut script = rhumb_sims::by_name(name, 20, 1).unwrap();
            let once = LoadedScene::of_script(&mut *script, name, 10).unwrap();
            let ids = FreeIds::default();
            let (again, once_more) = (scene.commands(ids).unwrap(), once.commands(ids).unwrap());
            assert_eq!(again.len(), once_more.len(), "{name}");
            for (one, other) in again.iter().zip(&once_more) {
                assert!(is_near(one, other), "{name}: {one:?} {other:?}");
            }
            assert_eq!(scene.config.gravity, once.config.gravity);
            written += 1;
        }
        assert!(written >= 5, "{written}");
    }

    #[test]
    fn a_scene_with_more_than_bodies_is_refused_with_the_reason() {
        for (scene, what) in [("asteroids", "a controller"), ("zoo", "zoo")] {
            let message = of(scene).unwrap_err();
            assert!(message.contains(what), "{message}");
        }
    }
}
