//! Bodies of a scene as Entity State PDUs: when to send, and in which bundle.
//!
//! Sans-IO: time is an argument, datagrams leave by [`Publisher::poll_datagram`]. A state is sent when its receivers'
//! prediction, computed from the rounded numbers of the PDU, is off by more than the threshold; and after a heartbeat.
//! A body that is no longer there leaves by a last state with the deactivated bit.

use core::time::Duration;
use std::collections::{BTreeMap, VecDeque};

use glam::{DQuat, DVec3};

use crate::dead_reckoning::{Euler, Model, Motion, reckon};
use crate::entity::{
    DEACTIVATED, DeadReckoning, EntityId, EntityState, EntityType, FROZEN, Kinematics, Marking,
};
use crate::geodesy::{SceneAxes, TangentFrame};
use crate::pdu::{Body, ENTITY_STATE_BYTES, Header, Pdu, TimeBase, Timestamp};

/// The DIS type of bodies of one kind, and the thresholds for their states.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kind {
    /// Their type.
    pub entity_type: EntityType,
    /// 1 friendly, 2 opposing, 3 neutral.
    pub force: u8,
    /// Their name for people.
    pub marking: Marking,
    /// Most distance from the prediction, metres.
    pub metres: f64,
    /// Most turn from the prediction, radians.
    pub radians: f64,
    /// Between two states of a body that moves.
    pub heartbeat: Duration,
    /// Between two states of a body that rests.
    pub stationary: Duration,
}

impl Default for Kind {
    /// The standard's thresholds of 1 m and 3°, and 5 s for both heartbeats.
    fn default() -> Self {
        Self {
            entity_type: EntityType {
                kind: 1,
                domain: 1,
                ..EntityType::default()
            },
            force: 0,
            marking: Marking::ascii("RHUMB"),
            metres: 1.0,
            radians: 3.0_f64.to_radians(),
            heartbeat: Duration::from_secs(5),
            stationary: Duration::from_secs(5),
        }
    }
}

/// A body as the scene has it now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observed {
    /// The caller's number of the body.
    pub key: u64,
    /// Its kind.
    pub kind: Kind,
    /// Metres, scene frame.
    pub position: DVec3,
    /// Unit quaternion, body → scene.
    pub rotation: DQuat,
    /// Metres per second, scene frame.
    pub velocity: DVec3,
    /// Metres per second squared, scene frame; gravity for a body in flight, zero where it is not known.
    pub acceleration: DVec3,
    /// Radians per second about the scene's axes.
    pub spin: DVec3,
}

/// Settings of a publisher.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PublisherConfig {
    /// The exercise.
    pub exercise: u8,
    /// Site and application of its entities.
    pub site: u16,
    /// The program at the site.
    pub application: u16,
    /// The place of the scene on the Earth.
    pub frame: TangentFrame,
    /// The directions of its axes.
    pub axes: SceneAxes,
    /// The origin of its timestamps.
    pub base: TimeBase,
    /// Most bytes of a datagram; a bundle holds as many states as fit, and one at least.
    pub datagram_bytes: usize,
    /// Most states a second; what waits is sent later, the largest errors first, and last states before all others.
    pub states_per_second: u32,
}

/// Counts since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublisherStatistics {
    /// States beyond a threshold, first ones included.
    pub updates: u64,
    /// States because of a heartbeat.
    pub heartbeats: u64,
    /// States that waited for the rate limit, once for each observation.
    pub delayed: u64,
    /// Bodies without a number: all 65,533 are taken.
    pub unnamed: u64,
    /// Observations with a number that is not finite; not sent.
    pub not_finite: u64,
}

/// The last state of a body that was sent, as receivers read it.
struct Sent {
    entity: u16,
    state: EntityState<'static>,
    at: Duration,
}

/// Turns observations of bodies into datagrams.
pub struct Publisher {
    config: PublisherConfig,
    sent: BTreeMap<u64, Sent>,
    names: Names,
    queue: VecDeque<(EntityState<'static>, Duration)>,
    leaving: VecDeque<EntityState<'static>>,
    allowance: f64,
    before: Option<Duration>,
    statistics: PublisherStatistics,
}

impl Publisher {
    /// A publisher that has sent nothing.
    #[must_use]
    pub fn new(config: PublisherConfig) -> Self {
        let allowance = f64::from(config.states_per_second);
        Self {
            config,
            sent: BTreeMap::new(),
            names: Names::default(),
            queue: VecDeque::new(),
            leaving: VecDeque::new(),
            allowance,
            before: None,
            statistics: PublisherStatistics::default(),
        }
    }

