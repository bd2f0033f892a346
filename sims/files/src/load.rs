//! The way in: a file, by its content's format, as a scene or as a script.
//!
//! An XML file is known by its first element, JSON by its first bracket, and glTF by what it begins with or its
//! `asset`. A script has no controller, and a joint comes with the later of its bodies. A script that only adds is such
//! a scene too.

use std::collections::BTreeMap;
use std::error::Error;
use std::fmt;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyBuilder, BodyDesc, Command, SceneConfig, Shape};
use rhumb_reckoning::{BodyState, Tick};
use rhumb_sims::Script;

use crate::assemble::{FreeIds, LoadedBody, LoadedJoint, LoadedScene, assemble};
use crate::files::{Files, join};
use crate::mesh::{MESH_BYTES_MAX, ending};
use crate::model::LoadOptions;
use crate::report::{LoadError, Place, Problem, Report};
use crate::xml::{self, XML_BYTES_MAX};
use crate::{gltf, json, mjcf, urdf};

/// Reads a file as a scene.
///
/// # Errors
///
/// [`LoadError`] names the file, the line and the reason.
pub fn load(
    files: &dyn Files,
    path: &str,
    options: &LoadOptions,
) -> Result<LoadedScene, LoadError> {
    let path = join("", path);
    // Meshes are in the same file, or between its lines.
    let most = match ending(&path).as_str() {
        "glb" | "gltf" => MESH_BYTES_MAX,
        _ => XML_BYTES_MAX,
    };
    let bytes = files.read(&path, most).map_err(|error| LoadError {
        place: Place::of(&path),
        problem: Problem::File(error),
    })?;
    if bytes.starts_with(gltf::MAGIC) {
        let mut report = Report::default();
        let model = gltf::read_binary(&path, &bytes, files, options, &mut report)?;
        return assemble(&model, options, report);
    }
    load_text(files, &path, &String::from_utf8_lossy(&bytes), options)
}

/// Reads a text as a scene. `path`: where it comes from, for the files that it names.
///
/// # Errors
///
/// [`LoadError`] names the file, the line and the reason.
pub fn load_text(
    files: &dyn Files,
    path: &str,
    text: &str,
    options: &LoadOptions,
) -> Result<LoadedScene, LoadError> {
    if text
        .trim_start_matches('\u{feff}')
        .trim_start()
        .starts_with('{')
    {
        if gltf::is_gltf(path, text) {
            let mut report = Report::default();
            let model = gltf::read(path, text, files, options, &mut report)?;
            return assemble(&model, options, report);
        }
        return json::read(path, text)?.load(path, options);
    }
    let root = xml::parse(path, text)?;
    let mut report = Report::default();
    let model = match root.name.as_str() {
        "robot" => urdf::read(&root, files, options, &mut report)?,
        "mujoco" => mjcf::read(root, files, options, &mut report)?,
        other => {
            let what = format!("<{other}>");
            return Err(root.wrong(Problem::UnknownFormat(what)));
        }
    };
    assemble(&model, options, report)
}

/// A loaded file as a script.
#[derive(Clone, Debug, PartialEq)]
pub struct FileScript {
    config: SceneConfig,
    /// Commands, each with the tick before which it comes; in this order.
    commands: Vec<(u64, Command)>,
    next: usize,
}

impl FileScript {
    /// The script of a scene.
    ///
    /// # Errors
    ///
    /// [`LoadError`] for a body that no scene accepts, and for more shapes than a scene has.
    pub fn new(scene: &LoadedScene) -> Result<Self, LoadError> {
        let tick = |index: usize| scene.bodies.get(index).map_or(0, |body| body.tick);
        let tick_of = |command: &Command| match command {
            Command::AddBody { desc, .. } => tick(desc.id.index() as usize),
            Command::AddJoint { joint, .. } => {
                let ticks = joint.bodies.map(|body| tick(body.index() as usize));
                ticks[0].max(ticks[1])
            }
            _ => 0,
        };
        let commands = scene.commands(FreeIds::default())?.into_iter();
        let mut commands: Vec<_> = commands
            .map(|command| (tick_of(&command), command))
            .collect();
        commands.sort_by_key(|(tick, _)| *tick);
        Ok(Self {
            config: scene.config,
            commands,
            next: 0,
        })
    }
}

