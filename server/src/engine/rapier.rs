//! Rapier as the engine of a scene.
//!
//! Wraps its `PhysicsWorld`; no type of Rapier leaves this file and its helpers. Invariants: the world takes no step
//! after a panic, since any part may be broken. Bodies that Rapier quarantined are removed when the step returns.

mod body;
mod crossing;
mod crowding;
mod drives;
mod held_joint;
mod image;
mod joints;
mod locomotion;
mod reports;
mod rest_and_spin;
mod solid;
mod stepping;
pub(super) mod threads;

use std::collections::{BTreeMap, BTreeSet};
use std::mem;
use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::{Quat, Vec3};
use rapier3d::math::Pose as RapierPose;
use rapier3d::prelude::{PhysicsWorld, RigidBody, RigidBodyHandle};
use rhumb_protocol::limits::COORDINATE_MAX;
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyEvent, BodyKind, Contact, Joint, JointId, JumpFrom, Locomotion, Query,
    SceneConfig, Shape, ShapeId, WheelInput,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Inertia, Integrator, Twist};

use self::body as translate;
use self::crowding::{Crowded, RapierCrowding};
use self::joints::RapierJoints;
use self::locomotion::RapierCharacters;
use self::locomotion::RapierVehicles;
use self::rest_and_spin::RapierRest;
use self::rest_and_spin::RapierSpin;
use self::solid::{self as solids, Solid};
use self::threads::StepThreads;
use super::interface::{
    BakedShape, Baker, BodyProperties, Engine, EngineFault, FrozenEngine, Push, SPEED_MAX,
    UnanswerableQuery, UnusableShape,
};
use super::kinematic_target::KinematicTarget;

/// A Rapier world.
pub struct RapierEngine {
    world: PhysicsWorld,
    threads: StepThreads,
    integrator: Integrator,
    fault: Option<EngineFault>,
    solids: BTreeMap<ShapeId, Solid>,
    joints: RapierJoints,
    characters: RapierCharacters,
    vehicles: RapierVehicles,
    rest: RapierRest,
    spin: RapierSpin,
    crowding: RapierCrowding,
    /// Slots by body index.
    places: Vec<Option<BodySlot>>,
    /// Kinematic bodies that move.
    kinematic_targets: BTreeMap<BodyId, KinematicTarget>,
    /// Bodies with a force until the next step is over.
    forced: Vec<RigidBodyHandle>,
    /// Bodies that do not move and were displaced or put to sleep since the last step.
    displaced: Vec<BodySlot>,
    /// Bodies that a command has added or moved since the last step. In a step: those that are awake, too.
    stirred: Vec<BodySlot>,
    /// Awake after the last step, in the order of ids.
    awake: Vec<BodySlot>,
    /// Awake after the step before, in the order of ids.
    awake_before: Vec<BodySlot>,
    observed: Vec<Observation>,
    /// Swept bodies.
    swept: BTreeSet<BodyId>,
    /// Sensors.
    sensors: BTreeSet<BodyId>,
    /// Half-spaces.
    half_spaces: BTreeSet<BodyId>,
    /// Where bodies were at the begin of the last step: the buffer of the next one.
    sensor_starts: Vec<(RigidBodyHandle, RapierPose)>,
    /// Sensors that bodies went through within the last step, with the bodies.
    crossed: BTreeSet<(BodyId, BodyId)>,
    /// True if the world has changed since its last step. Rapier's image of a world lacks some changes that are not
    /// stepped yet.
    has_changed: bool,
}

/// A body's id, and its Rapier handle.
#[derive(Clone, Copy, Debug)]
struct BodySlot {
    id: BodyId,
    handle: RigidBodyHandle,
}

impl RapierEngine {
    /// An empty world under this configuration.
    #[must_use]
    pub fn new(config: &SceneConfig) -> Self {
        Self::on(config, &StepThreads::default())
    }

