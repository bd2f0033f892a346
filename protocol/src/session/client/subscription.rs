//! A subscription: replicas of a member, and the requests that keep them live.
//!
//! Requests streams, reports losses, and asks for a new snapshot if a replica has lost sync. Sends by the outbox and
//! reports by events. Invariant: only one request that a snapshot answers is pending.

use alloc::collections::VecDeque;

use rhumb_reckoning::Tick;

use super::outbox::ClientOutbox;
use super::response_times::ResponseTimes;
use super::stream_selection::StreamSelection;
use crate::endpoint::{Instant, Span, Wake, WakeReason};
use crate::message::{ClientMessage, Joined, ResyncCause, SceneEvent, StreamChoice};
use crate::packet::Datagram;
use crate::session::close::CloseCode;
use crate::session::event::Event;
use crate::session::replica::Replica;
use crate::session::replica_switch::{EventTarget, ReplicaSwitch};
use crate::stream::{RetryTimer, SILENCE_MOST, StreamReceiver};

/// The pause between two requests for a snapshot, unless the stream converged meanwhile. It doubles, so that snapshots
/// do not fill a link that is too weak for the scene.
const RESYNC_AGAIN: Span = Span::from_millis(1_000);
/// The longest pause between two requests for a snapshot.
const RESYNC_MOST: Span = Span::from_millis(16_000);

/// The replicas of one membership, and what was requested for them.
#[derive(Debug)]
pub(super) struct Subscription {
    replica_switch: ReplicaSwitch,
    stream_selection: StreamSelection,
    /// The tick requested last.
    awaited: Tick,
    response_times: ResponseTimes,
    /// True while a new snapshot of the present stream is requested.
    resyncing: bool,
    resync_timer: RetryTimer,
}

impl Subscription {
    /// A subscription before the first snapshot.
    pub(super) fn new() -> Self {
        Self {
            replica_switch: ReplicaSwitch::new(),
            stream_selection: StreamSelection::new(),
            awaited: Tick::ZERO,
            response_times: ResponseTimes::new(),
            resyncing: false,
            resync_timer: RetryTimer::new(Span::ZERO, RESYNC_MOST),
        }
    }

    /// Selects another stream in place of any earlier choice.
    pub(super) fn select(&mut self, choice: StreamChoice, outbox: &mut ClientOutbox) {
        self.stream_selection.select(choice);
        self.request_stream(outbox);
    }

    /// Awaits a tick that is requested now.
    pub(super) fn advance(&mut self, now: Instant, to: Tick) {
        if !self.awaits() {
            // With no request pending, the receiver measured silence; the answer now has its own timeout.
            self.replica_switch
                .receivers_mut()
                .for_each(StreamReceiver::end_silence);
        }
        self.await_also(to);
        self.response_times.note_requested(now, to);
        self.await_tick(now);
    }

    /// Awaits a tick that was requested over another connection.
    pub(super) fn await_also(&mut self, to: Tick) {
        self.awaited = self.awaited.max(to);
    }

    /// Begins the replica that the following snapshot fills.
    pub(super) fn begin_snapshot(&mut self, joined: &Joined, outbox: &mut ClientOutbox) {
        self.replica_switch.begin(joined);
        self.stream_selection.handle_joined(joined.choice);
        self.request_stream(outbox);
    }

    /// Completes the snapshot.
    pub(super) fn end_snapshot(&mut self) -> Result<(), CloseCode> {
        self.replica_switch.end_snapshot()
    }

    /// Goes on after a snapshot: the next request may be sent.
    pub(super) fn end_resync(&mut self, outbox: &mut ClientOutbox) {
        self.resyncing = false;
        self.request_stream(outbox);
    }

    /// Goes on after the server denied a stream.
    pub(super) fn handle_denied(&mut self, outbox: &mut ClientOutbox) {
        self.stream_selection.handle_denied();
        self.request_stream(outbox);
    }

    /// Notes that the server moves the member to another stream.
    pub(super) const fn handle_tier_changed(&mut self, to: StreamChoice) {
        self.stream_selection.handle_tier_changed(to);
    }

    /// Applies a scene event to the replicas.
    pub(super) fn handle_scene_event(
        &mut self,
        scene_event: &SceneEvent,
    ) -> Result<EventTarget, CloseCode> {
        self.replica_switch.handle_scene_event(scene_event)
    }

    /// Applies a datagram; returns the watermark of the shown replica if it rose.
    pub(super) fn handle_datagram(&mut self, datagram: &Datagram<'_>) -> Option<Tick> {
        let before = self.watermark_tick();
        self.replica_switch.handle_datagram(datagram);
        let after = self.watermark_tick();
        after.filter(|_| after != before)
    }

