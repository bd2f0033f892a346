//! The client's end of a replay: a subscriber, and when it asks for repair.
//!
//! Asks as PROTOCOL 6.7 has it, and as the client's session does. The round trip is known, as if it had been measured.

use std::collections::VecDeque;
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::session::Asking;
use rhumb_protocol::stream::{Budget, Manner, StreamStart, Subscriber};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Integrator, Tick, Tolerance, Track};

/// A change that a notice tells of.
#[derive(Clone, Debug)]
pub(super) enum Change {
    Placed(BodyId, Manner, Track),
    Removed(BodyId),
}

/// How often it tells what it lost, where parities gave that back.
const REPORT: Span = Span::from_millis(500);
/// How long the stream may be silent before it is asked.
const SILENCE: Span = Span::from_millis(3_000);

/// The client's end.
#[derive(Debug)]
pub(super) struct Listener {
    pub(super) subscriber: Subscriber,
    /// What notices under way will say, in order.
    pub(super) told: VecDeque<Change>,
    asking: Asking,
    silence: Instant,
    round_trip: Span,
    /// When it said last what it lost, and how much that was.
    reported: (Instant, u64),
}

/// What both ends of a replay know before it begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    pub(super) stream: StreamId,
    pub(super) tolerance: Tolerance,
    pub(super) integrator: Integrator,
    pub(super) gravity: Vec3,
    pub(super) every: NonZeroU32,
}

impl Listener {
    /// `budget`: of a stream that has one.
    pub(super) fn new(start: &Start, round_trip: Span, budget: Option<Budget>) -> Self {
        let begin = match budget {
            Some(_) => Subscriber::limited,
            None => Subscriber::new,
        };
        Self {
            subscriber: begin(&StreamStart {
                stream: start.stream,
                tolerance: start.tolerance,
                integrator: start.integrator,
                every: start.every,
                gravity: start.gravity,
                tick: Tick::ZERO,
                next: 0,
                notices: 0,
            }),
            told: VecDeque::new(),
            asking: Asking::default(),
            silence: Instant::ZERO + SILENCE,
            round_trip,
            reported: (Instant::ZERO, 0),
        }
    }

    /// The next notice arrived; `false` when what it says breaks a limit.
    #[must_use]
    pub(super) fn hear_notice(&mut self, now: Instant) -> bool {
        let done = match self.told.pop_front() {
            Some(Change::Placed(id, manner, track)) => self.subscriber.place(id, &manner, track),
            Some(Change::Removed(id)) => self.subscriber.remove(id),
            None => false,
        };
        self.subscriber.handle_notice();
        self.watch(now);
        done
    }

    /// A datagram arrived.
    pub(super) fn hear(&mut self, now: Instant, datagram: &[u8]) {
        self.subscriber.handle_datagram(datagram);
        self.watch(now);
    }

    fn watch(&mut self, now: Instant) {
        self.silence = now + SILENCE;
        self.asking.watch(now, &self.subscriber);
    }

    /// When it asks next if it hears nothing until then.
    pub(super) fn due(&self) -> Instant {
        let lost = self.asking.due();
        lost.map_or(self.silence, |at| at.min(self.silence))
    }

    /// What it asks now, if it is time to.
    pub(super) fn ask(&mut self, now: Instant) -> Option<Bytes> {
        let (at, told) = self.reported;
        let whole = self.subscriber.missing() == 0;
        let reports = whole && self.subscriber.lost() > told && now >= at + REPORT;
        let silent = self.silence <= now;
        let patient = Span::from_nanos(self.round_trip.as_nanos() / 4 * 5);
        let lost: Vec<u64> = self.asking.ask(now, patient).collect();
        if lost.is_empty() && !reports && !silent {
            return None;
        }
        self.reported = (now, self.subscriber.lost());
        let echo = if silent {
            self.silence = now + SILENCE;
            self.subscriber.echo()
        } else {
            self.subscriber.echo_for(&lost)
        };
        Some(Bytes::from(echo.encode(self.subscriber.stream())))
    }
}
