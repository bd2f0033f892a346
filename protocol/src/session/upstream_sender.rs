//! The upstream of a client: states of the bodies it has authority over.
//!
//! Wraps a `StreamSender`. The caller chooses the lane for the packets. Invariant: a server that received all packets
//! of `publish` predicts each body within the tolerance of the state given here.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{BodyId, BodyState, Integrator, Tick, Ticks};

use crate::endpoint::{Instant, Span};
use crate::limits::TICK_JUMP_MAX;
use crate::message::{AuthorityGrant, TakeAuthority};
use crate::packet::{Datagram, StreamId};
use crate::scene;
use crate::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, PublisherStatistics,
    Recipient, StreamConfig, StreamSender, WatermarkPolicy, second,
};

/// A body that the client has authority over.
#[derive(Clone, Copy, Debug)]
struct UpstreamBody {
    /// None after the body left the scene.
    id: Option<BodyId>,
    /// The state that was published last.
    latest: BodyState,
    /// The tick since which the body stands still.
    still_since: Tick,
}

/// The outcome of publishing the states of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PublishOutcome {
    /// The states were compared with the server's prediction and encoded where they exceed the tolerance.
    Yes,
    /// This tick or a later one was already published.
    Before,
    /// The tick lies so far ahead that the stream must start again.
    TooFar,
}

/// The id of the only subscriber.
const SERVER: u64 = 0;

/// The publishing end of an upstream.
#[derive(Debug)]
pub(crate) struct UpstreamSender {
    sender: StreamSender,
    observation_history: ObservationHistory,
    /// In rising order of id. The position is the body's index in the stream.
    bodies: Vec<UpstreamBody>,
    observations: Vec<Observation>,
    /// A body that stands still for this long counts as asleep.
    second: Ticks,
}

/// Predictors allowed in an upstream: gravity does not act on kinematic bodies, and none is attached.
const FEATURES: Features = Features {
    ballistic: false,
    torque_free: false,
    attached: false,
    ..Features::ALL
};

/// An upstream has no scene events.
const SCENE_EVENTS: u64 = 0;

impl UpstreamSender {
    /// Starts the stream that the server granted for this request. `parameters` returns None for a body that is not in the scene.
    pub(crate) fn new(
        grant: &AuthorityGrant,
        request: &TakeAuthority,
        integrator: Integrator,
        parameters: impl Fn(BodyId) -> Option<PredictionParameters>,
    ) -> Self {
        let config = StreamConfig {
            tolerance: request.tolerance,
            largest_packet: request.largest_packet,
            integrator,
            publish_interval: scene::PublishSchedule::EACH_TICK.publish_interval,
            gravity: Vec3::ZERO,
            features: FEATURES,
        };
        let policy = WatermarkPolicy::upstream(integrator.rate);
        let mut sender = StreamSender::reckoned(grant.stream, &config, None, policy, grant.tick);
        let mut bodies = Vec::with_capacity(grant.bodies.len());
        for (id, motion) in &grant.bodies {
            let index = BodyId::new(bodies.len() as u32, 0);
            let track = grant.first_track(*motion);
            let placed = parameters(*id)
                .is_some_and(|parameters| sender.place(index, &parameters, track, *motion));
            bodies.push(UpstreamBody {
                id: placed.then_some(*id),
                latest: *motion,
                still_since: grant.tick,
            });
        }
        Self {
            sender,
            observation_history: ObservationHistory::new(scene::PublishSchedule::EACH_TICK),
            bodies,
            observations: Vec::new(),
            second: second(integrator.rate),
        }
    }

    /// The bodies still in the scene, in rising order.
    pub(crate) fn bodies(&self) -> impl Iterator<Item = BodyId> {
        self.bodies.iter().filter_map(|body| body.id)
    }

    /// Counters of everything published so far.
    pub(crate) fn statistics(&self) -> PublisherStatistics {
        self.sender.statistics()
    }

    /// Removes a body from the scene. Its track stays, because the server removes it at another tick.
    pub(crate) fn remove(&mut self, id: BodyId) {
        for body in &mut self.bodies {
            body.id = body.id.filter(|known| *known != id);
        }
    }

    /// Publishes the states of a tick and appends the packets. A body without a state stands still at its last place.
    pub(crate) fn publish(
        &mut self,
        tick: Tick,
        motions: &[(BodyId, BodyState)],
        out: &mut Vec<Bytes>,
    ) -> PublishOutcome {
        let before = self.sender.tick();
        if tick <= before {
            return PublishOutcome::Before;
        }
        if tick.value() - before.value() > TICK_JUMP_MAX {
            return PublishOutcome::TooFar;
        }
        let mut by_id: BTreeMap<BodyId, BodyState> = BTreeMap::new();
        by_id.extend(motions.iter().copied());
        self.observations.clear();
        for (place, body) in self.bodies.iter_mut().enumerate() {
            let Some(id) = body.id else { continue };
            let motion = by_id.get(&id).copied();
            let motion = motion.unwrap_or_else(|| body.latest.stilled());
            if motion != body.latest || motion != motion.stilled() {
                body.still_since = tick;
            }
            body.latest = motion;
            let still = tick.since(body.still_since);
            let rests = still.is_none_or(|ticks| ticks >= self.second);
            self.observations.push(Observation {
                id: BodyId::new(place as u32, 0),
                motion,
                activity: if rests {
                    Activity::Asleep
                } else {
                    Activity::Awake
                },
            });
        }
        self.observation_history.observe(tick, &self.observations);
        self.sender.publish(&self.observation_history, SCENE_EVENTS);
        out.extend(self.sender.datagrams(SERVER).cloned());
        PublishOutcome::Yes
    }

    /// The id of the stream.
    pub(crate) fn stream(&self) -> StreamId {
        self.sender.stream()
    }

    /// Answers a loss report that the server sent about this stream.
    pub(crate) fn handle_datagram(
        &mut self,
        now: Instant,
        round_trip: Span,
        datagram: &Datagram<'_>,
        out: &mut Vec<Bytes>,
    ) {
        let from = Recipient {
            id: SERVER,
            round_trip,
        };
        self.sender
            .handle_datagram(now, from, datagram, SCENE_EVENTS, out);
    }
}