    /// Handles all bodies of the scene at `now`: queues states that are due, and last states of bodies that are gone.
    ///
    /// Keys are in rising order, each once. Drain [`Self::poll_datagram`] before the next call.
    pub fn handle_bodies(&mut self, now: Duration, bodies: &[Observed]) {
        let passed = now.saturating_sub(self.before.unwrap_or(now)).as_secs_f64();
        let most = f64::from(self.config.states_per_second);
        self.allowance = (self.allowance + passed * most).min(most);
        self.before = Some(now);
        self.leave(bodies);
        while self.allowance >= 1.0 {
            let Some(state) = self.leaving.pop_front() else {
                break;
            };
            self.names.free(state.id.entity);
            self.queue.push_back((state, now));
            self.allowance -= 1.0;
        }
        let mut due = Vec::new();
        for body in bodies {
            if let Some(urgency) = self.urgency(now, body) {
                due.push((urgency, body));
            }
        }
        due.sort_by(|(a, x), (b, y)| b.total_cmp(a).then(x.key.cmp(&y.key)));
        for (urgency, body) in due {
            if self.allowance < 1.0 {
                self.statistics.delayed += 1;
            } else if self.send(now, body) {
                self.allowance -= 1.0;
                let count = if urgency > 1.0 {
                    &mut self.statistics.updates
                } else {
                    &mut self.statistics.heartbeats
                };
                *count += 1;
            }
        }
    }

    /// Writes the next datagram, and returns its bytes; `None` when all is sent, or when `to` has no room for a state.
    pub fn poll_datagram(&mut self, to: &mut [u8]) -> Option<usize> {
        let room = to
            .len()
            .min(self.config.datagram_bytes.max(ENTITY_STATE_BYTES));
        let mut bytes = 0;
        while let Some((state, at)) = self.queue.front() {
            let header = Header::new(self.config.exercise, Timestamp::at(*at, self.config.base));
            let pdu = Pdu {
                header,
                body: Body::EntityState(*state),
            };
            let Ok(written) = pdu.encode(&mut to[bytes..room]) else {
                break;
            };
            bytes += written;
            self.queue.pop_front();
        }
        (bytes > 0).then_some(bytes)
    }

    /// Last states that wait for the rate limit.
    #[must_use]
    pub fn leaving(&self) -> usize {
        self.leaving.len()
    }

    /// Counts since the start.
    #[must_use]
    pub const fn statistics(&self) -> PublisherStatistics {
        self.statistics
    }

    /// Queues last states of bodies that are not among these.
    fn leave(&mut self, bodies: &[Observed]) {
        let is_gone = |key: &u64| bodies.binary_search_by_key(key, |body| body.key).is_err();
        let gone: Vec<u64> = self.sent.keys().copied().filter(is_gone).collect();
        for key in gone {
            if let Some(mut last) = self.sent.remove(&key) {
                last.state.kinematics.appearance |= DEACTIVATED;
                self.leaving.push_back(last.state);
            }
        }
    }

    /// Above one: the error over the threshold. At most one: a heartbeat is due. `None`: nothing is.
    fn urgency(&self, now: Duration, body: &Observed) -> Option<f64> {
        let Some(sent) = self.sent.get(&body.key) else {
            return Some(f64::INFINITY);
        };
        let age = now.saturating_sub(sent.at);
        let receivers = predicted(&sent.state, age.as_secs_f64());
        let (true_location, true_orientation) = self.placed(body);
        let metres = (receivers.location - true_location).length() / body.kind.metres;
        let cosine = receivers.orientation.dot(true_orientation).abs().min(1.0);
        let radians = 2.0 * cosine.acos() / body.kind.radians;
        let error = metres.max(radians);
        let rests = body.velocity == DVec3::ZERO && body.spin == DVec3::ZERO;
        let heartbeat = if rests {
            body.kind.stationary
        } else {
            body.kind.heartbeat
        };
        if error > 1.0 {
            Some(error)
        } else {
            (age >= heartbeat).then_some(error)
        }
    }

    /// Location and orientation of a body, geocentric.
    fn placed(&self, body: &Observed) -> (DVec3, DQuat) {
        let frame = &self.config.frame;
        let turn = frame.rotation() * body.rotation * self.config.axes.entity_in_body();
        (frame.point_to_geocentric(body.position), turn.normalize())
    }

