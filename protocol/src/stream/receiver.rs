//! The receiver of a stream: its subscriber, and when it reports.
//!
//! Reports losses, open or recovered by repair symbols, and overdue watermarks. Sans-IO. Used by a client for its
//! scene, by a server for an upstream, and by replays; each sets how long silence may last. Call order:
//! `subscriber_mut().handle`, `update_timers`, then `due` and `report`. Every missing packet has a timer of its own with
//! pauses that grow while nothing is answered; only missing packets take memory.

use alloc::vec::Vec;

use bytes::Bytes;

use super::subscriber::Subscriber;
use crate::endpoint::{Instant, Span, Wake, WakeReason};
use crate::limits::LOST_NUMBERS_MAX;

/// The pause between reports of recovered losses. The sender adapts its redundancy to them.
const RESTORED_PAUSE: Span = Span::from_millis(500);
/// Added to the first timeout of a free-running stream before its silence is reported: its last packet may be lost.
/// Such a stream states its watermark at least every two and a half seconds.
const WATERMARK_TIMEOUT: Span = Span::from_millis(2_900);
/// The first timeout of a stream from which a datagram is expected.
const SILENCE: Span = Span::from_millis(100);
/// The longest pause between two reports to a stream that stays silent.
pub(crate) const SILENCE_MOST: Span = Span::from_millis(2_000);
/// The same of a stream that owes a watermark, whose silence means a dead link. QUIC's own pauses double without an end
/// meanwhile: the first report and the first answer that arrive make both ends send again at once what they hold back.
const DEAD_LINK_MOST: Span = Span::from_millis(500);

/// The receiving end of one stream.
#[derive(Debug)]
pub struct StreamReceiver {
    subscriber: Subscriber,
    nacks: NackScheduler,
    silence: RetryTimer,
    /// True if the timeout is that of datagrams that wait for scene events.
    waits: bool,
    /// The number of datagrams that had come when the timeout began.
    arrived: u64,
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
            waits: false,
            arrived: 0,
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
    pub fn update_timers(&mut self, now: Instant) {
        self.nacks.update(now, &self.subscriber);
    }

    /// Ends the timeout of silence after a datagram arrived.
    pub(crate) fn end_silence(&mut self) {
        self.silence.end();
    }

    /// Starts the timeout of silence, unless it runs: `span`, and the first timeout at least.
    pub(crate) fn expect_within(&mut self, now: Instant, span: Span) {
        self.silence.limit(SILENCE_MOST);
        self.silence.begin_for(now, span);
    }

