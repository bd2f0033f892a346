//! The client's end of a replay: a receiver, and scene events under way.
//!
//! The receiver is the product's. The round trip is known, as if it had been measured.

use std::collections::VecDeque;
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::stream::{
    Budget, PredictionParameters, StreamReceiver, StreamStart, Subscriber,
};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Integrator, Tick, Tolerance, Track};

/// The change of a scene event.
#[derive(Clone, Debug)]
pub(super) enum PendingEvent {
    Placed(BodyId, PredictionParameters, Track),
    Removed(BodyId),
}

/// The client's end.
#[derive(Debug)]
pub(super) struct ReplayClient {
    pub(super) receiver: StreamReceiver,
    /// The changes of scene events under way, in order.
    pub(super) pending: VecDeque<PendingEvent>,
    /// Pause between two reports of one loss.
    min_delay: Span,
}

/// What both ends of a replay know before it begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct StreamSetup {
    pub(super) stream: StreamId,
    pub(super) tolerance: Tolerance,
    pub(super) integrator: Integrator,
    pub(super) gravity: Vec3,
    pub(super) publish_interval: NonZeroU32,
}

impl ReplayClient {
    /// `budget`: of a stream that has one.
    pub(super) fn new(start: &StreamSetup, round_trip: Span, budget: Option<Budget>) -> Self {
        let begin = match budget {
            Some(_) => Subscriber::limited,
            None => Subscriber::new,
        };
        let subscriber = begin(&StreamStart {
            stream: start.stream,
            tolerance: start.tolerance,
            integrator: start.integrator,
            publish_interval: start.publish_interval,
            gravity: start.gravity,
            tick: Tick::ZERO,
            next: 0,
            scene_events: 0,
        });
        let mut receiver = StreamReceiver::new(subscriber);
        receiver.expect_watermark(Instant::ZERO);
        Self {
            receiver,
            pending: VecDeque::new(),
            min_delay: Span::from_nanos(round_trip.as_nanos() * 5 / 4),
        }
    }

    /// The next scene event arrived; `false` when its change breaks a limit.
    #[must_use]
    pub(super) fn receive_event(&mut self, now: Instant) -> bool {
        let subscriber = self.receiver.subscriber_mut();
        let done = match self.pending.pop_front() {
            Some(PendingEvent::Placed(id, parameters, track)) => {
                subscriber.place(id, &parameters, track)
            }
            Some(PendingEvent::Removed(id)) => subscriber.remove(id),
            None => false,
        };
        subscriber.apply_scene_event();
        self.watch(now);
        done
    }

    /// A datagram arrived.
    pub(super) fn receive(&mut self, now: Instant, datagram: &[u8]) {
        self.receiver.subscriber_mut().handle_datagram(datagram);
        self.watch(now);
    }

    fn watch(&mut self, now: Instant) {
        self.receiver.watch(now);
        self.receiver.expect_watermark(now);
    }

    /// The copy.
    pub(super) const fn subscriber(&self) -> &Subscriber {
        self.receiver.subscriber()
    }

    /// When it reports next if nothing arrives until then; it always expects a watermark.
    pub(super) fn due(&self) -> Instant {
        self.receiver.due().map_or(Instant::ZERO, |wake| wake.at)
    }

    /// What it reports now.
    pub(super) fn report(&mut self, now: Instant) -> Vec<Bytes> {
        let mut reports = Vec::new();
        self.receiver.report(now, self.min_delay, &mut reports);
        reports
    }
}
