//! Both ends of an upstream: states of bodies under a client's authority.
//!
//! The client's end wraps a `StreamSender`; its caller chooses the lane for the packets. Invariant: a server that
//! received all packets of `publish` predicts each body within the tolerance of the state given here.
//!
//! The server's end wraps a `StreamReceiver`. Bytes come from untrusted clients: none may panic, memory is bounded,
//! and only granted bodies are affected. It does not move bodies in the engine. It counts silence in ticks of the
//! scene alone, so that the timeout is the same in a lockstep scene (PROTOCOL 6.14).

use alloc::collections::{BTreeMap, VecDeque};
use alloc::vec::Vec;
use core::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{
    BodyId, BodyState, Integrator, Metres, Motion, Rate, Tick, Ticks, Tolerance, Track,
};

use crate::endpoint::{Instant, Span};
use crate::limits::{AUTHORITY_BODIES_MAX, TICK_JUMP_MAX, UPSTREAM_GRACE_MS};
use crate::message::{AuthorityGrant, TakeAuthority};
use crate::packet::{Datagram, PacketKind, StreamId};
use crate::scene;
use crate::stream::{
    Activity, DISORDER, Features, Observation, ObservationHistory, PredictionParameters,
    PublisherStatistics, Recipient, StreamConfig, StreamReceiver, StreamSender, StreamStart,
    Subscriber, SubscriberStatistics, WatermarkPolicy, second, whole_ticks,
};

/// The tracks of a body, oldest first, each from its origin on. A client may publish ticks that the server has not
/// reached.
#[derive(Clone, Debug)]
struct BodyTracks {
    /// None after the body left the scene.
    id: Option<BodyId>,
    tracks: VecDeque<Track>,
}

/// The receiving end of one client's upstream.
#[derive(Debug)]
pub struct UpstreamReceiver {
    receiver: StreamReceiver,
    /// The position is the body's index in the stream.
    body_tracks: Vec<BodyTracks>,
    upstream_timeout: UpstreamTimeout,
    /// Up to this tick everything was received, even where a later packet is missing.
    complete_until: Tick,
    /// The newest tick that `motions` was called for.
    present: Tick,
    changed: Vec<u32>,
}

/// The number of tracks kept for one body beside the one in force (PROTOCOL 6.14-12).
const LATER_TRACKS_KEPT: usize = 64;
/// Bound of the stream's indices and aliases. A body may take a second alias before its first one is free.
const NAMES_END: u32 = 2 * AUTHORITY_BODIES_MAX as u32;
/// The pause between the first two reports of one loss; it doubles. The server measures no round trip; the client does
/// and refreshes a packet at most once in one.
const REPORT_AGAIN: Span = Span::from_millis(50);

impl UpstreamReceiver {
    /// Opens the stream that was granted for this request. `parameters` returns None for a body that is not in the
    /// scene.
    pub fn new(
        grant: &AuthorityGrant,
        request: &TakeAuthority,
        integrator: Integrator,
        parameters: impl Fn(BodyId) -> Option<PredictionParameters>,
    ) -> Self {
        let start = StreamStart {
            stream: grant.stream,
            largest_packet: request.largest_packet,
            tolerance: request.tolerance,
            integrator,
            publish_interval: NonZeroU32::MIN,
            gravity: Vec3::ZERO,
            tick: grant.tick,
            next: 0,
            scene_events: 0,
        };
        let mut subscriber = Subscriber::restricted(&start, NAMES_END);
        let mut body_tracks = Vec::with_capacity(grant.bodies.len());
        for (id, motion) in &grant.bodies {
            let index = BodyId::new(body_tracks.len() as u32, 0);
            let track = grant.first_track(*motion);
            let placed = parameters(*id)
                .is_some_and(|parameters| subscriber.place(index, &parameters, track));
            body_tracks.push(BodyTracks {
                id: placed.then_some(*id),
                tracks: VecDeque::from([track]),
            });
        }
        subscriber.handle_snapshot_end();
        Self {
            receiver: StreamReceiver::with_timeout(subscriber, DISORDER),
            body_tracks,
            upstream_timeout: UpstreamTimeout::of(integrator.rate),
            complete_until: grant.tick,
            present: grant.tick,
            changed: Vec::new(),
        }
    }