    /// An empty world under this configuration, stepped by these threads.
    #[must_use]
    pub fn on(config: &SceneConfig, threads: &StepThreads) -> Self {
        let mut world = PhysicsWorld::new();
        threads.install(&mut world);
        world.gravity = config.gravity;
        let parameters = &mut world.integration_parameters;
        parameters.dt = config.integrator.rate.step().seconds() as f32;
        parameters.min_ccd_dt = parameters.dt / 100.0;
        parameters.normalized_max_linear_velocity = SPEED_MAX;
        parameters.num_solver_iterations = config.integrator.substeps.get() as usize;
        Self {
            world,
            threads: threads.clone(),
            integrator: config.integrator,
            fault: None,
            solids: BTreeMap::new(),
            joints: RapierJoints::default(),
            characters: RapierCharacters::default(),
            vehicles: RapierVehicles::default(),
            rest: RapierRest::default(),
            spin: RapierSpin::default(),
            crowding: RapierCrowding::default(),
            places: Vec::new(),
            kinematic_targets: BTreeMap::new(),
            forced: Vec::new(),
            displaced: Vec::new(),
            stirred: Vec::new(),
            awake: Vec::new(),
            awake_before: Vec::new(),
            observed: Vec::new(),
            swept: BTreeSet::new(),
            sensors: BTreeSet::new(),
            half_spaces: BTreeSet::new(),
            sensor_starts: Vec::new(),
            crossed: BTreeSet::new(),
            has_changed: false,
        }
    }

    /// Runs code that touches the world; if it panics, the engine is faulted and its world is dropped.
    fn contained(&mut self, work: impl FnOnce(&mut Self)) {
        if self.fault.is_some() {
            return;
        }
        self.has_changed = true;
        if catch_unwind(AssertUnwindSafe(|| work(self))).is_err() {
            self.fault = Some(EngineFault::Panicked);
            let broken = mem::take(&mut self.world);
            // A world that cannot even be dropped is leaked: the outcome does not matter.
            let _ = catch_unwind(AssertUnwindSafe(|| drop(broken)));
            self.solids.clear();
            self.joints.clear();
            self.characters.clear();
            self.vehicles.clear();
            self.places.clear();
            self.kinematic_targets.clear();
            self.stirred.clear();
            self.awake.clear();
            self.observed.clear();
            self.swept.clear();
            self.sensors.clear();
            self.half_spaces.clear();
            self.crossed.clear();
        }
    }

    fn place(&self, id: BodyId) -> Option<BodySlot> {
        let place = self.places.get(id.index() as usize).copied().flatten()?;
        (place.id == id).then_some(place)
    }

    fn body(&self, place: BodySlot) -> Option<&RigidBody> {
        self.world.bodies.get(place.handle)
    }

    fn kinematic_target_mut(&mut self, place: BodySlot) -> Option<&mut KinematicTarget> {
        let body = self.world.bodies.get(place.handle)?;
        let pose = translate::widen(body.translation(), *body.rotation());
        Some(
            self.kinematic_targets
                .entry(place.id)
                .or_insert_with(|| KinematicTarget::at(pose)),
        )
    }

    fn insert(&mut self, new: &BodyProperties, motion: &BodyState) {
        let Some(solid) = self.solids.get(&new.desc.shape) else {
            return;
        };
        let dt = self.world.integration_parameters.dt;
        let mut body = translate::body(new, motion, dt);
        if let Some(mass) = solids::mass_beside(new, solid) {
            body.set_additional_mass_properties(mass, false);
        }
        let is_half_space = solid.is_half_space();
        let handle = self.world.insert_body(body);
        for collider in solids::colliders(new, solid) {
            self.world.insert_collider(collider, Some(handle));
        }
        // Mass beside that of the colliders acts on pushes before the next step too.
        let body = &mut self.world.bodies[handle];
        body.recompute_mass_properties_from_colliders(&self.world.colliders);
        translate::take_over_spin(body);
        let id = new.desc.id;
        let index = id.index() as usize;
        if index >= self.places.len() {
            self.places.resize(index + 1, None);
        }
        let place = BodySlot { id, handle };
        self.places[index] = Some(place);
        self.stirred.push(place);
        self.crowding.place(&self.world, &self.world.bodies[handle]);
        self.note_motion(&new.desc);
        self.note_half_space(id, is_half_space);
        if new.desc.kind == BodyKind::Kinematic && new.desc.enabled {
            self.keep(place, motion.motion().twist());
        }
    }

