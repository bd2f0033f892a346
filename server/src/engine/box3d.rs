//! Box3D as the engine of a scene.
//!
//! Behind the feature `box3d`; no type of Box3D leaves this file and its helpers. It has no images and no copies: its
//! scenes are neither stored nor restored. Invariants: queries find bodies where the last step left them; a kinematic body
//! is awake only while it moves. Its cap of the speed of dynamic bodies is set to that of all engines, and it caps no spin.

mod body;
mod native;

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet};
use std::mem;
use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::{Quat, Vec3};
use rhumb_protocol::limits::COORDINATE_MAX;
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyKind, Contact, Joint, JointId, Locomotion, Query, QueryCandidate,
    SceneConfig, Shape, ShapeId,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Inertia, Integrator, Twist};
use rhumb_solids::PlacedBodies;

use self::body::{self as translate, Box3dJoints, Box3dSolid};
use self::native::{NativeBody, NativeShape, Placement, World};
use super::interface::{
    BakedShape, Baker, BodyProperties, Engine, EngineFault, EnginePart, NoEngine, Push, SPEED_MAX,
    UnanswerableQuery, UnusableShape, inertia,
};
use super::kinematic_target::{KinematicStep, KinematicTarget};

/// A Box3D world.
pub struct Box3dEngine {
    world: World,
    integrator: Integrator,
    solids: BTreeMap<ShapeId, Box3dSolid>,
    joints: Box3dJoints,
    bodies: BTreeMap<BodyId, Box3dBody>,
    /// Body of each shape of the world.
    owners: BTreeMap<NativeShape, BodyId>,
    /// Sensors, and the shapes inside them.
    inside: BTreeSet<(NativeShape, NativeShape)>,
    /// Kinematic bodies that move.
    kinematic_targets: BTreeMap<BodyId, KinematicTarget>,
    /// Kinematic bodies that moved in the last step.
    moved: BTreeSet<BodyId>,
    /// Bodies that are observed as asleep after the next step, unless they move.
    displaced: BTreeSet<BodyId>,
    /// True if a command has put a body to sleep since the last step.
    put_to_sleep: bool,
    /// Changes of velocities by the forces and torques since the last step.
    pending: BTreeMap<BodyId, Twist>,
    /// After the last step, in the order of ids.
    observed: Vec<Observation>,
    /// The bodies where the last step left them, once a query needs them.
    placed: OnceCell<PlacedBodies>,
}

/// A body of the world, its shapes, and its pose after the last step.
struct Box3dBody {
    body: NativeBody,
    shapes: Vec<NativeShape>,
    properties: BodyProperties,
    stepped: Placement,
}

impl Box3dBody {
    /// True for an enabled body of a kind.
    fn is(&self, kind: BodyKind) -> bool {
        self.properties.desc.enabled && self.properties.desc.kind == kind
    }
}

impl Box3dEngine {
    /// An empty world under this configuration.
    ///
    /// # Errors
    ///
    /// [`NoEngine`] if the process has as many worlds as Box3D allows: 128.
    pub fn new(config: &SceneConfig) -> Result<Self, NoEngine> {
        Ok(Self {
            world: World::new(config.gravity, SPEED_MAX).ok_or(NoEngine)?,
            integrator: config.integrator,
            solids: BTreeMap::new(),
            joints: Box3dJoints::default(),
            bodies: BTreeMap::new(),
            owners: BTreeMap::new(),
            inside: BTreeSet::new(),
            kinematic_targets: BTreeMap::new(),
            moved: BTreeSet::new(),
            displaced: BTreeSet::new(),
            put_to_sleep: false,
            pending: BTreeMap::new(),
            observed: Vec::new(),
            placed: OnceCell::new(),
        })
    }

    /// Seconds of a step.
    fn dt(&self) -> f32 {
        self.integrator.rate.step().seconds() as f32
    }

    /// Sets everything of a body beside its shapes.
    fn configure(&mut self, body: NativeBody, properties: &BodyProperties) {
        translate::set_properties(&mut self.world, body, properties, self.integrator);
        let solid = self.solids.get(&properties.desc.shape);
        let unit = solid.and_then(|solid| solid.unit);
        translate::weigh(&mut self.world, body, properties, unit);
    }

