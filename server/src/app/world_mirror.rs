//! What a client said of its world: shapes, actors, joints.
//!
//! Knows no scene: what is said takes effect at the next frame, all at once (see `realise`), so that an actor whose parts
//! and materials come in ten messages becomes a body once. What the published plug-in gets wrong is lived with here: names
//! that nobody defined, shapes that go while they are in use or come twice, words about actors that are gone.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_app::{AddJoint, AttachShape, Framed, Message, Motion, SetWorld, Surface};
use rhumb_protocol::limits::{
    ANGULAR_MAX, BODIES_MAX, COORDINATE_MAX, GRAVITY_MAX, GRAVITY_SCALE_MAX, JOINTS_MAX,
    LINEAR_MAX, PARTS_BYTES_MAX, PARTS_MAX,
};
use rhumb_protocol::scene::{BodyKind, JointId, Material};
use rhumb_reckoning::BodyId;

use super::actor::Actor;
use super::form::{Part, mass, material, unit};
use super::names::Names;
use super::outline::Outline;
use super::refusal::Refusal;
use super::shape_cache::ShapeCache;

/// Everything that one client has.
#[derive(Debug, Default)]
pub(super) struct WorldMirror {
    pub(super) gravity: Option<Vec3>,
    shapes: BTreeMap<u32, Outline>,
    shape_bytes: usize,
    pub(super) actors: BTreeMap<u32, Actor>,
    pub(super) joints: BTreeMap<u32, JointRecord>,
    /// The number in the scene of the joint that was held last.
    pub(super) last_joint: u32,
    /// Actors that were changed since the last frame, in the order in which they were first.
    changed: Vec<u32>,
    /// The index of the message that changed each of them last.
    changed_by: BTreeMap<u32, u32>,
    /// The index of the message that is heard.
    message_index: u32,
    /// Names in the scene of bodies that are to go.
    pub(super) removed_bodies: Vec<super::actor::ActorBody>,
    pub(super) removed_joints: Vec<JointId>,
    pub(super) pushes: Vec<(u32, ActorPush)>,
    pub(super) names: Names,
    pub(super) shape_cache: ShapeCache,
    /// The actor of each body, by index.
    by_body: Vec<Option<(BodyId, u32)>>,
    /// Whether collisions of any actor were ever asked for.
    pub(super) reports: bool,
}

/// A joint, and its name in the scene once it holds something there.
#[derive(Clone, Copy, Debug)]
pub(super) struct JointRecord {
    pub(super) message: AddJoint,
    /// The index of the message that message it.
    pub(super) index: u32,
    pub(super) name: Option<JointId>,
}

/// What acts on an actor during the next frame.
#[derive(Clone, Copy, Debug)]
pub(super) enum ActorPush {
    Force(Vec3),
    Torque(Vec3),
}

/// What a client hears at once of what it said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reply {
    Nothing,
    /// kg.
    Mass(f32),
}

/// The ground plane.
const PLANE: u32 = 0;
/// Shapes that one client may have defined at one time.
const SHAPES_TOLD_MAX: usize = 1 << 17;
/// Bytes that they may take.
const SHAPE_BYTES_MAX: usize = 64 << 20;
/// Forces and torques between two frames.
const PUSHES_MAX: usize = 1 << 16;
/// Bit of an actor's flags: its collisions are to be reported.
const REPORTS: u32 = 1;
/// Of bodies that bring none, as the engine of the paper has it by default.
pub(super) const MATERIAL: Material = Material {
    friction: 0.2,
    restitution: 0.0,
    density: 1_000.0,
};