    fn alter(&mut self, before: &BodyDesc, now: &BodyProperties) {
        let Some(place) = self.place(now.desc.id) else {
            return;
        };
        if let Some(solid) = self.solids.get(&now.desc.shape) {
            let is_half_space = solid.is_half_space();
            self.note_motion(&now.desc);
            self.note_half_space(now.desc.id, is_half_space);
        }
        let Some(solid) = self.solids.get(&now.desc.shape) else {
            return;
        };
        translate::wake_touching(&mut self.world, place.handle);
        let reshaped = before.shape != now.desc.shape;
        solids::change(&mut self.world, place.handle, now, (solid, reshaped));
        let mass = solids::mass_beside(now, solid).unwrap_or_default();
        let dt = self.world.integration_parameters.dt;
        self.stirred.push(place);
        let kept = self.kept(place).unwrap_or(Twist::ZERO);
        let body = &mut self.world.bodies[place.handle];
        translate::set_properties(body, now, dt);
        if !translate::has_velocities(body) {
            let (linear, angular) = translate::narrow_twist(&kept);
            body.set_linvel(linear, false);
            body.set_angvel(angular, false);
        }
        body.set_additional_mass_properties(mass, now.desc.enabled);
        body.recompute_mass_properties_from_colliders(&self.world.colliders);
        translate::take_over_spin(body);
        translate::bound_forces(body, dt);
        let meets = |desc: &BodyDesc| (desc.enabled, desc.kind, desc.sensor, desc.groups);
        if reshaped || meets(before) != meets(&now.desc) {
            let body = &self.world.bodies[place.handle];
            self.crowding.place(&self.world, body);
        }
        if now.desc.kind != BodyKind::Kinematic || !now.desc.enabled {
            self.kinematic_targets.remove(&place.id);
        }
    }

    fn discard(&mut self, id: BodyId) {
        if let Some(place) = self.place(id) {
            self.places[id.index() as usize] = None;
            self.kinematic_targets.remove(&id);
            self.swept.remove(&id);
            self.sensors.remove(&id);
            self.half_spaces.remove(&id);
            self.characters.remove(id);
            self.vehicles.remove(&mut self.world, id);
            self.crowding.remove(id);
            self.world.remove_body(place.handle);
        }
    }

    /// Notes whether a body is swept, and whether it is a sensor.
    fn note_motion(&mut self, desc: &BodyDesc) {
        let note = |bodies: &mut BTreeSet<BodyId>, is_one: bool| {
            if is_one && desc.enabled {
                bodies.insert(desc.id);
            } else {
                bodies.remove(&desc.id);
            }
        };
        let is_swept = desc.swept && desc.kind != BodyKind::Fixed;
        note(&mut self.swept, is_swept);
        note(&mut self.sensors, desc.sensor);
    }

    fn relocate(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        let Some(place) = self.place(id) else { return };
        let integrator = self.integrator;
        let body = &mut self.world.bodies[place.handle];
        if body.is_kinematic() && body.is_enabled() {
            if let Some(kinematic_target) = self.kinematic_target_mut(place) {
                kinematic_target.go_to(translate::widen(position, rotation), integrator);
            }
            return;
        }
        let pose = translate::pose(position, rotation);
        if *body.position() != pose {
            body.set_position(pose, body.is_enabled());
            if body.is_fixed() || !body.is_enabled() {
                self.displaced.push(place);
            }
            self.crowding
                .place(&self.world, &self.world.bodies[place.handle]);
        }
    }

    fn keep(&mut self, place: BodySlot, twist: Twist) {
        if let Some(kinematic_target) = self.kinematic_target_mut(place) {
            kinematic_target.keep(twist);
        }
    }