    /// Queues the state of a body; false if it has none.
    fn send(&mut self, now: Duration, body: &Observed) -> bool {
        let (location, orientation) = self.placed(body);
        let vectors = [body.velocity, body.acceleration, body.spin];
        let finite = vectors.into_iter().all(DVec3::is_finite);
        if !(finite && location.is_finite() && orientation.is_finite()) {
            self.statistics.not_finite += 1;
            return false;
        }
        let entity = match self.sent.get(&body.key) {
            Some(sent) => sent.entity,
            None => match self.names.take() {
                Some(entity) => entity,
                None => {
                    self.statistics.unnamed += 1;
                    return false;
                }
            },
        };
        let frame = &self.config.frame;
        let angles = Euler::from_quaternion(orientation);
        let spin = orientation.conjugate() * frame.vector_to_geocentric(body.spin);
        let PublisherConfig {
            site, application, ..
        } = self.config;
        let state = EntityState {
            id: EntityId {
                site,
                application,
                entity,
            },
            force: body.kind.force,
            entity_type: body.kind.entity_type,
            alternative_type: body.kind.entity_type,
            kinematics: Kinematics {
                velocity: frame
                    .vector_to_geocentric(body.velocity)
                    .as_vec3()
                    .to_array(),
                location,
                orientation: [angles.psi, angles.theta, angles.phi].map(|angle| angle as f32),
                appearance: 0,
            },
            dead_reckoning: DeadReckoning {
                model: model_of(body) as u8,
                other: [0; 15],
                acceleration: frame
                    .vector_to_geocentric(body.acceleration)
                    .as_vec3()
                    .to_array(),
                spin: spin.as_vec3().to_array(),
            },
            marking: body.kind.marking,
            capabilities: 0,
            parameters: &[],
        };
        self.sent.insert(
            body.key,
            Sent {
                entity,
                state,
                at: now,
            },
        );
        self.queue.push_back((state, now));
        true
    }
}

/// The model that predicts a body best. Models along the entity's axes are left out: tools disagree about some of them.
fn model_of(body: &Observed) -> Model {
    let [moves, speeds_up, turns] =
        [body.velocity, body.acceleration, body.spin].map(|vector| vector != DVec3::ZERO);
    match (moves || speeds_up, speeds_up, turns) {
        (false, _, false) => Model::Static,
        (true, false, false) => Model::FixedVelocityWorld,
        (_, false, true) => Model::RotatingVelocityWorld,
        (_, true, true) => Model::RotatingAccelerationWorld,
        (_, true, false) => Model::FixedAccelerationWorld,
    }
}

/// The pose that a receiver predicts from a state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Predicted {
    /// Geocentric, metres.
    pub location: DVec3,
    /// Unit quaternion, entity → geocentric.
    pub orientation: DQuat,
    /// Geocentric axes, metres per second.
    pub velocity: DVec3,
    /// Geocentric axes, radians per second.
    pub spin: DVec3,
}

/// Predicts from a state as a receiver does, `seconds` after it.
#[must_use]
pub fn predicted(state: &EntityState<'_>, seconds: f64) -> Predicted {
    let wide = |three: [f32; 3]| DVec3::from(three.map(f64::from));
    let kinematics = &state.kinematics;
    let [psi, theta, phi] = kinematics.orientation.map(f64::from);
    let motion = Motion {
        velocity: wide(kinematics.velocity),
        acceleration: wide(state.dead_reckoning.acceleration),
        orientation: Euler { psi, theta, phi }.to_quaternion(),
        spin: wide(state.dead_reckoning.spin),
    };
    let frozen = kinematics.appearance & FROZEN != 0;
    let model = Model::of(state.dead_reckoning.model).filter(|_| !frozen);
    let model = model.unwrap_or(Model::Static);
    let reckoned = reckon(model, &motion, seconds);
    let orientation = reckoned.orientation;
    let velocity = match model {
        Model::Static => DVec3::ZERO,
        _ if model.is_along_body() => orientation * reckoned.velocity,
        _ => reckoned.velocity,
    };
    let spin = if model.turns() {
        orientation * motion.spin
    } else {
        DVec3::ZERO
    };
    Predicted {
        location: kinematics.location + reckoned.displacement,
        orientation,
        velocity,
        spin,
    }
}

/// Numbers of entities, each used by one body at a time; the one that was free longest comes first.
#[derive(Default)]
struct Names {
    used: u16,
    free: VecDeque<u16>,
}

