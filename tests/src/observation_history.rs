//! The events and claims of one member, for comparison with the truth.
//!
//! Takes the events of a session, and changes nothing else of it.

use std::collections::BTreeSet;

use rhumb_protocol::Ending;
use rhumb_protocol::message::{
    AuthorityError, Denial, Inspection, RemovalCause, StreamChoice, TierChangeCause,
};
use rhumb_protocol::scene::{BodyEvent, BodyKind, CommandError, IdRange};
use rhumb_protocol::session::{ClientSession, Event, Replica};
use rhumb_protocol::stream::ErrorBound;
use rhumb_reckoning::{BodyId, Metres, Pose, Tick, Tolerance};

use crate::truth::SceneTruth;

/// A claim of a copy: a body is within a distance of this pose at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Claim {
    /// The body.
    pub id: BodyId,
    /// The tick.
    pub tick: Tick,
    /// The pose in the copy.
    pub pose: Pose,
    /// Greatest possible error of any point of the body.
    pub within: Metres,
    /// The tolerance of the body in its stream.
    pub tolerance: Tolerance,
    /// The stated factor by which errors may exceed the tolerance.
    pub error_scale: f64,
}

/// The history of one member.
#[derive(Debug, Default)]
pub struct ObservationHistory {
    /// Number of welcomes.
    pub welcomes: usize,
    /// Id range of the last join; `None` outside a membership.
    pub granted: Option<IdRange>,
    /// Commands up to this number were applied before the step of this tick.
    pub applied: Vec<(u64, Tick)>,
    /// Refused commands, by number.
    pub refused: Vec<(u64, CommandError)>,
    /// Denied requests.
    pub denied: Vec<Denial>,
    /// Removed bodies.
    pub removed: Vec<(BodyId, RemovalCause)>,
    /// Streams that the member changed to.
    pub following: Vec<StreamChoice>,
    /// Changes of tier by the server, with their causes.
    pub moved: Vec<(StreamChoice, TierChangeCause)>,
    /// Answers to requests for authority.
    pub authority_answers: Vec<Result<Vec<BodyId>, AuthorityError>>,
    /// Checksum mismatches of the copy.
    pub mismatches: u64,
    /// Answers to inspect requests.
    pub inspections: Vec<Inspection>,
    /// Numbers of the queries that were answered.
    pub queries: Vec<u64>,
    /// The number of times that this member created the scene.
    pub created: usize,
    /// The number of times that it left the scene.
    pub left: usize,
    /// The number of times that the scene was deleted.
    pub deleted: usize,
    /// Bodies whose publisher fell silent, with the first tick of the silence.
    pub silent: Vec<(BodyId, Tick)>,
    /// Bodies whose publisher was active again, with the tick.
    pub active: Vec<(BodyId, Tick)>,
    /// Pairs in contact, as the events tell; none after missed events.
    pub touching: BTreeSet<(BodyId, BodyId)>,
    /// Number of events that were missed.
    pub events_missed: u64,
    /// Greatest number of pairs that began in one tick.
    pub begun_at_most: usize,
    /// The end of the connection.
    pub ended: Option<Ending>,
    /// Claims about all bodies so far.
    pub claims: Vec<Claim>,
    /// Number of checks of a body without a known bound.
    pub unknown: usize,
    /// Watermark tick and packet count at the last stored claims.
    last_stored: Option<(Tick, u64)>,
    /// The tick of the last event of a body, and how many pairs began in it.
    begun: (Tick, usize),
}

impl ObservationHistory {
    /// Takes the session's events.
    pub fn take_events(&mut self, session: &mut ClientSession) {
        while let Some(event) = session.poll_event() {
            match event {
                Event::Welcomed(_) => self.welcomes += 1,
                Event::Created => self.created += 1,
                Event::Joined(granted) => self.granted = Some(granted),
                Event::SubscriptionChanged(choice) => self.following.push(choice),
                Event::TierChanged { to, cause } => self.moved.push((to, cause)),
                Event::Left => (self.granted, self.left) = (None, self.left + 1),
                Event::Deleted => (self.granted, self.deleted) = (None, self.deleted + 1),
                Event::Denied(denial) => self.denied.push(denial),
                Event::Applied { through, tick } => self.applied.push((through, tick)),
                Event::Refused { number, error } => self.refused.push((number, error)),
                Event::BodyRemoved { id, cause } => self.removed.push((id, cause)),
                Event::Inspected(inspection) => self.inspections.push(inspection),
                Event::PublisherSilent { id, since } => self.silent.push((id, since)),
                Event::PublisherActive { id, tick } => self.active.push((id, tick)),
                Event::Ended(ending) => self.ended = Some(ending),
                Event::ChecksumMismatch => self.mismatches += 1,
                Event::AuthorityGrant(bodies) => self.authority_answers.push(Ok(bodies)),
                Event::AuthorityDenied(error) => self.authority_answers.push(Err(error)),
                Event::Body { tick, event } => self.take_body_event(tick, event),
                Event::EventsMissed { count, .. } => {
                    self.touching.clear();
                    self.events_missed += count;
                }
                Event::SceneRestored(_) => self.touching.clear(),
                Event::QueryResult(result) => self.queries.push(result.number),
                Event::Reserved(_)
                | Event::BodyPlaced(_)
                | Event::SceneFaulted { .. }
                | Event::Interrupted(_)
                | Event::Resumed(_)
                | Event::SessionLost(_)
                | Event::Durable { .. }
                | Event::ClockSeen { .. } => {}
            }
        }
    }