    fn set_twist(&mut self, id: BodyId, twist: Twist) {
        let Some(place) = self.place(id) else { return };
        let body = &mut self.world.bodies[place.handle];
        if body.is_kinematic() {
            self.keep(place, twist);
        } else {
            let (linear, angular) = translate::narrow_twist(&twist);
            body.set_linvel(linear, true);
            body.set_angvel(angular, true);
            self.stirred.push(place);
        }
    }

    /// Moves kinematic bodies, steps, and reads the results.
    fn advance(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) {
        self.walk();
        self.move_kinematic();
        self.vehicles.advance(&mut self.world);
        self.joints.aim(&mut self.world);
        self.turn();
        let first = lost.len();
        self.step_world(lost);
        if self.fault.is_some() {
            return;
        }
        self.stirred.clear();
        self.bound_speeds();
        self.spin.after(&mut self.world, &self.integrator);
        self.rest.after(&mut self.world, &self.vehicles);
        for handle in self.forced.drain(..) {
            if let Some(body) = self.world.bodies.get_mut(handle) {
                translate::unpush(body);
            }
        }
        self.look(lost);
        let left = &mut lost[first..];
        if !left.is_empty() {
            left.sort_unstable_by_key(|(id, _)| *id);
            for (id, _) in left.iter() {
                self.discard(*id);
            }
            let mut awake = mem::take(&mut self.awake);
            awake.retain(|place| self.is_at(*place));
            self.awake = awake;
        }
        // Their observations lie beside one another, and bodies do not.
        let awake = self.observed.iter().filter_map(|observed| {
            let place = self.places.get(observed.id.index() as usize);
            let place = place.copied().flatten()?;
            let is_awake = observed.activity == Activity::Awake;
            is_awake.then(|| (place.id, place.handle, translate::pose_of(&observed.motion)))
        });
        self.crowding.after(&self.world, awake);
    }

    /// Gives the bodies that contacts or joints made too fast the greatest speed, with which Rapier moves them.
    fn bound_speeds(&mut self) {
        // Rapier's own bound is rounded.
        let most = SPEED_MAX * (1.0 + 1e-5);
        let is_too_fast = |body: &RigidBody| body.linvel().length_squared() > most * most;
        let active = self.world.active_bodies();
        let fast = active.filter(|(_, body)| body.is_dynamic() && is_too_fast(body));
        let fast: Vec<_> = fast.map(|(handle, _)| handle).collect();
        for handle in fast {
            let body = &mut self.world.bodies[handle];
            let share = translate::share_within(body.linvel(), SPEED_MAX);
            body.set_linvel(body.linvel() * share, false);
        }
    }

    /// Precesses the spin of bodies, and notes the slow ones, before a step.
    fn turn(&mut self) {
        self.stirred.extend_from_slice(&self.awake);
        self.stirred.sort_unstable_by_key(|place| place.id);
        self.stirred.dedup_by_key(|place| place.id);
        for place in &self.stirred {
            let Some(body) = self.world.bodies.get(place.handle) else {
                continue;
            };
            if body.is_enabled() && !body.is_sleeping() {
                self.rest.before(place.id.index(), place.handle, body);
                self.spin
                    .before(&mut self.world, place.handle, &self.integrator);
            }
        }
    }

    /// Removes the bodies that Rapier disabled in this step; its report lasts for one step only.
    fn discard_quarantined(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) {
        let quarantine = self.world.quarantine();
        if quarantine.is_empty() {
            return;
        }
        let owners = quarantine.colliders().iter().filter_map(|handle| {
            let collider = self.world.colliders.get(*handle)?;
            collider.parent()
        });
        let mut handles: Vec<RigidBodyHandle> = quarantine.bodies().to_vec();
        handles.extend(owners);
        for handle in handles {
            if let Some(body) = self.world.bodies.get(handle) {
                let id = translate::id(body);
                self.discard(id);
                lost.push((id, RemovalCause::NotFinite));
            }
        }
    }

