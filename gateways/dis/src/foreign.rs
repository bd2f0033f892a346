//! Entities of other simulators as bodies of a scene: who is there, and where.
//!
//! Sans-IO: datagrams and time are arguments, events leave by [`ForeignEntities::poll_event`]. Memory is bounded by the most
//! entities of the settings, not by what senders claim. An entity leaves by a state with the deactivated bit, by a Remove
//! Entity PDU, or when it was silent for 2.4 heartbeats. Its own application's entities are not foreign.

use core::time::Duration;
use std::collections::{BTreeMap, VecDeque};

use glam::{DQuat, DVec3};

use crate::entity::{DEACTIVATED, EntityId, EntityState, EntityType, Kinematics, Marking};
use crate::geodesy::{SceneAxes, TangentFrame};
use crate::pdu::{Body, Bundle, Malformed, Pdu, TimeBase, Timestamp};
use crate::published::predicted;

/// Settings for foreign entities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForeignConfig {
    /// The exercise; PDUs of others are ignored.
    pub exercise: u8,
    /// Site and application of the gateway, whose own PDUs come back by broadcast.
    pub site: u16,
    /// The program at the site.
    pub application: u16,
    /// The place of the scene on the Earth.
    pub frame: TangentFrame,
    /// The directions of its axes.
    pub axes: SceneAxes,
    /// An entity that is silent for this long is gone; 2.4 heartbeats by the standard.
    pub timeout: Duration,
    /// Most entities at a time; one member of a scene has authority over 256 bodies.
    pub entities_max: usize,
    /// Entities further than this from the origin, metres, leave their place to nearer ones.
    pub reach: f64,
    /// Most PDUs a second; those beyond are dropped.
    pub pdus_per_second: u32,
}

impl ForeignConfig {
    /// The standard's time of silence for a heartbeat of 5 s.
    pub const TIMEOUT: Duration = Duration::from_secs(12);
}

/// The reason why an entity left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LeaveCause {
    /// Its last state has the deactivated bit.
    Deactivated,
    /// A Remove Entity PDU names it.
    Removed,
    /// It was silent for too long.
    Silent,
    /// It was beyond the reach, and one within it took its place.
    Displaced,
}

/// A change of who is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ForeignEvent {
    /// An entity is there.
    Appeared {
        /// Its name.
        id: EntityId,
        /// Its type.
        entity_type: EntityType,
        /// Its name for people.
        marking: Marking,
    },
    /// An entity is gone.
    Left {
        /// Its name.
        id: EntityId,
        /// The reason.
        cause: LeaveCause,
    },
}

/// The pose of a foreign entity, in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForeignPose {
    /// Its name.
    pub id: EntityId,
    /// Metres, scene frame.
    pub position: DVec3,
    /// Unit quaternion, body → scene.
    pub rotation: DQuat,
    /// Metres per second, scene frame.
    pub velocity: DVec3,
    /// Radians per second about the scene's axes.
    pub spin: DVec3,
    /// Its type.
    pub entity_type: EntityType,
}

/// Counts since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ForeignStatistics {
    /// PDUs that were understood and used.
    pub used: u64,
    /// PDUs of other exercises, of the gateway itself, or of types that are not understood.
    pub ignored: u64,
    /// PDUs that are no PDUs, and states with numbers that are not finite.
    pub malformed: u64,
    /// PDUs older than what is known of their entity.
    pub stale: u64,
    /// PDUs beyond the rate limit.
    pub too_many: u64,
    /// States of entities for which there was no place.
    pub no_place: u64,
}

struct Entity {
    state: EntityState<'static>,
    stamp: Timestamp,
    /// Moment of the state, by the gateway's clock.
    at: Duration,
    arrival: Duration,
}

/// The entities of other simulators.
pub struct ForeignEntities {
    config: ForeignConfig,
    entities: BTreeMap<EntityId, Entity>,
    events: VecDeque<ForeignEvent>,
    allowance: f64,
    before: Option<Duration>,
    statistics: ForeignStatistics,
}

/// Most age that an absolute timestamp may give a state; beyond it, the clocks are not one, and the arrival counts.
const AGE_MAX: f64 = 2.0;
/// A state that is older than the last by more than this, in seconds, is of a sender that began anew.
const RESTART: f64 = 5.0;

