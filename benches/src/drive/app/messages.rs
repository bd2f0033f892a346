//! A script's commands as messages of the paper's protocol; the mode's errors.
//!
//! Uses the order of the published plug-in: a shape for each object, then the actor, then the attachment. A script
//! that the protocol cannot express is refused before a run begins.

use std::collections::BTreeMap;
use std::{fmt, io};

use glam::{Quat, Vec3};
use rhumb_app::{
    ApplyForce, ApplyTorque, AttachShape, ConvexMesh, CreateDynamicActor, CreateStaticActor, Id,
    Message, Motion, SetWorld, Surface,
};
use rhumb_protocol::limits::COORDINATE_MAX;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Material, SceneConfig, Shape, ShapeId, Sleep,
};
use rhumb_reckoning::{BodyState, Damping};

/// Id of the simulation that the benchmark logs on to.
pub(super) const SIMULATION: u32 = 1;
/// Lower objects are the ground plane and the terrain.
const FIRST_OBJECT: u32 = 2;
/// Damping that such a server gives every body; the protocol has no field for it.
const DAMPING: Damping = Damping {
    linear: 0.0,
    angular: 0.05,
};

/// Features of a script that the protocol cannot express.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsupported {
    /// Damping, of the scene or a body, other than such servers have.
    Damping,
    /// Sleep thresholds.
    Sleep,
    /// A kinematic body.
    Kinematic,
    /// A cylinder, a capsule not aligned as in the protocol, a height field, a mesh, or a compound.
    Shape,
    /// A body without gyroscopic forces, or one with locked rotation.
    Turning,
    /// An impulse.
    Impulse,
    /// A joint.
    Joint,
    /// Events of bodies.
    Events,
    /// Another description of a body, or one put to sleep or woken.
    Change,
}

impl fmt::Display for Unsupported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Damping => "damping other than 0 and 0.05",
            Self::Sleep => "sleep thresholds",
            Self::Kinematic => "a kinematic body",
            Self::Shape => "a shape that is neither ball nor cuboid nor hull",
            Self::Turning => "gyroscopic or locked rotation",
            Self::Impulse => "an impulse",
            Self::Change => "changes of bodies",
            Self::Joint => "a joint",
            Self::Events => "events of bodies",
        })
    }
}

/// Index of the body that an object stands for.
pub(super) const fn body_of(object: u32) -> Option<u32> {
    object.checked_sub(FIRST_OBJECT)
}

/// Object that stands for the body of an index.
pub(super) const fn object_of(index: u32) -> u32 {
    index + FIRST_OBJECT
}

const fn id(object: u32) -> Id {
    Id {
        simulation: SIMULATION,
        object,
    }
}

/// Translator; remembers shapes, which only scripts name.
#[derive(Debug)]
pub(super) struct MessageWriter {
    material: Material,
    shapes: BTreeMap<ShapeId, Shape>,
}

impl MessageWriter {
    /// A translator for a scene with this config.
    pub(super) fn new(config: &SceneConfig) -> Result<Self, Unsupported> {
        if config.damping != DAMPING {
            return Err(Unsupported::Damping);
        }
        if config.sleep != Sleep::Settled {
            return Err(Unsupported::Sleep);
        }
        Ok(Self {
            material: config.material,
            shapes: BTreeMap::new(),
        })
    }

    /// Gravity, and a ground plane too low to matter.
    pub(super) fn world(gravity: Vec3) -> Message {
        Message::SetWorld(SetWorld {
            plane: id(0),
            gravity,
            static_friction: 0.0,
            kinetic_friction: 0.0,
            restitution: 0.0,
            margin: 0.0,
            height: -COORDINATE_MAX,
            normal: Vec3::Z,
        })
    }

