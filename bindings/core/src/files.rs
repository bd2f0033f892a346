//! Robots and scenes from files, added to a joined scene.
//!
//! Compiled by the feature `files`. Places are in the coordinates of the scene; a file's own up points up in them.

use std::collections::BTreeSet;

use glam::{Quat, Vec3};
use rhumb_client::BodyId;
use rhumb_client::scene::{Command, Joint, JointId, SceneConfig};
use rhumb_scene_files::{Folder, LoadOptions, LoadedJoint, LoadedScene, UpAxis, load};

pub use rhumb_scene_files::{Base, OwnContacts};

use crate::coordinates::Coordinates;
use crate::error::BindingError;

/// The options of reading a file, and the place of its bodies.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadParams {
    /// The position of the file's root or world.
    pub position: Vec3,
    /// The file's axes, its up upward → world.
    pub rotation: Quat,
    /// Fixes the root of a robot, or leaves it free.
    pub base: Base,
    /// Lets parts of one robot touch each other, or not.
    pub own_contacts: OwnContacts,
    /// Folders that are searched for `package://` names.
    pub packages: Vec<String>,
    /// Density of bodies whose file gives shapes but no mass, kg/m³.
    pub density: f32,
    /// Number of the collision group, below 32, that the parts of a robot share.
    pub group: u8,
    /// Number of the first joint; `None`: the least that are free.
    pub first_joint: Option<u32>,
}

impl Default for LoadParams {
    fn default() -> Self {
        let options = LoadOptions::default();
        Self {
            position: options.position,
            rotation: options.rotation,
            base: options.base,
            own_contacts: options.own_contacts,
            packages: options.packages,
            density: options.density,
            group: options.group,
            first_joint: None,
        }
    }
}

/// A body of a loaded file.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedBody {
    /// Its name in the file, with a number behind it if the file has it twice or has none.
    pub name: String,
    /// The body.
    pub id: BodyId,
    /// Origin of the file's frame of it, from its centre of mass and in its axes.
    pub frame_position: Vec3,
    /// The file's frame of it → body.
    pub frame_rotation: Quat,
}

/// A joint of a loaded file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NamedJoint {
    /// Its name in the file, as that of a body.
    pub name: String,
    /// The joint.
    pub id: JointId,
}

/// The bodies and joints of a file in a scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LoadedFile {
    /// Its name in the file.
    pub name: String,
    /// Its bodies, holding ones before held ones.
    pub bodies: Vec<NamedBody>,
    /// Its joints.
    pub joints: Vec<NamedJoint>,
    /// A sentence for each thing that the file says and the scene has not, with file and line.
    pub left_out: Vec<String>,
}

/// The settings that a file asks of a new scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FileSettings {
    /// Units of length per s².
    pub gravity: Vec3,
    /// `None` if they are no whole number.
    pub ticks_per_second: Option<u32>,
    /// Steps of the engine in a tick.
    pub substeps: u32,
}

impl FileSettings {
    /// The settings that a file asks for, in these coordinates.
    ///
    /// # Errors
    ///
    /// [`BindingError::File`] for a file that cannot be loaded.
    pub fn read(
        path: &str,
        coordinates: Coordinates,
        params: &LoadParams,
    ) -> Result<Self, BindingError> {
        let config = read(path, coordinates, params)?.config;
        let rate = config.integrator.rate;
        Ok(Self {
            gravity: coordinates.vector_out(config.gravity),
            ticks_per_second: (rate.seconds() == 1).then(|| rate.ticks()),
            substeps: config.integrator.substeps.get(),
        })
    }
}

