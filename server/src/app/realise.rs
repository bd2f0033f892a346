//! Makes a scene what a client said of its world since the last frame.
//!
//! In the order of payload, and once for each actor: one that became another form is taken out and put in again where it
//! is, under the next generation of its index; one that only moves is moved. Joints come last, when all bodies are there.

use glam::{Quat, Vec3};
use rhumb_protocol::limits::JOINTS_MAX;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Compound, JointId, Shape};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, BodyState};

use super::actor::{Actor, ActorBody, TargetMotion};
use super::form::{Form, Frame, form};
use super::joint;
use super::lead::Lead;
use super::lifting::lift;
use super::names::Names;
use super::refusal::{Refusal, RefusedMessage};
use super::world_mirror::{JointRecord, MATERIAL, WorldMirror};

/// What came of it that the client should hear.
#[derive(Debug, Default)]
pub(super) struct FrameResult {
    /// Masses that are others than were message, kg, by actor.
    pub(super) masses: Vec<(u32, f32)>,
    /// What could not be done.
    pub(super) refused: Vec<RefusedMessage>,
}

/// Where an actor is, and how it moves.
#[derive(Clone, Copy, Debug)]
struct BodyMotion {
    position: Vec3,
    rotation: Quat,
    linear: Vec3,
    angular: Vec3,
}

impl WorldMirror {
    /// Does all that was said since the last frame.
    pub(super) fn realise(&mut self, lead: &mut Lead<'_>) -> FrameResult {
        let mut realised = FrameResult::default();
        for name in std::mem::take(&mut self.removed_joints) {
            // One that went with a body is gone already.
            let _ = lead.command(&Command::RemoveJoint { id: name });
        }
        for body in std::mem::take(&mut self.removed_bodies) {
            self.take_out(&body, lead);
            self.names.give_back(body.id);
        }
        let mut grounds = Vec::new();
        for (name, index) in self.take_touched() {
            let Some(mut actor) = self.actors.remove(&name) else {
                continue;
            };
            let before = actor.body.map(|body| body.id);
            if let Err(refusal) = self.realise_actor(name, &mut actor, lead, &mut realised) {
                let refused = RefusedMessage::at_frame(index, name, refusal);
                realised.refused.push(refused);
            }
            let ground = actor.body.map(|body| body.id);
            let is_new = ground != before && actor.kind == BodyKind::Static;
            grounds.extend(ground.filter(|_| is_new));
            self.actors.insert(name, actor);
        }
        for ground in grounds {
            lift(self, ground, lead);
        }
        self.realise_joints(lead, &mut realised);
        realised
    }

    fn take_out(&mut self, body: &ActorBody, lead: &mut Lead<'_>) {
        self.forget_body(body.id);
        // One that left the world is gone already.
        let _ = lead.command(&Command::RemoveBody { id: body.id });
        self.shape_cache.give_back(body.shape, lead);
        for held in self.joints.values_mut() {
            let gone = |id: JointId| lead.scene().joints().get(id).is_none();
            held.name = held.name.filter(|id| !gone(*id));
        }
    }

    fn realise_actor(
        &mut self,
        name: u32,
        actor: &mut Actor,
        lead: &mut Lead<'_>,
        realised: &mut FrameResult,
    ) -> Result<(), Refusal> {
        let form = form(actor.kind, &actor.parts, MATERIAL);
        if let Some(message) = actor.told_mass
            && (message - form.mass).abs() > message * SAME_MASS
        {
            actor.told_mass = Some(form.mass);
            realised.masses.push((name, form.mass));
        }
        let present = actor
            .body
            .and_then(|body| lead.scene().observation(body.id));
        if let (Some(body), None) = (&actor.body, &present)
            && actor.target_motion.position.is_none()
            && lead.scene().body(body.id).is_none()
        {
            // It left the world, and nobody says where it is to be.
            actor.fulfil();
            return Ok(());
        }
        let target_motion = actor.target_motion;
        let now = actor
            .body
            .zip(present)
            .map(|(body, seen)| seen_as(&body.frame, &seen));
        if let Some(now) = now {
            actor.position = now.position;
            actor.rotation = now.rotation;
            actor.linear = now.linear;
            actor.angular = now.angular;
        }
        actor.fulfil();
        match (actor.body, now) {
            (Some(body), Some(now)) if is_as(&body, &form, actor, lead) => {
                steer(actor, &body, target_motion, now, lead)
            }
            _ => self.put_in(name, actor, form, lead),
        }
    }

    /// Puts an actor into the scene, in place of the body that it was.
    fn put_in(
        &mut self,
        name: u32,
        actor: &mut Actor,
        form: Form,
        lead: &mut Lead<'_>,
    ) -> Result<(), Refusal> {
        let before = actor.body.take();
        if let Some(before) = &before {
            self.take_out(before, lead);
        }
        let again = before.and_then(|before| Names::again(before.id));
        let id = match again {
            Some(id) => id,
            None => self.names.take(&lead.range).ok_or(Refusal::TooMany)?,
        };
        let taken = self.shape_cache.take(&form.shape, lead);
        let shape = match taken {
            Ok(shape) => shape,
            Err(error) => {
                tracing::warn!(actor = name, %error, "an actor has no shape in its scene");
                let nothing = Shape::Compound(Compound::nothing());
                self.shape_cache.take(&nothing, lead)?
            }
        };
        let mut desc = BodyDesc::plain(id, actor.kind, shape);
        desc.material = form.material;
        desc.gravity_scale = actor.gravity;
        desc.turns = !actor.upright;
        let (position, rotation) = form.frame.body_of(actor.position, actor.rotation);
        let still = actor.kind == BodyKind::Static;
        let [linear, angular] =
            [actor.linear, actor.angular].map(|velocity| if still { Vec3::ZERO } else { velocity });
        let motion = BodyState::new(
            position.to_array(),
            rotation.to_array(),
            linear.to_array(),
            angular.to_array(),
        )
        .map_err(|_| Refusal::Number)?;
        if let Err(error) = lead.command(&Command::AddBody { desc, motion }) {
            self.shape_cache.give_back(shape, lead);
            self.names.give_back(id);
            return Err(error.into());
        }
        self.note_body(id, name);
        actor.body = Some(ActorBody {
            id,
            shape,
            frame: form.frame,
            material: form.material,
            gravity: actor.gravity,
            upright: actor.upright,
        });
        Ok(())
    }

