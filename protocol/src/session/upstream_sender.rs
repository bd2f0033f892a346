//! A member's own stream to its server: how the bodies that it drives move.
//!
//! The publisher's end. Does not know by which lane its packets go. Invariant: after `publish` the server, once it has
//! heard all of it, believes each body within the tolerance of what was said here.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{BodyId, BodyState, Integrator, Tick, Ticks, Tolerance};

use crate::limits::TICK_JUMP_MAX;
use crate::message::AuthorityGrant;
use crate::packet::{Datagram, StreamId};
use crate::scene;
use crate::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, PublisherStatistics,
    Recipient, StreamSender, StreamTerms, WatermarkPolicy, second,
};
use crate::time::{Instant, Span};

/// A body that is driven.
#[derive(Clone, Copy, Debug)]
struct UpstreamBody {
    /// None once it has left the scene.
    id: Option<BodyId>,
    /// Where it was said to be last.
    latest: BodyState,
    /// Since when it has stood there.
    still_since: Tick,
}

/// What was done with the truth of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PublishOutcome {
    /// It was compared with what was said, and said as far as that was needed.
    Yes,
    /// A tick as new was told before.
    Before,
    /// The tick lies so far ahead that the stream must begin anew.
    TooFar,
}

/// The only listener.
const SERVER: u64 = 0;

/// The stream at its source.
#[derive(Debug)]
pub(crate) struct UpstreamSender {
    sender: StreamSender,
    observation_history: ObservationHistory,
    /// In rising order of id. The place is the index in the stream.
    bodies: Vec<UpstreamBody>,
    seen: Vec<Observation>,
    /// A body that stands still for so long rests.
    second: Ticks,
}

/// What the source of an upstream may use: nothing pulls at what no engine moves, and no body holds another.
const FEATURES: Features = Features {
    ballistic: false,
    torque_free: false,
    attached: false,
    ..Features::ALL
};

/// There is only one count of scene_events in an upstream, and it stays there.
const SCENE_EVENTS: u64 = 0;

impl UpstreamSender {
    /// A stream as the server has granted it. `parameters` says what predictors need to know of a body that is there.
    pub(crate) fn new(
        driving: &AuthorityGrant,
        tolerance: Tolerance,
        integrator: Integrator,
        parameters: impl Fn(BodyId) -> Option<PredictionParameters>,
    ) -> Self {
        let config = StreamTerms {
            tolerance,
            integrator,
            publish_interval: scene::PublishSchedule::EACH_TICK.publish_interval,
            gravity: Vec3::ZERO,
            features: FEATURES,
        };
        let policy = WatermarkPolicy::upstream(integrator.rate);
        let mut sender =
            StreamSender::reckoned(driving.stream, &config, None, policy, driving.tick);
        let mut bodies = Vec::with_capacity(driving.bodies.len());
        for (id, motion) in &driving.bodies {
            let index = BodyId::new(bodies.len() as u32, 0);
            let track = driving.first_track(*motion);
            let placed = parameters(*id)
                .is_some_and(|parameters| sender.place(index, &parameters, track, *motion));
            bodies.push(UpstreamBody {
                id: placed.then_some(*id),
                latest: *motion,
                still_since: driving.tick,
            });
        }
        Self {
            sender,
            observation_history: ObservationHistory::new(scene::PublishSchedule::EACH_TICK),
            bodies,
            seen: Vec::new(),
            second: second(integrator.rate),
        }
    }

    /// The bodies that it drives, in rising order.
    pub(crate) fn bodies(&self) -> impl Iterator<Item = BodyId> {
        self.bodies.iter().filter_map(|body| body.id)
    }

    /// What it said so far.
    pub(crate) fn statistics(&self) -> PublisherStatistics {
        self.sender.statistics()
    }

    /// A body has left the scene. Its track stays, since the server does not know at the same tick.
    pub(crate) fn remove(&mut self, id: BodyId) {
        for body in &mut self.bodies {
            body.id = body.id.filter(|known| *known != id);
        }
    }

    /// Takes in the truth of a tick, and appends the packets that it takes. Bodies that are not by_id stand still where
    /// they were by_id last.
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
        let by_id: BTreeMap<BodyId, BodyState> = motions.iter().copied().collect();
        self.seen.clear();
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
            self.seen.push(Observation {
                id: BodyId::new(place as u32, 0),
                motion,
                activity: if rests {
                    Activity::Asleep
                } else {
                    Activity::Awake
                },
            });
        }
        self.observation_history.observe(tick, &self.seen);
        self.sender.publish(&self.observation_history, SCENE_EVENTS);
        out.extend(self.sender.datagrams(SERVER).cloned());
        PublishOutcome::Yes
    }

    /// Its name.
    pub(crate) fn stream(&self) -> StreamId {
        self.sender.stream()
    }

    /// Answers a datagram of the server about this stream: a loss report or a mismatch.
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