    /// Gives a body the shapes of its solid in place of those that it has.
    fn reshape(&mut self, slot: &mut Box3dBody) {
        self.strip(slot);
        let Some(solid) = self.solids.get(&slot.properties.desc.shape) else {
            return;
        };
        let surface = translate::surface(&slot.properties);
        for piece in &solid.pieces {
            if let Some(shape) = self.world.attach(slot.body, piece, &surface) {
                slot.shapes.push(shape);
                self.owners.insert(shape, slot.properties.desc.id);
            }
        }
    }

    /// Takes a body's shapes out of the world.
    fn strip(&mut self, slot: &mut Box3dBody) {
        for shape in slot.shapes.drain(..) {
            self.owners.remove(&shape);
            self.inside
                .retain(|(one, other)| *one != shape && *other != shape);
            self.world.detach(shape);
        }
    }

    /// Wakes the bodies that a body touched in the last step.
    fn wake_touching(&mut self, body: NativeBody) {
        for contact in self.world.contacts(body) {
            for shape in contact.shapes {
                let owner = self.owners.get(&shape);
                let slot = owner.and_then(|id| self.bodies.get(id));
                if let Some(slot) = slot.filter(|slot| slot.is(BodyKind::Dynamic)) {
                    self.world.set_awake(slot.body, true);
                }
            }
        }
    }

    fn discard(&mut self, id: BodyId) {
        if let Some(mut slot) = self.bodies.remove(&id) {
            self.wake_touching(slot.body);
            self.strip(&mut slot);
            self.world.remove_body(slot.body);
            self.kinematic_targets.remove(&id);
            self.displaced.remove(&id);
            self.moved.remove(&id);
            self.pending.remove(&id);
            self.placed.take();
        }
    }

    /// The target of a kinematic body.
    fn kinematic_target(&mut self, id: BodyId, body: NativeBody) -> &mut KinematicTarget {
        let (position, rotation) = self.world.pose(body);
        let target = self.kinematic_targets.entry(id);
        target.or_insert_with(|| KinematicTarget::at(translate::widen(position, rotation)))
    }

    /// Sets kinematic bodies on their ways, and stops those that have arrived.
    fn lead(&mut self) {
        let dt = self.dt();
        let integrator = self.integrator;
        (self.kinematic_targets).retain(|_, target| target.is_needed(integrator));
        let before = mem::take(&mut self.moved);
        for (id, target) in &mut self.kinematic_targets {
            let is_moving = target.is_moving();
            let step = target.advance(integrator);
            let slot = self.bodies.get(id).filter(|_| is_moving);
            if let Some(slot) = slot {
                let next = translate::narrow(&step.pose());
                match step {
                    KinematicStep::Move(_) => self.world.go_to(slot.body, next, dt),
                    KinematicStep::Jump(_) => {
                        self.world.set_pose(slot.body, next);
                        self.world
                            .set_velocities(slot.body, (Vec3::ZERO, Vec3::ZERO));
                    }
                }
                self.moved.insert(*id);
            }
        }
        for id in before.difference(&self.moved) {
            if let Some(slot) = self.bodies.get(id) {
                self.world
                    .set_velocities(slot.body, (Vec3::ZERO, Vec3::ZERO));
                self.displaced.insert(*id);
            }
        }
    }

    /// Puts kinematic bodies at the exact ends of their ways, so that rounding does not add up.
    fn arrive(&mut self) {
        for id in &self.moved {
            let slot = self.bodies.get(id);
            if let Some((slot, target)) = slot.zip(self.kinematic_targets.get(id)) {
                let exact = translate::narrow(&target.pose());
                self.world.set_pose(slot.body, exact);
            }
        }
    }

    /// A body falls asleep with the one that a command puts to sleep, though the last step saw it move.
    fn note_calmed(&mut self) {
        if !mem::take(&mut self.put_to_sleep) {
            return;
        }
        for seen in &self.observed {
            let slot = self.bodies.get(&seen.id);
            let slot = slot.filter(|slot| slot.is(BodyKind::Dynamic));
            if slot.is_some_and(|slot| !self.world.is_awake(slot.body)) {
                self.displaced.insert(seen.id);
            }
        }
    }

