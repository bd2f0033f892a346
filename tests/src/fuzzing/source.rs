//! The publisher of a stream, with bodies that a script moves.
//!
//! There is no engine: bodies fall, are hit, fall asleep, are teleported and are attached to each other. The true
//! states are kept for comparison with copies.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::{DQuat, DVec3, Vec3};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    Activity, Budget, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    StreamConfig, StreamStart, Subscriber,
};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Damping, Inertia, Integrator, Metres, Predictor, Rate, Tick,
    Tolerance, ToleranceScale, Track,
};

use super::script::Script;

/// The id of the stream.
pub(super) const STREAM: StreamId = StreamId(3);
/// Indices of bodies are below this.
pub(super) const BODIES: usize = 8;
const RADIUS: Metres = Metres::new(0.5);

/// A scene change that all subscribers receive in order.
#[derive(Clone, Copy, Debug)]
pub(super) enum SceneChange {
    Placed(BodyId, Track),
    Removed(BodyId),
    Gravity(Tick, Vec3),
}

impl SceneChange {
    pub(super) fn apply_to(self, subscriber: &mut Subscriber) {
        match self {
            Self::Placed(id, track) => assert!(subscriber.place(id, &parameters(id), track)),
            Self::Removed(id) => assert!(subscriber.remove(id), "{id} exists"),
            Self::Gravity(since, gravity) => subscriber.change_gravity(since, gravity),
        }
        subscriber.apply_scene_event();
    }
}

/// Prediction parameters that differ between neighbouring bodies.
pub(super) fn parameters(id: BodyId) -> PredictionParameters {
    let index = id.index();
    let inertia = Inertia::new([1.0, 2.0, 2.5], [0.0, 0.0, 0.0, 1.0]);
    PredictionParameters {
        radius: RADIUS,
        damping: Damping {
            linear: if index % 4 == 3 { 0.4 } else { 0.0 },
            angular: 0.0,
        },
        gravity_scale: [1.0, 0.0, 1.0, -0.5][index as usize % 4],
        inertia: inertia.ok().filter(|_| index % 3 == 2),
        tolerance_scale: ToleranceScale::new((index % 7) as i8 - 3)
            .expect("one of seven tolerance scales"),
    }
}

/// A body.
#[derive(Clone, Copy, Debug)]
struct ScriptedBody {
    id: BodyId,
    position: DVec3,
    rotation: DQuat,
    linear: DVec3,
    angular: DVec3,
    asleep: bool,
    /// Index of the parent that it is attached to.
    parent: Option<usize>,
}

impl ScriptedBody {
    fn body_state(&self) -> BodyState {
        BodyState::new(
            self.position.as_vec3().to_array(),
            self.rotation.as_quat().to_array(),
            self.linear.as_vec3().to_array(),
            self.angular.as_vec3().to_array(),
        )
        .expect("the motion of a scripted body is finite")
    }

    fn step(&mut self, gravity: DVec3) {
        let (damping, scale) = (
            parameters(self.id).damping,
            parameters(self.id).gravity_scale,
        );
        self.linear += gravity * f64::from(scale) / 60.0;
        self.linear *= 1.0 - f64::from(damping.linear) / 60.0;
        if self.position.y < 0.0 {
            self.linear.y = self.linear.y.abs();
        }
        self.position = (self.position + self.linear / 60.0).clamp(-FAR, FAR);
        let turn = DQuat::from_scaled_axis(self.angular / 60.0);
        self.rotation = (turn * self.rotation).normalize();
    }
}

/// Bodies stay within this distance of the origin on each axis, in metres.
const FAR: DVec3 = DVec3::splat(1e5);

/// The publisher and its bodies.
pub(super) struct Source {
    pub(super) publisher: Publisher,
    observation_history: ObservationHistory,
    bodies: [Option<ScriptedBody>; BODIES],
    generations: [u16; BODIES],
    /// The published rest state of each sleeping body.
    published_rests: [Option<(BodyId, BodyState)>; BODIES],
    gravity: Vec3,
    pub(super) tick: Tick,
    /// Number of scene changes so far.
    pub(super) scene_events: u64,
    /// True states after each tick.
    past: Vec<BTreeMap<BodyId, BodyState>>,
}

impl Source {
    /// A publisher without bodies.
    pub(super) fn new(tolerance: Tolerance, budget: Option<Budget>) -> Self {
        let gravity = Vec3::new(0.0, -9.8, 0.0);
        let config = StreamConfig {
            publish_interval: PublishSchedule::EACH_TICK.publish_interval,
            tolerance,
            integrator: integrator(),
            largest_packet: LargestPacket::DEFAULT,
            gravity,
            features: Features::ALL,
        };
        let mut publisher = Publisher::new(STREAM, &config, Tick::ZERO);
        if let Some(budget) = budget {
            publisher.limit(budget);
        }
        Self {
            publisher,
            observation_history: ObservationHistory::new(PublishSchedule::EACH_TICK),
            bodies: [None; BODIES],
            generations: [0; BODIES],
            published_rests: [None; BODIES],
            gravity,
            tick: Tick::ZERO,
            scene_events: 0,
            past: vec![BTreeMap::new()],
        }
    }