    const fn subscriber(&self) -> &Subscriber {
        self.receiver.subscriber()
    }

    /// The id of the stream.
    #[must_use]
    pub const fn stream(&self) -> StreamId {
        self.subscriber().stream()
    }

    /// The tolerance that the client keeps.
    #[must_use]
    pub const fn tolerance(&self) -> Tolerance {
        self.subscriber().tolerance()
    }

    /// Counters of everything received so far.
    #[must_use]
    pub const fn statistics(&self) -> SubscriberStatistics {
        self.subscriber().statistics()
    }

    /// The newest tick up to which the client has sent everything.
    #[must_use]
    pub const fn watermark_tick(&self) -> Tick {
        self.subscriber().watermark_tick()
    }

    /// The bodies still in the scene, in rising order.
    pub fn bodies(&self) -> impl Iterator<Item = BodyId> {
        self.body_tracks
            .iter()
            .filter_map(|body_track| body_track.id)
    }

    /// True if the stream must be replaced: too many packets are missing, or a checksum differs.
    #[must_use]
    pub const fn has_lost_sync(&self) -> bool {
        self.subscriber().has_lost_sync()
    }

    /// True if no packet about this tick is known to be missing.
    #[must_use]
    pub fn is_complete_at(&self, tick: Tick) -> bool {
        let is_complete =
            self.subscriber().is_converged() && self.subscriber().known_from() <= tick;
        is_complete || tick <= self.complete_until
    }

    /// The first tick that the client has not confirmed, if a watermark of it is overdue at this tick, so that one was
    /// requested.
    #[must_use]
    pub fn silent_since(&self, tick: Tick) -> Option<Tick> {
        let silence = self.subscriber().silent_ticks();
        let request_from = self
            .upstream_timeout
            .request_from(self.watermark_tick(), silence);
        (tick > request_from).then(|| self.watermark_tick().next())
    }

    fn last_predicted(&self) -> Tick {
        let silence = self.subscriber().silent_ticks();
        self.upstream_timeout
            .last_predicted(self.watermark_tick(), silence)
    }

    /// Removes a body from the scene. Its track stays, because the client learns of the removal later.
    pub fn remove(&mut self, id: BodyId) {
        for body_track in &mut self.body_tracks {
            body_track.id = body_track.id.filter(|known| *known != id);
        }
    }

    /// Applies a packet of this stream. A malformed packet, or one about bodies that were not granted, only changes a
    /// counter.
    ///
    /// Returns the oldest tick whose motions may have changed; None if no motion changed.
    pub fn handle_datagram(&mut self, datagram: &Datagram<'_>) -> Option<Tick> {
        if matches!(datagram.head().kind, PacketKind::Full | PacketKind::FullEnd) {
            return None;
        }
        let (converged, watermark_tick) = (self.subscriber().is_converged(), self.watermark_tick());
        let subscriber = self.receiver.subscriber_mut();
        subscriber.handle(datagram);
        subscriber.drain_changed(&mut self.changed);
        let mut oldest = None;
        for index in self.changed.drain(..) {
            let track = self.receiver.subscriber().track(BodyId::new(index, 0));
            if let Some((body_track, track)) = self.body_tracks.get_mut(index as usize).zip(track) {
                body_track.take(track);
                oldest = Some(oldest.map_or(track.origin, |oldest: Tick| oldest.min(track.origin)));
            }
        }
        // A missing packet may be about any tick after the last watermark.
        let is_converged = self.subscriber().is_converged();
        if converged && is_converged {
            return oldest;
        }
        // After a refresh, unknown ticks may still lie ahead of the present one; the old bound then stays valid.
        if converged && self.subscriber().known_from() <= self.present {
            self.complete_until = watermark_tick;
        }
        Some(watermark_tick.next())
    }