impl ForeignEntities {
    /// No entity is there.
    #[must_use]
    pub fn new(config: ForeignConfig) -> Self {
        Self {
            config,
            entities: BTreeMap::new(),
            events: VecDeque::new(),
            allowance: f64::from(config.pdus_per_second),
            before: None,
            statistics: ForeignStatistics::default(),
        }
    }

    /// Handles a datagram that arrived at `now`, a time since a full hour of UTC.
    ///
    /// # Errors
    ///
    /// The first [`Malformed`] of the bundle; the PDUs beside it are handled all the same.
    pub fn handle_datagram(&mut self, now: Duration, datagram: &[u8]) -> Result<(), Malformed> {
        let passed = now.saturating_sub(self.before.unwrap_or(now)).as_secs_f64();
        let most = f64::from(self.config.pdus_per_second);
        self.allowance = (self.allowance + passed * most).min(most);
        self.before = Some(now);
        let mut first = Ok(());
        for read in Bundle::new(datagram) {
            if self.allowance < 1.0 {
                self.statistics.too_many += 1;
                continue;
            }
            self.allowance -= 1.0;
            match read {
                Ok((_, pdu)) => self.handle_pdu(now, &pdu),
                Err(error) => {
                    self.statistics.malformed += 1;
                    first = first.and(Err(error));
                }
            }
        }
        first
    }

    /// Removes entities that were silent for too long.
    pub fn handle_timeout(&mut self, now: Duration) {
        let timeout = self.config.timeout;
        let silent = |entity: &Entity| now.saturating_sub(entity.arrival) >= timeout;
        let gone: Vec<_> = self
            .entities
            .iter()
            .filter(|(_, entity)| silent(entity))
            .collect();
        for id in gone.into_iter().map(|(id, _)| *id).collect::<Vec<_>>() {
            self.leave(id, LeaveCause::Silent);
        }
    }

    /// The next change of who is there.
    pub fn poll_event(&mut self) -> Option<ForeignEvent> {
        self.events.pop_front()
    }

    /// The poses of all entities at `now`, by their own dead reckoning, in order of name.
    pub fn poses(&self, now: Duration) -> impl Iterator<Item = ForeignPose> {
        let frame = &self.config.frame;
        let to_scene = frame.rotation().conjugate();
        let to_body = self.config.axes.entity_in_body().conjugate();
        self.entities.iter().map(move |(id, entity)| {
            let age = now.as_secs_f64() - entity.at.as_secs_f64();
            let predicted = predicted(&entity.state, age);
            ForeignPose {
                id: *id,
                position: frame.point_to_scene(predicted.location),
                rotation: (to_scene * predicted.orientation * to_body).normalize(),
                velocity: frame.vector_to_scene(predicted.velocity),
                spin: frame.vector_to_scene(predicted.spin),
                entity_type: entity.state.entity_type,
            }
        })
    }

    /// Counts since the start.
    #[must_use]
    pub const fn statistics(&self) -> ForeignStatistics {
        self.statistics
    }

    fn handle_pdu(&mut self, now: Duration, pdu: &Pdu<'_>) {
        if pdu.header.exercise != self.config.exercise {
            self.statistics.ignored += 1;
            return;
        }
        let stamp = pdu.header.timestamp;
        match pdu.body {
            Body::EntityState(state) if self.is_foreign(state.id) => {
                self.handle_state(
                    now,
                    stamp,
                    EntityState {
                        parameters: &[],
                        ..state
                    },
                );
            }
            Body::EntityStateUpdate(update) => match self.entities.get(&update.id) {
                Some(known) => {
                    let kinematics = update.kinematics;
                    self.handle_state(
                        now,
                        stamp,
                        EntityState {
                            kinematics,
                            ..known.state
                        },
                    );
                }
                None => self.statistics.ignored += 1,
            },
            Body::RemoveEntity(remove) => self.remove(remove.receiving),
            _ => self.statistics.ignored += 1,
        }
    }

