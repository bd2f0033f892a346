//! The engine of a scene that its owner feeds: it moves nothing by itself.
//!
//! A step takes the states that the owner has handed over for its tick. Between two fed ticks that are apart, bodies go
//! evenly from one state to the next. It has neither contacts nor queries, and no images: such a scene is neither
//! stored nor restored. Invariants: a body without a state at its tick rests where it is; one that has stood still for
//! [`STILL_TICKS`] sleeps, and wakes when it is fed elsewhere or with a velocity.

use std::collections::BTreeMap;
use std::mem;
use std::sync::Arc;

use glam::{DQuat, DVec3, Quat, Vec3};
use rhumb_protocol::limits::{ANGULAR_MAX, LINEAR_MAX};
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyKind, Contact, Joint, JointId, Locomotion, Query, SceneConfig, Shape,
    ShapeId,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Inertia, Tick, Twist};
use rhumb_solids::UnitMass;

use super::interface::{
    BodyProperties, Engine, EngineFault, EnginePart, Push, UnanswerableQuery, UnusableShape,
    inertia,
};
use crate::feed::{FedTick, FedVelocities, SharedFeed};

/// Ticks at one pose without a velocity after which a body sleeps. Chosen: an engine that pauses for a step does not have
/// its bodies sleep and wake.
const STILL_TICKS: u32 = 5;

/// Bodies that are where their owner says.
pub struct FedEngine {
    feed: Arc<SharedFeed>,
    /// Steps taken.
    now: Tick,
    stride: Stride,
    /// `None` for a shape without volume.
    masses: BTreeMap<ShapeId, Option<UnitMass>>,
    /// By index.
    bodies: Vec<Option<FedBody>>,
    /// Bodies that were awake after the last step, and those that commands have changed since.
    active: Vec<BodyId>,
    /// After the last step, in the order of ids.
    observed: Vec<Observation>,
}

/// A step, as far as velocities at its end follow from poses.
#[derive(Clone, Copy)]
struct Stride {
    /// Seconds.
    dt: f64,
    /// Time from the middle of the substeps' displacements to the end of the step, seconds: a substep moves a body by the
    /// velocity at its end.
    late: f64,
    gravity: DVec3,
}

impl Stride {
    fn new(config: &SceneConfig) -> Self {
        let dt = config.integrator.rate.step().seconds();
        let substeps = f64::from(config.integrator.substeps.get());
        Self {
            dt,
            late: dt * (substeps - 1.0) / (2.0 * substeps),
            gravity: config.gravity.as_dvec3(),
        }
    }
}

struct FedBody {
    properties: BodyProperties,
    state: BodyState,
    activity: Activity,
    /// Ticks for which it has been fed at one pose without a velocity.
    still: u32,
    /// The last step in which it was fed; `None` before the first one.
    fed: Option<Tick>,
    /// Its displacement over the time of the last step, m/s; `None` where velocities do not follow from poses.
    mean: Option<DVec3>,
}

impl FedBody {
    /// True if its states make it awake: a fixed or disabled body is only displaced.
    const fn can_move(&self) -> bool {
        self.properties.desc.enabled && !matches!(self.properties.desc.kind, BodyKind::Fixed)
    }

    /// Puts it to rest where it is.
    fn rest(&mut self) {
        self.state = self.state.stilled();
        self.activity = Activity::Asleep;
        self.mean = None;
    }

    /// A state with the velocities that led to its pose in a step.
    fn led_to(&mut self, state: &BodyState, stride: &Stride) -> BodyState {
        let before = self.mean.take();
        let [from, to] = [&self.state, state].map(|of| of.motion().pose().position);
        let mean = (to - from) / stride.dt;
        let gained = before.map_or(DVec3::ZERO, |before| (mean - before) / stride.dt);
        let fall = self.fall(mean, stride);
        // It falls if it gains the velocity of a fall rather than none.
        let rest = match gained.distance(fall) < gained.length() {
            true => fall * stride.late,
            false => DVec3::ZERO,
        };
        self.mean = Some(mean);
        moved(&self.state, state, stride.dt, rest)
    }

    /// The acceleration of a fall at this velocity, m/s².
    fn fall(&self, velocity: DVec3, stride: &Stride) -> DVec3 {
        match self.properties.desc.kind {
            BodyKind::Dynamic => {
                let gravity = stride.gravity * f64::from(self.properties.desc.gravity_scale);
                gravity - velocity * f64::from(self.properties.damping.linear)
            }
            _ => DVec3::ZERO,
        }
    }

