//! The server's end of an upstream: where a client's bodies belong.
//!
//! Wraps a `StreamReceiver`. Bytes come from anyone: none may panic, memory is bounded, and only granted bodies are
//! affected. Does not move bodies in the engine.

use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{BodyId, Integrator, Motion, Tick, Tolerance, Track};

use super::watermark_schedule::WatermarkSchedule;
use crate::limits::AUTHORITY_BODIES_MAX;
use crate::message::AuthorityGrant;
use crate::packet::{Datagram, PacketKind, StreamId};
use crate::stream::{
    DISORDER, PredictionParameters, StreamReceiver, StreamStart, Subscriber, SubscriberStatistics,
};
use crate::time::{Instant, Span};

/// The tracks of a body that hold from some tick on, oldest first: a client may publish ticks that the server has not reached.
#[derive(Clone, Debug)]
struct BodyTracks {
    /// None once it has left the scene.
    id: Option<BodyId>,
    tracks: VecDeque<Track>,
}

/// The upstream of one client, as far as it was received.
#[derive(Debug)]
pub struct UpstreamReceiver {
    receiver: StreamReceiver,
    /// The place is the index in the stream.
    body_tracks: Vec<BodyTracks>,
    watermark_schedule: WatermarkSchedule,
    /// Everything up to this tick was received before anything was missing.
    sure_until: Tick,
    /// The newest tick that `motions` was called for.
    present: Tick,
    changed: Vec<u32>,
}

/// Tracks that are kept of a body.
const TRACKS_KEPT: usize = 64;
/// Indices and aliases of a stream stay below it: a body that leaves an alias may take another before that one is free.
const NAMES_END: u32 = 2 * AUTHORITY_BODIES_MAX as u32;
/// The pause between the first two reports of one loss; it doubles. The server does not measure round trips; the
/// driver, which does, refreshes no packet twice within one.
const REPORT_AGAIN: Span = Span::from_millis(50);

impl UpstreamReceiver {
    /// A stream as it is granted. `parameters` says what predictors need to know of each body.
    pub fn new(
        driving: &AuthorityGrant,
        tolerance: Tolerance,
        integrator: Integrator,
        parameters: impl Fn(BodyId) -> Option<PredictionParameters>,
    ) -> Self {
        let start = StreamStart {
            stream: driving.stream,
            tolerance,
            integrator,
            publish_interval: NonZeroU32::MIN,
            gravity: Vec3::ZERO,
            tick: driving.tick,
            next: 0,
            scene_events: 0,
        };
        let mut subscriber = Subscriber::restricted(&start, NAMES_END);
        let mut body_tracks = Vec::with_capacity(driving.bodies.len());
        for (id, motion) in &driving.bodies {
            let index = BodyId::new(body_tracks.len() as u32, 0);
            let track = driving.first_track(*motion);
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
            watermark_schedule: WatermarkSchedule::of(integrator.rate),
            sure_until: driving.tick,
            present: driving.tick,
            changed: Vec::new(),
        }
    }

    const fn subscriber(&self) -> &Subscriber {
        self.receiver.subscriber()
    }

    /// Its name.
    #[must_use]
    pub const fn stream(&self) -> StreamId {
        self.subscriber().stream()
    }

    /// Its promise.
    #[must_use]
    pub const fn tolerance(&self) -> Tolerance {
        self.subscriber().tolerance()
    }

    /// What was received so far.
    #[must_use]
    pub const fn statistics(&self) -> SubscriberStatistics {
        self.subscriber().statistics()
    }

    /// The newest tick up to which the client has sent everything.
    #[must_use]
    pub const fn watermark_tick(&self) -> Tick {
        self.subscriber().watermark_tick()
    }

    /// The bodies, in rising order.
    pub fn bodies(&self) -> impl Iterator<Item = BodyId> {
        self.body_tracks
            .iter()
            .filter_map(|body_track| body_track.id)
    }

    /// Whether the stream must be replaced: too many packets are missing, or a checksum differs.
    #[must_use]
    pub const fn has_lost_sync(&self) -> bool {
        self.subscriber().has_lost_sync()
    }

    /// Whether nothing is known to be missing that was sent about a tick.
    #[must_use]
    pub fn is_complete_at(&self, tick: Tick) -> bool {
        let known = self.subscriber().is_converged() && self.subscriber().known_from() <= tick;
        known || tick <= self.sure_until
    }