    fn handle_state(&mut self, now: Duration, stamp: Timestamp, state: EntityState<'static>) {
        if !is_finite(&state) {
            self.statistics.malformed += 1;
            return;
        }
        let known = self.entities.get(&state.id);
        let newer = known.map_or(0.0, |known| stamp.seconds_since(known.stamp));
        if (-RESTART..0.0).contains(&newer) {
            self.statistics.stale += 1;
            return;
        }
        if state.kinematics.appearance & DEACTIVATED != 0 {
            self.statistics.used += 1;
            self.leave(state.id, LeaveCause::Deactivated);
            return;
        }
        if known.is_none() {
            if self.entities.len() >= self.config.entities_max && !self.make_place(&state) {
                self.statistics.no_place += 1;
                return;
            }
            let EntityState {
                id,
                entity_type,
                marking,
                ..
            } = state;
            self.events.push_back(ForeignEvent::Appeared {
                id,
                entity_type,
                marking,
            });
        }
        self.statistics.used += 1;
        let at = moment(now, stamp);
        self.entities.insert(
            state.id,
            Entity {
                state,
                stamp,
                at,
                arrival: now,
            },
        );
    }

    fn is_foreign(&self, id: EntityId) -> bool {
        (id.site, id.application) != (self.config.site, self.config.application)
    }

    /// True if an entity beyond the reach has left its place to this one.
    fn make_place(&mut self, state: &EntityState<'_>) -> bool {
        let is_near = |state: &EntityState<'_>| {
            let position = self.config.frame.point_to_scene(state.kinematics.location);
            position.length() <= self.config.reach
        };
        if !is_near(state) {
            return false;
        }
        let mut far = self.entities.iter();
        let far = far.find(|(_, entity)| !is_near(&entity.state));
        let far = far.map(|(id, _)| *id);
        far.inspect(|id| self.leave(*id, LeaveCause::Displaced))
            .is_some()
    }

    /// Removes the entities of a name, in which the greatest number stands for all.
    fn remove(&mut self, name: EntityId) {
        let fits = |own: u16, named: u16| named == u16::MAX || own == named;
        let all = self.entities.keys().filter(|id| {
            fits(id.site, name.site)
                && fits(id.application, name.application)
                && fits(id.entity, name.entity)
        });
        let all: Vec<_> = all.copied().collect();
        match all.is_empty() {
            true => self.statistics.ignored += 1,
            false => self.statistics.used += 1,
        }
        for id in all {
            self.leave(id, LeaveCause::Removed);
        }
    }

    fn leave(&mut self, id: EntityId, cause: LeaveCause) {
        if self.entities.remove(&id).is_some() {
            self.events.push_back(ForeignEvent::Left { id, cause });
        }
    }
}

/// The moment of a state: by its timestamp if that is absolute and plausible, else that of its arrival.
fn moment(now: Duration, stamp: Timestamp) -> Duration {
    let age = Timestamp::at(now, TimeBase::Absolute).seconds_since(stamp);
    if stamp.base() == TimeBase::Absolute && (0.0..=AGE_MAX).contains(&age) {
        now.saturating_sub(Duration::from_secs_f64(age))
    } else {
        now
    }
}