    const fn observation(&self) -> Observation {
        Observation {
            id: self.properties.desc.id,
            motion: self.state,
            activity: self.activity,
        }
    }

    /// Takes a state; true if it is to be observed.
    fn take(&mut self, now: Tick, state: BodyState) -> bool {
        let has_moved = !is_at(&self.state, &state);
        let stands = !has_moved && is_still(&state);
        self.still = if stands {
            self.still.saturating_add(1)
        } else {
            0
        };
        self.fed = Some(now);
        let was_asleep = self.activity == Activity::Asleep;
        self.state = state;
        if !self.can_move() {
            self.rest();
            return has_moved;
        }
        // Asleep, it stays so while it stands, however short that is: it may have been put to sleep.
        if stands && (was_asleep || self.still >= STILL_TICKS) {
            self.rest();
            return !was_asleep;
        }
        self.activity = Activity::Awake;
        true
    }
}

/// True if two states have one pose.
fn is_at(one: &BodyState, other: &BodyState) -> bool {
    one.parts()[..7] == other.parts()[..7]
}

/// True for a state without a velocity.
fn is_still(state: &BodyState) -> bool {
    state.parts()[7..].iter().all(|part| *part == 0.0)
}

impl FedEngine {
    /// An empty world that steps by this feed.
    pub(crate) fn new(config: &SceneConfig, feed: Arc<SharedFeed>) -> Self {
        Self {
            feed,
            now: Tick::ZERO,
            stride: Stride::new(config),
            masses: BTreeMap::new(),
            bodies: Vec::new(),
            active: Vec::new(),
            observed: Vec::new(),
        }
    }

    fn body(&self, id: BodyId) -> Option<&FedBody> {
        let body = self.bodies.get(id.index() as usize)?.as_ref();
        body.filter(|body| body.properties.desc.id == id)
    }

    fn body_mut(&mut self, id: BodyId) -> Option<&mut FedBody> {
        body_of(&mut self.bodies, id)
    }

    /// Puts a body to rest, which is observed after the next step.
    fn calm(&mut self, id: BodyId) {
        if let Some(body) = self.body_mut(id) {
            body.rest();
            self.active.push(id);
        }
    }

    /// Takes the states of this step; `apart`: the ticks to theirs, at least one.
    fn take(&mut self, fed: &FedTick, apart: u64) {
        let (now, stride) = (self.now, self.stride);
        for (id, state) in &fed.states {
            // The scene may have lost the body, or refused it, since its owner handed the state over.
            let Some(body) = body_of(&mut self.bodies, *id) else {
                continue;
            };
            let state = match apart {
                1 => *state,
                _ => between(&body.state, state, 1.0 / apart as f64),
            };
            let state = match fed.velocities {
                FedVelocities::Given => state,
                FedVelocities::FromPoses => body.led_to(&state, &stride),
            };
            if body.take(now, state) {
                self.observed.push(body.observation());
            }
            // Between ticks that are apart it goes evenly, and does not fall.
            if apart > 1 || fed.velocities == FedVelocities::Given {
                body.mean = None;
            }
        }
    }

    /// Bodies that were awake, or that a command has changed, and are not fed in this step: they rest.
    fn settle(&mut self) {
        for id in mem::take(&mut self.active) {
            let now = self.now;
            let Some(body) = self.body_mut(id).filter(|body| body.fed != Some(now)) else {
                continue;
            };
            // Once, though it was awake and changed.
            body.fed = Some(now);
            body.rest();
            let observation = body.observation();
            self.observed.push(observation);
        }
    }
}

fn body_of(bodies: &mut [Option<FedBody>], id: BodyId) -> Option<&mut FedBody> {
    let body = bodies.get_mut(id.index() as usize)?.as_mut();
    body.filter(|body| body.properties.desc.id == id)
}

/// The state at a share of the way from one to another, along the shorter turn.
fn between(from: &BodyState, to: &BodyState, share: f64) -> BodyState {
    let (one, other) = (from.motion(), to.motion());
    let (from_pose, to_pose) = (one.pose(), other.pose());
    let position = from_pose.position.lerp(to_pose.position, share);
    let rotation = from_pose.rotation.slerp(to_pose.rotation, share);
    let (from_twist, to_twist) = (one.twist(), other.twist());
    let twist = Twist {
        linear: from_twist.linear.lerp(to_twist.linear, share),
        angular: from_twist.angular.lerp(to_twist.angular, share),
    };
    rounded(position, rotation, twist).unwrap_or(*from)
}