    /// Restarts the timeout after a datagram; nothing else that arrives restarts it. The next one arrives at the latest
    /// with the watermark of a free-running stream. A datagram that waits for scene events is no news: the timeout is
    /// then shorter, and no other such datagram restarts it.
    pub fn expect_watermark(&mut self, now: Instant) {
        let waits = self.subscriber.waits_for_scene_events();
        let arrived = self.subscriber.arrived();
        let is_news = !waits && arrived != self.arrived;
        if self.silence.due().is_some() && waits == self.waits && !is_news {
            return;
        }
        self.waits = waits;
        self.arrived = arrived;
        self.silence.end();
        self.silence.limit(DEAD_LINK_MOST);
        match waits {
            true => self.silence.begin_for(now, DEAD_LINK_MOST),
            false => self.silence.begin(now + WATERMARK_TIMEOUT),
        }
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

/// Delay of a report, because packets may be reordered: the age at which a gap counts as a loss on a link that has
/// reordered packets. On other links it is a loss at once.
pub(crate) const DISORDER: Span = Span::from_millis(4);
/// The longest pause between two reports of one packet.
const WAIT_MOST: Span = Span::from_millis(500);

/// The missing packets of one stream and their timers.
#[derive(Clone, Debug)]
struct NackScheduler {
    /// In rising order of number.
    open: Vec<(u64, RetryTimer)>,
    /// The earliest time of the next report, because the last one had no place for more packets.
    paused_until: Instant,
    /// Parts of refreshes that had come at the last update.
    refreshes: u64,
}

impl NackScheduler {
    /// A scheduler without missing packets.
    const fn new() -> Self {
        Self {
            open: Vec::new(),
            paused_until: Instant::ZERO,
            refreshes: 0,
        }
    }

    /// Starts timers for packets that are newly missing, and drops those of packets that are no longer missing.
    fn update(&mut self, now: Instant, stream: &Subscriber) {
        let in_order = stream.statistics().disordered == 0;
        let allowed = if in_order { Span::ZERO } else { DISORDER };
        let filled = self.wait_for(now, allowed, stream.missing_packets());
        let refreshes = stream.statistics().refreshes;
        if filled || refreshes != self.refreshes {
            self.begin_anew(now);
        }
        self.refreshes = refreshes;
    }

    /// Sets the missing packets, in rising order of number. Returns whether one is no longer missing.
    fn wait_for(
        &mut self,
        now: Instant,
        allowed: Span,
        missing: impl Iterator<Item = u64>,
    ) -> bool {
        let before = core::mem::take(&mut self.open);
        let (count, mut kept) = (before.len(), 0);
        let mut before = before.into_iter().peekable();
        self.open.extend(missing.map(|number| {
            while before.next_if(|(other, _)| *other < number).is_some() {}
            let mut timer = match before.next_if(|(other, _)| *other == number) {
                Some((_, timer)) => {
                    kept += 1;
                    timer
                }
                None => RetryTimer::new(allowed, WAIT_MOST),
            };
            timer.begin(now);
            (number, timer)
        }));
        kept < count
    }

    /// Begins the longest pauses anew: what arrived tells that the link carries answers (PROTOCOL 6.7-1).
    fn begin_anew(&mut self, now: Instant) {
        for (_, timer) in &mut self.open {
            timer.begin_anew(now);
        }
    }

    /// The time of the next report.
    fn due(&self) -> Option<Instant> {
        let due = self.open.iter().filter_map(|(_, timer)| timer.due()).min();
        due.map(|due| due.max(self.paused_until))
    }

    /// The packets to report now, in rising order, as many as a report holds. The pause until the next report of each
    /// is `min_delay` at least, and never zero, even before a round trip is measured. More packets follow after a pause
    /// in which the sender answers no report.
    fn poll(&mut self, now: Instant, min_delay: Span) -> Vec<u64> {
        if now < self.paused_until {
            return Vec::new();
        }
        let min_delay = min_delay.max(DISORDER);
        let open = self.open.iter_mut();
        let due = open.filter_map(|(number, timer)| timer.fire(now, min_delay).then_some(*number));
        let reported: Vec<u64> = due.take(LOST_NUMBERS_MAX).collect();
        if reported.len() == LOST_NUMBERS_MAX {
            self.paused_until = now + DISORDER;
        }
        reported
    }
}

/// The timer of one message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RetryTimer {
    due: Option<Instant>,
    span: Span,
    least: Span,
    most: Span,
    /// When the message was due last, and the shortest pause after that.
    fired: Option<(Instant, Span)>,
}

impl RetryTimer {
    /// A timer with a first pause of `least`; later pauses are at most `most`.
    pub(crate) const fn new(least: Span, most: Span) -> Self {
        Self {
            due: None,
            span: least,
            least,
            most,
            fired: None,
        }
    }

    /// The time at which the message is due again; None while the timer is stopped.
    pub(crate) const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Starts, unless it runs already.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.begin_for(now, Span::ZERO);
    }

    /// Starts as [`Self::begin`], with a first pause of at least this span; later pauses double it.
    fn begin_for(&mut self, now: Instant, span: Span) {
        if self.due.is_none() {
            self.span = self.span.max(span);
            self.due = Some(now + self.span);
        }
    }

    /// Sets the longest pause anew.
    const fn limit(&mut self, most: Span) {
        self.most = most;
    }

    /// Stops: the message is answered, or needs no answer.
    pub(crate) fn end(&mut self) {
        self.due = None;
        self.span = self.least;
        self.fired = None;
    }

    /// Begins pauses that have grown to the longest one anew: the message is due again after the shortest one, and is
    /// then the first. Shorter ones grow on, so that answers on a full link do not make more of them.
    fn begin_anew(&mut self, now: Instant) {
        if self.span < self.most {
            return;
        }
        if let (Some(due), Some((at, pause))) = (self.due, self.fired) {
            self.due = Some(due.min(now.max(at + pause)));
            self.span = self.least;
        }
    }

