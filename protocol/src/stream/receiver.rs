//! The receiver of a stream: its subscriber, and when it reports.
//!
//! Reports losses, open or recovered by repair symbols, and overdue watermarks. Sans-IO. Used by a client for its
//! scene, by a server for an upstream, and by replays; each sets how long silence may last. Call order:
//! `subscriber_mut().handle`, `watch`, then `due` and `report`.

use alloc::vec::Vec;

use bytes::Bytes;

use super::nack_scheduler::NackScheduler;
use super::retry_timer::RetryTimer;
use super::subscriber::Subscriber;
use crate::endpoint::{Instant, Span, Wake, WakeReason};

/// The pause between reports of recovered losses. The sender adapts its redundancy to them.
const RESTORED_PAUSE: Span = Span::from_millis(500);
/// Added to the first timeout of a free-running stream before its silence is reported: its last packet may be lost.
/// Such a stream states its watermark at least every two and a half seconds.
const WATERMARK_TIMEOUT: Span = Span::from_millis(2_900);
/// The first timeout of a stream from which a datagram is expected.
const SILENCE: Span = Span::from_millis(100);
/// The longest pause between two reports to a stream that stays silent.
pub(crate) const SILENCE_MOST: Span = Span::from_millis(2_000);

/// The receiving end of one stream.
#[derive(Debug)]
pub struct StreamReceiver {
    subscriber: Subscriber,
    nacks: NackScheduler,
    silence: RetryTimer,
    /// The time of the last report of losses, and their number then.
    reported: (Instant, u64),
    /// The time of the last query.
    queried: Option<Instant>,
}

impl StreamReceiver {
    /// A receiver for a subscriber to a scene's stream.
    #[must_use]
    pub const fn new(subscriber: Subscriber) -> Self {
        Self::with_timeout(subscriber, SILENCE)
    }

    /// A receiver with another first timeout of a silent stream.
    pub(crate) const fn with_timeout(subscriber: Subscriber, silence: Span) -> Self {
        Self {
            subscriber,
            nacks: NackScheduler::new(),
            silence: RetryTimer::new(silence, SILENCE_MOST),
            reported: (Instant::ZERO, 0),
            queried: None,
        }
    }

    /// The subscriber that the receiver reports for.
    #[must_use]
    pub const fn subscriber(&self) -> &Subscriber {
        &self.subscriber
    }

    /// The subscriber, for applying datagrams and scene events.
    pub const fn subscriber_mut(&mut self) -> &mut Subscriber {
        &mut self.subscriber
    }

    /// Updates the retry timers after anything was received.
    pub fn watch(&mut self, now: Instant) {
        self.nacks.watch(now, &self.subscriber);
    }

    /// Ends the timeout of silence after a datagram arrived.
    pub(crate) fn end_silence(&mut self) {
        self.silence.end();
    }

    /// Starts the timeout of silence, unless it runs: `span`, and the first timeout at least.
    pub(crate) fn expect_within(&mut self, now: Instant, span: Span) {
        self.silence.begin_for(now, span);
    }

    /// Restarts the timeout after a datagram. The next one arrives at the latest with the watermark of a free-running
    /// stream.
    pub fn expect_watermark(&mut self, now: Instant) {
        self.silence.end();
        self.silence.begin(now + WATERMARK_TIMEOUT);
    }

    /// Appends a report that asks for the watermark, unless one was sent within `pause` (PROTOCOL 6.7-11).
    pub(crate) fn query(&mut self, now: Instant, pause: Span, out: &mut Vec<Bytes>) {
        if self.queried.is_some_and(|last| now < last + pause) {
            return;
        }
        self.queried = Some(now);
        let report = self.subscriber.loss_report();
        out.push(Bytes::from(report.encode(self.subscriber.stream())));
    }

    /// The time of the next report if nothing is received until then; None if there is nothing to report.
    #[must_use]
    pub fn due(&self) -> Option<Wake> {
        let restored = self.restored_due();
        let losses = [self.nacks.due(), restored];
        let losses = losses.into_iter().flatten().min();
        let wakes = [
            (losses, WakeReason::Refresh),
            (self.silence.due(), WakeReason::Watermark),
        ];
        let wakes = wakes
            .into_iter()
            .filter_map(|(at, reason)| at.map(|at| Wake { at, reason }));
        wakes.min_by_key(|wake| wake.at)
    }