/// A pose with the velocities that led to it from another one in a step, and a rest that they have gained beyond; without any
/// if they exceed the limits of commands, as after a teleport.
fn moved(from: &BodyState, to: &BodyState, dt: f64, rest: DVec3) -> BodyState {
    if is_at(from, to) {
        return to.stilled();
    }
    let (from, pose) = (from.motion().pose(), to.motion().pose());
    let turn = pose.rotation * from.rotation.conjugate();
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let twist = Twist {
        linear: (pose.position - from.position) / dt + rest,
        angular: turn.normalize().to_scaled_axis() / dt,
    };
    let most = |of: DVec3| of.abs().max_element();
    if most(twist.linear) > f64::from(LINEAR_MAX) || most(twist.angular) > f64::from(ANGULAR_MAX) {
        return to.stilled();
    }
    let parts = to.parts();
    let [px, py, pz, x, y, z, w, ..] = parts;
    let (linear, angular) = (twist.linear.as_vec3(), twist.angular.as_vec3());
    let state = BodyState::new(
        [px, py, pz],
        [x, y, z, w],
        linear.to_array(),
        angular.to_array(),
    );
    state.unwrap_or_else(|_| to.stilled())
}

fn rounded(position: DVec3, rotation: DQuat, twist: Twist) -> Option<BodyState> {
    let state = BodyState::new(
        position.as_vec3().to_array(),
        rotation.normalize().as_quat().to_array(),
        twist.linear.as_vec3().to_array(),
        twist.angular.as_vec3().to_array(),
    );
    state.ok()
}

impl Engine for FedEngine {
    fn supports(&self, part: EnginePart<'_>) -> bool {
        match part {
            EnginePart::Shape(_) | EnginePart::Body(_) => true,
            // Loads of joints are not known here.
            EnginePart::Joint(joint) => joint.strength.is_none(),
            EnginePart::Locomotion(locomotion) => matches!(locomotion, Locomotion::None),
        }
    }

    fn add_shape(&mut self, id: ShapeId, shape: &Shape) -> Result<(), UnusableShape> {
        self.masses.insert(id, UnitMass::of_shape(shape));
        Ok(())
    }

    fn remove_shape(&mut self, id: ShapeId) {
        self.masses.remove(&id);
    }

    fn add(&mut self, body: &BodyProperties, motion: BodyState) {
        let id = body.desc.id;
        let place = id.index() as usize;
        if place >= self.bodies.len() {
            self.bodies.resize_with(place + 1, || None);
        }
        let mut fed = FedBody {
            properties: *body,
            state: motion,
            activity: Activity::Awake,
            still: 0,
            fed: None,
            mean: None,
        };
        if fed.can_move() {
            self.active.push(id);
        } else {
            fed.rest();
        }
        self.bodies[place] = Some(fed);
    }

    fn change(&mut self, _before: &BodyDesc, body: &BodyProperties) {
        let id = body.desc.id;
        let Some(slot) = self.body_mut(id) else {
            return;
        };
        slot.properties = *body;
        (slot.still, slot.mean) = (0, None);
        if !slot.can_move() {
            self.calm(id);
        }
    }

    fn remove(&mut self, id: BodyId) {
        if self.body(id).is_some() {
            self.bodies[id.index() as usize] = None;
        }
    }

    fn add_joint(&mut self, _id: JointId, _joint: &Joint) {}

    fn remove_joint(&mut self, _id: JointId) {}

    fn overloaded_joints(&self, _out: &mut Vec<JointId>) {}

    fn set_pose(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        let (position, rotation) = (position.to_array(), rotation.to_array());
        let put = BodyState::new(position, rotation, [0.0; 3], [0.0; 3]);
        let (Some(body), Ok(put)) = (self.body_mut(id), put) else {
            return;
        };
        if !is_at(&body.state, &put) {
            body.state = put;
            (body.still, body.mean) = (0, None);
            self.calm(id);
        }
    }

    fn set_velocity(&mut self, _id: BodyId, _twist: Twist) {}

    fn set_activity(&mut self, id: BodyId, activity: Activity) {
        if activity == Activity::Asleep {
            self.calm(id);
        }
    }

    fn push(&mut self, _id: BodyId, _push: Push) {}