    fn note_sensors(&mut self) {
        let [ended, began] = self.world.sensor_changes();
        for pair in ended {
            self.inside.remove(&pair);
        }
        self.inside.extend(began);
    }

    /// Fills the observations of this step, and removes the bodies that are lost.
    fn look(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) {
        let displaced = mem::take(&mut self.displaced).into_iter();
        let mut seen: BTreeMap<_, _> = displaced.map(|id| (id, Activity::Asleep)).collect();
        for (tag, fell_asleep) in self.world.moves() {
            let id = translate::id(tag);
            let slot = self.bodies.get(&id);
            if slot.is_some_and(|slot| slot.is(BodyKind::Dynamic)) {
                let activity = if fell_asleep {
                    Activity::Asleep
                } else {
                    Activity::Awake
                };
                seen.insert(id, activity);
            }
        }
        seen.extend(self.moved.iter().map(|id| (*id, Activity::Awake)));
        self.observed.clear();
        let first = lost.len();
        for (id, activity) in seen {
            match self.observe_as(id, activity) {
                Some(Ok(observation)) => {
                    if let Some(slot) = self.bodies.get_mut(&id) {
                        slot.stepped = self.world.pose(slot.body);
                    }
                    self.observed.push(observation);
                }
                Some(Err(cause)) => lost.push((id, cause)),
                None => {}
            }
        }
        for (id, _) in &lost[first..] {
            self.discard(*id);
        }
    }

    /// The observation of a body, or the reason to remove it; `None` if it is not there.
    fn observe_as(
        &self,
        id: BodyId,
        activity: Activity,
    ) -> Option<Result<Observation, RemovalCause>> {
        let slot = self.bodies.get(&id)?;
        let target = self.kinematic_targets.get(&id);
        let target = target.filter(|_| activity == Activity::Awake);
        let kept = target.and_then(KinematicTarget::kept);
        let Ok(motion) = translate::motion(&self.world, slot.body, kept) else {
            return Some(Err(RemovalCause::NotFinite));
        };
        let (position, _) = self.world.pose(slot.body);
        if position.abs().max_element() > COORDINATE_MAX {
            return Some(Err(RemovalCause::LeftWorld));
        }
        Some(Ok(Observation {
            id,
            motion,
            activity,
        }))
    }

    /// The bodies where the last step left them.
    fn placed(&self) -> &PlacedBodies {
        self.placed.get_or_init(|| {
            let enabled = |slot: &&Box3dBody| slot.properties.desc.enabled;
            let bodies = self.bodies.values().filter(enabled).filter_map(|slot| {
                let desc = &slot.properties.desc;
                let solid = self.solids.get(&desc.shape)?;
                Some((QueryCandidate::of(desc), slot.stepped, &solid.parts[..]))
            });
            PlacedBodies::new(bodies)
        })
    }
}

impl Engine for Box3dEngine {
    fn supports(&self, part: EnginePart<'_>) -> bool {
        match part {
            EnginePart::Shape(shape) => translate::supports_shape(shape),
            // Box3D has no dominance, and always has gyroscopic forces.
            EnginePart::Body(body) => body.desc.dominance == 0 && body.desc.gyroscopic,
            EnginePart::Joint(joint) => translate::supports_joint(joint),
            EnginePart::Locomotion(locomotion) => matches!(locomotion, Locomotion::None),
        }
    }

    fn add_shape(&mut self, id: ShapeId, shape: &Shape) -> Result<(), UnusableShape> {
        self.solids.insert(id, translate::solid(shape)?);
        Ok(())
    }

    fn baker(&self) -> Option<Baker> {
        Some(|shape| translate::solid(shape).map(BakedShape::new))
    }

    fn add_baked(&mut self, id: ShapeId, baked: BakedShape) -> Result<(), UnusableShape> {
        (self.solids).insert(id, baked.into_solid().ok_or(UnusableShape)?);
        Ok(())
    }