    /// Fills the observations of this step.
    fn look(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) {
        mem::swap(&mut self.awake, &mut self.awake_before);
        self.awake.clear();
        let active = self.world.active_bodies();
        self.awake.extend(active.map(|(handle, body)| BodySlot {
            id: translate::id(body),
            handle,
        }));
        self.awake.sort_unstable_by_key(|place| place.id);
        let mut observed = mem::take(&mut self.observed);
        observed.clear();
        let mut before = self.awake_before.iter().peekable();
        for place in &self.awake {
            while let Some(left) = before.next_if(|other| other.id < place.id) {
                observed.extend(self.fallen_asleep(*left));
            }
            before.next_if(|other| other.id == place.id);
            match self.observe_slot(*place, Activity::Awake) {
                Ok(observation) => observed.push(observation),
                Err(cause) => lost.push((place.id, cause)),
            }
        }
        for left in before {
            observed.extend(self.fallen_asleep(*left));
        }
        if !self.displaced.is_empty() {
            self.displaced.sort_unstable_by_key(|place| place.id);
            self.displaced.dedup_by_key(|place| place.id);
            let others = observed.len();
            for place in &self.displaced {
                let known = observed[..others].binary_search_by_key(&place.id, |other| other.id);
                if known.is_err() && self.is_at(*place) {
                    observed.extend(self.observe_slot(*place, Activity::Asleep));
                }
            }
            observed.sort_unstable_by_key(|observation| observation.id);
            self.displaced.clear();
        }
        self.observed = observed;
    }

    /// True if the body is still in its slot.
    fn is_at(&self, place: BodySlot) -> bool {
        self.place(place.id)
            .is_some_and(|now| now.handle == place.handle)
    }

    /// The last observation of a body that fell asleep, unless it was removed.
    fn fallen_asleep(&self, place: BodySlot) -> Option<Observation> {
        if !self.is_at(place) {
            return None;
        }
        self.observe_slot(place, Activity::Asleep).ok()
    }

    /// Velocities that a kinematic body kept in the last step.
    fn kept(&self, place: BodySlot) -> Option<Twist> {
        let target = self.kinematic_targets.get(&place.id);
        target.and_then(KinematicTarget::kept)
    }

    /// The observation of a body, or the reason to remove it.
    fn observe_slot(
        &self,
        place: BodySlot,
        activity: Activity,
    ) -> Result<Observation, RemovalCause> {
        let body = self.body(place).ok_or(RemovalCause::NotFinite)?;
        let kept = match activity {
            Activity::Awake if body.is_kinematic() => self.kept(place),
            _ => None,
        };
        // Rapier gives up what a joint tears apart, and leaves such velocities at the kinematic end, which stays.
        let kept = match body.is_kinematic() && !translate::has_velocities(body) {
            true => kept.or(Some(Twist::ZERO)),
            false => kept,
        };
        let motion = translate::motion(body, kept).map_err(|_| RemovalCause::NotFinite)?;
        if !translate::is_within(body.translation(), COORDINATE_MAX) {
            return Err(RemovalCause::LeftWorld);
        }
        Ok(Observation {
            id: place.id,
            motion,
            activity,
        })
    }
}

impl Engine for RapierEngine {
    fn add_shape(&mut self, id: ShapeId, shape: &Shape) -> Result<(), UnusableShape> {
        self.solids.insert(id, solids::solid(shape)?);
        Ok(())
    }

    fn baker(&self) -> Option<Baker> {
        Some(|shape| solids::solid(shape).map(BakedShape::new))
    }

    fn add_baked(&mut self, id: ShapeId, baked: BakedShape) -> Result<(), UnusableShape> {
        (self.solids).insert(id, baked.into_solid().ok_or(UnusableShape)?);
        Ok(())
    }

    fn moment(&self, body: &BodyProperties) -> Option<f32> {
        solids::moment(body, self.solids.get(&body.desc.shape)?)
    }

    fn remove_shape(&mut self, id: ShapeId) {
        self.solids.remove(&id);
    }