    fn set_gravity(&mut self, gravity: Vec3) {
        self.stride.gravity = gravity.as_dvec3();
    }

    fn step(&mut self, _lost: &mut Vec<(BodyId, RemovalCause)>) -> Result<(), EngineFault> {
        let before = self.now.value();
        self.now = self.now.next();
        self.observed.clear();
        if let Some(fed) = self.feed.take() {
            let apart = fed.tick.value().saturating_sub(before);
            if apart > 0 {
                self.take(&fed, apart);
            }
            if apart > 1 {
                self.feed.put_back(fed);
            } else {
                self.feed.recycle(fed.states);
            }
        }
        self.settle();
        if !self.observed.is_sorted_by_key(|seen| seen.id) {
            self.observed.sort_unstable_by_key(|seen| seen.id);
        }
        let awake = |seen: &&Observation| seen.activity == Activity::Awake;
        let awake = self.observed.iter().filter(awake);
        self.active.extend(awake.map(|seen| seen.id));
        Ok(())
    }

    fn observe(&self, out: &mut Vec<Observation>) {
        out.extend_from_slice(&self.observed);
    }

    fn observe_one(&self, id: BodyId) -> Option<Observation> {
        self.body(id).map(FedBody::observation)
    }

    fn inertia(&self, id: BodyId) -> Option<Inertia> {
        let properties = &self.body(id)?.properties;
        let unit = self.masses.get(&properties.desc.shape)?;
        inertia(properties, *unit)
    }

    fn contacts(&self, _id: BodyId, _out: &mut Vec<Contact>) {}

    fn has_contacts(&self) -> bool {
        false
    }

    fn sensed(&self, _id: BodyId, _out: &mut Vec<(BodyId, BodyId)>) {}

    fn query(&self, _query: &Query) -> Result<Answer, UnanswerableQuery> {
        Err(UnanswerableQuery)
    }

    fn awake_count(&self) -> usize {
        let observed = self.observed.iter();
        let awake = observed.filter(|seen| seen.activity == Activity::Awake);
        awake.count()
    }

    fn fault(&self) -> Option<EngineFault> {
        None
    }
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::Peer;
    use rhumb_protocol::scene::Command;

    use super::*;
    use crate::feed::{Feed, Feeds};
    use crate::scene::Scene;

    const SPIN: [f32; 3] = [0.0, 0.0, 1.0];

    /// A scene of balls at rest in a row, and the feed of it.
    fn scene(count: u32) -> (Scene, Feed) {
        scene_of(SceneConfig::default(), count)
    }

    fn scene_of(config: SceneConfig, count: u32) -> (Scene, Feed) {
        let (feeds, name) = (Feeds::default(), "fed".parse().unwrap());
        let feed = feeds.open(&name, Peer(1)).unwrap();
        let engine = FedEngine::new(&config, feeds.of(&name).unwrap());
        let mut scene = Scene::with_engine(config, Box::new(engine)).unwrap();
        let (shape, ball) = (ShapeId(0), Shape::ball(0.5));
        let id = shape;
        scene.apply(&Command::AddShape { id, shape: ball }).unwrap();
        for index in 0..count {
            let desc = BodyDesc::plain(BodyId::new(index, 0), BodyKind::Dynamic, shape);
            let motion = state(index as f32, [0.0; 3]);
            scene.apply(&Command::AddBody { desc, motion }).unwrap();
        }
        (scene, feed)
    }

