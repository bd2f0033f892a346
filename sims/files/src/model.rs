//! The model that readers make of a file before it becomes commands.
//!
//! Frames are those of the file. Invariant: a body's index is above that of the body that holds it.

use std::rc::Rc;

use glam::{DVec3, Quat, Vec3};
use rhumb_protocol::scene::{CollisionGroups, JointKind};

use crate::error::Place;
use crate::inertia::{Inertia, Pose};
use crate::mesh::TriangleMesh;

/// Whether the root of a robot moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Base {
    /// A root called `world`, or one without mass, is fixed; others are free.
    #[default]
    AsFile,
    /// It is fixed.
    Fixed,
    /// It moves freely.
    Free,
}

/// The world's axis that points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UpAxis {
    /// The axis of the file: z of robots, y of JSON scenes. Gravity points the other way.
    #[default]
    AsFile,
    /// y: the scene is turned where its file has another.
    Y,
}

/// Whether parts of one robot touch each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OwnContacts {
    /// As programs do that read such files: not those of a URDF, those of MJCF by its bits and exclusions.
    #[default]
    AsFile,
    /// All that no joint connects.
    All,
}

/// The options of reading a file.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadOptions {
    /// Whether the root of a robot moves.
    pub base: Base,
    /// The world's axis that points up.
    pub up: UpAxis,
    /// Whether parts of one robot touch each other.
    pub own_contacts: OwnContacts,
    /// The position at which the root or the world of the file is added, metres; in the world's axes.
    pub position: Vec3,
    /// File's axes → world.
    pub rotation: Quat,
    /// Folders that are searched for `package://` names, first ones first. The folders above the file are searched
    /// after them.
    pub packages: Vec<String>,
    /// Density of bodies whose file gives shapes but no mass, kg/m³.
    pub density: f32,
    /// Number of the collision group, below 32, that the parts of a robot share: robots of one scene with different
    /// numbers touch each other.
    pub group: u8,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            base: Base::AsFile,
            up: UpAxis::AsFile,
            own_contacts: OwnContacts::AsFile,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            packages: Vec::new(),
            density: 1_000.0,
            group: 1,
        }
    }
}

/// A file as it was read.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    pub(crate) name: String,
    /// m/s², in the file's axes.
    pub(crate) gravity: DVec3,
    /// Seconds of a step, where the file says it.
    pub(crate) step: Option<f64>,
    pub(crate) bodies: Vec<ModelBody>,
    pub(crate) joints: Vec<ModelJoint>,
}

/// A body: one link, or several that nothing moves against each other.
#[derive(Clone, Debug)]
pub(crate) struct ModelBody {
    pub(crate) name: String,
    pub(crate) place: Place,
    /// Frame → the file's world.
    pub(crate) pose: Pose,
    pub(crate) fixed: bool,
    /// In the frame.
    pub(crate) inertia: Inertia,
    pub(crate) solids: Vec<Placed>,
    pub(crate) groups: CollisionGroups,
    /// Coefficient, where the file says it.
    pub(crate) friction: Option<f64>,
}

/// A solid of a body.
#[derive(Clone, Debug)]
pub(crate) struct Placed {
    /// Solid → the body's frame.
    pub(crate) pose: Pose,
    pub(crate) solid: Solid,
    pub(crate) name: String,
}

/// A solid, in metres; long axes along z.
#[derive(Clone, Debug)]
pub(crate) enum Solid {
    Ball {
        radius: f64,
    },
    Cuboid {
        half: DVec3,
    },
    Cylinder {
        half: f64,
        radius: f64,
    },
    Capsule {
        half: f64,
        radius: f64,
    },
    Ellipsoid {
        half: DVec3,
    },
    /// Its hull.
    Hull(Rc<TriangleMesh>),
    /// Its triangles where the body is fixed, else its hull.
    Mesh(Rc<TriangleMesh>),
    /// Everything below z = 0.
    Plane,
}

/// A joint; at the start its frame is the same in both bodies.
#[derive(Clone, Debug)]
pub(crate) struct ModelJoint {
    pub(crate) name: String,
    pub(crate) place: Place,
    /// The holding one, and the held one.
    pub(crate) bodies: [usize; 2],
    /// Frame → the file's world.
    pub(crate) frame: Pose,
    pub(crate) kind: JointKind,
    pub(crate) drives: [Option<Drive>; 6],
    pub(crate) collide: bool,
    /// False for a loop's closing joint.
    pub(crate) holds: bool,
}

/// Passive forces of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Drive {
    /// N/m or N·m/rad.
    pub(crate) stiffness: f64,
    /// The rest of the spring, metres or radians.
    pub(crate) rest: f64,
    /// N·s/m or N·m·s/rad.
    pub(crate) damping: f64,
    /// Dry friction, N or N·m.
    pub(crate) friction: f64,
    /// Inertia of a rotor that turns with the axis, kg or kg·m².
    pub(crate) armature: f64,
    /// Time constant, seconds, and damping ratio of the spring, in place of stiffness and damping.
    pub(crate) timed: Option<[f64; 2]>,
}

impl Drive {
    /// True if it pushes.
    pub(crate) fn pushes(&self) -> bool {
        self.stiffness > 0.0 || self.damping > 0.0 || self.friction > 0.0 || self.timed.is_some()
    }

    /// A multiple of its forces and of its rotor.
    pub(crate) const fn times(self, factor: f64) -> Self {
        Self {
            stiffness: self.stiffness * factor,
            damping: self.damping * factor,
            friction: self.friction * factor,
            armature: self.armature * factor,
            ..self
        }
    }

    /// The same for an inertia, kg or kg·m², that it moves: with stiffness and damping in numbers.
    pub(crate) fn of_inertia(self, inertia: f64) -> Self {
        match self.timed {
            None => self,
            Some([seconds, ratio]) => Self {
                stiffness: inertia / (seconds * ratio).powi(2).max(1e-15),
                damping: 2.0 * inertia / seconds.max(1e-15),
                ..self
            },
        }
    }
}