    /// The motions of the bodies at a tick, in rising order of id. Call with rising ticks. Bodies of a client that has
    /// been silent for too long stand at their last predicted place.
    pub fn motions(&mut self, tick: Tick) -> impl Iterator<Item = (BodyId, Motion)> {
        self.present = tick;
        let until = self.last_predicted();
        let (at, stale) = (tick.min(until), tick > until);
        let subscriber = self.receiver.subscriber();
        let body_tracks = self.body_tracks.iter_mut().enumerate();
        body_tracks.filter_map(move |(place, body_track)| {
            let id = body_track.id?;
            let track = body_track.at(at)?;
            let motion = subscriber.predicted(BodyId::new(place as u32, 0), track, at)?;
            Some((id, if stale { motion.stilled() } else { motion }))
        })
    }

    /// Appends the reports due at a tick: losses, and silence, which requests the client's watermark.
    pub fn poll_reports(&mut self, now: Instant, tick: Tick, out: &mut Vec<Bytes>) {
        if self.silent_since(tick).is_some() {
            self.receiver.expect_within(now, Span::ZERO);
        } else {
            self.receiver.end_silence();
        }
        self.receiver.update_timers(now);
        self.receiver.report(now, REPORT_AGAIN, out);
    }
}

impl BodyTracks {
    /// Adds a track that replaces those from its origin on.
    fn take(&mut self, track: Track) {
        self.tracks.retain(|kept| kept.origin < track.origin);
        if self.tracks.len() > LATER_TRACKS_KEPT {
            // The first track is the one in force: without it the body would not move.
            self.tracks.remove(1);
        }
        self.tracks.push_back(track);
    }

    /// The track in force at a tick. Tracks before it are dropped.
    fn at(&mut self, tick: Tick) -> Option<&Track> {
        let begun_tracks = self.tracks.partition_point(|track| track.origin <= tick);
        self.tracks.drain(..begun_tracks.saturating_sub(1));
        self.tracks.front().filter(|track| track.origin <= tick)
    }
}

