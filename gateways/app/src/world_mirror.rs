//! World of an APP client as its messages define it: shapes, actors, joints.
//!
//! Knows no scene: changes take effect at the next frame, all at once (see `apply`). An actor whose parts and
//! materials come in ten messages becomes a body once. Faults of the published plug-in are tolerated: undefined names,
//! shapes removed in use or defined twice, messages about removed actors.

use std::collections::{BTreeMap, BTreeSet};

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{
    ANGULAR_MAX, BODIES_MAX, COORDINATE_MAX, GRAVITY_MAX, GRAVITY_SCALE_MAX, JOINTS_MAX,
    LINEAR_MAX, PARTS_BYTES_MAX, PARTS_MAX,
};
use rhumb_protocol::scene::{BodyKind, JointId, Material};
use rhumb_reckoning::BodyId;

use crate::actor::{Actor, ActorPart, check_joint, keeps_upright, mass, material, unit};
use crate::codec::Surface;
use crate::gateway::Refusal;
use crate::message::{AddJoint, AttachShape, FramedMessage, Message, Motion, SetWorld};
use crate::shape_definition::{ShapeCache, ShapeDefinition};

/// All objects of one client.
#[derive(Debug, Default)]
pub(super) struct WorldMirror {
    pub(super) gravity: Option<Vec3>,
    shapes: BTreeMap<u32, ShapeDefinition>,
    shape_bytes: usize,
    pub(super) actors: BTreeMap<u32, Actor>,
    pub(super) joints: BTreeMap<u32, JointRecord>,
    /// The last assigned joint number in the scene.
    pub(super) last_joint: u32,
    /// Actors that changed since the last frame, in the order of their first change.
    changed: Vec<u32>,
    /// Index of the last message that changed each actor.
    changed_by: BTreeMap<u32, u32>,
    /// Index of the present message.
    message_index: u32,
    /// Bodies to remove from the scene.
    pub(super) removed_bodies: Vec<crate::actor::ActorBody>,
    /// Actors that have lost a body: they are gone, or their bodies were refused.
    pub(super) bodiless: BTreeSet<u32>,
    pub(super) removed_joints: Vec<JointId>,
    pub(super) pushes: Vec<(u32, ActorPush)>,
    pub(super) shape_cache: ShapeCache,
    /// The actor of each body, by body index.
    by_body: Vec<Option<(BodyId, u32)>>,
    /// True if any actor ever requested collision reports.
    pub(super) reports: bool,
}

/// A joint, and its number in the scene once it is added there.
#[derive(Clone, Copy, Debug)]
pub(super) struct JointRecord {
    pub(super) message: AddJoint,
    /// Index of its message.
    pub(super) index: u32,
    pub(super) name: Option<JointId>,
}

/// An actor as far as its contacts concern it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContactActor {
    pub(super) body: BodyId,
    pub(super) name: u32,
    pub(super) reports: bool,
    pub(super) upright: bool,
    /// The step of the frame in which its contacts were noted last, and their number.
    pub(super) noted: Option<(usize, usize)>,
    /// True if it was observed in a step of the frame.
    pub(super) looked: bool,
}

/// Force or torque on an actor during the next frame.
#[derive(Clone, Copy, Debug)]
pub(super) enum ActorPush {
    Force(Vec3),
    Torque(Vec3),
}

/// Immediate reply to a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reply {
    Nothing,
    /// Mass, kg.
    Mass(f32),
}

/// Name of the ground plane.
const PLANE: u32 = 0;
/// Shape definitions of one client, at most.
const SHAPES_MAX: usize = 1 << 17;
/// Bytes of these definitions, at most.
const SHAPE_BYTES_MAX: usize = 64 << 20;
/// Actors that are noted as changed, at most: those that are gone by then are left out.
const CHANGED_MAX: usize = 2 * BODIES_MAX as usize;
/// Forces and torques between two frames, at most.
const PUSHES_MAX: usize = 1 << 16;
/// Bit of an actor's flags: report its collisions.
const REPORTS: u32 = 1;
/// Default material of the paper's engine.
pub(super) const MATERIAL: Material = Material {
    friction: 0.2,
    restitution: 0.0,
    density: 1_000.0,
};