    fn add(&mut self, body: &BodyProperties, motion: BodyState) {
        self.contained(|engine| engine.insert(body, &motion));
    }

    fn change(&mut self, before: &BodyDesc, body: &BodyProperties) {
        self.contained(|engine| engine.alter(before, body));
    }

    fn remove(&mut self, id: BodyId) {
        self.contained(|engine| engine.discard(id));
    }

    fn add_joint(&mut self, id: JointId, joint: &Joint) {
        self.contained(|engine| {
            let [Some(first), Some(second)] = joint.bodies.map(|body| engine.place(body)) else {
                return;
            };
            let bodies = [first.handle, second.handle];
            engine.joints.add(&mut engine.world, bodies, (id, joint));
        });
    }

    fn remove_joint(&mut self, id: JointId) {
        self.contained(|engine| engine.joints.remove(&mut engine.world, id));
    }

    fn overloaded_joints(&self, out: &mut Vec<JointId>) {
        // Rapier keeps the impulses of the last substep.
        let parameters = &self.world.integration_parameters;
        let substep = parameters.dt / parameters.num_solver_iterations as f32;
        self.joints.overloaded(&self.world, substep, out);
    }

    fn set_pose(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        self.contained(|engine| engine.relocate(id, position, rotation));
    }

    fn set_velocity(&mut self, id: BodyId, twist: Twist) {
        self.contained(|engine| engine.set_twist(id, twist));
    }

    fn set_locomotion(&mut self, id: BodyId, locomotion: &Locomotion) {
        self.contained(|engine| {
            let Some(place) = engine.place(id) else {
                return;
            };
            let (characters, vehicles) = (&mut engine.characters, &mut engine.vehicles);
            if !matches!(locomotion, Locomotion::Character(_)) {
                characters.remove(id);
            }
            match locomotion {
                Locomotion::None => vehicles.remove(&mut engine.world, id),
                Locomotion::Character(character) => characters.set(id, *character),
                Locomotion::Vehicle(vehicle) => {
                    vehicles.set(&mut engine.world, (id, place.handle), vehicle);
                }
            }
        });
    }

    fn jump(&mut self, id: BodyId, speed: f32, from: JumpFrom) {
        self.contained(|engine| engine.characters.jump(id, speed, from));
    }

    fn set_wheels(&mut self, id: BodyId, inputs: &[WheelInput]) {
        self.contained(|engine| engine.vehicles.set_inputs(&mut engine.world, id, inputs));
    }

    fn ground_events(&self, out: &mut Vec<BodyEvent>) {
        self.characters.events(out);
    }

    fn set_activity(&mut self, id: BodyId, activity: Activity) {
        self.contained(|engine| {
            let Some(place) = engine.place(id) else {
                return;
            };
            let body = &mut engine.world.bodies[place.handle];
            match activity {
                Activity::Awake => body.wake_up(true),
                Activity::Asleep => {
                    body.sleep();
                    engine.displaced.push(place);
                }
            }
        });
    }

    fn effect(&self, id: BodyId, push: Push) -> Option<Twist> {
        let body = self.body(self.place(id)?)?;
        let dt = self.world.integration_parameters.dt;
        Some(translate::widen_twist(translate::effect(body, push, dt)))
    }

    fn pending(&self, id: BodyId) -> Twist {
        let body = self.place(id).and_then(|place| self.body(place));
        let dt = self.world.integration_parameters.dt;
        body.map_or(Twist::ZERO, |body| {
            translate::widen_twist(translate::pending(body, dt))
        })
    }

    fn push(&mut self, id: BodyId, push: Push) {
        self.contained(|engine| {
            let Some(place) = engine.place(id) else {
                return;
            };
            translate::push(&mut engine.world.bodies[place.handle], push);
            engine.stirred.push(place);
            if matches!(push, Push::Force(_) | Push::ForceAt(..) | Push::Torque(_)) {
                engine.forced.push(place.handle);
            }
        });
    }