/// A body that the client has authority over.
#[derive(Clone, Copy, Debug)]
struct UpstreamBody {
    /// None after the body left the scene.
    id: Option<BodyId>,
    /// Its track, until it is known how the body is predicted. It has no updates before that.
    waiting: Option<Track>,
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
    /// The tick of the grant.
    granted: Tick,
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
    /// Starts the stream that the server granted for this request. Its bodies wait for [`Self::learn`].
    pub(crate) fn new(
        grant: &AuthorityGrant,
        request: &TakeAuthority,
        integrator: Integrator,
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
            // A checksum covers all tracks, and no parameters.
            let unknown = PredictionParameters::plain(Metres::new(1.0));
            let placed = sender.place(index, &unknown, track, *motion);
            bodies.push(UpstreamBody {
                id: placed.then_some(*id),
                waiting: Some(track),
                latest: *motion,
                still_since: grant.tick,
            });
        }
        Self {
            sender,
            observation_history: ObservationHistory::new(scene::PublishSchedule::EACH_TICK),
            bodies,
            observations: Vec::new(),
            granted: grant.tick,
            second: second(integrator.rate),
        }
    }

    /// Begins to publish those of the waiting bodies of which it is known now how they are predicted; returns these.
    pub(crate) fn learn(
        &mut self,
        parameters: impl Fn(BodyId) -> Option<PredictionParameters>,
    ) -> Vec<(BodyId, PredictionParameters)> {
        let mut learnt = Vec::new();
        for (place, body) in self.bodies.iter_mut().enumerate() {
            if let (Some(id), Some(track)) = (body.id, body.waiting)
                && let Some(parameters) = parameters(id)
            {
                let index = BodyId::new(place as u32, 0);
                if self.sender.place(index, &parameters, track, body.latest) {
                    body.waiting = None;
                    learnt.push((id, parameters));
                }
            }
        }
        learnt
    }

    /// True while a body waits until it is known how it is predicted.
    pub(crate) fn waits(&self) -> bool {
        let mut present = self.bodies.iter().filter(|body| body.id.is_some());
        present.any(|body| body.waiting.is_some())
    }

    /// The bodies still in the scene that are published, in rising order.
    pub(crate) fn bodies(&self) -> impl Iterator<Item = BodyId> {
        let known = self.bodies.iter().filter(|body| body.waiting.is_none());
        known.filter_map(|body| body.id)
    }

    /// True for a stream that has lasted less than ten seconds: a body that the server predicts otherwise shows within some
    /// after it moves.
    pub(crate) fn is_new(&self) -> bool {
        let lasted = self.sender.tick().since(self.granted);
        lasted.is_none_or(|ticks| ticks.count() < 10 * self.second.count())
    }

    /// True for a body still in the scene, published or not.
    pub(crate) fn has(&self, id: BodyId) -> bool {
        self.bodies.iter().any(|body| body.id == Some(id))
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
            let Some(id) = body.id.filter(|_| body.waiting.is_none()) else {
                continue;
            };
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

/// The timeout of an upstream, in ticks of its scene.
#[derive(Clone, Copy, Debug)]
struct UpstreamTimeout {
    policy: WatermarkPolicy,
    /// The allowed delay of a watermark.
    grace: Ticks,
}

impl UpstreamTimeout {
    fn of(rate: Rate) -> Self {
        Self {
            policy: WatermarkPolicy::upstream(rate),
            grace: Ticks::new(whole_ticks(rate, UPSTREAM_GRACE_MS) as u32),
        }
    }

    /// The tick at which the watermark after `watermark_tick` is due. `silence`: the ticks of silence that ended there.
    fn due(&self, watermark_tick: Tick, silence: u64) -> Tick {
        watermark_tick + Ticks::new(self.policy.pause_after(silence) as u32)
    }

    /// The tick from which the server requests the overdue watermark.
    fn request_from(&self, watermark_tick: Tick, silence: u64) -> Tick {
        self.due(watermark_tick, silence) + Ticks::new(self.grace.count() / 4)
    }

    /// The last tick that the server predicts without that watermark.
    fn last_predicted(&self, watermark_tick: Tick, silence: u64) -> Tick {
        self.due(watermark_tick, silence) + self.grace
    }
}

#[cfg(test)]
mod tests {
    use core::num::NonZeroU32;

    use proptest::prelude::*;
    use rhumb_reckoning::{BodyState, Damping, Divergence, Metres, Rate, Ticks};

    use super::*;
    use crate::packet::LargestPacket;
    use crate::scene::{BodyDesc, BodyKind, Shape, ShapeId};

    const INTEGRATOR: Integrator = Integrator {
        rate: Rate::HZ_60,
        substeps: NonZeroU32::new(4).unwrap(),
    };
    const TOLERANCE: Tolerance = Tolerance::FINE;

    fn at(x: f32, speed: f32) -> BodyState {
        BodyState::new(
            [x, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [speed, 0.0, 0.0],
            [0.0; 3],
        )
        .unwrap()
    }

    /// Back and forth along x, with a speed that changes each half second.
    fn trajectory(tick: u64) -> BodyState {
        let mut x = 0.0;
        let speed = |tick: u64| ((tick / 30) % 4) as f32 - 1.5;
        for before in 0..tick {
            x += speed(before) / 60.0;
        }
        at(x, speed(tick))
    }

    fn parameters(id: BodyId) -> Option<PredictionParameters> {
        let desc = BodyDesc::plain(id, BodyKind::Kinematic, ShapeId(0));
        let shape = Shape::Ball { radius: 0.5 };
        Some(PredictionParameters::of(
            &desc,
            &shape,
            Damping::default(),
            None,
        ))
    }

    fn opened(bytes: &[u8]) -> Datagram<'_> {
        Datagram::open(bytes).expect("both ends send datagrams")
    }

    fn connected_ends() -> (UpstreamSender, UpstreamReceiver) {
        let id = BodyId::new(70, 3);
        let request = TakeAuthority {
            tolerance: TOLERANCE,
            largest_packet: LargestPacket::DEFAULT,
            bodies: alloc::vec![id],
        };
        let grant = AuthorityGrant {
            stream: StreamId(9),
            tick: Tick::new(100),
            bodies: alloc::vec![(id, at(0.0, 0.0))],
        };
        let mut sender = UpstreamSender::new(&grant, &request, INTEGRATOR);
        assert_eq!(sender.learn(parameters).len(), 1);
        let upstream_receiver = UpstreamReceiver::new(&grant, &request, INTEGRATOR, parameters);
        (sender, upstream_receiver)
    }

    /// The motion that the server predicts for the body at a tick.
    fn placed(upstream_receiver: &mut UpstreamReceiver, tick: Tick) -> Option<Motion> {
        let mut motions = upstream_receiver.motions(tick);
        motions.next().map(|(id, motion)| {
            assert_eq!(id, BodyId::new(70, 3));
            motion
        })
    }

    proptest! {
        /// `lost` and `late` decide the fate of each packet. The client leads the server by `lead` ticks.
        #[test]
        fn bodies_known_in_time_are_within_tolerance(
            fates in proptest::collection::vec((0_u8..10, 0_u64..6), 600), lead in 0_u64..12
        ) {
            let (mut sender, mut upstream_receiver) = connected_ends();
            let mut under_way: Vec<(u64, Bytes)> = Vec::new();
            let mut fates = fates.into_iter();
            let (mut packets, mut reports): (Vec<Bytes>, Vec<Bytes>) = Default::default();
            let mut checked = 0;
            for step in 1..240_u64 {
                let tick = Tick::new(100 + step);
                let now = Instant::from_nanos(step * 16_666_667);
                let ahead = step + lead;
                let states = [(BodyId::new(70, 3), trajectory(ahead))];
                let outcome = sender.publish(Tick::new(100 + ahead), &states, &mut packets);
                prop_assert_eq!(outcome, PublishOutcome::Yes);
                for report in reports.drain(..) {
                    sender.handle_datagram(now, Span::from_millis(30), &opened(&report), &mut packets);
                }
                for packet in packets.drain(..) {
                    let (fate, way) = fates.next().unwrap_or((9, 0));
                    if fate > 1 {
                        under_way.push((step + way, packet));
                    }
                }
                under_way.retain(|(due, packet)| {
                    let is_due = *due <= step;
                    if is_due {
                        upstream_receiver.handle_datagram(&opened(packet));
                    }
                    !is_due
                });
                let placed = placed(&mut upstream_receiver, tick).expect("it is there");
                if upstream_receiver.is_complete_at(tick) && upstream_receiver.watermark_tick() >= tick && step > lead {
                    let apart = Divergence::between(&trajectory(step).motion().pose(), &placed.pose());
                    let share = TOLERANCE.share(&apart, Metres::new(0.5));
                    prop_assert!(share <= 1.0, "off by {} at step {}", share, step);
                    checked += 1;
                }
                upstream_receiver.poll_reports(now, tick, &mut reports);
            }
            prop_assert!(lead < 8 || checked > 0);
            prop_assert_eq!(upstream_receiver.statistics().mismatches, 0);
            prop_assert_eq!(upstream_receiver.statistics().malformed, 0);
        }
    }

    #[test]
    fn a_wrong_track_ends_the_stream() {
        let (mut sender, mut upstream_receiver) = connected_ends();
        let (mut packets, mut reports): (Vec<Bytes>, Vec<Bytes>) = Default::default();
        for step in 1..=200_u64 {
            let now = Instant::from_nanos(step * 16_666_667);
            let tick = Tick::new(100 + step);
            sender.publish(tick, &[(BodyId::new(70, 3), at(0.0, 0.0))], &mut packets);
            if step == 20 {
                let wrong = Track::resting(tick, at(7.0, 0.0));
                let index = BodyId::new(0, 0);
                assert!(upstream_receiver.receiver.subscriber_mut().place(
                    index,
                    &parameters(index).unwrap(),
                    wrong
                ));
            }
            for packet in packets.drain(..) {
                upstream_receiver.handle_datagram(&opened(&packet));
            }
            upstream_receiver.poll_reports(now, tick, &mut reports);
            for report in reports.drain(..) {
                sender.handle_datagram(now, Span::from_millis(30), &opened(&report), &mut packets);
            }
        }
        assert_eq!(upstream_receiver.statistics().mismatches, 1);
        assert!(upstream_receiver.has_lost_sync());
    }

    #[test]
    fn a_client_far_ahead_still_moves_its_bodies() {
        let (mut sender, mut upstream_receiver) = connected_ends();
        let mut packets = Vec::new();
        // No prediction fits, so each tick has a track of its own.
        let place = |ahead: u64| (ahead * ahead * ahead % 101) as f32;
        for ahead in 1..=200_u64 {
            let state = at(place(ahead), 0.0);
            sender.publish(
                Tick::new(100 + ahead),
                &[(BodyId::new(70, 3), state)],
                &mut packets,
            );
        }
        for packet in packets.drain(..) {
            upstream_receiver.handle_datagram(&opened(&packet));
        }
        let mut x = |tick: u64| {
            let motion = placed(&mut upstream_receiver, Tick::new(100 + tick));
            motion.expect("it is there").pose().position.x
        };
        // The track of the grant is in force until the oldest kept one.
        for tick in [0, 136] {
            assert!(x(tick).abs() < 0.1, "tick {tick}: {}", x(tick));
        }
        for tick in 137..=200 {
            let off = x(tick) - f64::from(place(tick));
            assert!(off.abs() < 0.1, "tick {tick}: {off}");
        }
    }

    #[test]
    fn bodies_of_a_silent_client_stop() {
        let (mut sender, mut upstream_receiver) = connected_ends();
        let mut packets = Vec::new();
        for ahead in 1..=20_u64 {
            let motion = at(ahead as f32 / 60.0, 1.0);
            sender.publish(
                Tick::new(100 + ahead),
                &[(BodyId::new(70, 3), motion)],
                &mut packets,
            );
        }
        for packet in packets.drain(..) {
            upstream_receiver.handle_datagram(&opened(&packet));
        }
        let last = upstream_receiver.watermark_tick();
        let mut flown = 0;
        let mut before = placed(&mut upstream_receiver, last)
            .expect("it is there")
            .pose();
        for ahead in 1..300 {
            let now =
                placed(&mut upstream_receiver, last + Ticks::new(ahead)).expect("it is there");
            flown += u32::from(now.pose() != before);
            assert_eq!(
                last + Ticks::new(ahead) > upstream_receiver.last_predicted(),
                now.twist() == rhumb_reckoning::Twist::ZERO
            );
            before = now.pose();
        }
        // The silence before the last packet, at least four ticks, plus one second.
        assert!((64..=80).contains(&flown), "{flown} ticks");
    }

    #[test]
    fn an_upstream_is_predicted_until_a_second_after_its_watermark_was_due() {
        let timeout = UpstreamTimeout::of(Rate::HZ_60);
        assert_eq!(timeout.last_predicted(Tick::new(10), 0), Tick::new(74));
        assert_eq!(
            timeout.last_predicted(Tick::new(900), 700),
            Tick::new(1_110)
        );
    }
}
