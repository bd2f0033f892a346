//! A client's copy in the paper's protocol: its messages, its defects.
//!
//! A script's commands become messages in the order of the published plug-in: a shape for each object, then the actor, then
//! the attachment. A script that the protocol cannot express is refused before a run begins.
//!
//! A defect is a time loss of the published client, each a switch. Each cost is measured here. That the paper's client
//! lost the same time is inferred, because it ran on another runtime and machine.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::{fmt, io};

use clap::ValueEnum;
use glam::{Quat, Vec3};
use rhumb_app::{
    ApplyForce, ApplyTorque, AttachShape, ConvexMesh, CreateDynamicActor, CreateStaticActor, Id,
    Message, Motion, SetWorld, Surface,
};
use rhumb_protocol::limits::COORDINATE_MAX;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Material, SceneConfig, Shape, ShapeId, Sleep,
};
use rhumb_reckoning::{BodyId, BodyState, Damping};

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
const fn body_of(object: u32) -> Option<u32> {
    object.checked_sub(FIRST_OBJECT)
}

/// Object that stands for the body of an index.
const fn object_of(index: u32) -> u32 {
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

/// The poses received last.
#[derive(Debug, Default)]
pub(super) struct AppReplica {
    poses: BTreeMap<u32, (BodyId, Vec3, Quat)>,
    /// The published client's list: one entry per received state, never emptied; `None` without that defect.
    known_objects: Option<Vec<u32>>,
    /// Entries to add to the list before the first state.
    listed: usize,
    /// Actors whose pose changed since this was last emptied.
    pub(super) changed: Vec<BodyId>,
    pub(super) states: u64,
    /// True if the server has admitted the client.
    pub(super) ready: bool,
    /// Frames that ended before their wait was abandoned.
    pub(super) ended_frames: u64,
    /// Frames abandoned: their end messages were lost or late.
    pub(super) lost: u64,
    /// End messages of abandoned frames that may still arrive.
    owed: u64,
    /// States received when the present frame was requested.
    begun: u64,
    /// True if an end message since then was attributed to an abandoned frame.
    paid: bool,
}

/// An awaited end of frame: the number of frames ended before it.
#[derive(Clone, Copy, Debug)]
pub(super) struct AwaitedEnd(u64);

impl AppReplica {
    /// Creates the state, with the published client's list if `defects` has it.
    pub(super) fn new(defects: Defects) -> Self {
        Self {
            known_objects: defects.list.then(Vec::new),
            listed: defects.listed as usize,
            ..Self::default()
        }
    }

    /// True if a buffer of `buffer_datagrams` datagrams can overflow by one state per body and the end of frame.
    pub(super) fn may_lose(&self, buffer_datagrams: usize) -> bool {
        self.poses.len() + 2 > buffer_datagrams
    }

    /// Starts waiting for the end of a requested frame.
    pub(super) fn await_end(&mut self) -> AwaitedEnd {
        (self.begun, self.paid) = (self.states, false);
        AwaitedEnd(self.ended_frames)
    }

    /// True if the awaited end has arrived.
    pub(super) fn has_ended(&self, AwaitedEnd(before): AwaitedEnd) -> bool {
        self.ended_frames > before
    }

    /// Abandons the wait. If an end and then silence came, that end was this frame's own, and the owed one was lost.
    pub(super) fn abandon(&mut self) {
        if std::mem::take(&mut self.paid) {
            self.owed = 0;
            self.ended_frames += 1;
        } else {
            self.lost += 1;
            self.owed += 1;
        }
    }

    /// Attributes an end message. One that arrives before any state while another is owed belongs to an abandoned
    /// frame. Datagrams keep their order on loopback, so no owed end can follow a frame's own end.
    fn receive_end(&mut self) {
        if self.owed > 0 && self.states == self.begun {
            self.owed -= 1;
            self.paid = true;
        } else {
            self.ended_frames += 1;
            self.owed = 0;
        }
    }

    /// Adds a body at its initial pose.
    pub(super) fn place(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        self.poses.insert(id.index(), (id, position, rotation));
        self.changed.push(id);
    }

    /// Removes a body.
    pub(super) fn remove(&mut self, id: BodyId) {
        self.poses.remove(&id.index());
    }

    pub(super) fn pose(&self, id: BodyId) -> Option<(Vec3, Quat)> {
        let (known, position, rotation) = *self.poses.get(&id.index())?;
        (known == id).then_some((position, rotation))
    }

    /// Processes a message, with the published client's list work if that defect is set.
    pub(super) fn receive(&mut self, message: &Message) {
        match message {
            Message::SetDynamicActor(state) => {
                self.states += 1;
                let object = state.actor.object;
                if let Some(list) = &mut self.known_objects {
                    if list.len() < self.listed {
                        let known = self.poses.keys().map(|index| object_of(*index));
                        list.extend(known.cycle().take(self.listed));
                    }
                    let entries = list.iter().filter(|other| **other == object).count();
                    black_box(entries);
                    list.push(object);
                }
                let Some(index) = body_of(object) else { return };
                if let Some((id, position, rotation)) = self.poses.get_mut(&index) {
                    (*position, *rotation) = (state.position, state.rotation);
                    self.changed.push(*id);
                }
            }
            Message::TimeAdvanced(SIMULATION) => {
                self.receive_end();
                if let Some(list) = &self.known_objects {
                    for object in list.clone() {
                        black_box(body_of(object).and_then(|index| self.poses.get(&index)));
                    }
                }
            }
            Message::LogonReady(SIMULATION) => self.ready = true,
            _ => {}
        }
    }
}

/// An avoidable time loss of the published client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum)]
pub enum Defect {
    /// Threads poll for work every 30 ms (TCP) and 10 ms (received messages) instead of being woken.
    Poll,
    /// At most fifty messages are sent per 30 ms.
    Cap,
    /// A list of received bodies is never emptied: each state scans it, each end of frame copies and walks it.
    List,
    /// The socket buffer has the system's default size, which holds 277 datagrams.
    Buffer,
}

/// The defects of a client.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Defects {
    /// See [`Defect::Poll`].
    pub poll: bool,
    /// See [`Defect::Cap`].
    pub cap: bool,
    /// See [`Defect::List`].
    pub list: bool,
    /// See [`Defect::Buffer`].
    pub buffer: bool,
    /// Initial entries of the list, as if the client had received that many states before.
    pub listed: u32,
}