    fn moment(&self, body: &BodyProperties) -> Option<f32> {
        if body.desc.kind == BodyKind::Dynamic && body.desc.mass.is_some() {
            return None;
        }
        let unit = self.solids.get(&body.desc.shape)?.unit;
        let greatest = unit.map_or(0.0, |unit| unit.moments.max_element());
        Some(greatest * body.material.density)
    }

    fn remove_shape(&mut self, id: ShapeId) {
        self.solids.remove(&id);
    }

    fn add(&mut self, body: &BodyProperties, motion: BodyState) {
        let (id, properties) = (body.desc.id, *body);
        let new = translate::new_body(&properties, &motion);
        let body = self.world.add_body(&new);
        let mut slot = Box3dBody {
            body,
            shapes: Vec::new(),
            properties,
            stepped: new.at,
        };
        self.reshape(&mut slot);
        self.configure(body, &properties);
        self.bodies.insert(id, slot);
        if properties.desc.kind == BodyKind::Kinematic && properties.desc.enabled {
            self.displaced.insert(id);
            let twist = motion.motion().twist();
            self.kinematic_target(id, body).keep(twist);
        }
    }

    fn change(&mut self, before: &BodyDesc, body: &BodyProperties) {
        let now = &body.desc;
        let Some(mut slot) = self.bodies.remove(&now.id) else {
            return;
        };
        self.wake_touching(slot.body);
        let keeps_shapes = before.shape == now.shape
            && slot.properties.material == body.material
            && before.groups == now.groups
            && before.sensor == now.sensor;
        slot.properties = *body;
        let native = slot.body;
        translate::set_kind(&mut self.world, native, now.kind);
        if !keeps_shapes {
            self.reshape(&mut slot);
        }
        self.bodies.insert(now.id, slot);
        self.configure(native, body);
        if now.kind != BodyKind::Kinematic || !now.enabled {
            self.kinematic_targets.remove(&now.id);
        }
        if now.kind == BodyKind::Dynamic && now.enabled {
            self.world.set_awake(native, true);
        } else {
            self.displaced.insert(now.id);
        }
    }

    fn remove(&mut self, id: BodyId) {
        self.discard(id);
    }

    fn add_joint(&mut self, id: JointId, joint: &Joint) {
        let [Some(first), Some(second)] = joint.bodies.map(|body| self.bodies.get(&body)) else {
            return;
        };
        let bodies = [first.body, second.body];
        self.joints.add(&mut self.world, bodies, (id, joint));
    }

    fn remove_joint(&mut self, id: JointId) {
        self.joints.remove(&mut self.world, id);
    }

    fn overloaded_joints(&self, out: &mut Vec<JointId>) {
        self.joints.overloaded(&self.world, out);
    }

    fn set_pose(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        let Some(slot) = self.bodies.get(&id) else {
            return;
        };
        let (body, is_dynamic) = (slot.body, slot.is(BodyKind::Dynamic));
        if slot.is(BodyKind::Kinematic) {
            let to = translate::widen(position, rotation);
            let integrator = self.integrator;
            self.kinematic_target(id, body).go_to(to, integrator);
        } else if self.world.pose(body) != (position, rotation) {
            self.wake_touching(body);
            self.world.set_pose(body, (position, rotation));
            if is_dynamic {
                self.world.set_awake(body, true);
            }
            // Another command may put it to sleep before it moves.
            self.displaced.insert(id);
        }
    }

    fn set_velocity(&mut self, id: BodyId, twist: Twist) {
        let Some(slot) = self.bodies.get(&id) else {
            return;
        };
        let body = slot.body;
        if slot.is(BodyKind::Kinematic) {
            self.kinematic_target(id, body).keep(twist);
        } else {
            translate::set_twist(&mut self.world, body, &twist);
        }
    }

    fn set_activity(&mut self, id: BodyId, activity: Activity) {
        if let Some(slot) = self.bodies.get(&id) {
            let is_awake = activity == Activity::Awake;
            self.world.set_awake(slot.body, is_awake);
            if !is_awake {
                self.displaced.insert(id);
                self.put_to_sleep = true;
            }
        }
    }