    /// True if the message is due; the next pause is then twice as long, and at least `round_trip`.
    pub(crate) fn fire(&mut self, now: Instant, round_trip: Span) -> bool {
        if self.due.is_none_or(|due| due > now) {
            return false;
        }
        let doubled = Span::from_nanos(self.span.as_nanos() * 2);
        self.span = doubled.max(round_trip).min(self.most);
        self.due = Some(now + self.span);
        self.fired = Some((now, round_trip.min(self.most)));
        true
    }
}

#[cfg(test)]
mod tests {
    mod receiver {
        use rhumb_reckoning::Tick;

        use super::super::*;
        use crate::packet::{Datagram, LossReport, Low16, PacketKind, StreamId, Watermark};
        use crate::stream::StreamConfig;

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
            handle_watermark_after(receiver, now, next, 0);
        }

        /// The same after some scene events.
        fn handle_watermark_after(
            receiver: &mut StreamReceiver,
            now: Instant,
            next: u64,
            scene_events: u64,
        ) {
            let watermark = Watermark {
                next: Low16::of(next),
                tick: Low16(1),
                scene_events: Low16::of(scene_events),
            };
            let subscriber = receiver.subscriber_mut();
            subscriber.handle_datagram(&watermark.encode(STREAM));
            receiver.update_timers(now);
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
            // Anything else that arrives changes nothing.
            receiver.expect_watermark(at(1_000));
            for ms in [3_000, 3_200, 3_600, 4_100, 4_600, 5_100] {
                let due = receiver.due().map(|wake| (wake.at, wake.reason));
                assert_eq!(due, Some((at(ms), WakeReason::Watermark)));
                assert!(reported(&mut receiver, at(ms)).is_some());
            }
            handle_watermark(&mut receiver, at(8_100), 0);
            assert_eq!(receiver.due().map(|wake| wake.at), Some(at(11_100)));
        }

