//! A scene of the demo that is read from a file: a robot or a scene.

use core::fmt;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyDesc, BodyKind, SceneName, Shape, Stepping};
use rhumb_scene::ProvidedScene;
use rhumb_scene_files::{
    FileScript, Folder, LoadError, LoadOptions, LoadedBody, LoadedScene, UpAxis, load,
};
use rhumb_sims::Script;

use super::reset_script::{ResetAfter, reset_script};

/// A scene of the demo that is read from a file.
#[derive(Clone, Debug)]
pub(crate) struct FileScene {
    pub(super) name: SceneName,
    scene: LoadedScene,
    script: FileScript,
}

/// Seconds after which the bodies of a file are back where they began.
const RESET_SECONDS: u32 = 20;
/// Seconds for which they lie still before.
const STILL_SECONDS: u32 = 4;

impl FileScene {
    /// Reads a file. What would fall for ever gets a floor.
    pub(crate) fn read(path: &str) -> Result<Self, LoadError> {
        let options = LoadOptions {
            up: UpAxis::Y,
            ..LoadOptions::default()
        };
        let mut scene = load(&Folder::default(), path, &options)?;
        let is_fixed = |body: &LoadedBody| body.builder.kind() == BodyKind::Fixed;
        if !scene.bodies.iter().any(is_fixed) && scene.config.gravity != Vec3::ZERO {
            let floor = floor(&scene.bodies);
            scene.bodies.push(floor);
        }
        let script = FileScript::new(&scene)?;
        Ok(Self {
            name: name(path),
            scene,
            script,
        })
    }

    pub(super) fn provided(&self) -> ProvidedScene {
        let script = self.script.clone();
        let mut config = script.config();
        config.stepping = Stepping::FreeRunning;
        let after = ResetAfter {
            seconds: RESET_SECONDS,
            still_seconds: Some(STILL_SECONDS),
        };
        ProvidedScene {
            config,
            script: reset_script(Box::new(script), after),
        }
    }
}

/// The parts of the file that the scene has not, a line for each.
impl fmt::Display for FileScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let notes = self.scene.report.notes();
        notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

/// A name for the scene of a file, which no scene of the demo has.
fn name(path: &str) -> SceneName {
    let file = path.rsplit(['/', '\\']).next().unwrap_or(path);
    let plain = |sign: char| match sign.is_ascii_alphanumeric() || ".-_".contains(sign) {
        true => sign,
        false => '-',
    };
    let name: String = file.chars().take(50).map(plain).collect();
    let name = format!("file/{name}").parse();
    name.expect("letters, digits and few signs, less than 64 of them")
}

/// A floor under the lowest body.
fn floor(bodies: &[LoadedBody]) -> LoadedBody {
    let lowest = |body: &LoadedBody| {
        let height = body.builder.state().map_or(0.0, |state| state.parts()[1]);
        height - body.builder.shape().bounding_radius().metres() as f32
    };
    let lowest = bodies.iter().map(lowest).fold(f32::MAX, f32::min);
    let slab = Shape::cuboid(20.0, 0.5, 20.0);
    LoadedBody {
        name: "floor".to_owned(),
        builder: BodyDesc::fixed(slab).at(0.0, lowest - 0.5, 0.0),
        tick: 0,
        frame_position: Vec3::ZERO,
        frame_rotation: Quat::IDENTITY,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_a_file_is_one_of_a_scene() {
        assert_eq!(name("robots/a b.urdf").as_str(), "file/a-b.urdf");
        assert_eq!(name("").as_str(), "file/");
        assert!(name(&"ä".repeat(90)).as_str().len() < 64);
    }

    #[test]
    fn what_would_fall_for_ever_gets_a_floor() {
        let folder = std::env::temp_dir().join(format!("rhumb-demo-file-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("ball.json");
        let ball = |kind: &str| {
            format!(
                "{{\"bodies\": [{{\"dynamic\": {kind}, \"shape\": {{\"ball\": {{\"radius\": 0.5}}}}, \"position\": [0, 3, 0], \"mood\": 1}}]}}"
            )
        };
        for (dynamic, bodies) in [("true", 2), ("false", 1)] {
            std::fs::write(&path, ball(dynamic)).unwrap();
            let scene = FileScene::read(path.to_str().unwrap()).unwrap();
            assert_eq!(scene.scene.bodies.len(), bodies);
            assert_eq!(scene.name.as_str(), "file/ball.json");
            assert!(scene.to_string().contains("mood of body 0"), "{scene}");
            assert_eq!(scene.provided().config.stepping, Stepping::FreeRunning);
        }
        std::fs::remove_dir_all(folder).unwrap();
    }
}