    fn set_gravity(&mut self, gravity: Vec3) {
        self.contained(|engine| {
            if engine.world.gravity != gravity {
                engine.world.gravity = gravity;
                engine.world.wake_up_all(true);
            }
        });
    }

    fn step(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) -> Result<(), EngineFault> {
        let first = lost.len();
        self.contained(|engine| engine.advance(lost));
        match self.fault {
            None => {
                self.has_changed = lost.len() > first;
                Ok(())
            }
            Some(fault) => {
                lost.truncate(first);
                Err(fault)
            }
        }
    }

    fn observe(&self, out: &mut Vec<Observation>) {
        out.extend_from_slice(&self.observed);
    }

    fn observe_one(&self, id: BodyId) -> Option<Observation> {
        let place = self.place(id)?;
        let body = self.body(place)?;
        let activity = if body.is_fixed() || body.is_sleeping() || !body.is_enabled() {
            Activity::Asleep
        } else {
            Activity::Awake
        };
        self.observe_slot(place, activity).ok()
    }

    fn inertia(&self, id: BodyId) -> Option<Inertia> {
        translate::inertia(self.body(self.place(id)?)?)
    }

    fn contacts(&self, id: BodyId, out: &mut Vec<Contact>) {
        if let Some(place) = self.place(id)
            && let Some(body) = self.body(place)
        {
            reports::contacts(&self.world, place.handle, body, out);
        }
    }

    fn sensed(&self, id: BodyId, out: &mut Vec<(BodyId, BodyId)>) {
        if let Some(body) = self.place(id).and_then(|place| self.body(place)) {
            reports::sensed(&self.world, body, out);
            let crossed = self.crossed.iter().copied();
            out.extend(crossed.filter(|(sensor, inside)| [sensor, inside].contains(&&id)));
        }
    }

    fn query(&self, query: &Query) -> Result<Answer, UnanswerableQuery> {
        // A query reads the world only, so that a panic leaves it as it is.
        let answered = catch_unwind(AssertUnwindSafe(|| reports::answer(&self.world, query)));
        answered.map_err(|_| UnanswerableQuery)
    }

    fn count_crowding(&mut self, most: u32) {
        self.crowding.begin(&self.world, most);
    }

    fn crowding(&self) -> u64 {
        self.crowding.pairs()
    }

    fn crowding_ahead(&mut self) -> u64 {
        for (id, target) in &self.kinematic_targets {
            let Some(pose) = target.jump(self.integrator) else {
                continue;
            };
            let place = self.places.get(id.index() as usize).copied().flatten();
            let body = place.and_then(|place| self.world.bodies.get(place.handle));
            if let Some(body) = body {
                let pose = translate::nearest(translate::narrow(&pose), *body.rotation());
                self.crowding.place_at(&self.world, body, &pose);
            }
        }
        self.crowding.pairs()
    }

    fn crowding_with(&self, body: &BodyProperties, motion: &BodyState) -> u64 {
        let solid = self.solids.get(&body.desc.shape);
        let Some(solid) = solid.filter(|_| body.desc.enabled) else {
            return 0;
        };
        let of = Crowded {
            body: body.desc.id,
            kind: translate::body_type(body.desc.kind),
            types: solids::collision_types(&body.desc),
            groups: solids::groups(&body.desc),
        };
        let at = translate::pose_of(motion);
        (self.crowding).pairs_with(&self.world, of, solids::boxes(solid, at))
    }

    fn awake_count(&self) -> usize {
        self.awake.len()
    }

    fn fault(&self) -> Option<EngineFault> {
        self.fault
    }

    fn copy(&self) -> Option<Box<dyn Engine>> {
        Some(Box::new(self.duplicate()?))
    }

    fn freeze(&self) -> Option<FrozenEngine> {
        self.image()
    }
}

#[cfg(test)]
mod chain_tests;
#[cfg(test)]
mod crossing_tests;
#[cfg(test)]
mod motor_tests;
#[cfg(test)]
mod stepping_tests;
#[cfg(test)]
mod tests;
