//! Scripts by name, or from a file; and as a file: `rhumb-bench dev scene`.
//!
//! A name that a script has is never taken for a file. The number of bodies and the seed mean nothing to a file.
//!
//! The written file is the JSON scene of `rhumb-scene-files`, which reads it back. A script with more than bodies and joints
//! is refused with the reason, since another engine would run a different scene.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use rhumb_protocol::scene::BodyKind;
use rhumb_scene_files::{FileScript, Folder, LoadOptions, LoadedScene, SceneFile, UpAxis, load};
use rhumb_sims::{NAMES, Script};

use crate::output::{self, Failure, ended};

/// Checks the name of a script or a file.
///
/// # Errors
///
/// The reason why it is neither.
pub fn parse(text: &str) -> Result<String, String> {
    if !NAMES.contains(&text) {
        let scene = read(text)?;
        FileScript::new(&scene).map_err(|error| error.to_string())?;
    }
    Ok(text.to_owned())
}

/// A script by its name or file; `None` if there is neither.
#[must_use]
pub fn by_name(name: &str, bodies: u32, seed: u64) -> Option<Box<dyn Script>> {
    if NAMES.contains(&name) {
        return rhumb_sims::by_name(name, bodies, seed);
    }
    let script = FileScript::new(&read(name).ok()?).ok()?;
    Some(Box::new(script))
}

/// Default numbers of bodies: those of the script, or the bodies of the file that the engine moves.
#[must_use]
pub fn default_bodies(name: &str) -> Vec<u32> {
    if let Some(bodies) = rhumb_sims::default_bodies(name) {
        return bodies.to_vec();
    }
    let moving = |scene: &LoadedScene| {
        let bodies = scene.bodies.iter();
        bodies
            .filter(|body| body.builder.kind() == BodyKind::Dynamic)
            .count() as u32
    };
    read(name).iter().map(moving).collect()
}

/// Reads a file, with y up as all scripts have it.
fn read(path: &str) -> Result<LoadedScene, String> {
    let options = LoadOptions {
        up: UpAxis::Y,
        ..LoadOptions::default()
    };
    load(&Folder::default(), path, &options).map_err(|error| {
        let names = NAMES.join(", ");
        format!("{error}; give a file or one of {names}")
    })
}

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
    use rhumb_reckoning::Tick;
    use rhumb_scene_files::{FreeIds, LoadOptions, MemoryFiles, SceneFileShape, load_text};

    use super::*;

    #[test]
    fn a_file_is_a_script_and_a_missing_one_is_named() {
        let file = format!("rhumb-script-{}.urdf", std::process::id());
        let path = std::env::temp_dir().join(file);
        let ball = "<robot name='b'><link name='l'><inertial><mass value='1'/><inertia ixx='1' iyy='1' izz='1'/></inertial></link></robot>";
        std::fs::write(&path, ball).expect("it is written");
        let path = path.to_str().expect("plain letters");
        assert_eq!(parse(path).as_deref(), Ok(path));
        assert_eq!(default_bodies(path), [1]);
        let mut commands = Vec::new();
        let mut script = by_name(path, 0, 0).expect("it is there");
        script.commands(Tick::ZERO, &mut commands);
        assert_eq!(commands.len(), 2);
        assert!(script.config().gravity.y < -9.0);
        std::fs::remove_file(path).expect("it was written");
        let missing = parse("no-such-scene").expect_err("there is none");
        assert!(
            missing.contains("no-such-scene") && missing.contains("ball-pit"),
            "{missing}"
        );
    }

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
        for name in NAMES {
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