impl Defects {
    /// A client without defects.
    pub const SOUND: Self = Self {
        poll: false,
        cap: false,
        list: false,
        buffer: false,
        listed: 0,
    };

    /// The published client, with all defects.
    pub const AS_PUBLISHED: Self = Self {
        poll: true,
        cap: true,
        list: true,
        buffer: true,
        listed: 0,
    };

    /// A client with the given defects only.
    #[must_use]
    pub fn only(defects: &[Defect]) -> Self {
        Self {
            poll: defects.contains(&Defect::Poll),
            cap: defects.contains(&Defect::Cap),
            list: defects.contains(&Defect::List),
            buffer: defects.contains(&Defect::Buffer),
            listed: 0,
        }
    }

    /// The same, with a list of this many initial entries.
    #[must_use]
    pub const fn with_listed(self, listed: u32) -> Self {
        Self { listed, ..self }
    }
}

impl fmt::Display for Defects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = [
            (self.poll, "poll"),
            (self.cap, "cap"),
            (self.list, "list"),
            (self.buffer, "buffer"),
        ];
        let names: Vec<_> = named
            .iter()
            .filter(|(on, _)| *on)
            .map(|(_, n)| *n)
            .collect();
        match names.as_slice() {
            [] => f.write_str("sound"),
            _ if self.with_listed(0) == Self::AS_PUBLISHED => f.write_str("as published"),
            names => write!(f, "sound except for {}", names.join(", ")),
        }
    }
}
