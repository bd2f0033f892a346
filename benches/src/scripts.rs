//! Scripts by name, or from a file: a robot or a scene.
//!
//! A name that a script has is never taken for a file. The number of bodies and the seed mean nothing to a file.

use rhumb_protocol::scene::BodyKind;
use rhumb_scene_files::{FileScript, Folder, LoadOptions, LoadedScene, UpAxis, load};
use rhumb_sims::{NAMES, Script};

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

#[cfg(test)]
mod tests {
    use rhumb_reckoning::Tick;

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
}