impl WorldMirror {
    /// Takes a message in.
    ///
    /// # Errors
    ///
    /// [`Refusal`] says why nothing of it was done. What is said of things that are not there is passed over.
    pub(super) fn handle_message(&mut self, framed: &Framed) -> Result<Reply, Refusal> {
        self.message_index = framed.index;
        match &framed.message {
            Message::SetWorld(world) => self.set_world(world)?,
            Message::CreateStaticActor(message) => {
                let actor = Actor::new(BodyKind::Static, message.position, message.rotation);
                self.create(message.actor.object, actor, message.flags)?;
            }
            Message::CreateDynamicActor(message) => {
                let Motion { actor: id, .. } = message.motion;
                let actor = moving(&message.motion)?;
                self.create(id.object, actor, message.flags)?;
            }
            Message::RemoveActor(id) => self.remove(id.object),
            Message::GetMass(id) => return Ok(self.mass(id.object)),
            Message::AddSphere((id, origin, radius)) => {
                self.define(id.object, Outline::ball(*origin, *radius)?)?;
            }
            Message::AddCapsule((id, radius, height)) => {
                self.define(id.object, Outline::capsule(*radius, *height)?)?;
            }
            Message::AddBox((id, edges)) => self.define(id.object, Outline::cuboid(*edges)?)?,
            Message::AddConvexMesh(message) => {
                self.define(message.shape.object, Outline::hull(message)?)?;
            }
            Message::AddTriangleMesh(message) => {
                self.define(message.shape.object, Outline::mesh(message)?)?;
            }
            Message::AddHeightField(message) => {
                self.define(message.shape.object, Outline::heights(message)?)?;
            }
            Message::AddPlane(_) => return Err(Refusal::Plane),
            Message::RemoveShape(id) => self.forget(id.object),
            Message::AttachShape(message) => self.attach(message)?,
            Message::DetachShape(message) => {
                let name = message.shape.object;
                self.change(message.actor.object, |actor| actor.detach(name));
            }
            Message::UpdateShapeMaterial(message) => {
                self.resurface(message.actor.object, message.shape.object, &message.surface)?;
            }
            Message::AddJoint(message) => self.join(message)?,
            Message::RemoveJoint(id) => self.unjoin(id.object),
            other => self.hear_motion(other)?,
        }
        Ok(Reply::Nothing)
    }

    /// Takes in what is said of how actors move.
    fn hear_motion(&mut self, message: &Message) -> Result<(), Refusal> {
        match *message {
            Message::SetStaticActor(message) => {
                self.set_target_position(message.actor.object, message.position)?;
                self.set_target_rotation(message.actor.object, message.rotation)?;
            }
            Message::SetDynamicActor(message) => {
                let moved = moving(&message)?;
                self.change(message.actor.object, |actor| {
                    actor.target_motion.position = Some(moved.position);
                    actor.target_motion.rotation = Some(moved.rotation);
                    actor.target_motion.linear = Some(moved.linear);
                    actor.target_motion.angular = Some(moved.angular);
                });
            }
            Message::UpdateActorPosition((id, position)) => {
                self.set_target_position(id.object, position)?;
            }
            Message::UpdateActorOrientation((id, rotation)) => {
                self.set_target_rotation(id.object, rotation)?;
            }
            Message::UpdateGravityModifier((id, factor)) => {
                let factor = within(Vec3::splat(factor), GRAVITY_SCALE_MAX)?.x;
                self.change(id.object, |actor| actor.gravity = factor);
            }
            Message::UpdateLinearVelocity((id, linear)) => {
                let linear = within(linear, LINEAR_MAX)?;
                self.change(id.object, |actor| actor.target_motion.linear = Some(linear));
            }
            Message::UpdateAngularVelocity((id, angular)) => {
                let angular = within(angular, ANGULAR_MAX)?;
                self.change(id.object, |actor| {
                    actor.target_motion.angular = Some(angular)
                });
            }
            Message::ApplyForce(message) => {
                self.push(message.actor.object, ActorPush::Force(message.force))?
            }
            Message::ApplyTorque(message) => {
                self.push(message.actor.object, ActorPush::Torque(message.torque))?;
            }
            // What is left is the session's, or was refused by it.
            _ => {}
        }
        Ok(())
    }

    fn set_world(&mut self, world: &SetWorld) -> Result<(), Refusal> {
        let gravity = within(world.gravity, GRAVITY_MAX)?;
        let normal = world.normal.try_normalize().ok_or(Refusal::Number)?;
        if !world.height.is_finite() {
            return Err(Refusal::Number);
        }
        self.gravity = Some(gravity);
        self.remove(PLANE);
        // What falls so far leaves the world: a plane there is none.
        if world.height <= -COORDINATE_MAX {
            return Ok(());
        }
        let slab = Outline::cuboid(Vec3::new(SLAB, SLAB, SLAB_THICK))?;
        let middle = normal * (world.height - SLAB_THICK * 0.5);
        let rotation = unit(Quat::from_rotation_arc(Vec3::Z, normal))?;
        let mut actor = Actor::new(BodyKind::Static, middle, rotation);
        actor.parts.push(Part {
            name: PLANE,
            outline: Some(slab),
            material: material(&Surface {
                density: MATERIAL.density,
                static_friction: world.static_friction,
                kinetic_friction: world.kinetic_friction,
                // The published plug-in says the restitution where the margin belongs, and the other way round: neither is
                // known for what it is.
                restitution: 0.0,
            })?,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
        });
        self.create(PLANE, actor, 0)
    }

