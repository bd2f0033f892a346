//! Applies an APP client's messages since the last frame to its scene.
//!
//! In the order of messages, and once for each actor. An actor of another form is removed and added again at its
//! place, under the next generation of its index; an actor that only moves is moved. Joints come last, when all bodies
//! exist.
//!
//! Moving bodies stay above ground that changed. Ground is a surface: a body below a new one would fall for ever.
//! Regions set their ground two or three times while bodies already rest on it. A body below the ground is placed
//! above it by its own size.

use glam::{DQuat, DVec3, Quat, Vec3};
use rhumb_protocol::limits::JOINTS_MAX;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, Compound, Heights, JointId, LockedAxes, Shape,
};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, BodyState};

use crate::actor::{
    Actor, ActorBody, ActorProperties, Frame, TargetMotion, again, body_properties, joint_between,
    keeps_upright,
};
use crate::gateway::{Refusal, RefusedMessage};
use crate::message::AddJoint;
use crate::scene::{CommandSubject, OwnScene, Sent};
use crate::world_mirror::{JointRecord, MATERIAL, WorldMirror};

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
    pub(super) fn apply(&mut self, scene: &mut OwnScene) -> FrameResult {
        let mut result = FrameResult::default();
        for name in std::mem::take(&mut self.removed_joints) {
            // A joint is removed with its body: it may be gone already.
            let _ = scene.command(&Command::RemoveJoint { id: name });
        }
        for body in std::mem::take(&mut self.removed_bodies) {
            self.take_out(&body, scene);
        }
        let mut grounds = Vec::new();
        for (name, index) in self.take_touched() {
            let Some(mut actor) = self.actors.remove(&name) else {
                continue;
            };
            let before = actor.body.map(|body| body.id);
            scene.about = Some((name, index));
            if let Err(refusal) = self.apply_actor(name, &mut actor, scene, &mut result) {
                let refused = RefusedMessage::at_frame(index, name, refusal);
                result.refused.push(refused);
            }
            let ground = actor.body.map(|body| body.id);
            let is_new = ground != before && actor.kind == BodyKind::Fixed;
            grounds.extend(ground.filter(|_| is_new));
            self.actors.insert(name, actor);
        }
        scene.about = None;
        for ground in grounds {
            depenetrate(self, ground, scene);
        }
        self.apply_joints(scene, &mut result);
        result
    }

    fn take_out(&mut self, body: &ActorBody, scene: &mut OwnScene) {
        self.forget_body(body.id);
        // A body that left the world is gone already.
        if scene.body(body.id).is_some() {
            let _ = scene.command(&Command::RemoveBody { id: body.id });
        }
        self.shape_cache.give_back(body.shape, scene);
        for record in self.joints.values_mut() {
            let is_absent = |id: JointId| !scene.has_joint(id);
            record.name = record.name.filter(|id| !is_absent(*id));
        }
    }

    fn apply_actor(
        &mut self,
        name: u32,
        actor: &mut Actor,
        scene: &mut OwnScene,
        result: &mut FrameResult,
    ) -> Result<(), Refusal> {
        let properties = body_properties(actor.kind, &actor.parts, MATERIAL);
        if let Some(message) = actor.reported_mass
            && (message - properties.mass).abs() > message * SAME_MASS
        {
            actor.reported_mass = Some(properties.mass);
            result.masses.push((name, properties.mass));
        }
        let present = actor.body.and_then(|body| scene.observation(body.id));
        if let (Some(body), None) = (&actor.body, &present)
            && actor.target_motion.position.is_none()
            && scene.body(body.id).is_none()
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
            (Some(body), Some(now)) if is_as(&body, &properties, actor, scene) => {
                steer(actor, &body, target_motion, now, scene)
            }
            _ => self.put_in(name, actor, properties, scene),
        }
    }

    /// Adds an actor to the scene, in place of its former body.
    fn put_in(
        &mut self,
        name: u32,
        actor: &mut Actor,
        properties: ActorProperties,
        scene: &mut OwnScene,
    ) -> Result<(), Refusal> {
        let before = actor.body.take();
        // The client's library takes the index of a body that left the world for other bodies.
        let is_there = before.is_some_and(|before| scene.body(before.id).is_some());
        if let Some(before) = &before {
            self.take_out(before, scene);
        }
        let again = before
            .filter(|_| is_there)
            .and_then(|before| again(before.id));
        let id = match again {
            Some(id) => id,
            None => scene.new_id().map_err(|_| Refusal::TooMany)?,
        };
        let taken = self.shape_cache.take(&properties.shape, scene);
        let shape = match taken {
            Ok(shape) => shape,
            Err(error) => {
                tracing::warn!(actor = name, %error, "an actor has no shape in its scene");
                let nothing = Shape::Compound(Compound::nothing());
                self.shape_cache.take(&nothing, scene)?
            }
        };
        let mut desc = BodyDesc::plain(id, actor.kind, shape);
        desc.material = properties.material;
        desc.gravity_scale = actor.gravity;
        if actor.upright {
            desc.locked = LockedAxes::ROTATIONS;
        }
        let (position, rotation) = properties.frame.body_of(actor.position, actor.rotation);
        let still = actor.kind == BodyKind::Fixed;
        let [linear, angular] =
            [actor.linear, actor.angular].map(|velocity| if still { Vec3::ZERO } else { velocity });
        let motion = BodyState::new(
            position.to_array(),
            rotation.to_array(),
            linear.to_array(),
            angular.to_array(),
        )
        .map_err(|_| Refusal::Number)?;
        if let Err(error) = scene.command(&Command::AddBody { desc, motion }) {
            self.shape_cache.give_back(shape, scene);
            scene.take_back(id);
            return Err(error.into());
        }
        self.note_body(id, name);
        actor.body = Some(ActorBody {
            id,
            shape,
            frame: properties.frame,
            material: properties.material,
            gravity: actor.gravity,
            upright: actor.upright,
        });
        Ok(())
    }

    fn apply_joints(&mut self, scene: &mut OwnScene, result: &mut FrameResult) {
        let waiting: Vec<u32> = self
            .joints
            .iter()
            .filter(|(_, record)| record.name.is_none() && !keeps_upright(&record.message))
            .map(|(name, _)| *name)
            .collect();
        for name in waiting {
            let Some(JointRecord { message, index, .. }) = self.joints.get(&name).copied() else {
                continue;
            };
            if !self.actors.contains_key(&message.second.actor.object) {
                self.add_world(index, scene, result);
            }
            let joined = self.free_joint(scene).and_then(|id| {
                self.hold(&message, id, scene)?;
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
                    result.refused.push(refused);
                }
            }
        }
    }

    /// Takes back what the scene refused, and adds what its client learns to the result.
    pub(super) fn take_back(&mut self, scene: &mut OwnScene, result: &mut FrameResult) {
        for (Sent { subject, about }, error) in scene.take_refused() {
            let (name, index) = match subject {
                CommandSubject::Shape(id) => {
                    tracing::warn!(?about, %error, "an actor has no shape in its scene");
                    self.shape_cache.refuse(id);
                    continue;
                }
                CommandSubject::Body(id) => {
                    match about.filter(|_| self.take_back_body(id, error, scene)) {
                        Some(of) => of,
                        None => continue,
                    }
                }
                CommandSubject::Joint(id) => match self.take_back_joint(id) {
                    Some(of) => of,
                    None => continue,
                },
                CommandSubject::Motion => match about {
                    Some(of) => of,
                    None => continue,
                },
                // A body that is removed may be gone, and a static actor is not pushed.
                CommandSubject::Other => {
                    tracing::debug!(?about, %error, "a command of an app client was refused");
                    continue;
                }
            };
            let refused = RefusedMessage::at_frame(index, name, error.into());
            result.refused.push(refused);
        }
    }

    /// Forgets a body that was refused; true if its client learns of it. An actor whose shape was refused gets a body without
    /// shape at the next frame.
    fn take_back_body(&mut self, id: BodyId, error: CommandError, scene: &mut OwnScene) -> bool {
        let Some((name, _)) = self.actor_of(id) else {
            return false;
        };
        self.forget_body(id);
        let actor = self.actors.get_mut(&name);
        if let Some(body) = actor.and_then(|actor| actor.body.take()) {
            self.bodiless.insert(name);
            self.shape_cache.give_back(body.shape, scene);
        }
        scene.take_back(id);
        let lacks_shape = matches!(error, CommandError::UnknownShape(_));
        if lacks_shape {
            self.touch(name);
        }
        !lacks_shape
    }

    /// Forgets a joint that was refused; returns its first actor and its message.
    fn take_back_joint(&mut self, id: JointId) -> Option<(u32, u32)> {
        let mut joints = self.joints.iter();
        let (name, _) = joints.find(|(_, record)| record.name == Some(id))?;
        let name = *name;
        let record = self.joints.remove(&name)?;
        Some((record.message.first.actor.object, record.index))
    }

    /// A joint number that the scene does not use, after the last one.
    fn free_joint(&self, scene: &OwnScene) -> Result<JointId, Refusal> {
        let from = (self.last_joint + 1) % JOINTS_MAX;
        let mut numbers = (from..JOINTS_MAX).chain(0..from).map(JointId);
        let free = numbers.find(|id| !scene.has_joint(*id));
        free.ok_or(Refusal::TooMany)
    }

    /// Adds a body that represents the world, for joints to it; `index`: of the joint's message.
    fn add_world(&mut self, index: u32, scene: &mut OwnScene, result: &mut FrameResult) {
        let stands = Actor::new(BodyKind::Fixed, Vec3::ZERO, Quat::IDENTITY);
        let mut world = self.actors.remove(&WORLD).unwrap_or(stands);
        if world.body.is_none()
            && let Err(refusal) = self.apply_actor(WORLD, &mut world, scene, result)
        {
            result
                .refused
                .push(RefusedMessage::at_frame(index, WORLD, refusal));
        }
        self.actors.insert(WORLD, world);
    }

    fn hold(&self, message: &AddJoint, id: JointId, scene: &mut OwnScene) -> Result<(), Refusal> {
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
        let joint = joint_between(message, bodies).ok_or(Refusal::Joint)?;
        scene.command(&Command::AddJoint {
            id,
            joint: joint.into(),
        })?;
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

/// True if a body still matches its actor.
fn is_as(body: &ActorBody, properties: &ActorProperties, actor: &Actor, scene: &OwnScene) -> bool {
    body.frame == properties.frame
        && body.material == properties.material
        && body.gravity == actor.gravity
        && body.upright == actor.upright
        && scene.shape(body.shape) == Some(&properties.shape)
}

/// Applies an actor's requested motion to its body.
fn steer(
    actor: &Actor,
    body: &ActorBody,
    target_motion: TargetMotion,
    now: BodyMotion,
    scene: &mut OwnScene,
) -> Result<(), Refusal> {
    let elsewhere = (actor.position, actor.rotation) != (now.position, now.rotation);
    if elsewhere {
        let (position, rotation) = body.frame.body_of(actor.position, actor.rotation);
        scene.command(&Command::SetPose {
            id: body.id,
            position,
            rotation,
        })?;
    }
    let set_going = target_motion.linear.is_some() || target_motion.angular.is_some();
    let otherwise = (actor.linear, actor.angular) != (now.linear, now.angular);
    if set_going && otherwise && actor.kind == BodyKind::Dynamic {
        scene.command(&Command::SetVelocity {
            id: body.id,
            linear: actor.linear,
            angular: actor.angular,
        })?;
    }
    Ok(())
}

/// Raises the bodies below a body's height field.
fn depenetrate(mirror: &WorldMirror, ground: BodyId, scene: &mut OwnScene) {
    let shape_of = |scene: &OwnScene, id| scene.shape(scene.body(id)?.shape).cloned();
    let (Some(Shape::Heights(field)), Some(at)) =
        (shape_of(scene, ground), scene.observation(ground))
    else {
        return;
    };
    let (origin, turned) = pose(&at.motion.parts());
    let moving = mirror
        .actors
        .values()
        .filter(|a| a.kind == BodyKind::Dynamic);
    let bodies: Vec<BodyId> = moving.filter_map(|a| a.body).map(|body| body.id).collect();
    for id in bodies {
        let Some(observation) = scene.observation(id) else {
            continue;
        };
        let parts = observation.motion.parts();
        let (position, _) = pose(&parts);
        let mut local = turned.conjugate() * (position - origin);
        let surface = highest_near(&field, local);
        if surface.is_none_or(|surface| local.y >= surface) {
            continue;
        }
        let radius = shape_of(scene, id).map_or(0.0, |shape| shape.bounding_radius().metres());
        local.y = surface.unwrap_or(local.y) + radius;
        let raised = Command::SetPose {
            id,
            position: (origin + turned * local).as_vec3(),
            rotation: Quat::from_xyzw(parts[3], parts[4], parts[5], parts[6]),
        };
        if let Err(error) = scene.command(&raised) {
            tracing::warn!(%id, %error, "a body stays under the ground");
        }
    }
}

fn pose(parts: &[f32; 13]) -> (DVec3, DQuat) {
    let position = Vec3::new(parts[0], parts[1], parts[2]);
    let rotation = Quat::from_xyzw(parts[3], parts[4], parts[5], parts[6]);
    (position.as_dvec3(), rotation.as_dquat().normalize())
}

/// The highest corner of the cell at a point; `None` beside the field.
fn highest_near(field: &Heights, at: DVec3) -> Option<f64> {
    let cell = |along: f64, spacing: f32, count: u32| {
        let place = (along / f64::from(spacing)).floor();
        (place >= 0.0 && place < f64::from(count - 1)).then_some(place as usize)
    };
    let row = cell(at.x, field.row_spacing(), field.rows())?;
    let column = cell(at.z, field.column_spacing(), field.columns())?;
    let columns = field.columns() as usize;
    let here = row * columns + column;
    let corners = [here, here + 1, here + columns, here + columns + 1];
    let heights = corners.map(|corner| f64::from(field.heights()[corner]));
    Some(heights.into_iter().fold(f64::MIN, f64::max))
}
