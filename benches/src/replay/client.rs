//! The client's end of a replay: a subscriber, and when it asks for refresh.
//!
//! Asks as PROTOCOL 6.7 has it, and as the client's session does. The round trip is known, as if it had been measured.

use std::collections::VecDeque;
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::session::NackScheduler;
use rhumb_protocol::stream::{Budget, PredictionParameters, StreamStart, Subscriber};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Integrator, Tick, Tolerance, Track};

/// A change that a scene_event tells of.
#[derive(Clone, Debug)]
pub(super) enum PendingEvent {
    Placed(BodyId, PredictionParameters, Track),
    Removed(BodyId),
}

/// How often it tells what it lost, where repair_symbols gave that back.
const REPORT: Span = Span::from_millis(500);
/// How long the stream may be silent before it is asked.
const SILENCE: Span = Span::from_millis(3_000);

/// The client's end.
#[derive(Debug)]
pub(super) struct ReplayClient {
    pub(super) subscriber: Subscriber,
    /// What scene_events under way will say, in order.
    pub(super) pending: VecDeque<PendingEvent>,
    nacks: NackScheduler,
    silence: Instant,
    round_trip: Span,
    /// When it said last what it lost, and how much that was.
    reported: (Instant, u64),
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
        Self {
            subscriber: begin(&StreamStart {
                stream: start.stream,
                tolerance: start.tolerance,
                integrator: start.integrator,
                publish_interval: start.publish_interval,
                gravity: start.gravity,
                tick: Tick::ZERO,
                next: 0,
                scene_events: 0,
            }),
            pending: VecDeque::new(),
            nacks: NackScheduler::default(),
            silence: Instant::ZERO + SILENCE,
            round_trip,
            reported: (Instant::ZERO, 0),
        }
    }

    /// The next scene_event arrived; `false` when what it says breaks a limit.
    #[must_use]
    pub(super) fn receive_event(&mut self, now: Instant) -> bool {
        let done = match self.pending.pop_front() {
            Some(PendingEvent::Placed(id, parameters, track)) => {
                self.subscriber.place(id, &parameters, track)
            }
            Some(PendingEvent::Removed(id)) => self.subscriber.remove(id),
            None => false,
        };
        self.subscriber.apply_scene_event();
        self.watch(now);
        done
    }

    /// A datagram arrived.
    pub(super) fn receive(&mut self, now: Instant, datagram: &[u8]) {
        self.subscriber.handle_datagram(datagram);
        self.watch(now);
    }

    fn watch(&mut self, now: Instant) {
        self.silence = now + SILENCE;
        self.nacks.watch(now, &self.subscriber);
    }

    /// When it asks next if it hears nothing until then.
    pub(super) fn due(&self) -> Instant {
        let lost = self.nacks.due();
        lost.map_or(self.silence, |at| at.min(self.silence))
    }

    /// What it asks now, if it is time to.
    pub(super) fn ask(&mut self, now: Instant) -> Option<Bytes> {
        let (at, lost_before) = self.reported;
        let whole = self.subscriber.missing() == 0;
        let reports = whole && self.subscriber.lost() > lost_before && now >= at + REPORT;
        let silent = self.silence <= now;
        let patient = Span::from_nanos(self.round_trip.as_nanos() / 4 * 5);
        let lost: Vec<u64> = self.nacks.ask(now, patient).collect();
        if lost.is_empty() && !reports && !silent {
            return None;
        }
        self.reported = (now, self.subscriber.lost());
        let report = if silent {
            self.silence = now + SILENCE;
            self.subscriber.loss_report()
        } else {
            self.subscriber.loss_report_for(&lost)
        };
        Some(Bytes::from(report.encode(self.subscriber.stream())))
    }
}