    /// The time of the next report of recovered losses.
    fn restored_due(&self) -> Option<Instant> {
        let (at, lost) = self.reported;
        let news = self.subscriber.missing() == 0 && self.subscriber.lost() != lost;
        news.then(|| at + RESTORED_PAUSE)
    }

    /// Appends the reports that are due. A report of the same losses follows at least `min_delay` later.
    pub fn report(&mut self, now: Instant, min_delay: Span, out: &mut Vec<Bytes>) {
        let stream = self.subscriber.stream();
        let lost = self.nacks.poll(now, min_delay);
        let restored = self.restored_due().is_some_and(|due| due <= now);
        let report = if self.silence.fire(now, min_delay) || restored {
            Some(self.subscriber.loss_report())
        } else {
            (!lost.is_empty()).then(|| self.subscriber.loss_report_for(&lost))
        };
        if let Some(report) = report {
            self.reported = (now, self.subscriber.lost());
            out.push(Bytes::from(report.encode(stream)));
        }
    }
}

#[cfg(test)]
mod tests {
    use rhumb_reckoning::Tick;

    use super::*;
    use crate::packet::{Datagram, LossReport, Low16, PacketKind, StreamId, Watermark};
    use crate::stream::stream_config::StreamConfig;

    const STREAM: StreamId = StreamId(3);
    const DELAY: Span = Span::from_millis(50);

    fn at(ms: u64) -> Instant {
        Instant::ZERO + Span::from_millis(ms)
    }

    fn receiver() -> StreamReceiver {
        let mut subscriber = Subscriber::new(&StreamConfig::PLAIN.start(STREAM, Tick::ZERO));
        subscriber.handle_snapshot_end();
        StreamReceiver::new(subscriber)
    }

    /// Handles a watermark with this number of the next packet.
    fn handle_watermark(receiver: &mut StreamReceiver, now: Instant, next: u64) {
        let watermark = Watermark {
            next: Low16::of(next),
            tick: Low16(1),
            scene_events: Low16(0),
        };
        let subscriber = receiver.subscriber_mut();
        subscriber.handle_datagram(&watermark.encode(STREAM));
        receiver.watch(now);
        receiver.expect_watermark(now);
    }

    /// The report that is due now, if any.
    fn reported(receiver: &mut StreamReceiver, now: Instant) -> Option<LossReport> {
        let mut reports = Vec::new();
        receiver.report(now, DELAY, &mut reports);
        assert!(reports.len() < 2);
        let report = reports.pop()?;
        let report = Datagram::open(&report).expect("a receiver sends datagrams");
        assert_eq!(report.head().kind, PacketKind::LossReport);
        Some(LossReport::decode(report.body()).expect("it is a report"))
    }

    #[test]
    fn a_lost_packet_is_reported_at_once_and_again_after_the_delay() {
        let mut receiver = receiver();
        handle_watermark(&mut receiver, at(7), 2);
        let due = receiver.due().map(|wake| (wake.at, wake.reason));
        assert_eq!(due, Some((at(7), WakeReason::Refresh)));
        for (ms, lost) in [(7, Some(2)), (8, None), (56, None), (57, Some(2))] {
            let report = reported(&mut receiver, at(ms));
            assert_eq!(report.map(|report| report.lost.len()), lost, "{ms} ms");
        }
    }

    #[test]
    fn a_stream_without_watermark_is_queried_after_three_seconds() {
        let mut receiver = receiver();
        handle_watermark(&mut receiver, at(0), 0);
        for ms in [3_000, 3_200, 3_600, 4_400, 6_000, 8_000] {
            let due = receiver.due().map(|wake| (wake.at, wake.reason));
            assert_eq!(due, Some((at(ms), WakeReason::Watermark)));
            assert!(reported(&mut receiver, at(ms)).is_some());
        }
        handle_watermark(&mut receiver, at(8_100), 0);
        assert_eq!(receiver.due().map(|wake| wake.at), Some(at(11_100)));
    }
}