    /// Shows a replica that has caught up and restarts the timers. Called after each received message and datagram.
    pub(super) fn watch(
        &mut self,
        now: Instant,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) {
        self.switch_replica(outbox, events);
        let Some(replica) = self.replica_switch.shown() else {
            return;
        };
        self.response_times
            .note_complete(now, replica.stream().complete());
        let (converged, awaits) = (replica.stream().is_converged(), self.awaits());
        for receiver in self.replica_switch.receivers_mut() {
            receiver.watch(now);
            if awaits {
                receiver.end_silence();
            } else {
                receiver.expect_watermark(now);
            }
        }
        let lost_sync = self.replica_switch.have_lost_sync();
        if lost_sync {
            self.resync_timer.begin(now);
        } else if converged {
            self.resync_timer.end();
        }
        if lost_sync && !self.awaits_snapshot() && self.resync_timer.fire(now, RESYNC_AGAIN) {
            self.resyncing = true;
            let cause = self.replica_switch.resync_cause();
            if cause == ResyncCause::ChecksumMismatch {
                events.push_back(Event::ChecksumMismatch);
            }
            outbox.send(&ClientMessage::Resync(cause));
        }
        if awaits {
            self.await_tick(now);
        }
    }

    /// Sends the reports due now.
    pub(super) fn report(
        &mut self,
        now: Instant,
        round_trip: Span,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) {
        let min_delay = Span::from_nanos(round_trip.as_nanos() * 5 / 4);
        outbox.send_states(self.replica_switch.report(now, min_delay));
        if self.resync_due().is_some_and(|due| due <= now) {
            self.watch(now, outbox, events);
        }
    }

    /// Asks for the watermark of the shown replica, unless it was asked for within `pause`.
    pub(super) fn query(&mut self, now: Instant, pause: Span, outbox: &mut ClientOutbox) {
        outbox.send_states(self.replica_switch.query(now, pause));
    }

    /// The next moment at which [`Self::report`] has something to do.
    pub(super) fn due(&self) -> Option<Wake> {
        let resync = self.resync_due().map(|at| Wake {
            at,
            reason: WakeReason::Refresh,
        });
        let receivers = self.replica_switch.receivers();
        let due = receivers.filter_map(StreamReceiver::due).chain(resync);
        due.min_by_key(|wake| wake.at)
    }

    /// The replica that the application displays; None until its snapshot is complete.
    pub(super) const fn shown(&self) -> Option<&Replica> {
        self.replica_switch.shown()
    }

    /// See [`Self::shown`].
    pub(super) const fn shown_mut(&mut self) -> Option<&mut Replica> {
        self.replica_switch.shown_mut()
    }

    fn watermark_tick(&self) -> Option<Tick> {
        let shown = self.replica_switch.shown();
        shown.map(|replica| replica.stream().watermark_tick())
    }

    /// True if a tick requested by `advance` is not complete yet.
    fn awaits(&self) -> bool {
        let shown = self.replica_switch.shown();
        shown.is_some_and(|replica| replica.stream().complete() < self.awaited)
    }

    /// Starts the timeout for a requested tick. The latest response times decide its length.
    fn await_tick(&mut self, now: Instant) {
        let timeout = self.response_times.timeout(SILENCE_MOST);
        for receiver in self.replica_switch.receivers_mut() {
            receiver.expect_within(now, timeout);
        }
    }

    /// True if a requested snapshot is pending, of the present stream or of another one.
    const fn awaits_snapshot(&self) -> bool {
        self.resyncing || self.stream_selection.awaits_answer()
    }

    /// The time of the next request for a snapshot; None if the replica has not lost sync.
    fn resync_due(&self) -> Option<Instant> {
        let due = self.resync_timer.due()?;
        (self.replica_switch.have_lost_sync() && !self.awaits_snapshot()).then_some(due)
    }

    /// Requests the selected stream, unless an answer or a snapshot that could be mistaken for its answer is pending.
    fn request_stream(&mut self, outbox: &mut ClientOutbox) {
        if !self.resyncing
            && let Some(choice) = self.stream_selection.take_request()
        {
            outbox.send(&ClientMessage::Subscribe(choice));
        }
    }

    /// Shows the next replica if it has caught up, and reports the change of subscription. A client that selects
    /// another stream meanwhile skips the one between; the server sends that stream no more.
    fn switch_replica(&mut self, outbox: &mut ClientOutbox, events: &mut VecDeque<Event>) {
        let shown = self.replica_switch.shown();
        let is_live = shown.is_some_and(|replica| !replica.stream().has_lost_sync());
        if self.stream_selection.awaits_answer() && is_live {
            return;
        }
        let Some(before) = self.replica_switch.switch_when_caught_up() else {
            return;
        };
        let Some(replica) = self.replica_switch.shown() else {
            return;
        };
        let (choice, stream) = (replica.choice(), replica.stream().stream());
        if self.stream_selection.take_subscription_change() || before.choice() != choice {
            events.push_back(Event::SubscriptionChanged(choice));
        }
        outbox.send(&ClientMessage::Subscribed(stream));
    }
}
