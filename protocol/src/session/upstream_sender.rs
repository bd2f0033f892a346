//! A member's own stream to its server: how the bodies that it drives move.
//!
//! The publisher's end. Does not know by which lane its packets go. Invariant: after `publish` the server, once it has
//! heard all of it, believes each body within the tolerance of what was said here.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{BodyId, BodyState, Integrator, Tick, Tolerance};

use super::watermark_schedule::WatermarkSchedule;
use crate::limits::TICK_JUMP_MAX;
use crate::message::AuthorityGrant;
use crate::packet::{ChecksumMismatch, Head, LossReport, PacketKind};
use crate::scene;
use crate::stream::{
    Activity, Features, LossTracker, MismatchReply, Observation, ObservationHistory,
    PredictionParameters, Publisher, PublisherStatistics, StreamTerms,
};
use crate::time::{Instant, Span};
use crate::wire::Wire;
use crate::wire::bytes::Reader;

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
    publisher: Publisher,
    /// What the server loses.
    losses: LossTracker,
    observation_history: ObservationHistory,
    /// In rising order of id. The place is the index in the stream.
    bodies: Vec<UpstreamBody>,
    seen: Vec<Observation>,
    watermark_schedule: WatermarkSchedule,
    /// The tick of the newest packet, and the length of silence since that is watermark_tick for next, in ticks.
    last_published: Tick,
    watermark_at: u64,
    /// When the sum over all tracks was last said, and what it was.
    checksums: (Tick, u64),
    /// When each lost packet was last made good.
    answered: BTreeMap<u64, Instant>,
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
        let mut publisher = Publisher::new(driving.stream, &config, driving.tick);
        let mut bodies = Vec::with_capacity(driving.bodies.len());
        for (id, motion) in &driving.bodies {
            let index = BodyId::new(bodies.len() as u32, 0);
            let track = driving.first_track(*motion);
            let placed = parameters(*id)
                .is_some_and(|parameters| publisher.place(index, &parameters, track));
            bodies.push(UpstreamBody {
                id: placed.then_some(*id),
                latest: *motion,
                still_since: driving.tick,
            });
        }
        Self {
            publisher,
            observation_history: ObservationHistory::new(scene::PublishSchedule::EACH_TICK),
            bodies,
            seen: Vec::new(),
            watermark_schedule: WatermarkSchedule::of(integrator.rate),
            last_published: driving.tick,
            watermark_at: WatermarkSchedule::of(integrator.rate).watermark_after(0),
            checksums: (driving.tick, 0),
            answered: BTreeMap::new(),
            losses: LossTracker::default(),
        }
    }

    /// The bodies that it drives, in rising order.
    pub(crate) fn bodies(&self) -> impl Iterator<Item = BodyId> {
        self.bodies.iter().filter_map(|body| body.id)
    }

    /// What it said so far.
    pub(crate) const fn statistics(&self) -> PublisherStatistics {
        self.publisher.statistics()
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
        let before = self.publisher.tick();
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
            let rests = still.is_none_or(|ticks| ticks >= self.watermark_schedule.second);
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
        let first = out.len();
        self.publisher
            .publish(&self.observation_history, SCENE_EVENTS, out);
        self.close_tick(tick, out.len() > first, out);
        let redundancy = self.losses.redundancy(1, self.publisher.next_number());
        self.publisher.encode_repair_symbols(redundancy, out);
        PublishOutcome::Yes
    }

    /// Says what is due at the end of a tick: a sum over all tracks, or a watermark for silence.
    fn close_tick(&mut self, tick: Tick, spoke: bool, out: &mut Vec<Bytes>) {
        if spoke {
            self.last_published = tick;
            self.watermark_at = self.watermark_schedule.watermark_after(0);
            out.extend(self.due_checksums(tick));
            return;
        }
        let silence = tick.value() - self.last_published.value();
        if silence >= self.watermark_at {
            self.watermark_at = self.watermark_schedule.watermark_after(silence);
            // A checksums watermarks too.
            let checksums = self.due_checksums(tick);
            out.push(checksums.unwrap_or_else(|| self.publisher.watermark(SCENE_EVENTS)));
        }
    }

    fn due_checksums(&mut self, tick: Tick) -> Option<Bytes> {
        let (last, sum) = self.checksums;
        if tick.since(last)? < self.watermark_schedule.second
            || self.publisher.state_checksum() == sum
        {
            return None;
        }
        self.checksums = (tick, self.publisher.state_checksum());
        Some(self.publisher.checksums(SCENE_EVENTS))
    }

    /// Whether a datagram names this stream.
    pub(crate) fn is_about(&self, datagram: &[u8]) -> bool {
        let head = Head::decode(&mut Reader::new(datagram));
        head.is_ok_and(|head| head.stream == self.publisher.stream())
    }

    /// Answers what the server says of this stream: what it lost, or what it believes otherwise. A packet that was made
    /// good less than a round trip ago is not again.
    pub(crate) fn handle_datagram(
        &mut self,
        now: Instant,
        round_trip: Span,
        datagram: &[u8],
        out: &mut Vec<Bytes>,
    ) {
        let mut reader = Reader::new(datagram);
        let Ok(head) = Head::decode(&mut reader) else {
            return;
        };
        match head.kind {
            PacketKind::LossReport => {
                if let Ok(loss_report) = LossReport::decode(reader) {
                    self.answer(now, round_trip, &loss_report, out);
                }
            }
            PacketKind::ChecksumMismatch => {
                let mismatch = ChecksumMismatch::decode(reader);
                match mismatch
                    .map(|mismatch| self.publisher.answer_mismatch(mismatch, SCENE_EVENTS))
                {
                    Ok(MismatchReply::Sums(datagram)) => out.push(datagram),
                    Ok(MismatchReply::Resync(_, datagrams)) => out.extend(datagrams),
                    Err(_) => {}
                }
            }
            _ => {}
        }
    }

    fn answer(
        &mut self,
        now: Instant,
        round_trip: Span,
        loss_report: &LossReport,
        out: &mut Vec<Bytes>,
    ) {
        self.answered.retain(|_, at| now < *at + round_trip);
        self.losses
            .hear(SERVER, loss_report, self.publisher.next_number());
        for number in self.publisher.answer(loss_report, out) {
            if self.answered.contains_key(&number) {
                continue;
            }
            // One that is forgotten is not refreshed: the watermark tells how much was missed.
            if let Some(datagrams) = self.publisher.refresh(number, SCENE_EVENTS) {
                out.extend(datagrams);
                self.answered.insert(number, now);
            }
        }
        out.push(self.publisher.watermark(SCENE_EVENTS));
    }
}
