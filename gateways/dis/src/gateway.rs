//! A member of a scene that speaks DIS, without sockets and clocks.
//!
//! Bodies leave as states, entities of others come in as bodies. Datagrams and moments are arguments, datagrams leave by
//! [`Gateway::poll_datagram`]. Foreign entities are kinematic bodies that this member adds, has authority over, and removes.
//! They are not sent back. No act of other members on these bodies ends the gateway: a body that is removed or refused
//! is tried again a second later. [`Report`] tells the traffic in a line.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::time::Duration;

use glam::DVec3;
use rhumb_client::scene::{BodyDesc, Command, Shape};
use rhumb_client::{
    AuthorityError, BodyId, BodyState, Client, ClientError, Event, Metres, Misuse, Replica,
    Tolerance,
};
use rhumb_protocol::limits::AUTHORITY_BODIES_MAX;

use crate::entity::EntityId;
use crate::foreign::{ForeignConfig, ForeignEntities, ForeignPose, ForeignStatistics};
use crate::pdu::Malformed;
use crate::published::{Kind, Observed, Publisher, PublisherConfig, PublisherStatistics};
use crate::rules::Rules;

/// Settings of a gateway.
#[derive(Clone, Debug, PartialEq)]
pub struct GatewayConfig {
    /// Settings of the bodies that leave; `None`: none leaves.
    pub publisher: Option<PublisherConfig>,
    /// Settings of the entities that come in; `None`: none comes in.
    pub foreign: Option<ForeignConfig>,
    /// The types that bodies and entities become.
    pub rules: Rules,
    /// Tolerance of the server's bodies to their entities' dead reckoning.
    pub tolerance: Tolerance,
}

/// Counts since the start, and who is there now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GatewayStatistics {
    /// Bodies that are sent now.
    pub bodies: usize,
    /// Entities with a body now.
    pub entities: usize,
    /// Entities without one now, beyond the reach.
    pub beyond: usize,
    /// Entities within it that no body can follow now: faster than bodies of a scene are, or further away.
    pub unfit: usize,
    /// Bodies that are sent now with a threshold that the copy's tolerance uses up: they may be further off.
    pub coarse: usize,
    /// Of the sending side.
    pub sent: PublisherStatistics,
    /// Of the receiving side.
    pub received: ForeignStatistics,
    /// Commands that the server refused, such as a body beyond a quota.
    pub refused: u64,
    /// Requests of authority that the server denied.
    pub denied: u64,
}

/// A member of a scene that speaks DIS.
pub struct Gateway {
    client: Client,
    publisher: Option<Publisher>,
    foreign: Option<ForeignEntities>,
    rules: Rules,
    reach: f64,
    authority: Authority,
    /// The kind of each body that is sent, of a copy of this revision and tolerance.
    kinds: BTreeMap<BodyId, Option<CopiedKind>>,
    copy: (u64, Option<Tolerance>),
    observed: Vec<Observed>,
    beyond: usize,
    unfit: usize,
    coarse: usize,
    refused: u64,
}

/// The kind of a body in a copy.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CopiedKind {
    /// Its thresholds are to the copy.
    kind: Kind,
    /// True if the copy's tolerance leaves one of them nothing.
    is_coarse: bool,
}

impl CopiedKind {
    /// The kind of a body in a copy within a tolerance: the thresholds are to the truth, from which the copy may be off.
    fn new(kind: Kind, tolerance: Tolerance, radius: Metres) -> Self {
        let [position, turn] = match tolerance {
            Tolerance::Surface(length) => {
                let length = length.metres().metres();
                // The chord of a turn at the bounding radius.
                let sine = length / (2.0 * radius.metres()).max(f64::MIN_POSITIVE);
                [length, 2.0 * sine.min(1.0).asin()]
            }
            Tolerance::Parts { position, turn } => {
                [position.metres().metres(), turn.radians().radians()]
            }
        };
        let (metres, radians) = (kind.metres - position, kind.radians - turn);
        let is_left = [metres >= LEAST_METRES, radians >= LEAST_RADIANS];
        let rest = |is_left: bool, rest: f64, whole: f64| if is_left { rest } else { whole * 0.5 };
        Self {
            kind: Kind {
                metres: rest(is_left[0], metres, kind.metres),
                radians: rest(is_left[1], radians, kind.radians),
                ..kind
            },
            is_coarse: is_left != [true; 2],
        }
    }
}

/// The least threshold that a copy's tolerance leaves: half of the whole one is taken in place of a lesser one.
const LEAST_METRES: f64 = 0.001;
const LEAST_RADIANS: f64 = 0.001;