        #[test]
        fn datagrams_that_wait_for_scene_events_are_reported_twice_a_second_until_these_arrive() {
            let mut receiver = receiver();
            handle_watermark(&mut receiver, at(0), 0);
            // The stream continues, but what it waits for is held back.
            for ms in [40, 100, 300] {
                handle_watermark_after(&mut receiver, at(ms), 0, 1);
            }
            for ms in [540, 1_040, 1_540] {
                assert_eq!(receiver.due().map(|wake| wake.at), Some(at(ms)));
                assert!(reported(&mut receiver, at(ms)).is_some());
                handle_watermark_after(&mut receiver, at(ms + 50), 0, 1);
            }
            receiver.subscriber_mut().apply_scene_event();
            receiver.expect_watermark(at(1_700));
            assert_eq!(receiver.due().map(|wake| wake.at), Some(at(4_700)));
        }
    }

    mod nack_scheduler {
        use super::super::*;

        fn at(ms: u64) -> Instant {
            Instant::ZERO + Span::from_millis(ms)
        }

        #[test]
        fn no_packet_is_requested_twice_at_zero_round_trip() {
            let mut scheduler = NackScheduler::new();
            for now in [at(0), at(4), at(12)] {
                scheduler.wait_for(now, Span::ZERO, [3].into_iter());
                assert_eq!(scheduler.poll(now, Span::ZERO), [3]);
                assert!(scheduler.poll(now, Span::ZERO).is_empty());
            }
            assert_eq!(scheduler.due(), Some(at(28)));
        }

        #[test]
        fn each_lost_packet_has_its_own_timer() {
            let min_delay = Span::from_millis(125);
            let mut scheduler = NackScheduler::new();
            scheduler.wait_for(at(0), DISORDER, [3].into_iter());
            assert_eq!(scheduler.due(), Some(at(4)));
            assert!(scheduler.poll(at(3), min_delay).is_empty());
            assert_eq!(scheduler.poll(at(4), min_delay), [3]);
            scheduler.wait_for(at(20), DISORDER, [3, 7, 9].into_iter());
            assert_eq!(scheduler.due(), Some(at(24)));
            assert_eq!(scheduler.poll(at(24), min_delay), [7, 9]);
            assert_eq!(scheduler.due(), Some(at(129)));
            // Packets 3 and 9 arrived; packet 7 is requested again after its own pause.
            scheduler.wait_for(at(129), DISORDER, [7].into_iter());
            assert_eq!(scheduler.due(), Some(at(149)));
            assert_eq!(scheduler.poll(at(149), min_delay), [7]);
            assert_eq!(scheduler.due(), Some(at(149 + 250)));
            scheduler.wait_for(at(150), DISORDER, [].into_iter());
            assert_eq!(scheduler.due(), None);
            scheduler.wait_for(at(160), Span::ZERO, [12].into_iter());
            assert_eq!(scheduler.poll(at(160), min_delay), [12]);
        }

        /// The times in milliseconds at which a packet is reported; another one arrives at these times.
        fn reports_of_one(answers: &[u64]) -> Vec<u64> {
            let mut scheduler = NackScheduler::new();
            let mut reports = Vec::new();
            for ms in 0..=2_000 {
                // Each answer fills a gap behind the packet.
                let others = answers.iter().filter(|answer| **answer > ms);
                let missing = [3].into_iter().chain(others.map(|answer| 10 + answer));
                if scheduler.wait_for(at(ms), Span::ZERO, missing) {
                    scheduler.begin_anew(at(ms));
                }
                let due = scheduler.due();
                let reported = scheduler.poll(at(ms), Span::from_millis(100));
                assert_eq!(due.is_some_and(|due| due <= at(ms)), !reported.is_empty());
                reports.extend(reported.contains(&3).then_some(ms));
            }
            reports
        }

        #[test]
        fn an_answer_begins_the_longest_pauses_of_all_missing_packets_anew() {
            let unanswered = [0, 100, 300, 700, 1_200, 1_700];
            assert_eq!(reports_of_one(&[]), unanswered);
            // A pause that has not grown to the longest one grows on.
            assert_eq!(reports_of_one(&[320]), unanswered);
            // A round trip after the last report, then in pauses that double again.
            let anew = [0, 100, 300, 700, 800, 900, 1_100, 1_500, 2_000];
            assert_eq!(reports_of_one(&[720]), anew);
            // After a longer pause than that, at once.
            let at_once = [0, 100, 300, 700, 1_000, 1_100, 1_300, 1_700];
            assert_eq!(reports_of_one(&[1_000]), at_once);
        }

        #[test]
        fn no_number_of_answers_ends_the_pauses() {
            // One at each millisecond.
            let answers: Vec<u64> = (1..=2_000).collect();
            let expected = [
                0, 100, 300, 700, 800, 900, 1_100, 1_500, 1_600, 1_700, 1_900,
            ];
            assert_eq!(reports_of_one(&answers), expected);
        }

        #[test]
        fn many_lost_packets_are_reported_at_once_in_several_reports() {
            let mut scheduler = NackScheduler::new();
            scheduler.wait_for(at(0), Span::ZERO, 0..150);
            for (ms, count) in [(0, 64), (4, 64), (8, 22), (12, 0)] {
                let due = scheduler.due().filter(|due| *due <= at(ms));
                assert_eq!(due.is_some(), count > 0, "{ms} ms");
                let reported = scheduler.poll(at(ms), Span::from_millis(100));
                assert_eq!(reported.len(), count, "{ms} ms");
            }
            assert_eq!(scheduler.due(), Some(at(100)));
        }
    }

    mod retry_timer {
        use super::super::*;

        #[test]
        fn a_longer_first_timeout_doubles_too() {
            let mut timer = RetryTimer::new(Span::from_millis(5), Span::from_millis(70));
            let mut now = Instant::ZERO;
            timer.begin_for(now, Span::from_millis(20));
            for millis in [20, 40, 70] {
                let due = timer.due().unwrap();
                assert_eq!(due, now + Span::from_millis(millis));
                now = due;
                assert!(timer.fire(now, Span::ZERO));
            }
            timer.end();
            timer.begin_for(now, Span::from_millis(1));
            assert_eq!(timer.due(), Some(now + Span::from_millis(5)));
        }

        #[test]
        fn retries_back_off_until_answered() {
            let mut timer = RetryTimer::new(Span::from_millis(5), Span::from_millis(40));
            let mut now = Instant::ZERO;
            timer.begin(now);
            let mut spans = [0; 5];
            for span in &mut spans {
                let due = timer.due().unwrap();
                *span = due.since(now).as_nanos() / 1_000_000;
                assert!(!timer.fire(now, Span::ZERO));
                now = due;
                assert!(timer.fire(now, Span::from_millis(15)));
            }
            assert_eq!(spans, [5, 15, 30, 40, 40]);
            timer.end();
            assert_eq!(timer.due(), None);
            timer.begin(now);
            assert_eq!(timer.due(), Some(now + Span::from_millis(5)));
        }
    }
}