impl WorldMirror {
    /// Handles a message.
    ///
    /// # Errors
    ///
    /// [`Refusal`] names the reason; the message had no effect. Messages about absent objects are ignored.
    pub(super) fn handle_message(&mut self, framed: &FramedMessage) -> Result<Reply, Refusal> {
        self.message_index = framed.index;
        match &framed.message {
            Message::SetWorld(world) => self.set_world(world)?,
            Message::CreateStaticActor(message) => {
                let actor = Actor::new(BodyKind::Fixed, message.position, message.rotation);
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
                self.define(id.object, ShapeDefinition::ball(*origin, *radius)?)?;
            }
            Message::AddCapsule((id, radius, height)) => {
                self.define(id.object, ShapeDefinition::capsule(*radius, *height)?)?;
            }
            Message::AddBox((id, edges)) => {
                self.define(id.object, ShapeDefinition::cuboid(*edges)?)?;
            }
            Message::AddConvexMesh(message) => {
                self.define(message.shape.object, ShapeDefinition::hull(message)?)?;
            }
            Message::AddTriangleMesh(message) => {
                self.define(message.shape.object, ShapeDefinition::mesh(message)?)?;
            }
            Message::AddHeightField(message) => {
                self.define(message.shape.object, ShapeDefinition::heights(message)?)?;
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
            other => self.handle_motion(other)?,
        }
        Ok(Reply::Nothing)
    }

    /// Handles a message about an actor's motion.
    fn handle_motion(&mut self, message: &Message) -> Result<(), Refusal> {
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
                    actor.target_motion.angular = Some(angular);
                });
            }
            Message::ApplyForce(message) => {
                self.push(message.actor.object, ActorPush::Force(message.force))?;
            }
            Message::ApplyTorque(message) => {
                self.push(message.actor.object, ActorPush::Torque(message.torque))?;
            }
            // Other messages belong to the session, which has handled or refused them.
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
        // A body that falls this far leaves the world: there is no plane there.
        if world.height <= -COORDINATE_MAX {
            return Ok(());
        }
        let slab = ShapeDefinition::cuboid(Vec3::new(SLAB, SLAB, SLAB_THICK))?;
        let middle = normal * (world.height - SLAB_THICK * 0.5);
        let rotation = unit(Quat::from_rotation_arc(Vec3::Z, normal))?;
        let mut actor = Actor::new(BodyKind::Fixed, middle, rotation);
        actor.parts.push(ActorPart {
            name: PLANE,
            definition: Some(slab),
            material: material(&Surface {
                density: MATERIAL.density,
                static_friction: world.static_friction,
                kinetic_friction: world.kinetic_friction,
                // The published plug-in swaps restitution and margin: neither can be trusted.
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
            if let Some(body) = actor.body {
                self.removed_bodies.push(body);
                self.bodiless.insert(name);
            }
            self.pushes.retain(|(pushed_name, _)| *pushed_name != name);
        }
    }

    /// Changes an actor, if it exists.
    fn change(&mut self, name: u32, change: impl FnOnce(&mut Actor)) {
        if let Some(actor) = self.actors.get_mut(&name) {
            change(actor);
            self.touch(name);
        }
    }

    /// Actors that had bodies and are gone, each once.
    pub(super) fn take_gone(&mut self) -> Vec<u32> {
        let mut gone = Vec::new();
        self.bodiless.retain(|name| {
            let actor = self.actors.get(name);
            gone.extend(actor.is_none().then_some(*name));
            actor.is_some_and(|actor| actor.body.is_none())
        });
        gone
    }

    /// The actor of a body.
    pub(super) fn actor_of(&self, id: BodyId) -> Option<(u32, &Actor)> {
        let (body, name) = (*self.by_body.get(id.index() as usize)?)?;
        let actor = self.actors.get(&name).filter(|_| body == id)?;
        Some((name, actor))
    }

    /// The actor of each body, by body index.
    pub(super) fn contact_actors(&self) -> Vec<Option<ContactActor>> {
        let places = self.by_body.iter().map(|place| {
            let (body, name) = (*place)?;
            let actor = self.actors.get(&name)?;
            Some(ContactActor {
                body,
                name,
                reports: actor.reports,
                upright: actor.upright,
                noted: None,
                looked: false,
            })
        });
        places.collect()
    }

    /// Assigns a body to an actor.
    pub(super) fn note_body(&mut self, id: BodyId, name: u32) {
        let index = id.index() as usize;
        if index >= self.by_body.len() {
            self.by_body.resize(index + 1, None);
        }
        self.by_body[index] = Some((id, name));
    }

    /// Removes a body's assignment.
    pub(super) fn forget_body(&mut self, id: BodyId) {
        if let Some(place) = self.by_body.get_mut(id.index() as usize) {
            *place = None;
        }
    }

    pub(super) fn touch(&mut self, name: u32) {
        if self.changed_by.insert(name, self.message_index).is_some() {
            return;
        }
        self.changed.push(name);
        if self.changed.len() > CHANGED_MAX {
            // No more actors exist than half of that: those that are gone have nothing to change.
            let actors = &self.actors;
            self.changed.retain(|name| actors.contains_key(name));
            self.changed_by.retain(|name, _| actors.contains_key(name));
        }
    }

    /// Changed actors in the order of their first change, each with the index of the last message about it. Clears the
    /// list.
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

    /// The mass of an actor, sent again whenever it changes. For an absent actor there is no reply.
    fn mass(&mut self, name: u32) -> Reply {
        let Some(actor) = self.actors.get_mut(&name) else {
            return Reply::Nothing;
        };
        let mass = mass(actor.kind, &actor.parts);
        actor.reported_mass = Some(mass);
        Reply::Mass(mass)
    }

    fn define(&mut self, name: u32, definition: ShapeDefinition) -> Result<(), Refusal> {
        let bytes = self.shape_bytes + definition.shape.bytes();
        if self.shapes.len() >= SHAPES_MAX || bytes > SHAPE_BYTES_MAX {
            return Err(Refusal::TooMany);
        }
        self.forget(name);
        self.shape_bytes += definition.shape.bytes();
        self.shapes.insert(name, definition);
        Ok(())
    }

    /// Actors keep the shapes that they have.
    fn forget(&mut self, name: u32) {
        if let Some(definition) = self.shapes.remove(&name) {
            self.shape_bytes -= definition.shape.bytes();
        }
    }

    fn attach(&mut self, message: &AttachShape) -> Result<(), Refusal> {
        let part = ActorPart {
            name: message.shape.object,
            definition: self.shapes.get(&message.shape.object).cloned(),
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
        check_joint(message)?;
        self.unjoin(name);
        let record = JointRecord {
            message: *message,
            index: self.message_index,
            name: None,
        };
        self.joints.insert(name, record);
        self.set_upright(message);
        Ok(())
    }

    fn unjoin(&mut self, name: u32) {
        let Some(record) = self.joints.remove(&name) else {
            return;
        };
        self.removed_joints.extend(record.name);
        self.set_upright(&record.message);
    }

    /// Recomputes whether a joint prevents the actor's rotation.
    fn set_upright(&mut self, message: &AddJoint) {
        let name = message.first.actor.object;
        let keeps = |record: &JointRecord| record.message.first.actor.object == name;
        let upright = self
            .joints
            .values()
            .filter(|record| keeps(record))
            .any(|record| keeps_upright(&record.message));
        self.change(name, |actor| actor.upright = upright);
    }
}

/// Bytes of an actor's parts with one more.
fn bytes(parts: &[ActorPart], more: &ActorPart) -> usize {
    let definitions = parts
        .iter()
        .chain([more])
        .filter_map(|part| part.definition.as_ref());
    definitions.map(|definition| definition.shape.bytes()).sum()
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

/// Checks that a vector is finite and within a limit.
fn within(vector: Vec3, most: f32) -> Result<Vec3, Refusal> {
    if vector.is_finite() && vector.abs().max_element() <= most {
        Ok(vector)
    } else {
        Err(Refusal::Number)
    }
}

/// Edges of the slab that is the ground plane, metres: larger than any region, small enough for binary32 to resolve
/// its top, and thick enough that nothing passes through.
const SLAB: f32 = 8_192.0;
const SLAB_THICK: f32 = 20.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn actors_that_come_and_go_without_a_frame_take_no_more_memory() {
        let mut mirror = WorldMirror::default();
        let actor = || Actor::new(BodyKind::Fixed, Vec3::ZERO, Quat::IDENTITY);
        let create = |mirror: &mut WorldMirror, name| {
            assert_eq!(mirror.create(name, actor(), 0), Ok(()));
        };
        create(&mut mirror, 7);
        create(&mut mirror, 5);
        for name in 10..10 + CHANGED_MAX as u32 {
            create(&mut mirror, name);
            mirror.remove(name);
        }
        assert!(mirror.changed.len() <= CHANGED_MAX);
        assert!(mirror.changed_by.len() <= CHANGED_MAX);
        let named: Vec<_> = mirror
            .take_touched()
            .iter()
            .map(|(name, _)| *name)
            .collect();
        assert_eq!(named[..2], [7, 5], "in the order of their first change");
    }
}