/// The bodies of entities, and the authority over them.
struct Authority {
    tolerance: Tolerance,
    bodies: BTreeMap<EntityId, BodyId>,
    /// Commands without an answer that add bodies.
    added: BTreeMap<u64, EntityId>,
    /// Entities whose body was refused, or removed by others: none is added before this moment.
    absent: BTreeMap<EntityId, Duration>,
    requested: BTreeSet<BodyId>,
    /// Bodies that a denial named: no request names them before this moment.
    without: BTreeMap<BodyId, Duration>,
    /// True until the server answers the last request.
    waits: bool,
    denied: u64,
    /// No request before this moment, after a denial that names no body.
    not_before: Duration,
}

/// Pause after a denial, and after a body was refused or removed by others.
const PAUSE: Duration = Duration::from_secs(1);

impl Gateway {
    /// A gateway of this member, whose client reports refusals as events alone.
    #[must_use]
    pub fn new(client: Client, config: GatewayConfig) -> Self {
        let reach = config.foreign.map_or(0.0, |foreign| foreign.reach);
        Self {
            client,
            publisher: config.publisher.map(Publisher::new),
            foreign: config.foreign.map(ForeignEntities::new),
            rules: config.rules,
            reach,
            authority: Authority {
                tolerance: config.tolerance,
                bodies: BTreeMap::new(),
                added: BTreeMap::new(),
                absent: BTreeMap::new(),
                requested: BTreeSet::new(),
                without: BTreeMap::new(),
                waits: false,
                denied: 0,
                not_before: Duration::ZERO,
            },
            kinds: BTreeMap::new(),
            copy: (0, None),
            observed: Vec::new(),
            beyond: 0,
            unfit: 0,
            coarse: 0,
            refused: 0,
        }
    }

    /// The member.
    #[must_use]
    pub const fn client(&self) -> &Client {
        &self.client
    }

    /// Counts since the start, and who is there now.
    #[must_use]
    pub fn statistics(&self) -> GatewayStatistics {
        let (publisher, foreign) = (&self.publisher, &self.foreign);
        GatewayStatistics {
            bodies: self.observed.len(),
            entities: self.authority.bodies.len(),
            beyond: self.beyond,
            unfit: self.unfit,
            coarse: self.coarse,
            sent: publisher
                .as_ref()
                .map(Publisher::statistics)
                .unwrap_or_default(),
            received: foreign
                .as_ref()
                .map(ForeignEntities::statistics)
                .unwrap_or_default(),
            refused: self.refused,
            denied: self.authority.denied,
        }
    }

    /// Handles a datagram that arrived at `now`, a time since a full hour of UTC.
    ///
    /// # Errors
    ///
    /// The first [`Malformed`] of the bundle; the PDUs beside it are handled all the same.
    pub fn handle_datagram(&mut self, now: Duration, datagram: &[u8]) -> Result<(), Malformed> {
        match &mut self.foreign {
            Some(foreign) => foreign.handle_datagram(now, datagram),
            None => Ok(()),
        }
    }

    /// Brings both sides up to `now`: moves the bodies of entities, and queues the states that are due. Call it once for
    /// each tick of the scene, and drain [`Self::poll_datagram`] after it.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] and its like when the scene is over.
    pub fn handle_time(&mut self, now: Duration) -> Result<(), ClientError> {
        self.client.poll()?;
        self.take_events(now);
        self.place_entities(now)?;
        self.observe();
        if let Some(publisher) = &mut self.publisher {
            publisher.handle_bodies(now, &self.observed);
        }
        Ok(())
    }

    /// Writes the next datagram, and returns its bytes.
    pub fn poll_datagram(&mut self, to: &mut [u8]) -> Option<usize> {
        self.publisher.as_mut()?.poll_datagram(to)
    }

    /// Leaves DIS and the scene: queues last states of all bodies as far as the rate limit allows, and removes the bodies of
    /// entities. Returns the number of last states that wait for the limit: call it again later for those.
    ///
    /// # Errors
    ///
    /// The first error of a command that removes a body, as of [`Self::handle_time`]. The last states are queued all
    /// the same; call it again for those that wait.
    pub fn leave(&mut self, now: Duration) -> Result<usize, ClientError> {
        self.observed.clear();
        let mut waiting = 0;
        if let Some(publisher) = &mut self.publisher {
            publisher.handle_bodies(now, &[]);
            waiting = publisher.leaving();
        }
        let mut removed = Ok(());
        for (_, id) in std::mem::take(&mut self.authority.bodies) {
            let sent = self.client.command(Command::RemoveBody { id });
            removed = removed.and(sent.map(drop));
        }
        self.client.flush();
        removed.map(|()| waiting)
    }

