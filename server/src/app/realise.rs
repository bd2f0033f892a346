//! Applies an APP client's messages since the last frame to its scene.
//!
//! In the order of messages, and once for each actor. An actor of another form is removed and added again at its
//! place, under the next generation of its index; an actor that only moves is moved. Joints come last, when all bodies
//! exist.

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

/// Results of a frame for the client.
#[derive(Debug, Default)]
pub(super) struct FrameResult {
    /// Masses that differ from the reported ones, kg, by actor.
    pub(super) masses: Vec<(u32, f32)>,
    /// Messages that could not be applied.
    pub(super) refused: Vec<RefusedMessage>,
}

/// Pose and velocities of an actor.
#[derive(Clone, Copy, Debug)]
struct BodyMotion {
    position: Vec3,
    rotation: Quat,
    linear: Vec3,
    angular: Vec3,
}

impl WorldMirror {
    /// Applies all messages since the last frame.
    pub(super) fn realise(&mut self, lead: &mut Lead<'_>) -> FrameResult {
        let mut realised = FrameResult::default();
        for name in std::mem::take(&mut self.removed_joints) {
            // A joint goes with its body: it may not exist any more.
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
        // A body that left the world does not exist any more.
        let _ = lead.command(&Command::RemoveBody { id: body.id });
        self.shape_cache.give_back(body.shape, lead);
        for record in self.joints.values_mut() {
            let is_absent = |id: JointId| lead.scene().joints().get(id).is_none();
            record.name = record.name.filter(|id| !is_absent(*id));
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
        if let Some(message) = actor.reported_mass
            && (message - form.mass).abs() > message * SAME_MASS
        {
            actor.reported_mass = Some(form.mass);
            realised.masses.push((name, form.mass));
        }
        let present = actor
            .body
            .and_then(|body| lead.scene().observation(body.id));
        if let (Some(body), None) = (&actor.body, &present)
            && actor.target_motion.position.is_none()
            && lead.scene().body(body.id).is_none()
        {
            // The body left the world, and no message sets a new position.
            actor.fulfil();
            return Ok(());
        }
        let target_motion = actor.target_motion;
        let now = actor
            .body
            .zip(present)
            .map(|(body, observation)| actor_motion(&body.frame, &observation));
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

    /// Adds an actor to the scene, in place of its former body.
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
            .filter(|(_, record)| record.name.is_none() && !joint::is_upright(&record.message))
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
                    if let Some(record) = self.joints.get_mut(&name) {
                        record.name = Some(id);
                    }
                }
                // The other actor may still come.
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

    /// A joint number that the scene does not use, after the last one.
    fn free_joint(&self, lead: &Lead<'_>) -> Result<JointId, Refusal> {
        let from = (self.last_joint + 1) % JOINTS_MAX;
        let mut numbers = (from..JOINTS_MAX).chain(0..from).map(JointId);
        let free = numbers.find(|id| lead.scene().joints().get(*id).is_none());
        free.ok_or(Refusal::TooMany)
    }

    /// Adds a body that represents the world, for joints to it; `index`: of the joint's message.
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

/// Name in a joint that no actor has: the world.
const WORLD: u32 = u32::MAX;
/// Share of a mass by which rounding may change it.
const SAME_MASS: f32 = 1e-6;

/// A body's motion as that of its actor.
fn actor_motion(frame: &Frame, observation: &Observation) -> BodyMotion {
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = observation.motion.parts();
    let (position, rotation) = frame.actor_of(Vec3::new(px, py, pz), Quat::from_xyzw(x, y, z, w));
    BodyMotion {
        position,
        rotation,
        linear: Vec3::new(vx, vy, vz),
        angular: Vec3::new(wx, wy, wz),
    }
}

/// Whether a body still matches its actor.
fn is_as(body: &ActorBody, form: &Form, actor: &Actor, lead: &Lead<'_>) -> bool {
    body.frame == form.frame
        && body.material == form.material
        && body.gravity == actor.gravity
        && body.upright == actor.upright
        && lead.scene().shape(body.shape) == Some(&form.shape)
}

/// Applies an actor's requested motion to its body.
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