    fn realise_joints(&mut self, lead: &mut Lead<'_>, realised: &mut FrameResult) {
        let waiting: Vec<u32> = self
            .joints
            .iter()
            .filter(|(_, held)| held.name.is_none() && !joint::is_upright(&held.message))
            .map(|(name, _)| *name)
            .collect();
        for name in waiting {
            let Some(JointRecord { message, index, .. }) = self.joints.get(&name).copied() else {
                continue;
            };
            if !self.actors.contains_key(&message.second.actor.object) {
                self.realise_world(index, lead, realised);
            }
            let joined = self.free_joint(lead).and_then(|id| {
                self.hold(&message, id, lead)?;
                self.last_joint = id.0;
                Ok(id)
            });
            match joined {
                Ok(id) => {
                    if let Some(held) = self.joints.get_mut(&name) {
                        held.name = Some(id);
                    }
                }
                // The other actor may come yet.
                Err(Refusal::JointTo(_)) => {}
                Err(refusal) => {
                    self.joints.remove(&name);
                    let refused =
                        RefusedMessage::at_frame(index, message.first.actor.object, refusal);
                    realised.refused.push(refused);
                }
            }
        }
    }

    /// A number that the scene has no joint of, behind the one that was given last.
    fn free_joint(&self, lead: &Lead<'_>) -> Result<JointId, Refusal> {
        let from = (self.last_joint + 1) % JOINTS_MAX;
        let mut numbers = (from..JOINTS_MAX).chain(0..from).map(JointId);
        let free = numbers.find(|id| lead.scene().joints().get(*id).is_none());
        free.ok_or(Refusal::TooMany)
    }

    /// Has something in the scene that stands for the world, which joints may hold; `index`: of the message of such a joint.
    fn realise_world(&mut self, index: u32, lead: &mut Lead<'_>, realised: &mut FrameResult) {
        let stands = Actor::new(BodyKind::Static, Vec3::ZERO, Quat::IDENTITY);
        let mut world = self.actors.remove(&WORLD).unwrap_or(stands);
        if world.body.is_none()
            && let Err(refusal) = self.realise_actor(WORLD, &mut world, lead, realised)
        {
            realised
                .refused
                .push(RefusedMessage::at_frame(index, WORLD, refusal));
        }
        self.actors.insert(WORLD, world);
    }

    fn hold(
        &self,
        message: &rhumb_app::AddJoint,
        id: JointId,
        lead: &mut Lead<'_>,
    ) -> Result<(), Refusal> {
        let body = |name: u32| -> Result<(BodyId, Frame), Refusal> {
            let body = self.actors.get(&name).and_then(|actor| actor.body);
            body.map(|body| (body.id, body.frame))
                .ok_or(Refusal::JointTo(name))
        };
        let second = message.second.actor.object;
        let second = if self.actors.contains_key(&second) {
            second
        } else {
            WORLD
        };
        let bodies = [body(message.first.actor.object)?, body(second)?];
        let joint = joint::between(message, bodies).ok_or(Refusal::Joint)?;
        lead.command(&Command::AddJoint { id, joint })?;
        Ok(())
    }
}

/// The actor that a joint holds which names one that does not exist.
const WORLD: u32 = u32::MAX;
/// A share of a mass by which rounding may change it.
const SAME_MASS: f32 = 1e-6;

/// A body as the actor that it is.
fn seen_as(frame: &Frame, seen: &Observation) -> BodyMotion {
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = seen.motion.parts();
    let (position, rotation) = frame.actor_of(Vec3::new(px, py, pz), Quat::from_xyzw(x, y, z, w));
    BodyMotion {
        position,
        rotation,
        linear: Vec3::new(vx, vy, vz),
        angular: Vec3::new(wx, wy, wz),
    }
}

/// Whether a body is what its actor has become.
fn is_as(body: &ActorBody, form: &Form, actor: &Actor, lead: &Lead<'_>) -> bool {
    body.frame == form.frame
        && body.material == form.material
        && body.gravity == actor.gravity
        && body.upright == actor.upright
        && lead.scene().shape(body.shape) == Some(&form.shape)
}

/// Has a body do what was said of its actor's motion.
fn steer(
    actor: &Actor,
    body: &ActorBody,
    target_motion: TargetMotion,
    now: BodyMotion,
    lead: &mut Lead<'_>,
) -> Result<(), Refusal> {
    let elsewhere = (actor.position, actor.rotation) != (now.position, now.rotation);
    if elsewhere {
        let (position, rotation) = body.frame.body_of(actor.position, actor.rotation);
        lead.command(&Command::SetPose {
            id: body.id,
            position,
            rotation,
        })?;
    }
    let set_going = target_motion.linear.is_some() || target_motion.angular.is_some();
    let otherwise = (actor.linear, actor.angular) != (now.linear, now.angular);
    if set_going && otherwise && actor.kind == BodyKind::Dynamic {
        lead.command(&Command::SetVelocity {
            id: body.id,
            linear: actor.linear,
            angular: actor.angular,
        })?;
    }
    Ok(())
}