    fn take_events(&mut self, now: Duration) {
        let authority = &mut self.authority;
        while let Some((_, event)) = self.client.poll_event() {
            match event {
                Event::AuthorityGrant(_) => authority.waits = false,
                Event::AuthorityDenied(error) => authority.note_denial(now, error),
                Event::Refused { number, .. } => {
                    self.refused += 1;
                    if let Some(entity) = authority.added.remove(&number) {
                        authority.lose(now, entity);
                    }
                }
                Event::Applied { through, .. } => {
                    authority.added.retain(|number, _| *number > through);
                }
                Event::BodyRemoved { id, .. } => {
                    let mut bodies = authority.bodies.iter();
                    if let Some((entity, _)) = bodies.find(|(_, body)| **body == id) {
                        let entity = *entity;
                        authority.lose(now, entity);
                    }
                }
                _ => {}
            }
        }
    }

    /// Adds, moves and removes the bodies of entities.
    fn place_entities(&mut self, now: Duration) -> Result<(), ClientError> {
        let Some(foreign) = &mut self.foreign else {
            return Ok(());
        };
        foreign.handle_timeout(now);
        // The poses say which entities are there.
        while foreign.poll_event().is_some() {}
        let all: Vec<ForeignPose> = foreign.poses(now).collect();
        let count = all.len();
        let is_near = |pose: &ForeignPose| pose.position.length() <= self.reach;
        let near: Vec<_> = all.into_iter().filter(is_near).collect();
        self.beyond = count - near.len();
        let here: BTreeSet<_> = near.iter().map(|pose| pose.id).collect();
        for id in self.authority.leaving(&here, now) {
            self.client.command(Command::RemoveBody { id })?;
        }
        let mut states = Vec::with_capacity(near.len());
        self.unfit = 0;
        for pose in &near {
            let Some(state) = state(pose) else {
                self.unfit += 1;
                continue;
            };
            let known = self.authority.bodies.get(&pose.id).copied();
            if let Some(id) = known.map_or_else(|| self.add(pose, now), |id| Ok(Some(id)))? {
                states.push((id, state));
            }
        }
        self.authority.request(now, &mut self.client)?;
        let own: BTreeSet<_> = self.client.authority_bodies().collect();
        states.retain(|(id, _)| own.contains(id));
        if !states.is_empty() {
            self.client.publish(&states)?;
        }
        Ok(())
    }