    fn effect(&self, id: BodyId, push: Push) -> Option<Twist> {
        let slot = self.bodies.get(&id)?;
        let (linear, angular) = translate::effect(&self.world, slot.body, push, self.dt());
        Some(Twist {
            linear: linear.as_dvec3(),
            angular: angular.as_dvec3(),
        })
    }

    fn pending(&self, id: BodyId) -> Twist {
        self.pending.get(&id).copied().unwrap_or(Twist::ZERO)
    }

    fn push(&mut self, id: BodyId, push: Push) {
        let lasts = matches!(push, Push::Force(_) | Push::ForceAt(..) | Push::Torque(_));
        if let Some(effect) = self.effect(id, push).filter(|_| lasts) {
            let pending = self.pending.entry(id).or_default();
            pending.linear += effect.linear;
            pending.angular += effect.angular;
        }
        if let Some(slot) = self.bodies.get(&id) {
            translate::push(&mut self.world, slot.body, push);
        }
    }

    fn set_gravity(&mut self, gravity: Vec3) {
        if self.world.gravity() == gravity {
            return;
        }
        self.world.set_gravity(gravity);
        let dynamic = self
            .bodies
            .values()
            .filter(|slot| slot.is(BodyKind::Dynamic));
        for slot in dynamic {
            self.world.set_awake(slot.body, true);
        }
    }

    fn step(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) -> Result<(), EngineFault> {
        self.note_calmed();
        self.lead();
        let substeps = translate::substeps(self.integrator);
        let substeps = i32::try_from(substeps).unwrap_or(i32::MAX);
        self.world.step(self.dt(), substeps);
        self.pending.clear();
        self.placed.take();
        self.arrive();
        self.note_sensors();
        self.look(lost);
        Ok(())
    }

    fn observe(&self, out: &mut Vec<Observation>) {
        out.extend_from_slice(&self.observed);
    }

    fn observe_one(&self, id: BodyId) -> Option<Observation> {
        let slot = self.bodies.get(&id)?;
        let is_awake = (slot.is(BodyKind::Dynamic) && self.world.is_awake(slot.body))
            || self.moved.contains(&id);
        let activity = if is_awake {
            Activity::Awake
        } else {
            Activity::Asleep
        };
        self.observe_as(id, activity)?.ok()
    }

    fn inertia(&self, id: BodyId) -> Option<Inertia> {
        let properties = &self.bodies.get(&id)?.properties;
        let solid = self.solids.get(&properties.desc.shape)?;
        inertia(properties, solid.unit)
    }

    fn contacts(&self, id: BodyId, out: &mut Vec<Contact>) {
        if let Some(slot) = self.bodies.get(&id) {
            let owner = |shape: NativeShape| self.owners.get(&shape).copied();
            let (centre, _) = self.world.pose(slot.body);
            let found = self.world.contacts(slot.body);
            translate::contacts(&found, (id, centre), self.dt(), owner, out);
        }
    }

    fn sensed(&self, id: BodyId, out: &mut Vec<(BodyId, BodyId)>) {
        let owner = |shape: &NativeShape| self.owners.get(shape).copied();
        out.extend(self.inside.iter().filter_map(|(sensor, visitor)| {
            let pair = (owner(sensor)?, owner(visitor)?);
            let is_static = |id| {
                self.bodies
                    .get(id)
                    .is_some_and(|slot| slot.is(BodyKind::Fixed))
            };
            let moves = !is_static(&pair.0) || !is_static(&pair.1);
            (moves && (pair.0 == id || pair.1 == id)).then_some(pair)
        }));
    }

    fn query(&self, query: &Query) -> Result<Answer, UnanswerableQuery> {
        // The project's own search, which panics on some shapes; a query reads the world only.
        let answer = || rhumb_solids::answer(self.placed(), query);
        catch_unwind(AssertUnwindSafe(answer)).map_err(|_| UnanswerableQuery)
    }

    fn awake_count(&self) -> usize {
        let observed = self.observed.iter();
        let awake = observed.filter(|seen| seen.activity == Activity::Awake);
        awake.count()
    }

    fn fault(&self) -> Option<EngineFault> {
        // It does not panic: its code is not Rust.
        None
    }
}