    /// Appends the messages of a command.
    pub(super) fn encode(
        &mut self,
        command: &Command,
        out: &mut Vec<Message>,
    ) -> Result<(), Unsupported> {
        let object = |index: u32| id(object_of(index));
        match *command {
            Command::AddShape { id, ref shape } => {
                self.shapes.insert(id, shape.clone());
            }
            Command::RemoveShape { id } => drop(self.shapes.remove(&id)),
            Command::AddBody { desc, motion } => self.add(&desc, motion, out)?,
            Command::RemoveBody { id } => {
                out.push(Message::RemoveActor(object(id.index())));
                out.push(Message::RemoveShape(object(id.index())));
            }
            Command::SetPose {
                id,
                position,
                rotation,
            } => {
                let actor = object(id.index());
                out.push(Message::UpdateActorPosition((actor, position)));
                out.push(Message::UpdateActorOrientation((actor, rotation)));
            }
            Command::SetVelocity {
                id,
                linear,
                angular,
            } => {
                let actor = object(id.index());
                out.push(Message::UpdateLinearVelocity((actor, linear)));
                out.push(Message::UpdateAngularVelocity((actor, angular)));
            }
            Command::Force { id, force } => {
                let actor = object(id.index());
                out.push(Message::ApplyForce(ApplyForce { actor, force }));
            }
            Command::Torque { id, torque } => {
                let actor = object(id.index());
                out.push(Message::ApplyTorque(ApplyTorque { actor, torque }));
            }
            Command::SetGravity { gravity } => out.push(Self::world(gravity)),
            Command::Impulse { .. }
            | Command::TorqueImpulse { .. }
            | Command::ForceAt { .. }
            | Command::ImpulseAt { .. } => return Err(Unsupported::Impulse),
            Command::AddJoint { .. }
            | Command::ChangeJoint { .. }
            | Command::RemoveJoint { .. } => {
                return Err(Unsupported::Joint);
            }
            Command::SetEvents { .. } => return Err(Unsupported::Events),
            Command::ChangeBody { .. }
            | Command::Sleep { .. }
            | Command::Wake { .. }
            | Command::SetLocomotion { .. }
            | Command::Jump { .. }
            | Command::SetWheels { .. } => {
                return Err(Unsupported::Change);
            }
        }
        Ok(())
    }

    fn add(
        &self,
        desc: &BodyDesc,
        motion: BodyState,
        out: &mut Vec<Message>,
    ) -> Result<(), Unsupported> {
        if desc.damping.is_some_and(|damping| damping != DAMPING) {
            return Err(Unsupported::Damping);
        }
        if !desc.gyroscopic || !desc.locked.is_empty() {
            return Err(Unsupported::Turning);
        }
        let actor = id(desc.id.index() + FIRST_OBJECT);
        out.push(match self.shapes.get(&desc.shape) {
            Some(Shape::Ball { radius }) => Message::AddSphere((actor, Vec3::ZERO, *radius)),
            Some(Shape::Cuboid { half_extents }) => Message::AddBox((actor, *half_extents * 2.0)),
            Some(Shape::Hull(hull)) => Message::AddConvexMesh(ConvexMesh {
                shape: actor,
                points: hull.points().to_vec(),
            }),
            _ => return Err(Unsupported::Shape),
        });
        let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = motion.parts();
        let position = Vec3::new(px, py, pz);
        let rotation = Quat::from_xyzw(x, y, z, w);
        out.push(match desc.kind {
            BodyKind::Fixed => Message::CreateStaticActor(CreateStaticActor {
                actor,
                position,
                rotation,
                flags: 0,
            }),
            BodyKind::Dynamic => Message::CreateDynamicActor(CreateDynamicActor {
                motion: Motion {
                    actor,
                    position,
                    rotation,
                    gravity_modifier: desc.gravity_scale,
                    linear: Vec3::new(vx, vy, vz),
                    angular: Vec3::new(wx, wy, wz),
                },
                flags: 0,
            }),
            BodyKind::Kinematic => return Err(Unsupported::Kinematic),
        });
        let material = desc.material.unwrap_or(self.material);
        out.push(Message::AttachShape(AttachShape {
            actor,
            shape: Id {
                simulation: 0,
                object: actor.object,
            },
            surface: Surface {
                density: material.density,
                static_friction: material.friction,
                kinetic_friction: material.friction,
                restitution: material.restitution,
            },
            rotation: Quat::IDENTITY,
            position: Vec3::ZERO,
        }));
        Ok(())
    }
}

/// The error of a mode of the paper's protocol.
#[derive(Debug)]
pub enum AppError {
    /// The script uses a feature that the protocol cannot express.
    Unsupported(Unsupported),
    /// The sockets failed, or the server ended the connection.
    PaperConnection(io::Error),
}

impl fmt::Display for AppError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unsupported(what) => write!(f, "the paper's protocol cannot express {what}"),
            Self::PaperConnection(cause) => write!(f, "the paper's protocol: {cause}"),
        }
    }
}

impl From<io::Error> for AppError {
    fn from(cause: io::Error) -> Self {
        Self::PaperConnection(cause)
    }
}

impl From<Unsupported> for AppError {
    fn from(what: Unsupported) -> Self {
        Self::Unsupported(what)
    }
}