    /// Adds the body of an entity; `None` while it has to wait.
    fn add(&mut self, pose: &ForeignPose, now: Duration) -> Result<Option<BodyId>, ClientError> {
        let authority = &mut self.authority;
        if authority.absent.contains_key(&pose.id) || authority.bodies.len() >= AUTHORITY_BODIES_MAX
        {
            return Ok(None);
        }
        let shape = self.rules.shape_of(pose.entity_type).clone();
        let body = BodyDesc::kinematic(shape)
            .position(pose.position.as_vec3())
            .rotation(pose.rotation.as_quat());
        match self.client.add_body(body) {
            Ok(id) => {
                authority.bodies.insert(pose.id, id);
                let number = self.client.last_command();
                authority
                    .added
                    .extend(number.map(|number| (number, pose.id)));
                Ok(Some(id))
            }
            // The server grants no index, or the scene has no number for the shape, now.
            Err(ClientError::Denied(_) | ClientError::TooManyShapes) => {
                self.refused += 1;
                authority.lose(now, pose.id);
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Takes the bodies that are sent out of the view.
    fn observe(&mut self) {
        self.observed.clear();
        self.coarse = 0;
        let (view, Some(replica)) = (self.client.view(), self.client.replica()) else {
            return;
        };
        if self.publisher.is_none() {
            return;
        }
        let tolerance = self.client.tolerance();
        let copy = (replica.revision(), tolerance);
        if self.copy != copy {
            self.copy = copy;
            self.kinds.clear();
        }
        let own: BTreeSet<_> = self.authority.bodies.values().collect();
        for (place, id) in view.ids().iter().enumerate() {
            let rules = &self.rules;
            let kind = *self
                .kinds
                .entry(*id)
                .or_insert_with(|| kind_of(rules, replica, tolerance, *id));
            let Some(copied) = kind.filter(|_| !own.contains(id)) else {
                continue;
            };
            self.coarse += usize::from(copied.is_coarse);
            self.observed.push(Observed {
                key: u64::from(id.index()) << 16 | u64::from(id.generation()),
                kind: copied.kind,
                position: view.positions()[place].as_dvec3(),
                rotation: view.rotations()[place].as_dquat(),
                velocity: view.linear_velocities()[place].as_dvec3(),
                acceleration: fall(replica, *id),
                spin: view.angular_velocities()[place].as_dvec3(),
            });
        }
        self.observed.sort_unstable_by_key(|observed| observed.key);
    }
}

impl Authority {
    /// Forgets entities that are not among these, and returns their bodies; ends pauses.
    fn leaving(&mut self, here: &BTreeSet<EntityId>, now: Duration) -> Vec<BodyId> {
        self.absent.retain(|_, until| now < *until);
        self.without.retain(|_, until| now < *until);
        let mut gone = Vec::new();
        self.bodies.retain(|entity, body| {
            let stays = here.contains(entity);
            if !stays {
                gone.push(*body);
            }
            stays
        });
        gone
    }

    /// Requests the authority over all bodies of entities, unless it has it or waits for an answer.
    fn request(&mut self, now: Duration, client: &mut Client) -> Result<(), ClientError> {
        let wanted = self.bodies.values().copied();
        let wanted: BTreeSet<_> = wanted.filter(|id| !self.without.contains_key(id)).collect();
        if self.waits || wanted == self.requested || now < self.not_before {
            return Ok(());
        }
        let ids: Vec<_> = wanted.iter().copied().collect();
        match client.take_authority(&ids, self.tolerance) {
            Ok(()) => {
                self.requested = wanted;
                self.waits = true;
                Ok(())
            }
            // The client itself requests it again, and a later call will find it answered.
            Err(ClientError::Misuse(Misuse::AuthorityUnanswered)) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Forgets the body of an entity, which others removed or the server refused; a later one waits.
    fn lose(&mut self, now: Duration, entity: EntityId) {
        self.bodies.remove(&entity);
        self.absent.insert(entity, now + PAUSE);
    }

    /// Lets the next request be without the body that a denial names, or wait.
    fn note_denial(&mut self, now: Duration, error: AuthorityError) {
        self.denied += 1;
        self.waits = false;
        self.requested.clear();
        match error {
            AuthorityError::UnknownBody(id)
            | AuthorityError::NotYours(id)
            | AuthorityError::NotKinematic(id)
            | AuthorityError::HeldByAnother(id) => {
                self.without.insert(id, now + PAUSE);
            }
            AuthorityError::SceneFaulted
            | AuthorityError::LostSync
            | AuthorityError::NotAllowed
            | AuthorityError::Other(_) => self.not_before = now + PAUSE,
        }
    }
}

/// `tolerance`: of the copy; `None` if it is exact.
fn kind_of(
    rules: &Rules,
    replica: &Replica,
    tolerance: Option<Tolerance>,
    id: BodyId,
) -> Option<CopiedKind> {
    let body = replica.body(id)?;
    let shape = replica.shape(body.shape)?;
    let kind = rules.kind_of(&body, shape)?;
    let is_coarse = false;
    Some(match tolerance {
        None => CopiedKind { kind, is_coarse },
        Some(all) => CopiedKind::new(
            kind,
            all.scaled(body.tolerance_scale),
            shape.bounding_radius(),
        ),
    })
}

/// The acceleration that a body's track predicts: gravity while it is in flight.
fn fall(replica: &Replica, id: BodyId) -> DVec3 {
    let track = replica.stream().track(id);
    if track.is_some_and(|track| track.predictor.falls()) {
        let factor = replica.body(id).map_or(1.0, |body| body.gravity_scale);
        (replica.gravity() * factor).as_dvec3()
    } else {
        DVec3::ZERO
    }
}

/// The state of an entity's body; `None` if its numbers are beyond those of a scene.
fn state(pose: &ForeignPose) -> Option<BodyState> {
    let body = BodyDesc::kinematic(Shape::ball(1.0))
        .position(pose.position.as_vec3())
        .rotation(pose.rotation.as_quat())
        .linear_velocity(pose.velocity.as_vec3())
        .angular_velocity(pose.spin.as_vec3());
    body.check().and_then(|()| body.state()).ok()
}

/// Counts between two lines.
#[derive(Debug)]
pub struct Report {
    /// Seconds between two lines; zero for none.
    period: u64,
    since: Duration,
    before: GatewayStatistics,
    sent: Traffic,
    received: Traffic,
    unsent: u64,
    /// The last error of sending, and the last PDU that is none.
    error: Option<String>,
}

#[derive(Debug, Default)]
struct Traffic {
    datagrams: u64,
    bytes: usize,
}

impl Traffic {
    const fn add(&mut self, bytes: usize) {
        self.datagrams += 1;
        self.bytes += bytes;
    }
}

impl Report {
    /// Lines every `period` seconds; none for zero.
    #[must_use]
    pub fn new(period: u64, now: Duration) -> Self {
        Self {
            period,
            since: now,
            before: GatewayStatistics::default(),
            sent: Traffic::default(),
            received: Traffic::default(),
            unsent: 0,
            error: None,
        }
    }

    /// Counts a datagram of this many bytes, and whether it left.
    pub fn sent(&mut self, bytes: usize, outcome: io::Result<()>) {
        self.sent.add(bytes);
        if let Err(error) = outcome {
            self.unsent += 1;
            self.error = Some(format!("sending: {error}"));
        }
    }

    /// Counts a datagram of this many bytes that arrived.
    pub const fn received(&mut self, bytes: usize) {
        self.received.add(bytes);
    }

    /// Keeps the reason why bytes are no PDU.
    pub fn malformed(&mut self, malformed: &Malformed) {
        self.error = Some(format!("received: {malformed}"));
    }

    /// The line about the time since the last one, if it is due: who is there, a second's traffic, and what went wrong.
    pub fn line(&mut self, now: Duration, statistics: &GatewayStatistics) -> Option<String> {
        let passed = now.saturating_sub(self.since);
        if self.period == 0 || passed < Duration::from_secs(self.period) {
            return None;
        }
        let (new, old) = (statistics, self.before);
        let seconds = passed.as_secs_f64();
        let rate = |count: u64| count as f64 / seconds;
        let kilobytes = |bytes: usize| bytes as f64 / 1000.0 / seconds;
        let states =
            new.sent.updates + new.sent.heartbeats - old.sent.updates - old.sent.heartbeats;
        let mut line = format!(
            "{} bodies out, {:.1} states/s, {:.2} kB/s; {} entities in, {:.1} PDUs/s, {:.2} kB/s",
            new.bodies,
            rate(states),
            kilobytes(self.sent.bytes),
            new.entities,
            rate(new.received.used - old.received.used),
            kilobytes(self.received.bytes),
        );
        let faults = [
            ("delayed", new.sent.delayed - old.sent.delayed),
            ("without a number", new.sent.unnamed - old.sent.unnamed),
            ("not finite", new.sent.not_finite - old.sent.not_finite),
            ("unsent", self.unsent),
            ("malformed", new.received.malformed - old.received.malformed),
            ("stale", new.received.stale - old.received.stale),
            ("too many", new.received.too_many - old.received.too_many),
            (
                "without place",
                new.received.no_place - old.received.no_place,
            ),
            ("beyond reach", new.beyond as u64),
            ("unfit for a body", new.unfit as u64),
            ("coarser than their thresholds", new.coarse as u64),
            ("refused", new.refused - old.refused),
            ("denied", new.denied - old.denied),
        ];
        for (name, count) in faults.into_iter().filter(|(_, count)| *count > 0) {
            line += &format!(", {count} {name}");
        }
        if let Some(error) = self.error.take() {
            line += &format!(" ({error})");
        }
        (self.before, self.since) = (*statistics, now);
        (self.sent, self.received, self.unsent) = (Traffic::default(), Traffic::default(), 0);
        Some(line)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::published::PublisherStatistics;

    #[test]
    fn a_line_has_a_seconds_traffic_and_only_faults_that_were() {
        let at = Duration::from_secs;
        let mut report = Report::new(10, at(100));
        assert_eq!(report.line(at(109), &GatewayStatistics::default()), None);
        let mut statistics = GatewayStatistics {
            bodies: 3,
            sent: PublisherStatistics {
                updates: 20,
                heartbeats: 10,
                ..PublisherStatistics::default()
            },
            ..GatewayStatistics::default()
        };
        report.sent(4_320, Ok(()));
        let line = report.line(at(110), &statistics).expect("it is due");
        let calm = "3 bodies out, 3.0 states/s, 0.43 kB/s; 0 entities in, 0.0 PDUs/s, 0.00 kB/s";
        assert_eq!(line, calm);
        statistics.received.malformed = 2;
        report.received(5);
        report.malformed(&Malformed::CutHeader {
            offset: 0,
            available: 5,
        });
        let line = report.line(at(120), &statistics).expect("it is due");
        let end =
            ", 2 malformed (received: pdu at byte 0 is cut: 5 bytes are left, its header has 12)";
        assert!(line.ends_with(end), "{line}");
    }
}