    fn state(x: f32, linear: [f32; 3]) -> BodyState {
        BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], linear, [0.0; 3]).unwrap()
    }

    fn feed_at(feed: &mut Feed, tick: u64, states: &[(u32, BodyState)]) {
        let states = states
            .iter()
            .map(|(index, state)| (BodyId::new(*index, 0), *state));
        let states: Vec<_> = states.collect();
        feed.push(Tick::new(tick), &states, FedVelocities::Given, 0);
    }

    fn seen(scene: &mut Scene) -> Vec<(u32, f32, Activity)> {
        scene.step().unwrap();
        let seen = scene.observations().iter();
        seen.map(|seen| (seen.id.index(), seen.motion.position()[0], seen.activity))
            .collect()
    }

    #[test]
    fn a_body_is_where_it_is_fed_and_rests_where_it_is_not() {
        let (mut scene, mut feed) = scene(2);
        feed_at(&mut feed, 1, &[(1, state(5.0, [1.0, 0.0, 0.0]))]);
        let both = [(0, 0.0, Activity::Asleep), (1, 5.0, Activity::Awake)];
        assert_eq!(seen(&mut scene), both);
        feed_at(&mut feed, 2, &[(0, state(0.0, [0.0; 3]))]);
        assert_eq!(seen(&mut scene), [(1, 5.0, Activity::Asleep)]);
        assert_eq!(scene.awake_count(), 0);
    }

    #[test]
    fn a_body_that_is_fed_at_one_pose_sleeps_once_and_wakes_when_it_moves() {
        let (mut scene, mut feed) = scene(1);
        let mut activities = Vec::new();
        for tick in 1..=20 {
            let x = if tick == 20 { 1.0 } else { 0.0 };
            feed_at(&mut feed, tick, &[(0, state(x, [0.0; 3]))]);
            activities.extend(seen(&mut scene).into_iter().map(|(.., activity)| activity));
        }
        let awake = STILL_TICKS as usize - 1;
        assert_eq!(activities.len(), awake + 2);
        assert_eq!(activities[awake], Activity::Asleep);
        assert_eq!(activities[awake + 1], Activity::Awake);
    }

    #[test]
    fn ticks_that_are_left_out_lead_evenly_to_the_next_states() {
        let (mut scene, mut feed) = scene(1);
        feed_at(&mut feed, 4, &[(0, state(8.0, SPIN))]);
        let places: Vec<_> = (0..4).map(|_| seen(&mut scene)[0].1).collect();
        assert_eq!(places, [2.0, 4.0, 6.0, 8.0]);
        assert!(feed.is_taken());
    }

    #[test]
    fn velocities_follow_from_poses_and_a_teleport_has_none() {
        let dt = 1.0 / 60.0;
        let turned = DQuat::from_rotation_z(3.0 * dt).as_quat().to_array();
        let to = BodyState::new([0.1, 0.0, 0.0], turned, [9.0; 3], [9.0; 3]).unwrap();
        let [.., vx, vy, vz, wx, wy, wz] =
            moved(&state(0.0, [0.0; 3]), &to, dt, DVec3::ZERO).parts();
        let off = Vec3::new(vx - 6.0, vy, vz).length() + Vec3::new(wx, wy, wz - 3.0).length();
        assert!(off < 1e-4, "{off}");
        let far = state(900.0, [1.0; 3]);
        assert_eq!(
            moved(&state(0.0, [0.0; 3]), &far, dt, DVec3::ZERO),
            far.stilled()
        );
    }

    /// A substep adds gravity to the velocity, damps it, and moves the body by it.
    #[test]
    fn velocities_that_follow_from_the_poses_of_a_fall_are_those_of_the_substeps() {
        let mut config = SceneConfig::default();
        config.integrator.substeps = std::num::NonZeroU32::new(4).unwrap();
        (config.gravity, config.damping.linear) = (Vec3::new(0.0, -9.81, 0.0), 0.1);
        let (mut scene, mut feed) = scene_of(config, 2);
        let dt = config.integrator.rate.step().seconds();
        let part = dt / 4.0;
        let (mut place, mut velocity) = ([0.0, 30.0, 0.0], [3.0, 0.0, 0.0]);
        for tick in 1..=40_u64 {
            for _ in 0..4 {
                velocity[1] -= 9.81 * part;
                for (place, velocity) in place.iter_mut().zip(&mut velocity) {
                    *velocity /= 1.0 + part * 0.1;
                    *place += *velocity * part;
                }
            }
            // The other one goes evenly, as on a table.
            let even = [2.0 * dt * tick as f64, 0.0, 5.0];
            let states = [place, even].map(|at| {
                let at = at.map(|part| part as f32);
                BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).unwrap()
            });
            let states = [0, 1].map(|index| (BodyId::new(index, 0), states[index as usize]));
            feed.push(Tick::new(tick), &states, FedVelocities::FromPoses, 0);
            scene.step().unwrap();
            if tick < 3 {
                continue;
            }
            let off = |index: u32, expected: [f64; 3]| {
                let mut seen = scene.observations().iter();
                let seen = seen.find(|seen| seen.id.index() == index).unwrap();
                let twist = seen.motion.motion().twist();
                (twist.linear - DVec3::from_array(expected)).length()
            };
            assert!(off(0, velocity) < 2e-3, "{tick}: {}", off(0, velocity));
            assert!(off(1, [2.0, 0.0, 0.0]) < 1e-3, "{tick}");
        }
    }
}