fn is_finite(state: &EntityState<'_>) -> bool {
    let Kinematics {
        velocity,
        location,
        orientation,
        ..
    } = state.kinematics;
    let more = [state.dead_reckoning.acceleration, state.dead_reckoning.spin];
    let mut floats = [velocity, orientation].into_iter().chain(more).flatten();
    location.is_finite() && floats.all(f32::is_finite)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::entity::RemoveEntity;
    use crate::geodesy::Geodetic;
    use crate::pdu::Header;
    use crate::published::{Kind, Observed, Publisher, PublisherConfig};

    fn frame() -> TangentFrame {
        let place = Geodetic::from_degrees(-33.9, 151.2, 20.0).expect("in range");
        TangentFrame::new(place, SceneAxes::YUp)
    }

    fn publisher() -> Publisher {
        Publisher::new(PublisherConfig {
            exercise: 1,
            site: 8,
            application: 9,
            frame: frame(),
            axes: SceneAxes::YUp,
            base: TimeBase::Absolute,
            datagram_bytes: 1400,
            states_per_second: 1000,
        })
    }

    fn foreign() -> ForeignEntities {
        ForeignEntities::new(config())
    }

    fn config() -> ForeignConfig {
        ForeignConfig {
            exercise: 1,
            site: 2,
            application: 3,
            frame: frame(),
            axes: SceneAxes::YUp,
            timeout: ForeignConfig::TIMEOUT,
            entities_max: 2,
            reach: 1_000.0,
            pdus_per_second: 1000,
        }
    }

    const ID: EntityId = EntityId {
        site: 8,
        application: 9,
        entity: 1,
    };

    fn body() -> Observed {
        Observed {
            key: 1,
            kind: Kind::default(),
            position: DVec3::new(5.0, 6.0, 7.0),
            rotation: DQuat::from_rotation_y(0.5),
            velocity: DVec3::new(3.0, 0.0, 1.0),
            acceleration: DVec3::ZERO,
            spin: DVec3::new(0.0, 0.25, 0.0),
        }
    }

    fn datagram(publisher: &mut Publisher, now: Duration, bodies: &[Observed]) -> Vec<u8> {
        let mut buffer = [0; 1500];
        publisher.handle_bodies(now, bodies);
        let bytes = publisher.poll_datagram(&mut buffer).unwrap_or(0);
        buffer[..bytes].to_vec()
    }

    const START: Duration = Duration::from_secs(3599);

    #[test]
    fn a_body_of_one_gateway_is_where_it_was_in_another_over_the_full_hour() {
        let (mut publisher, mut foreign) = (publisher(), foreign());
        let sent = datagram(&mut publisher, START, &[body()]);
        let arrival = START + Duration::from_millis(500);
        assert_eq!(foreign.handle_datagram(arrival, &sent), Ok(()));
        assert!(matches!(
            foreign.poll_event(),
            Some(ForeignEvent::Appeared { id: ID, .. })
        ));
        let now = START + Duration::from_secs(2);
        let pose = foreign.poses(now).next().expect("it is there");
        let there = body().position + body().velocity * 2.0;
        assert!((pose.position - there).length() < 1e-5, "{}", pose.position);
        assert!((pose.velocity - body().velocity).length() < 1e-6);
        assert!((pose.spin - body().spin).length() < 1e-6);
        let turn = DQuat::from_rotation_y(1.0);
        assert!(
            pose.rotation.dot(turn).abs() > 1.0 - 1e-12,
            "{}",
            pose.rotation
        );
    }

    #[test]
    fn an_entity_leaves_when_it_is_deactivated_removed_or_silent() {
        let (mut publisher, mut foreign) = (publisher(), foreign());
        let first = datagram(&mut publisher, START, &[body()]);
        let last = datagram(&mut publisher, START + Duration::from_secs(1), &[]);
        let remove = Pdu {
            header: Header::new(1, Timestamp(0)),
            body: Body::RemoveEntity(RemoveEntity {
                originating: EntityId::default(),
                receiving: ID,
                request: 1,
            }),
        };
        let mut removal = [0; 28];
        assert_eq!(remove.encode(&mut removal), Ok(28));
        let mut causes = Vec::new();
        for way in 0..3 {
            foreign.handle_datagram(START, &first).expect("sound");
            match way {
                0 => foreign.handle_datagram(START, &last).expect("sound"),
                1 => foreign.handle_datagram(START, &removal).expect("sound"),
                _ => {
                    foreign.handle_timeout(START + Duration::from_millis(11_999));
                    assert_eq!(foreign.poses(START).count(), 1);
                    foreign.handle_timeout(START + Duration::from_secs(12));
                }
            }
            assert_eq!(foreign.poses(START).count(), 0);
            causes.extend(std::iter::from_fn(|| foreign.poll_event()).filter_map(
                |event| match event {
                    ForeignEvent::Left { cause, .. } => Some(cause),
                    ForeignEvent::Appeared { .. } => None,
                },
            ));
        }
        assert_eq!(
            causes,
            [
                LeaveCause::Deactivated,
                LeaveCause::Removed,
                LeaveCause::Silent
            ]
        );
    }

    #[test]
    fn an_older_state_never_replaces_a_newer_one() {
        let (mut publisher, mut foreign) = (publisher(), foreign());
        let first = datagram(&mut publisher, START, &[body()]);
        let later = START + Duration::from_secs(1);
        let moved = Observed {
            position: DVec3::splat(50.0),
            ..body()
        };
        let second = datagram(&mut publisher, later, &[moved]);
        foreign.handle_datagram(later, &second).expect("sound");
        foreign.handle_datagram(later, &first).expect("sound");
        assert_eq!(foreign.statistics().stale, 1);
        let pose = foreign.poses(later).next().expect("it is there");
        assert!((pose.position - moved.position).length() < 1e-3);
    }

    #[test]
    fn others_than_asked_for_and_more_than_allowed_are_counted_and_dropped() {
        let mut publisher = publisher();
        let bodies = [1, 2, 3].map(|key| Observed { key, ..body() });
        let three = datagram(&mut publisher, START, &bodies);
        let mut full = foreign();
        full.handle_datagram(START, &three).expect("sound");
        assert_eq!(
            (full.poses(START).count(), full.statistics().no_place),
            (2, 1)
        );
        let mut slow = ForeignEntities::new(ForeignConfig {
            pdus_per_second: 1,
            ..config()
        });
        slow.handle_datagram(START, &three).expect("sound");
        assert_eq!(
            (slow.poses(START).count(), slow.statistics().too_many),
            (1, 2)
        );
        let own = ForeignConfig {
            site: 8,
            application: 9,
            ..config()
        };
        let elsewhere = ForeignConfig {
            exercise: 2,
            ..config()
        };
        for config in [own, elsewhere] {
            let mut deaf = ForeignEntities::new(config);
            deaf.handle_datagram(START, &three).expect("sound");
            assert_eq!(
                (deaf.poses(START).count(), deaf.statistics().ignored),
                (0, 3)
            );
        }
    }

    #[test]
    fn a_state_that_is_not_finite_is_refused_and_its_neighbours_are_not() {
        let mut publisher = publisher();
        let bodies = [1, 2].map(|key| Observed { key, ..body() });
        let mut two = datagram(&mut publisher, START, &bodies);
        two[48..56].copy_from_slice(&f64::NAN.to_be_bytes());
        let mut foreign = foreign();
        foreign
            .handle_datagram(START, &two)
            .expect("lengths are sound");
        assert_eq!(
            (foreign.poses(START).count(), foreign.statistics().malformed),
            (1, 1)
        );
        two.truncate(200);
        let cut = Malformed::Cut {
            offset: 144,
            length: 144,
            available: 56,
        };
        assert_eq!(foreign.handle_datagram(START, &two), Err(cut));
    }

    #[test]
    fn a_near_entity_takes_the_place_of_one_beyond_the_reach_and_one_name_removes_all() {
        let (mut publisher, mut foreign) = (publisher(), foreign());
        let at = |key: u64, x: f64| Observed {
            key,
            position: DVec3::new(x, 0.0, 0.0),
            ..body()
        };
        let bodies = [at(1, 5.0), at(2, 2_000.0), at(3, 3_000.0)];
        let first = datagram(&mut publisher, START, &bodies);
        foreign.handle_datagram(START, &first).expect("sound");
        assert_eq!(foreign.statistics().no_place, 1);
        let more = [bodies[0], bodies[1], bodies[2], at(4, 10.0), at(5, 15.0)];
        let second = datagram(&mut publisher, START, &more);
        foreign.handle_datagram(START, &second).expect("sound");
        let mut places: Vec<_> = foreign
            .poses(START)
            .map(|pose| pose.position.x.round())
            .collect();
        places.sort_by(f64::total_cmp);
        assert_eq!(places, [5.0, 10.0]);
        assert_eq!(foreign.statistics().no_place, 2);
        let everyone = EntityId {
            site: u16::MAX,
            application: u16::MAX,
            entity: u16::MAX,
        };
        let mut removal = [0; 28];
        let remove = Pdu {
            header: Header::new(1, Timestamp(0)),
            body: Body::RemoveEntity(RemoveEntity {
                originating: EntityId::default(),
                receiving: everyone,
                request: 1,
            }),
        };
        assert_eq!(remove.encode(&mut removal), Ok(28));
        foreign.handle_datagram(START, &removal).expect("sound");
        assert_eq!(foreign.poses(START).count(), 0);
    }
}