    /// Whether the client has been silent for so long that its bodies stand still at a tick.
    #[must_use]
    pub fn is_stale(&self, tick: Tick) -> bool {
        tick > self.trusted()
    }

    fn trusted(&self) -> Tick {
        let silence = self.subscriber().silent_ticks();
        self.watermark_schedule
            .trusted(self.watermark_tick(), silence)
    }

    /// A body has left the scene. Its track stays, since the client learns of it later.
    pub fn remove(&mut self, id: BodyId) {
        for body_track in &mut self.body_tracks {
            body_track.id = body_track.id.filter(|known| *known != id);
        }
    }

    /// Takes in a packet of this stream. One that is none, or that names what was not granted, changes nothing but a
    /// count.
    ///
    /// Returns the oldest tick of which more, or less, is known than before; none if nothing changed.
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
        let settles = self.subscriber().is_converged();
        if converged && settles {
            return oldest;
        }
        // The ticks that a refresh left unknown may still lie ahead.
        if converged && self.subscriber().known_from() <= self.present {
            self.sure_until = watermark_tick;
        }
        Some(watermark_tick.next())
    }

    /// Where the bodies belong at a tick, in rising order; ticks are asked for in rising order too. Bodies of a
    /// client that has been silent for too long stand where they were predicted last.
    pub fn motions(&mut self, tick: Tick) -> impl Iterator<Item = (BodyId, Motion)> {
        self.present = tick;
        let until = self.trusted();
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

    /// Appends the reports that are due at a tick: of losses, and of silence, so that the client states its watermark.
    pub fn ask(&mut self, now: Instant, tick: Tick, out: &mut Vec<Bytes>) {
        let silence = self.subscriber().silent_ticks();
        let overdue = tick
            > self
                .watermark_schedule
                .asked(self.watermark_tick(), silence);
        if overdue {
            self.receiver.expect_within(now, Span::ZERO);
        } else {
            self.receiver.end_silence();
        }
        self.receiver.watch(now);
        self.receiver.report(now, REPORT_AGAIN, out);
    }
}

impl BodyTracks {
    /// Another track holds from its origin on.
    fn take(&mut self, track: Track) {
        if self
            .tracks
            .back()
            .is_some_and(|last| last.origin >= track.origin)
        {
            self.tracks.clear();
        }
        if self.tracks.len() == TRACKS_KEPT {
            self.tracks.pop_front();
        }
        self.tracks.push_back(track);
    }