    fn create(&mut self, name: u32, mut actor: Actor, flags: u32) -> Result<(), Refusal> {
        actor.position = within(actor.position, COORDINATE_MAX)?;
        actor.rotation = unit(actor.rotation)?;
        actor.reports = flags & REPORTS != 0;
        self.reports |= actor.reports;
        self.remove(name);
        if self.actors.len() >= BODIES_MAX as usize {
            return Err(Refusal::TooMany);
        }
        self.actors.insert(name, actor);
        self.touch(name);
        Ok(())
    }

    fn remove(&mut self, name: u32) {
        if let Some(actor) = self.actors.remove(&name) {
            self.removed_bodies.extend(actor.body);
            self.pushes.retain(|(pushed, _)| *pushed != name);
        }
    }

    /// Changes an actor, if it is there.
    fn change(&mut self, name: u32, change: impl FnOnce(&mut Actor)) {
        if let Some(actor) = self.actors.get_mut(&name) {
            change(actor);
            self.touch(name);
        }
    }

    /// The actor that a body is.
    pub(super) fn actor_of(&self, id: BodyId) -> Option<(u32, &Actor)> {
        let (body, name) = (*self.by_body.get(id.index() as usize)?)?;
        let actor = self.actors.get(&name).filter(|_| body == id)?;
        Some((name, actor))
    }

    /// From now on a body is an actor's.
    pub(super) fn note_body(&mut self, id: BodyId, name: u32) {
        let index = id.index() as usize;
        if index >= self.by_body.len() {
            self.by_body.resize(index + 1, None);
        }
        self.by_body[index] = Some((id, name));
    }

    /// A body is nobody's any more.
    pub(super) fn forget_body(&mut self, id: BodyId) {
        if let Some(place) = self.by_body.get_mut(id.index() as usize) {
            *place = None;
        }
    }

    fn touch(&mut self, name: u32) {
        if self.changed_by.insert(name, self.message_index).is_none() {
            self.changed.push(name);
        }
    }

    /// Actors to look at, in the order in which they were changed, each with the index of the message that was about it last;
    /// none after.
    pub(super) fn take_touched(&mut self) -> Vec<(u32, u32)> {
        let by = std::mem::take(&mut self.changed_by);
        let changed = std::mem::take(&mut self.changed).into_iter();
        changed
            .filter_map(|name| Some((name, *by.get(&name)?)))
            .collect()
    }

    fn set_target_position(&mut self, name: u32, position: Vec3) -> Result<(), Refusal> {
        let position = within(position, COORDINATE_MAX)?;
        self.change(name, |actor| actor.target_motion.position = Some(position));
        Ok(())
    }

    fn set_target_rotation(&mut self, name: u32, rotation: Quat) -> Result<(), Refusal> {
        let rotation = unit(rotation)?;
        self.change(name, |actor| actor.target_motion.rotation = Some(rotation));
        Ok(())
    }

    fn push(&mut self, name: u32, push: ActorPush) -> Result<(), Refusal> {
        let (ActorPush::Force(vector) | ActorPush::Torque(vector)) = push;
        within(vector, rhumb_protocol::limits::FORCE_MAX)?;
        if self.pushes.len() >= PUSHES_MAX {
            return Err(Refusal::TooMany);
        }
        if self.actors.contains_key(&name) {
            self.pushes.push((name, push));
        }
        Ok(())
    }

    /// The mass of an actor, which is message again when it changes. Of one that there is not there is nothing to tell.
    fn mass(&mut self, name: u32) -> Reply {
        let Some(actor) = self.actors.get_mut(&name) else {
            return Reply::Nothing;
        };
        let mass = mass(actor.kind, &actor.parts);
        actor.told_mass = Some(mass);
        Reply::Mass(mass)
    }