    /// The start of the stream for a new subscriber.
    pub(super) fn start(&self) -> StreamStart {
        StreamStart {
            stream: STREAM,
            tolerance: self.publisher.tolerance(),
            integrator: integrator(),
            publish_interval: PublishSchedule::EACH_TICK.publish_interval,
            largest_packet: LargestPacket::DEFAULT,
            gravity: self.gravity,
            tick: self.tick,
            next: self.publisher.next_number(),
            scene_events: self.scene_events,
        }
    }

    /// Adds a body, if the index is free.
    pub(super) fn add(&mut self, index: usize, position: Vec3) -> Option<SceneChange> {
        if self.bodies[index].is_some() {
            return None;
        }
        let body = ScriptedBody {
            id: BodyId::new(index as u32, self.generations[index]),
            position: position.as_dvec3().clamp(-FAR, FAR),
            rotation: DQuat::IDENTITY,
            linear: DVec3::ZERO,
            angular: DVec3::ZERO,
            asleep: false,
            parent: None,
        };
        self.bodies[index] = Some(body);
        let track = Track {
            origin: self.tick,
            predictor: Predictor::Ballistic,
            anchor: Anchor::Exact(body.body_state()),
            parent: None,
        };
        let placed = self.publisher.place(body.id, &parameters(body.id), track);
        assert!(placed, "eight aliases fit into the table");
        self.scene_events += 1;
        Some(SceneChange::Placed(body.id, track))
    }

    /// Removes a body, if it exists.
    pub(super) fn remove(&mut self, index: usize) -> Option<SceneChange> {
        let body = self.bodies[index].take()?;
        self.generations[index] = self.generations[index].wrapping_add(1);
        self.publisher.remove(body.id);
        self.scene_events += 1;
        Some(SceneChange::Removed(body.id))
    }

    /// Changes the gravity.
    pub(super) fn change_gravity(&mut self, gravity: Vec3) -> SceneChange {
        self.gravity = gravity;
        self.publisher.change_gravity(self.tick, gravity);
        self.scene_events += 1;
        SceneChange::Gravity(self.tick, gravity)
    }

    /// Applies a random change to a body.
    pub(super) fn strike(&mut self, script: &mut Script<'_>) {
        let (index, parent) = (script.below(BODIES), script.below(BODIES));
        let Some(body) = &mut self.bodies[index] else {
            return;
        };
        body.asleep = false;
        match script.below(5) {
            0 => body.linear += script.sane_vector(20.0).as_dvec3(),
            1 => body.angular += script.sane_vector(20.0).as_dvec3(),
            2 => body.position = script.sane_vector(1e5).as_dvec3(),
            3 => (body.linear, body.angular, body.asleep) = (DVec3::ZERO, DVec3::ZERO, true),
            _ => body.parent = (parent != index && body.parent.is_none()).then_some(parent),
        }
    }

    /// Steps to the next tick, and returns its datagrams.
    pub(super) fn step(&mut self) -> Vec<Bytes> {
        self.tick = self.tick.next();
        let before = self.bodies;
        let mut observations = Vec::new();
        for (index, body) in self.bodies.iter_mut().enumerate() {
            let Some(body) = body else {
                continue;
            };
            if !body.asleep {
                body.step(self.gravity.as_dvec3());
            }
            if let Some(parent) = body.parent.and_then(|parent| before[parent])
                && !body.asleep
            {
                let offset = parent.rotation * DVec3::new(0.0, 1.0, 0.0);
                body.position = (parent.position + parent.linear / 60.0 + offset).clamp(-FAR, FAR);
                (body.linear, body.rotation) = (parent.linear, parent.rotation);
            }
            // An engine reports a sleeping body only once.
            let sleeper = body.asleep.then(|| (body.id, body.body_state()));
            if sleeper.is_none() || self.published_rests[index] != sleeper {
                self.published_rests[index] = sleeper;
                observations.push(Observation {
                    id: body.id,
                    motion: body.body_state(),
                    activity: if body.asleep {
                        Activity::Asleep
                    } else {
                        Activity::Awake
                    },
                });
            }
        }
        let bodies = self.bodies.iter().flatten();
        self.past
            .push(bodies.map(|body| (body.id, body.body_state())).collect());
        self.observation_history.observe(self.tick, &observations);
        let mut sent = Vec::new();
        self.publisher
            .publish(&self.observation_history, self.scene_events, &mut sent);
        if sent.is_empty() {
            sent.push(self.publisher.watermark(self.scene_events));
        }
        sent
    }

    /// True state of a body after a tick.
    pub(super) fn truth(&self, id: BodyId, tick: Tick) -> Option<&BodyState> {
        self.past.get(tick.value() as usize)?.get(&id)
    }
}

fn integrator() -> Integrator {
    Integrator {
        rate: Rate::HZ_60,
        substeps: const { NonZeroU32::new(4).expect("four is not zero") },
    }
}