    /// The track that holds at a tick; those before it are forgotten.
    fn at(&mut self, tick: Tick) -> Option<&Track> {
        let held = self.tracks.partition_point(|track| track.origin <= tick);
        self.tracks.drain(..held.saturating_sub(1));
        self.tracks.front().filter(|track| track.origin <= tick)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{BodyDesc, BodyKind, Shape, ShapeId};
    use crate::session::upstream_sender::{PublishOutcome, UpstreamSender};
    use core::num::NonZeroU32;
    use proptest::prelude::*;
    use rhumb_reckoning::{BodyState, Damping, Divergence, Metres, Rate, Ticks};

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

    /// To and fro, at a speed that changes each half second.
    fn walk(tick: u64) -> BodyState {
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

    fn ends() -> (UpstreamSender, UpstreamReceiver) {
        let id = BodyId::new(70, 3);
        let driving = AuthorityGrant {
            stream: StreamId(9),
            tick: Tick::new(100),
            bodies: alloc::vec![(id, at(0.0, 0.0))],
        };
        let driver = UpstreamSender::new(&driving, TOLERANCE, INTEGRATOR, parameters);
        let driven = UpstreamReceiver::new(&driving, TOLERANCE, INTEGRATOR, parameters);
        (driver, driven)
    }

    /// Where the server has the body at a tick.
    fn placed(driven: &mut UpstreamReceiver, tick: Tick) -> Option<Motion> {
        let mut motions = driven.motions(tick);
        motions.next().map(|(id, motion)| {
            assert_eq!(id, BodyId::new(70, 3));
            motion
        })
    }

    proptest! {
        /// `lost` and `late` say what becomes of each packet; the driver leads by `lead` ticks.
        #[test]
        fn bodies_known_in_time_are_within_tolerance(
            fates in proptest::collection::vec((0_u8..10, 0_u64..6), 600), lead in 0_u64..12
        ) {
            let (mut driver, mut driven) = ends();
            let mut under_way: Vec<(u64, Bytes)> = Vec::new();
            let mut fates = fates.into_iter();
            let (mut said, mut asked): (Vec<Bytes>, Vec<Bytes>) = Default::default();
            let mut sure = 0;
            for step in 1..240_u64 {
                let tick = Tick::new(100 + step);
                let now = Instant::from_nanos(step * 16_666_667);
                let ahead = step + lead;
                let told = driver.publish(Tick::new(100 + ahead), &[(BodyId::new(70, 3), walk(ahead))], &mut said);
                prop_assert_eq!(told, PublishOutcome::Yes);
                for question in asked.drain(..) {
                    driver.handle_datagram(now, Span::from_millis(30), &opened(&question), &mut said);
                }
                for packet in said.drain(..) {
                    let (fate, way) = fates.next().unwrap_or((9, 0));
                    if fate > 1 {
                        under_way.push((step + way, packet));
                    }
                }
                under_way.retain(|(due, packet)| {
                    let is_due = *due <= step;
                    if is_due {
                        driven.handle_datagram(&opened(packet));
                    }
                    !is_due
                });
                let placed = placed(&mut driven, tick).expect("it is there");
                if driven.is_complete_at(tick) && driven.watermark_tick() >= tick && step > lead {
                    let apart = Divergence::between(&walk(step).motion().pose(), &placed.pose());
                    let share = TOLERANCE.share(&apart, Metres::new(0.5));
                    prop_assert!(share <= 1.0, "off by {} at step {}", share, step);
                    sure += 1;
                }
                driven.ask(now, tick, &mut asked);
            }
            prop_assert!(lead < 8 || sure > 0);
            prop_assert_eq!(driven.statistics().mismatches, 0);
            prop_assert_eq!(driven.statistics().malformed, 0);
        }
    }

    #[test]
    fn a_wrong_track_ends_the_stream() {
        let (mut driver, mut driven) = ends();
        let (mut said, mut asked): (Vec<Bytes>, Vec<Bytes>) = Default::default();
        for step in 1..=200_u64 {
            let now = Instant::from_nanos(step * 16_666_667);
            let tick = Tick::new(100 + step);
            driver.publish(tick, &[(BodyId::new(70, 3), at(0.0, 0.0))], &mut said);
            if step == 20 {
                let wrong = Track::resting(tick, at(7.0, 0.0));
                let index = BodyId::new(0, 0);
                assert!(driven.receiver.subscriber_mut().place(
                    index,
                    &parameters(index).unwrap(),
                    wrong
                ));
            }
            for packet in said.drain(..) {
                driven.handle_datagram(&opened(&packet));
            }
            driven.ask(now, tick, &mut asked);
            for question in asked.drain(..) {
                driver.handle_datagram(now, Span::from_millis(30), &opened(&question), &mut said);
            }
        }
        assert_eq!(driven.statistics().mismatches, 1);
        assert!(driven.has_lost_sync());
    }

    #[test]
    fn bodies_of_a_silent_client_stop() {
        let (mut driver, mut driven) = ends();
        let mut said = Vec::new();
        for ahead in 1..=20_u64 {
            let motion = at(ahead as f32 / 60.0, 1.0);
            driver.publish(
                Tick::new(100 + ahead),
                &[(BodyId::new(70, 3), motion)],
                &mut said,
            );
        }
        for packet in said.drain(..) {
            driven.handle_datagram(&opened(&packet));
        }
        let last = driven.watermark_tick();
        let mut flown = 0;
        let mut before = placed(&mut driven, last).expect("it is there").pose();
        for ahead in 1..300 {
            let now = placed(&mut driven, last + Ticks::new(ahead)).expect("it is there");
            flown += u32::from(now.pose() != before);
            assert_eq!(
                driven.is_stale(last + Ticks::new(ahead)),
                now.twist() == rhumb_reckoning::Twist::ZERO
            );
            before = now.pose();
        }
        // As long as it was silent before, or four ticks, and a second.
        assert!((64..=80).contains(&flown), "{flown} ticks");
    }
}
