//! Client of a replay: a receiver, and the scene events in transit.
//!
//! The receiver is the product's. The round trip is a known constant instead of a measurement.

use std::collections::VecDeque;
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::stream::{
    Budget, PredictionParameters, StreamReceiver, StreamStart, Subscriber,
};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Integrator, Tick, Tolerance, Track};

/// Change by a scene event in transit.
#[derive(Clone, Debug)]
pub(super) enum PendingEvent {
    Placed(BodyId, PredictionParameters, Track),
    Removed(BodyId),
}

/// Client of a replay.
#[derive(Debug)]
pub(super) struct ReplayClient {
    pub(super) receiver: StreamReceiver,
    /// The changes by scene events in transit, in order.
    pub(super) pending: VecDeque<PendingEvent>,
    /// Least time between two reports of one loss.
    min_delay: Span,
}

/// Configuration that both ends of a replay know at its start.
#[derive(Clone, Copy, Debug)]
pub(super) struct StreamSetup {
    pub(super) stream: StreamId,
    pub(super) tolerance: Tolerance,
    pub(super) integrator: Integrator,
    pub(super) gravity: Vec3,
    pub(super) publish_interval: NonZeroU32,
    pub(super) largest_packet: LargestPacket,
}

impl ReplayClient {
    /// `budget`: the budget of a capped stream.
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
            largest_packet: start.largest_packet,
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

    /// Applies the next scene event; `false` when its change breaks a limit.
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

    /// Handles a received datagram.
    pub(super) fn receive(&mut self, now: Instant, datagram: &[u8]) {
        self.receiver.subscriber_mut().handle_datagram(datagram);
        self.watch(now);
    }

    fn watch(&mut self, now: Instant) {
        self.receiver.update_timers(now);
        self.receiver.expect_watermark(now);
    }

    /// The copy.
    pub(super) const fn subscriber(&self) -> &Subscriber {
        self.receiver.subscriber()
    }

    /// Time of the next report if nothing arrives before. There always is one, because a watermark is expected.
    pub(super) fn due(&self) -> Instant {
        self.receiver.due().map_or(Instant::ZERO, |wake| wake.at)
    }

    /// The loss reports that are due now.
    pub(super) fn report(&mut self, now: Instant) -> Vec<Bytes> {
        let mut reports = Vec::new();
        self.receiver.report(now, self.min_delay, &mut reports);
        reports
    }
}
