//! Rapier as the engine of a scene.
//!
//! Wraps its `PhysicsWorld`; no type of Rapier leaves this file and its helpers. Invariants: the world takes no step
//! after a panic, since any part may be broken. Bodies that Rapier quarantined are removed when the step returns.
//! Rapier caps the speeds of dynamic bodies at 400 m/s and an eighth of a turn per tick.

mod image;

use std::collections::BTreeMap;
use std::mem;
use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::{Quat, Vec3};
use rapier3d::prelude::{
    Collider, ContactPair, ImpulseJointHandle, PhysicsWorld, RigidBody, RigidBodyHandle,
};
use rhumb_protocol::limits::COORDINATE_MAX;
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    BodyKind, Contact, Joint, JointId, SceneConfig, Shape, ShapeId, SleepConfig,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, Inertia, Integrator, Twist};

use super::interface::{Engine, EngineFault, FrozenEngine, NewBody, Push, UnusableShape};
use super::kinematic_target::KinematicTarget;
use super::rapier_body as translate;
use super::rapier_solid::{self as solids, Solid};
use super::rapier_workers::Workers;

/// A Rapier world.
pub struct RapierEngine {
    world: PhysicsWorld,
    integrator: Integrator,
    sleep: Option<SleepConfig>,
    fault: Option<EngineFault>,
    solids: BTreeMap<ShapeId, Solid>,
    /// True if a body ever had a thin solid, which fast bodies could pass through: dynamic bodies are swept from then
    /// on.
    has_sheets: bool,
    /// Some may have left with a body.
    joints: BTreeMap<JointId, ImpulseJointHandle>,
    /// Slots by body index.
    places: Vec<Option<BodySlot>>,
    /// Kinematic bodies that move.
    kinematic_targets: BTreeMap<BodyId, KinematicTarget>,
    /// Bodies with a force until the next step is over.
    forced: Vec<RigidBodyHandle>,
    /// Static bodies that were displaced since the last step.
    displaced: Vec<BodySlot>,
    /// Awake after the last step, in the order of ids.
    awake: Vec<BodySlot>,
    /// Awake after the step before, in the order of ids.
    awake_before: Vec<BodySlot>,
    observed: Vec<Observation>,
    /// Whether the world has changed since its last step. Rapier's image of a world lacks some changes that are not
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
        Self::on(config, &Workers::default())
    }

    /// An empty world under this configuration, stepped by these threads.
    #[must_use]
    pub fn on(config: &SceneConfig, workers: &Workers) -> Self {
        let mut world = PhysicsWorld::new();
        workers.employ(&mut world);
        world.gravity = config.gravity;
        let parameters = &mut world.integration_parameters;
        parameters.dt = config.integrator.rate.step().seconds() as f32;
        parameters.min_ccd_dt = parameters.dt / 100.0;
        parameters.num_solver_iterations = config.integrator.substeps.get() as usize;
        Self {
            world,
            integrator: config.integrator,
            sleep: config.sleep,
            fault: None,
            solids: BTreeMap::new(),
            has_sheets: false,
            joints: BTreeMap::new(),
            places: Vec::new(),
            kinematic_targets: BTreeMap::new(),
            forced: Vec::new(),
            displaced: Vec::new(),
            awake: Vec::new(),
            awake_before: Vec::new(),
            observed: Vec::new(),
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
            self.places.clear();
            self.kinematic_targets.clear();
            self.awake.clear();
            self.observed.clear();
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

    fn insert(&mut self, new_body: &NewBody) {
        let Some(solid) = self.solids.get(&new_body.shape) else {
            return;
        };
        let mut body = translate::body(new_body);
        if let Some(sleep) = self.sleep {
            translate::let_sleep(&mut body, sleep);
        }
        if let Some(mass) = solids::mass_beside(new_body, solid) {
            body.set_additional_mass_properties(mass, false);
        }
        if solid.is_sheet && !self.has_sheets {
            self.has_sheets = true;
            for (_, other) in self.world.bodies.iter_mut() {
                other.enable_ccd(other.is_dynamic());
            }
        }
        body.enable_ccd(self.has_sheets && body.is_dynamic());
        let handle = self.world.insert_body(body);
        for collider in solids::colliders(new_body, solid) {
            self.world.insert_collider(collider, Some(handle));
        }
        let index = new_body.id.index() as usize;
        if index >= self.places.len() {
            self.places.resize(index + 1, None);
        }
        let place = BodySlot {
            id: new_body.id,
            handle,
        };
        self.places[index] = Some(place);
        if new_body.kind == BodyKind::Kinematic {
            let twist = new_body.motion.motion().twist();
            self.keep(place, twist);
        }
    }

    fn discard(&mut self, id: BodyId) {
        if let Some(place) = self.place(id) {
            self.places[id.index() as usize] = None;
            self.kinematic_targets.remove(&id);
            self.world.remove_body(place.handle);
        }
    }

    fn relocate(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        let Some(place) = self.place(id) else { return };
        let body = &mut self.world.bodies[place.handle];
        if body.is_kinematic() {
            if let Some(kinematic_target) = self.kinematic_target_mut(place) {
                kinematic_target.go_to(translate::widen(position, rotation));
            }
            return;
        }
        let pose = translate::pose(position, rotation);
        if *body.position() != pose {
            body.set_position(pose, true);
            if body.is_fixed() {
                self.displaced.push(place);
            }
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
        }
    }

    /// Moves kinematic bodies, steps, and reads the results.
    fn advance(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) {
        self.kinematic_targets
            .retain(|_, kinematic_target| kinematic_target.is_moving());
        for (id, kinematic_target) in &mut self.kinematic_targets {
            let next = translate::narrow(&kinematic_target.advance(self.integrator));
            let place = self.places.get(id.index() as usize).copied().flatten();
            if let Some(body) = place.and_then(|place| self.world.bodies.get_mut(place.handle)) {
                let next = translate::nearest(next, *body.rotation());
                body.set_next_kinematic_position(next);
            }
        }
        self.world.step();
        for handle in self.forced.drain(..) {
            if let Some(body) = self.world.bodies.get_mut(handle) {
                translate::unpush(body);
            }
        }
        let first = lost.len();
        self.discard_quarantined(lost);
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
            let still_there = self.displaced.iter().filter(|place| self.is_at(**place));
            observed.extend(
                still_there.filter_map(|place| self.observe_slot(*place, Activity::Asleep).ok()),
            );
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

    /// The deepest contact of a pair of solids, from the first one's body or the second's.
    fn contact(&self, of: RigidBodyHandle, pair: &ContactPair) -> Option<Contact> {
        if !pair.has_any_active_contact() {
            return None;
        }
        let [first, second] =
            [pair.collider1, pair.collider2].map(|handle| self.world.colliders.get(handle));
        let (first, second) = (first?, second?);
        let (manifold, deepest) = pair.find_deepest_contact()?;
        // From the first solid towards the second.
        let normal = manifold.data.normal;
        let at = |collider: &Collider, point| collider.position().transform_point(point);
        let is_first = first.parent() == Some(of);
        let (other, point, normal) = if is_first {
            (second, at(first, deepest.local_p1), -normal)
        } else {
            (first, at(second, deepest.local_p2), normal)
        };
        let other = self.world.bodies.get(other.parent()?)?;
        let contact = Contact {
            with: translate::id(other),
            point,
            normal,
            separation: deepest.dist,
        };
        let finite = point.is_finite() && normal.is_finite() && deepest.dist.is_finite();
        finite.then_some(contact)
    }

    /// The observation of a body, or the reason to remove it.
    fn observe_slot(
        &self,
        place: BodySlot,
        activity: Activity,
    ) -> Result<Observation, RemovalCause> {
        let body = self.body(place).ok_or(RemovalCause::NotFinite)?;
        let kept = if body.is_kinematic() && activity == Activity::Awake {
            self.kinematic_targets
                .get(&place.id)
                .and_then(KinematicTarget::kept)
        } else {
            None
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
        let solid = solids::solid(shape)?;
        self.solids.insert(id, solid);
        Ok(())
    }

    fn remove_shape(&mut self, id: ShapeId) {
        self.solids.remove(&id);
    }

    fn add(&mut self, body: &NewBody) {
        self.contained(|engine| engine.insert(body));
    }

    fn remove(&mut self, id: BodyId) {
        self.contained(|engine| engine.discard(id));
    }

    fn add_joint(&mut self, id: JointId, joint: &Joint) {
        self.contained(|engine| {
            let [Some(first), Some(second)] = joint.bodies.map(|body| engine.place(body)) else {
                return;
            };
            let rapier_joint = translate::joint(joint);
            let handle =
                engine
                    .world
                    .insert_impulse_joint(first.handle, second.handle, rapier_joint);
            engine.joints.insert(id, handle);
        });
    }

    fn remove_joint(&mut self, id: JointId) {
        self.contained(|engine| {
            if let Some(handle) = engine.joints.remove(&id) {
                engine.world.remove_impulse_joint(handle);
            }
        });
    }

    fn set_pose(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        self.contained(|engine| engine.relocate(id, position, rotation));
    }

    fn set_velocity(&mut self, id: BodyId, twist: Twist) {
        self.contained(|engine| engine.set_twist(id, twist));
    }

    fn push(&mut self, id: BodyId, push: Push) {
        self.contained(|engine| {
            let Some(place) = engine.place(id) else {
                return;
            };
            let dt = engine.world.integration_parameters.dt;
            translate::push(&mut engine.world.bodies[place.handle], push, dt);
            if matches!(push, Push::Force(_) | Push::Torque(_)) {
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
        let activity = if body.is_fixed() || body.is_sleeping() {
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
        let first = out.len();
        let Some((place, body)) = self.place(id).and_then(|at| Some((at, self.body(at)?))) else {
            return;
        };
        for collider in body.colliders() {
            for pair in self.world.contact_pairs_with(*collider) {
                out.extend(self.contact(place.handle, pair));
            }
        }
        let deepest_first = |a: &Contact, b: &Contact| {
            (a.with.cmp(&b.with)).then(a.separation.total_cmp(&b.separation))
        };
        out[first..].sort_by(deepest_first);
        let mut with = None;
        let mut place = 0;
        out.retain(|contact| {
            place += 1;
            let again = place > first && with == Some(contact.with);
            with = (place > first).then_some(contact.with);
            !again
        });
    }

    fn awake_count(&self) -> usize {
        self.awake.len()
    }

    fn fault(&self) -> Option<EngineFault> {
        self.fault
    }

    fn freeze(&self) -> Option<FrozenEngine> {
        self.image()
    }
}

#[cfg(test)]
mod tests {
    use core::num::NonZeroU32;

    use rhumb_protocol::scene::{Material, PublishSchedule, Stepping};
    use rhumb_reckoning::{BodyState, Damping, Rate};

    use super::*;

    #[test]
    fn after_a_panic_the_engine_is_empty_and_takes_no_steps() {
        let (material, damping) = (
            Material {
                friction: 0.5,
                restitution: 0.0,
                density: 1_000.0,
            },
            Damping::default(),
        );
        let mut engine = RapierEngine::new(&SceneConfig {
            integrator: Integrator {
                rate: Rate::HZ_60,
                substeps: NonZeroU32::new(4).unwrap(),
            },
            gravity: Vec3::ZERO,
            stepping: Stepping::Lockstep,
            material,
            damping,
            sleep: None,
            publish_schedule: PublishSchedule::EACH_TICK,
        });
        let id = BodyId::new(0, 0);
        let ball = NewBody {
            id,
            kind: BodyKind::Dynamic,
            shape: ShapeId(0),
            material,
            damping,
            gravity_scale: 1.0,
            gyroscopic: true,
            turns: true,
            motion: BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).unwrap(),
        };
        let shape = Shape::Ball { radius: 0.5 };
        assert_eq!(engine.add_shape(ball.shape, &shape), Ok(()));
        engine.add(&ball);
        let mut lost = Vec::new();
        assert_eq!(engine.step(&mut lost), Ok(()));
        assert_eq!(engine.awake_count(), 1);
        engine.contained(|_| panic!("as Rapier might"));
        assert_eq!(engine.fault(), Some(EngineFault::Panicked));
        engine.add(&ball);
        engine.push(id, Push::Impulse(Vec3::X));
        assert_eq!(engine.step(&mut lost), Err(EngineFault::Panicked));
        assert_eq!(engine.observe_one(id), None);
        let mut observed = Vec::new();
        engine.observe(&mut observed);
        assert_eq!((observed, lost, engine.awake_count()), (vec![], vec![], 0));
    }
}