    fn take_body_event(&mut self, tick: Tick, event: BodyEvent) {
        if self.begun.0 != tick {
            self.begun = (tick, 0);
        }
        match event {
            BodyEvent::ContactBegan { body, contact } => {
                self.touching.insert((body, contact.with));
                self.begun.1 += 1;
            }
            BodyEvent::ContactEnded { body, with } => {
                self.touching.remove(&(body, with));
            }
            _ => {}
        }
        self.begun_at_most = self.begun_at_most.max(self.begun.1);
    }

    /// Stores the present claims about all bodies that can move, if data arrived since the last call.
    pub fn store_claims(&mut self, session: &ClientSession) {
        let Some(replica) = session.replica() else {
            return;
        };
        let statistics = replica.stream().statistics();
        let now = (
            replica.stream().watermark_tick(),
            statistics.packets + statistics.refreshes,
        );
        if self.last_stored == Some(now) {
            return;
        }
        self.last_stored = Some(now);
        self.claim(replica, |kind| kind != BodyKind::Fixed);
    }

    /// Stores the present claims about all bodies.
    pub fn store_all_claims(&mut self, session: &ClientSession) {
        if let Some(replica) = session.replica() {
            self.claim(replica, |_| true);
        }
    }

    fn claim(&mut self, replica: &Replica, wanted: impl Fn(BodyKind) -> bool) {
        let stream = replica.stream();
        let tick = stream.watermark_tick();
        for desc in replica.bodies().filter(|desc| wanted(desc.kind)) {
            let id = desc.id;
            match stream
                .bound(id)
                .expect("every body of the copy has a bound")
            {
                ErrorBound::Unknown { .. } => self.unknown += 1,
                ErrorBound::Within(within) => {
                    let predicted_motion = stream
                        .predicted_motion(id, tick)
                        .expect("every body of the copy has a prediction");
                    let pose = predicted_motion.pose();
                    self.claims.push(Claim {
                        id,
                        tick,
                        pose,
                        within,
                        tolerance: stream
                            .tolerance_of(id)
                            .expect("every body of the copy has a tolerance"),
                        error_scale: stream
                            .error_scale_at(tick)
                            .expect("every bound has a factor"),
                    });
                }
            }
        }
    }

    /// Checks every claim against the truth and returns the greatest error. `member` names the member in messages.
    ///
    /// # Panics
    ///
    /// At the first claim that is false.
    pub fn judge(&self, truth: &SceneTruth, member: &str) -> Metres {
        let mut worst = Metres::new(0.0);
        for Claim {
            id,
            tick,
            pose,
            within,
            tolerance,
            error_scale,
        } in &self.claims
        {
            let (divergence, radius) = truth.apart(*id, *tick, pose).unwrap_or_else(|| {
                panic!("{member}: {id} has a bound at {tick}, when it did not exist")
            });
            let error = divergence.surface_error(radius);
            assert!(
                error <= *within && tolerance.share(&divergence, radius) <= *error_scale,
                "{member}: the error of {id} at {tick} is {error}, bound {within}, tolerance {tolerance}"
            );
            if error > worst {
                worst = error;
            }
        }
        worst
    }
}

/// Requires that two copies of one scene in one tier are bit-identical; shapes are not compared.
///
/// # Panics
///
/// At the first body whose configuration, track or prediction differs.
pub fn assert_same_copy(one: &Replica, other: &Replica) {
    let ids = |replica: &Replica| replica.bodies().map(|desc| desc.id).collect::<Vec<_>>();
    assert_eq!(ids(one), ids(other), "the copies hold different bodies");
    assert_eq!(one.gravity(), other.gravity());
    let (one_stream, other_stream) = (one.stream(), other.stream());
    let tick = one_stream
        .watermark_tick()
        .max(other_stream.watermark_tick());
    for desc in one.bodies() {
        let id = desc.id;
        assert_eq!(Some(desc), other.body(id));
        assert_eq!(
            one_stream.track(id),
            other_stream.track(id),
            "the tracks of {id} at {tick}"
        );
        assert_eq!(
            one_stream.predicted_motion(id, tick),
            other_stream.predicted_motion(id, tick),
            "{id} at {tick}"
        );
    }
}