/// The reason why a script is more than a file can say.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NotAFile {
    /// It acts on the scene after each tick.
    Controller,
    /// It sends a command that adds nothing.
    OtherCommands,
}

impl fmt::Display for NotAFile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Controller => "it has a controller",
            Self::OtherCommands => "it has commands that do more than add bodies and joints",
        })
    }
}

impl Error for NotAFile {}

impl LoadedScene {
    /// The scene that a script makes in its first ticks, the last one among them.
    ///
    /// # Errors
    ///
    /// [`NotAFile`] for a script that does more than add shapes, bodies and joints.
    pub fn of_script(script: &mut dyn Script, name: &str, ticks: u64) -> Result<Self, NotAFile> {
        if script.controller().is_some() {
            return Err(NotAFile::Controller);
        }
        let mut scene = Self {
            name: name.to_owned(),
            config: script.config(),
            bodies: Vec::new(),
            joints: Vec::new(),
            report: Report::default(),
        };
        let (mut shapes, mut places) = (BTreeMap::new(), BTreeMap::new());
        let mut commands = Vec::new();
        for tick in 0..=ticks {
            commands.clear();
            script.commands(Tick::new(tick), &mut commands);
            for command in commands.drain(..) {
                match command {
                    Command::AddShape { id, shape } => drop(shapes.insert(id, shape)),
                    Command::AddBody { desc, motion } => {
                        let shape = shapes.get(&desc.shape).cloned();
                        let shape = shape.ok_or(NotAFile::OtherCommands)?;
                        places.insert(desc.id, scene.bodies.len());
                        scene.bodies.push(body(desc, shape, &motion, tick));
                    }
                    Command::AddJoint { joint, .. } => {
                        let place = |body| places.get(&body).copied();
                        let [first, second] = joint.bodies.map(place);
                        let bodies =
                            [first, second].map(|place| place.ok_or(NotAFile::OtherCommands));
                        let [first, second] = bodies;
                        scene.joints.push(LoadedJoint {
                            name: String::new(),
                            bodies: [first?, second?],
                            joint: *joint,
                        });
                    }
                    _ => return Err(NotAFile::OtherCommands),
                }
            }
        }
        Ok(scene)
    }
}

fn body(desc: BodyDesc, shape: Shape, motion: &BodyState, tick: u64) -> LoadedBody {
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = motion.parts();
    let builder = BodyBuilder::of(desc, shape)
        .at(px, py, pz)
        .rotation(Quat::from_xyzw(x, y, z, w))
        .linear_velocity(Vec3::new(vx, vy, vz))
        .angular_velocity(Vec3::new(wx, wy, wz));
    LoadedBody {
        name: String::new(),
        builder,
        tick,
        frame_position: Vec3::ZERO,
        frame_rotation: Quat::IDENTITY,
    }
}

impl Script for FileScript {
    fn name(&self) -> &'static str {
        "file"
    }

    fn config(&self) -> SceneConfig {
        self.config
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        let due = self.commands[self.next..].iter();
        let due = due.take_while(|(at, _)| Tick::new(*at) <= tick);
        let before = out.len();
        out.extend(due.map(|(_, command)| command.clone()));
        self.next += out.len() - before;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::MemoryFiles;
    use crate::model::LoadOptions;

    #[test]
    fn bodies_and_their_joints_come_before_their_ticks() {
        let body = |tick: u32| {
            format!(
                "{{\"tick\": {tick}, \"dynamic\": true, \"shape\": {{\"ball\": {{\"radius\": 1}}}}, \"position\": [{tick}, 0, 0]}}"
            )
        };
        let frame = "{\"position\": [0, 0, 0]}";
        let text = format!(
            "{{\"bodies\": [{}, {}, {}], \"joints\": [{{\"bodies\": [0, 1], \"kind\": \"fixed\", \"frames\": [{frame}, {frame}]}}]}}",
            body(0),
            body(2),
            body(1)
        );
        let options = LoadOptions::default();
        let scene = load_text(&MemoryFiles::default(), "a.json", &text, &options).expect("balls");
        let mut script = FileScript::new(&scene).expect("within the limits");
        let mut counts = Vec::new();
        for tick in 0..4 {
            let mut out = Vec::new();
            script.commands(Tick::new(tick), &mut out);
            counts.push(out.len());
        }
        assert_eq!(counts, [2, 1, 2, 0]);
    }
}