    fn define(&mut self, name: u32, outline: Outline) -> Result<(), Refusal> {
        let bytes = self.shape_bytes + outline.shape.bytes();
        if self.shapes.len() >= SHAPES_TOLD_MAX || bytes > SHAPE_BYTES_MAX {
            return Err(Refusal::TooMany);
        }
        self.forget(name);
        self.shape_bytes += outline.shape.bytes();
        self.shapes.insert(name, outline);
        Ok(())
    }

    /// Actors that have it keep it.
    fn forget(&mut self, name: u32) {
        if let Some(outline) = self.shapes.remove(&name) {
            self.shape_bytes -= outline.shape.bytes();
        }
    }

    fn attach(&mut self, message: &AttachShape) -> Result<(), Refusal> {
        let part = Part {
            name: message.shape.object,
            outline: self.shapes.get(&message.shape.object).cloned(),
            material: material(&message.surface)?,
            position: within(message.position, rhumb_protocol::limits::EXTENT_MAX)?,
            rotation: unit(message.rotation)?,
        };
        if let Some(actor) = self.actors.get(&message.actor.object)
            && (actor.parts.len() >= PARTS_MAX || bytes(&actor.parts, &part) > PARTS_BYTES_MAX)
        {
            return Err(Refusal::TooMany);
        }
        self.change(message.actor.object, |actor| {
            actor.parts.retain(|other| other.name != part.name);
            actor.parts.push(part);
        });
        Ok(())
    }

    fn resurface(&mut self, actor: u32, shape: u32, surface: &Surface) -> Result<(), Refusal> {
        let material = material(surface)?;
        self.change(actor, |actor| {
            for part in actor.parts.iter_mut().filter(|part| part.name == shape) {
                part.material = material;
            }
        });
        Ok(())
    }

    fn join(&mut self, message: &AddJoint) -> Result<(), Refusal> {
        if self.joints.len() >= JOINTS_MAX as usize {
            return Err(Refusal::TooMany);
        }
        let name = message.joint.object;
        super::joint::check(message)?;
        self.unjoin(name);
        let held = JointRecord {
            message: *message,
            index: self.message_index,
            name: None,
        };
        self.joints.insert(name, held);
        self.set_upright(message);
        Ok(())
    }

    fn unjoin(&mut self, name: u32) {
        let Some(held) = self.joints.remove(&name) else {
            return;
        };
        self.removed_joints.extend(held.name);
        self.set_upright(&held.message);
    }

    /// Looks again which joints keep an actor from turning.
    fn set_upright(&mut self, message: &AddJoint) {
        let name = message.first.actor.object;
        let keeps = |held: &JointRecord| held.message.first.actor.object == name;
        let upright = self
            .joints
            .values()
            .filter(|held| keeps(held))
            .any(|held| super::joint::is_upright(&held.message));
        self.change(name, |actor| actor.upright = upright);
    }
}

/// Bytes that the parts of an actor take, with one more.
fn bytes(parts: &[Part], more: &Part) -> usize {
    let outlines = parts
        .iter()
        .chain([more])
        .filter_map(|part| part.outline.as_ref());
    outlines.map(|outline| outline.shape.bytes()).sum()
}

/// An actor that moves, from its state.
fn moving(message: &Motion) -> Result<Actor, Refusal> {
    let position = within(message.position, COORDINATE_MAX)?;
    let mut actor = Actor::new(BodyKind::Dynamic, position, unit(message.rotation)?);
    actor.gravity = within(Vec3::splat(message.gravity_modifier), GRAVITY_SCALE_MAX)?.x;
    actor.linear = within(message.linear, LINEAR_MAX)?;
    actor.angular = within(message.angular, ANGULAR_MAX)?;
    Ok(actor)
}

/// A vector of numbers that are finite and no larger than allowed.
fn within(vector: Vec3, most: f32) -> Result<Vec3, Refusal> {
    if vector.is_finite() && vector.abs().max_element() <= most {
        Ok(vector)
    } else {
        Err(Refusal::Number)
    }
}

/// Edges of the slab that is the ground plane, metres: larger than any region, and not so large that binary32 tells its top
/// no more; so thick that nothing passes through.
const SLAB: f32 = 8_192.0;
const SLAB_THICK: f32 = 20.0;