/// Reads a file, with y up.
pub(crate) fn read(
    path: &str,
    coordinates: Coordinates,
    params: &LoadParams,
) -> Result<LoadedScene, BindingError> {
    if params.group >= 32 {
        return Err(BindingError::value("group", params.group, "0 to 31"));
    }
    if !(params.density > 0.0 && params.density.is_finite()) {
        let needed = "above zero and finite, kg/m³";
        return Err(BindingError::value("density", params.density, needed));
    }
    let rotation = coordinates.rotation_in(params.rotation);
    if !(rotation.is_finite() && (rotation.length() - 1.0).abs() < 1e-3) {
        let needed = "a quaternion of unit length";
        return Err(BindingError::value("rotation", params.rotation, needed));
    }
    let options = LoadOptions {
        base: params.base,
        up: UpAxis::Y,
        own_contacts: params.own_contacts,
        position: coordinates.vector_in(params.position),
        rotation: rotation.normalize(),
        packages: params.packages.clone(),
        density: params.density,
        group: params.group,
    };
    Ok(load(&Folder::default(), path, &options).map_err(Box::new)?)
}

/// Numbers for joints: these and the next ones, or the least that are not taken.
///
/// # Errors
///
/// [`BindingError::Value`] for numbers that no joint has.
pub(crate) fn numbers(
    count: usize,
    first: Option<u32>,
    taken: &BTreeSet<JointId>,
) -> Result<Vec<JointId>, BindingError> {
    let free = |id: &JointId| first.is_some() || !taken.contains(id);
    let all = (first.unwrap_or(0)..=u32::MAX).map(JointId).filter(free);
    let numbers: Vec<_> = all.take(count).collect();
    let is_number = |id: &JointId| Command::RemoveJoint { id: *id }.check_ids().is_ok();
    match numbers.len() == count && numbers.iter().all(is_number) {
        true => Ok(numbers),
        false => Err(BindingError::value(
            "first_joint",
            first.unwrap_or(0),
            format_args!("so small that the numbers of {count} joints follow it"),
        )),
    }
}

/// The command that adds a joint between two of these bodies.
pub(crate) fn joint(id: JointId, joint: &LoadedJoint, bodies: &[BodyId]) -> Command {
    let bodies = joint.bodies.map(|place| bodies[place]);
    let joint = Box::new(Joint {
        bodies,
        ..joint.joint
    });
    Command::AddJoint { id, joint }
}

/// Names that differ: a second one of a name has a number, and so has each without one.
pub(crate) fn distinct<'a>(names: impl Iterator<Item = &'a str>, what: &str) -> Vec<String> {
    let mut taken = BTreeSet::new();
    let mut distinct = Vec::new();
    for (place, name) in names.enumerate() {
        let mut own = match name.is_empty() {
            true => format!("{what} {place}"),
            false => name.to_owned(),
        };
        let mut number = 2;
        while !taken.insert(own.clone()) {
            own = format!("{name} ({number})");
            number += 1;
        }
        distinct.push(own);
    }
    distinct
}

/// Sentences about what a file asks of a scene that was made without it.
pub(crate) fn differences(
    scene: &LoadedScene,
    config: &SceneConfig,
    gravity: Vec3,
    coordinates: Coordinates,
) -> Vec<String> {
    let mut left = Vec::new();
    let asked = &scene.config;
    if asked.gravity.distance(gravity) > 1e-4 * (1.0 + gravity.length()) {
        left.push(format!(
            "gravity {} left out: the scene has {}",
            coordinates.vector_out(asked.gravity),
            coordinates.vector_out(gravity)
        ));
    }
    if asked.integrator.rate != config.integrator.rate
        || asked.integrator.substeps != config.integrator.substeps
    {
        let said = |config: &SceneConfig| {
            let integrator = &config.integrator;
            let step = integrator.rate.step().seconds();
            format!("a step of {step:.6} s in {} parts", integrator.substeps)
        };
        left.push(format!(
            "{} left out: the scene has {}",
            said(asked),
            said(config)
        ));
    }
    if asked.damping != config.damping {
        left.push("damping of the file's scene left out: the scene has its own".to_owned());
    }
    let later = scene.bodies.iter().filter(|body| body.tick > 0).count();
    if later > 0 {
        left.push(format!(
            "the ticks of {later} bodies changed: all bodies are added at once"
        ));
    }
    left
}