impl Names {
    /// Highest number of a single entity; the rest mean all of them, or none.
    const LAST: u16 = 65_533;

    fn take(&mut self) -> Option<u16> {
        if self.used < Self::LAST {
            self.used += 1;
            return Some(self.used);
        }
        self.free.pop_front()
    }

    fn free(&mut self, entity: u16) {
        self.free.push_back(entity);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geodesy::Geodetic;
    use crate::pdu::Bundle;

    fn config() -> PublisherConfig {
        let place = Geodetic::from_degrees(48.0, 11.0, 500.0).expect("in range");
        PublisherConfig {
            exercise: 1,
            site: 2,
            application: 3,
            frame: TangentFrame::new(place, SceneAxes::YUp),
            axes: SceneAxes::YUp,
            base: TimeBase::Absolute,
            datagram_bytes: 1400,
            states_per_second: 1000,
        }
    }

    fn ball(key: u64) -> Observed {
        Observed {
            key,
            kind: Kind::default(),
            position: DVec3::new(key as f64, 1.0, 0.0),
            rotation: DQuat::IDENTITY,
            velocity: DVec3::ZERO,
            acceleration: DVec3::ZERO,
            spin: DVec3::ZERO,
        }
    }

    fn seconds(time: f64) -> Duration {
        Duration::from_secs_f64(time)
    }

    /// Bytes of each datagram.
    fn sent(publisher: &mut Publisher) -> Vec<Vec<u8>> {
        let mut buffer = [0; 1500];
        std::iter::from_fn(|| {
            let bytes = publisher.poll_datagram(&mut buffer)?;
            Some(buffer[..bytes].to_vec())
        })
        .collect()
    }

    #[test]
    fn a_resting_body_is_sent_once_and_then_by_heartbeat() {
        let mut publisher = Publisher::new(config());
        let mut times = Vec::new();
        for step in 0..660 {
            let now = seconds(f64::from(step) / 60.0);
            publisher.handle_bodies(now, &[ball(1)]);
            times.extend(sent(&mut publisher).iter().map(|_| step));
        }
        assert_eq!(times, [0, 300, 600]);
        let counts = publisher.statistics();
        assert_eq!((counts.updates, counts.heartbeats), (1, 2));
    }

    #[test]
    fn receivers_are_within_the_threshold_at_every_step() {
        let mut publisher = Publisher::new(config());
        let mut known: Option<(EntityState<'static>, f64)> = None;
        let mut count = 0;
        for step in 0..600 {
            let t = f64::from(step) / 60.0;
            // A circle of 20 m in 6 s, nose along the path.
            let angle = t * core::f64::consts::TAU / 6.0;
            let rate = core::f64::consts::TAU / 6.0;
            let body = Observed {
                position: DVec3::new(20.0 * angle.cos(), 0.0, 20.0 * angle.sin()),
                velocity: DVec3::new(-angle.sin(), 0.0, angle.cos()) * 20.0 * rate,
                rotation: DQuat::from_rotation_y(-angle),
                spin: DVec3::new(0.0, -rate, 0.0),
                ..ball(1)
            };
            publisher.handle_bodies(seconds(t), &[body]);
            for datagram in sent(&mut publisher) {
                let pdu = Pdu::decode(&datagram).expect("a sound pdu");
                let Body::EntityState(state) = pdu.body else {
                    panic!("a state")
                };
                known = Some((
                    EntityState {
                        parameters: &[],
                        ..state
                    },
                    t,
                ));
                count += 1;
            }
            let (state, at) = known.as_ref().expect("the first state is sent at once");
            let Predicted {
                location,
                orientation,
                ..
            } = predicted(state, t - at);
            let (true_location, true_orientation) = publisher.placed(&body);
            assert!((location - true_location).length() <= 1.0);
            assert!(orientation.dot(true_orientation).abs() >= 1.5_f64.to_radians().cos() - 1e-12);
        }
        // sqrt(a / 2e) = 3.3 a second for first order.
        assert!((25..45).contains(&count), "{count} states");
    }

    #[test]
    fn a_thrown_body_with_its_gravity_needs_heartbeats_alone() {
        let mut publisher = Publisher::new(config());
        let gravity = DVec3::new(0.0, -9.81, 0.0);
        for step in 0..240 {
            let t = f64::from(step) / 60.0;
            let velocity = DVec3::new(10.0, 20.0, 0.0) + gravity * t;
            let position = DVec3::new(10.0, 20.0, 0.0) * t + gravity * (0.5 * t * t);
            let spin = DVec3::new(0.0, 0.0, 2.0);
            let rotation = DQuat::from_rotation_z(2.0 * t);
            let body = Observed {
                position,
                velocity,
                acceleration: gravity,
                spin,
                rotation,
                ..ball(1)
            };
            publisher.handle_bodies(seconds(t), &[body]);
            sent(&mut publisher);
        }
        assert_eq!(publisher.statistics().updates, 1);
    }

    #[test]
    fn bundles_fill_datagrams_and_a_body_that_is_gone_leaves() {
        let mut publisher = Publisher::new(config());
        let bodies: Vec<_> = (0..20).map(ball).collect();
        publisher.handle_bodies(seconds(0.0), &bodies);
        let sizes: Vec<_> = sent(&mut publisher).iter().map(Vec::len).collect();
        assert_eq!(sizes, [9 * 144, 9 * 144, 2 * 144]);
        publisher.handle_bodies(seconds(0.1), &bodies[1..]);
        let last = sent(&mut publisher).concat();
        let read: Vec<_> = Bundle::new(&last).filter_map(Result::ok).collect();
        assert_eq!(read.len(), 1);
        let Body::EntityState(state) = read[0].1.body else {
            panic!("a state")
        };
        assert_eq!(state.id.entity, 1);
        assert_eq!(state.kinematics.appearance, DEACTIVATED);
        publisher.handle_bodies(seconds(0.2), &bodies);
        let again = sent(&mut publisher).concat();
        let Body::EntityState(state) = Pdu::decode(&again).expect("one state").body else {
            panic!("a state")
        };
        assert_eq!(state.id.entity, 21, "a name is not used again at once");
    }

    #[test]
    fn the_rate_limit_holds_and_the_largest_errors_come_first() {
        let mut publisher = Publisher::new(PublisherConfig {
            states_per_second: 10,
            ..config()
        });
        let mut bodies: Vec<_> = (0..10).map(ball).collect();
        publisher.handle_bodies(seconds(0.0), &bodies);
        assert_eq!(sent(&mut publisher).concat().len(), 10 * 144);
        for (body, metres) in bodies.iter_mut().zip([2.0, 9.0, 3.0, 8.0]) {
            body.position.z += metres;
        }
        publisher.handle_bodies(seconds(0.21), &bodies);
        let datagram = sent(&mut publisher).concat();
        let names: Vec<_> = Bundle::new(&datagram)
            .filter_map(|read| match read.ok()?.1.body {
                Body::EntityState(state) => Some(state.id.entity),
                _ => None,
            })
            .collect();
        assert_eq!(names, [2, 4]);
        assert_eq!(publisher.statistics().delayed, 2);
    }

    #[test]
    fn a_last_state_does_not_wait_behind_bodies_that_are_always_due() {
        let mut publisher = Publisher::new(PublisherConfig {
            states_per_second: 10,
            ..config()
        });
        let mut bodies: Vec<_> = (0..10).map(ball).collect();
        publisher.handle_bodies(seconds(0.0), &bodies);
        assert_eq!(sent(&mut publisher).concat().len(), 10 * 144);
        bodies.remove(0);
        for tenth in 1..=3 {
            bodies.iter_mut().for_each(|body| body.position.z += 5.0);
            publisher.handle_bodies(seconds(0.11 * f64::from(tenth)), &bodies);
            let datagram = sent(&mut publisher).concat();
            let pdu = Pdu::decode(&datagram).expect("one state");
            let Body::EntityState(state) = pdu.body else {
                panic!("a state")
            };
            let is_last = state.kinematics.appearance == DEACTIVATED;
            assert_eq!(is_last, tenth == 1, "state {tenth}");
        }
        // At the end all leave at once, as fast as the limit lets them.
        publisher.handle_bodies(seconds(0.45), &[]);
        assert_eq!(publisher.leaving(), 8);
        publisher.handle_bodies(seconds(1.45), &[]);
        assert_eq!(publisher.leaving(), 0);
    }

    #[test]
    fn numbers_that_are_not_finite_are_not_sent() {
        let mut publisher = Publisher::new(config());
        let body = Observed {
            position: DVec3::NAN,
            ..ball(1)
        };
        publisher.handle_bodies(seconds(0.0), &[body]);
        assert!(sent(&mut publisher).is_empty());
        assert_eq!(publisher.statistics().not_finite, 1);
    }
}
