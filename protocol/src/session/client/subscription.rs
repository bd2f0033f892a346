//! A subscription: replicas of a member, and the requests that keep them live.
//!
//! Requests streams, reports losses, and asks for a new snapshot if a replica has lost sync. Sends by the outbox and
//! reports by events. Invariants: only one request that a snapshot answers is pending, so the member sends no request
//! while another one is unanswered (PROTOCOL 4.8-14); every choice is requested in the end, whatever the server does;
//! the shown replica never falls back to an earlier complete tick, unless it had lost sync.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{BodyId, Tick};

use super::outbox::ClientOutbox;
use crate::endpoint::{Instant, Span, Wake, WakeReason};
use crate::message::{
    CellNews, CellRequest, ClientMessage, Joined, ResyncCause, SceneEvent, StreamChoice,
};
use crate::packet::{Datagram, StreamId};
use crate::scene::Cell;
use crate::session::replica::Replica;
use crate::session::{CloseCode, Event};
use crate::stream::{RetryTimer, SILENCE_MOST, StreamReceiver};

/// The pause between two requests for a snapshot, unless the stream converged meanwhile. It doubles, so that snapshots
/// do not fill a link that is too weak for the scene.
const RESYNC_AGAIN: Span = Span::from_millis(1_000);
/// The longest pause between two requests for a snapshot.
const RESYNC_MOST: Span = Span::from_millis(16_000);

/// The replicas of one membership, and what was requested for them.
#[derive(Debug)]
pub(super) struct Subscription {
    /// The cell that it is about; `None`: the scene, or what of it is in no cell.
    cell: Option<Cell>,
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
        Self::about(None)
    }

    /// The same of a cell.
    pub(super) fn of_cell(cell: Cell) -> Self {
        Self::about(Some(cell))
    }

    fn about(cell: Option<Cell>) -> Self {
        Self {
            cell,
            replica_switch: ReplicaSwitch {
                until: cell.map(|_| Tick::ZERO),
                ..ReplicaSwitch::new()
            },
            stream_selection: StreamSelection::new(),
            awaited: Tick::ZERO,
            response_times: ResponseTimes::new(),
            resyncing: false,
            resync_timer: RetryTimer::new(Span::ZERO, RESYNC_MOST),
        }
    }

    /// Makes replicas that an edge speaks from.
    pub(super) const fn relay(&mut self) {
        self.replica_switch.relays = true;
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

    /// Notes the end of a snapshot: the next request may be sent.
    pub(super) fn end_resync(&mut self, outbox: &mut ClientOutbox) {
        self.resyncing = false;
        self.request_stream(outbox);
    }

    /// Notes that the server denied a stream.
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
        self.replica_switch
            .apply(|replica| replica.apply_scene_event(scene_event))
    }

    /// Applies the news of a cell to its replicas; returns the bodies that it is about, by their ids in the scene, unless
    /// it is part of a snapshot. What comes before the first snapshot is of an earlier subscription.
    pub(super) fn handle_cell_news(
        &mut self,
        news: &CellNews,
        shapes: &Replica,
    ) -> Result<Vec<BodyId>, CloseCode> {
        if self.newest().is_none() {
            return Ok(Vec::new());
        }
        let apply = |replica: &mut Replica| replica.apply_cell_news(news, shapes);
        let target = self.replica_switch.apply(apply)?;
        let bodies = match news {
            CellNews::Placed { id, .. } => return Ok(bodies_of(target, [*id])),
            CellNews::SceneEvent(SceneEvent::BodyRemoved { id, .. }) => core::slice::from_ref(id),
            CellNews::SceneEvent(
                SceneEvent::PublisherSilent { bodies, .. }
                | SceneEvent::PublisherActive { bodies, .. },
            ) => bodies,
            _ => &[],
        };
        let newest = self.newest().into_iter();
        let named =
            newest.flat_map(|replica| bodies.iter().filter_map(|id| replica.id_in_scene(*id)));
        Ok(bodies_of(target, named))
    }

    /// Shows no replica that begins after this tick.
    pub(super) const fn show_until(&mut self, tick: Tick) {
        self.replica_switch.until = Some(tick);
    }

    /// The streams of its replicas; the last is that of the shown one, if one is shown.
    pub(super) fn streams(&self) -> impl Iterator<Item = StreamId> {
        let replicas = [&self.replica_switch.next, &self.replica_switch.shown];
        let replicas = replicas.into_iter().flatten();
        replicas.map(|replica| replica.stream().stream())
    }

    /// True while a replica waits to be shown.
    pub(super) const fn is_switching(&self) -> bool {
        self.replica_switch.next.is_some()
    }

    /// True if a datagram is of one of its streams.
    pub(super) fn follows(&self, stream: StreamId) -> bool {
        self.replica_switch.follows(stream)
    }

    /// Applies a datagram; returns the watermark of the shown replica if it rose.
    pub(super) fn handle_datagram(&mut self, datagram: &Datagram<'_>) -> Option<Tick> {
        let before = self.watermark_tick();
        self.replica_switch.handle_datagram(datagram);
        let after = self.watermark_tick();
        after.filter(|_| after != before)
    }

    /// Shows a replica that has caught up and restarts the timers. Called after each received message and datagram.
    pub(super) fn update(
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
            receiver.update_timers(now);
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
            self.send(CellRequest::Resync(cause), outbox);
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
            self.update(now, outbox, events);
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

    /// The replica of the newest stream, whether it is complete or not.
    pub(super) fn newest(&self) -> Option<&Replica> {
        self.replica_switch.newest()
    }

    /// The stream that is requested, while the answer is pending.
    pub(super) const fn requested(&self) -> Option<StreamChoice> {
        self.stream_selection.requested
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
    pub(super) const fn awaits_snapshot(&self) -> bool {
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
            self.send(CellRequest::Subscribe(choice), outbox);
        }
    }

    /// Shows the next replica if it has caught up, and reports the change of subscription. A client that selects
    /// another stream meanwhile skips the one between; the server stops sending that stream.
    fn switch_replica(&mut self, outbox: &mut ClientOutbox, events: &mut VecDeque<Event>) {
        let shown = self.replica_switch.shown();
        let is_live = shown.is_some_and(|replica| !replica.stream().has_lost_sync());
        // A cell with an ended stream would hold up the ticks of all: what is between is not shown even in place of a lost one.
        if self.stream_selection.awaits_answer() && (is_live || self.cell.is_some()) {
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
        self.send(CellRequest::Subscribed(stream), outbox);
    }

    /// Sends a request about the cell, or about the scene.
    pub(super) fn send(&self, request: CellRequest, outbox: &mut ClientOutbox) {
        let message = match (self.cell, request) {
            (Some(cell), request) => ClientMessage::OfCell { cell, request },
            (None, CellRequest::Subscribe(choice)) => ClientMessage::Subscribe(choice),
            (None, CellRequest::Subscribed(stream)) => ClientMessage::Subscribed(stream),
            (None, CellRequest::Resync(cause)) => ClientMessage::Resync(cause),
            (None, CellRequest::Leave) => ClientMessage::Leave,
        };
        outbox.send(&message);
    }
}

/// The bodies of a scene event; none of one that is part of a snapshot.
fn bodies_of(target: EventTarget, bodies: impl IntoIterator<Item = BodyId>) -> Vec<BodyId> {
    match target {
        EventTarget::Snapshot => Vec::new(),
        EventTarget::Scene => bodies.into_iter().collect(),
    }
}

/// The requested stream and the choice that follows it.
#[derive(Clone, Copy, Debug)]
struct StreamSelection {
    /// The stream requested last, while the answer is pending.
    requested: Option<StreamChoice>,
    /// The stream to request next.
    wanted: Option<StreamChoice>,
    /// The stream to which the server moves the member. Its snapshot comes next, before that of a requested stream.
    moved: Option<StreamChoice>,
    pending_replica: PendingReplica,
}

/// The reason of a replica that is not shown yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PendingReplica {
    /// No such replica exists, or it follows the present stream.
    Nothing,
    /// The member requested this stream.
    Requested(StreamChoice),
    /// The server moves the member to this stream.
    TierChanged,
}

impl StreamSelection {
    /// No choice and no pending request.
    const fn new() -> Self {
        Self {
            requested: None,
            wanted: None,
            moved: None,
            pending_replica: PendingReplica::Nothing,
        }
    }

    /// Selects a stream in place of any earlier choice.
    fn select(&mut self, choice: StreamChoice) {
        let is_pending = match self.requested {
            Some(requested) => requested == choice,
            None => self.pending_replica == PendingReplica::Requested(choice),
        };
        self.wanted = (!is_pending).then_some(choice);
    }

    /// The stream to request now, if any.
    const fn take_request(&mut self) -> Option<StreamChoice> {
        if self.requested.is_some() {
            return None;
        }
        self.requested = self.wanted.take();
        self.requested
    }

    /// True if a request is unanswered.
    const fn awaits_answer(&self) -> bool {
        self.requested.is_some()
    }

    /// Notes that the server moves the member to another stream.
    const fn handle_tier_changed(&mut self, to: StreamChoice) {
        self.moved = Some(to);
    }

    /// Notes the start of a snapshot: an answer, a move, or the present stream again.
    fn handle_joined(&mut self, choice: StreamChoice) {
        if self.moved.take() == Some(choice) {
            self.pending_replica = PendingReplica::TierChanged;
        } else if self.requested == Some(choice) {
            self.requested = None;
            self.pending_replica = PendingReplica::Requested(choice);
        }
    }

    /// Notes that the server denied the request.
    const fn handle_denied(&mut self) {
        self.requested = None;
    }

    /// True if the replica now shown is an answer or a move rather than a resync.
    fn take_subscription_change(&mut self) -> bool {
        core::mem::replace(&mut self.pending_replica, PendingReplica::Nothing)
            != PendingReplica::Nothing
    }
}

/// The latest response times. A tick that takes long to step is not reported as lost.
#[derive(Clone, Copy, Debug)]
struct ResponseTimes {
    /// The tick being timed and the time of its request.
    pending: Option<(Tick, Instant)>,
    /// The last two response times. The shorter one counts, because a loss may have lengthened the other.
    response_times: [Span; 2],
}

impl ResponseTimes {
    const fn new() -> Self {
        Self {
            pending: None,
            response_times: [Span::ZERO; 2],
        }
    }

    /// Starts timing a requested tick, unless another one is being timed.
    fn note_requested(&mut self, now: Instant, tick: Tick) {
        self.pending.get_or_insert((tick, now));
    }

    /// Notes that all ticks up to this one are complete.
    fn note_complete(&mut self, now: Instant, complete: Tick) {
        if let Some((_, at)) = self.pending.take_if(|(tick, _)| *tick <= complete) {
            self.response_times = [now.since(at), self.response_times[0]];
        }
    }

    /// The timeout for the next tick: twice the shorter of the last two response times, at most `most`.
    fn timeout(&self, most: Span) -> Span {
        let [last, before] = self.response_times;
        Span::from_nanos(last.min(before).as_nanos() * 2).min(most)
    }
}

/// The replicas of one membership.
#[derive(Debug, Default)]
struct ReplicaSwitch {
    shown: Option<Replica>,
    /// The replica that a snapshot is filling, or a complete one that has not caught up with the shown one.
    next: Option<Replica>,
    /// True for an edge: see `Subscriber::keep_relayed_packets`.
    relays: bool,
    /// Of a cell: the tick up to which all cells are complete. A replica that begins later, or after what a view shows, is
    /// not shown yet.
    until: Option<Tick>,
}

/// The part of the protocol to which a scene event belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EventTarget {
    /// The event is part of a snapshot.
    Snapshot,
    /// The event reports a change of the scene.
    Scene,
}

impl ReplicaSwitch {
    const fn new() -> Self {
        Self {
            shown: None,
            next: None,
            relays: false,
            until: None,
        }
    }

    /// The replica that the application displays.
    const fn shown(&self) -> Option<&Replica> {
        self.shown.as_ref()
    }

    /// See [`Self::shown`].
    const fn shown_mut(&mut self) -> Option<&mut Replica> {
        self.shown.as_mut()
    }

    /// Starts a replica that the following snapshot fills.
    fn begin(&mut self, joined: &Joined) {
        let mut replica = Replica::new(joined);
        if self.relays {
            replica.stream_mut().keep_relayed_packets();
        }
        if self.until.is_some() {
            replica.stream_mut().expect_view();
        }
        self.next = Some(replica);
    }

    /// Completes the snapshot. The first replica of a membership is shown at once.
    fn end_snapshot(&mut self) -> Result<(), CloseCode> {
        let filling = self.next.as_mut().filter(|replica| !replica.is_complete());
        filling.ok_or(CloseCode::VIOLATION)?.end_snapshot();
        if self.shown.is_none() {
            self.shown = self.next.take();
        }
        Ok(())
    }

    /// Shows the next replica if it has caught up, so that the display has no gap. An edge displays nothing, and speaks
    /// from the newest snapshot. Returns the replaced replica.
    fn switch_when_caught_up(&mut self) -> Option<Replica> {
        let relays = self.relays;
        let shown = self.shown.as_mut()?;
        let until = self.until;
        let is_late = |next: &Replica| {
            let (stream, start) = (shown.stream(), next.stream().start());
            let is_due = until.is_none_or(|until| stream.is_shown_from(start, until));
            !is_due && !stream.has_lost_sync()
        };
        let as_far = |next: &mut Replica| {
            let is_due = relays || next.has_caught_up_with(shown) && !is_late(next);
            next.is_complete() && is_due
        };
        let mut next = self.next.take_if(as_far)?;
        next.take_over(shown);
        Some(core::mem::replace(shown, next))
    }

    /// Applies a scene event to the next replica, and to the shown one unless a snapshot is being filled.
    fn apply(
        &mut self,
        apply: impl Fn(&mut Replica) -> Result<(), CloseCode>,
    ) -> Result<EventTarget, CloseCode> {
        if let Some(next) = &mut self.next {
            let filling = !next.is_complete();
            apply(next)?;
            if filling {
                return Ok(EventTarget::Snapshot);
            }
        }
        apply(self.shown.as_mut().ok_or(CloseCode::VIOLATION)?)?;
        Ok(EventTarget::Scene)
    }

    /// True if a replica follows a stream.
    fn follows(&self, stream: StreamId) -> bool {
        let mut replicas = [&self.next, &self.shown].into_iter().flatten();
        replicas.any(|replica| replica.stream().stream() == stream)
    }

    /// Hands a datagram to the replicas that follow its stream.
    fn handle_datagram(&mut self, datagram: &Datagram<'_>) {
        for replica in [&mut self.next, &mut self.shown].into_iter().flatten() {
            if replica.stream().stream() == datagram.head().stream {
                replica.stream_mut().handle(datagram);
            }
        }
    }

    /// The receivers of complete replicas, the shown one first.
    fn receivers(&self) -> impl Iterator<Item = &StreamReceiver> {
        let replicas = [self.shown.as_ref(), self.next.as_ref()];
        let complete = replicas
            .into_iter()
            .flatten()
            .filter(|replica| replica.is_complete());
        complete.map(|replica| &replica.receiver)
    }

    /// See [`Self::receivers`].
    fn receivers_mut(&mut self) -> impl Iterator<Item = &mut StreamReceiver> {
        let replicas = [self.shown.as_mut(), self.next.as_mut()];
        let complete = replicas
            .into_iter()
            .flatten()
            .filter(|replica| replica.is_complete());
        complete.map(|replica| &mut replica.receiver)
    }

    /// The reports due now.
    fn report(&mut self, now: Instant, min_delay: Span) -> Vec<Bytes> {
        let mut reports = Vec::new();
        for receiver in self.receivers_mut() {
            receiver.report(now, min_delay, &mut reports);
        }
        reports
    }

    /// A report that asks for the watermark of the shown replica, if one is due.
    fn query(&mut self, now: Instant, pause: Span) -> Vec<Bytes> {
        let mut reports = Vec::new();
        if let Some(replica) = &mut self.shown {
            replica.receiver.query(now, pause, &mut reports);
        }
        reports
    }

    /// The replica of the newest stream, which will replace the shown one.
    fn newest(&self) -> Option<&Replica> {
        self.next.as_ref().or(self.shown.as_ref())
    }

    /// True if only a new snapshot helps.
    fn have_lost_sync(&self) -> bool {
        self.newest()
            .is_some_and(|replica| replica.stream().has_lost_sync())
    }

    /// The cause to give if a new snapshot is requested.
    fn resync_cause(&self) -> ResyncCause {
        if self
            .newest()
            .is_some_and(|replica| replica.stream().has_mismatched())
        {
            ResyncCause::ChecksumMismatch
        } else {
            ResyncCause::LostSync
        }
    }
}

#[cfg(test)]
mod tests {
    use rhumb_reckoning::Tolerance;

    use super::*;

    const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);
    const FINE: StreamChoice = StreamChoice::Within(Tolerance::FINE);
    const FULL: StreamChoice = StreamChoice::Full;

    /// A selection with this request pending.
    fn with_request(choice: StreamChoice) -> StreamSelection {
        let mut stream_selection = StreamSelection::new();
        stream_selection.select(choice);
        assert_eq!(stream_selection.take_request(), Some(choice));
        stream_selection
    }

    #[test]
    fn the_newest_request_is_sent_after_the_pending_one_is_answered() {
        let mut stream_selection = with_request(EXACT);
        stream_selection.select(FULL);
        stream_selection.select(FINE);
        assert_eq!(stream_selection.take_request(), None);
        stream_selection.handle_joined(EXACT);
        assert_eq!(stream_selection.take_request(), Some(FINE));
        stream_selection.handle_denied();
        assert_eq!(stream_selection.take_request(), None);
        assert!(!stream_selection.awaits_answer());
    }

    #[test]
    fn a_pending_stream_is_not_requested_again() {
        let mut stream_selection = with_request(EXACT);
        stream_selection.select(FINE);
        stream_selection.select(EXACT);
        stream_selection.handle_joined(EXACT);
        assert_eq!(stream_selection.take_request(), None);
        stream_selection.select(EXACT);
        assert_eq!(stream_selection.take_request(), None);
        assert!(stream_selection.take_subscription_change());
        stream_selection.select(EXACT);
        assert_eq!(stream_selection.take_request(), Some(EXACT));
    }

    #[test]
    fn a_tier_change_answers_no_pending_request() {
        let mut stream_selection = with_request(FINE);
        stream_selection.handle_tier_changed(FINE);
        stream_selection.handle_joined(FINE);
        assert!(
            stream_selection.awaits_answer(),
            "the snapshot of a move answers no request"
        );
        stream_selection.handle_joined(FINE);
        assert!(!stream_selection.awaits_answer());
        // The member requests its own choice even if the server already moves it to that stream.
        stream_selection.handle_tier_changed(EXACT);
        stream_selection.handle_joined(EXACT);
        stream_selection.select(EXACT);
        assert_eq!(stream_selection.take_request(), Some(EXACT));
    }

    #[test]
    fn a_resync_snapshot_is_no_subscription_change() {
        let mut stream_selection = StreamSelection::new();
        stream_selection.handle_joined(FINE);
        assert!(!stream_selection.take_subscription_change());
        let mut stream_selection = with_request(EXACT);
        stream_selection.handle_joined(FINE);
        assert!(stream_selection.awaits_answer() && !stream_selection.take_subscription_change());
        stream_selection.handle_joined(EXACT);
        stream_selection.handle_joined(EXACT);
        assert!(stream_selection.take_subscription_change());
    }

    const MOST: Span = Span::from_millis(2_000);

    /// Requests some ticks in turn; each takes the given number of milliseconds.
    fn after(response_times: &[u64]) -> ResponseTimes {
        let (mut answers, mut now) = (ResponseTimes::new(), Instant::ZERO);
        for (tick, millis) in (1..).map(Tick::new).zip(response_times) {
            answers.note_requested(now, tick);
            now = now + Span::from_millis(*millis);
            answers.note_complete(now, tick);
        }
        answers
    }

    #[test]
    fn the_timeout_is_twice_the_quicker_of_the_last_two() {
        let timeout = |response_times: &[u64]| after(response_times).timeout(MOST);
        assert_eq!(timeout(&[]), Span::ZERO);
        assert_eq!(timeout(&[300]), Span::ZERO);
        assert_eq!(timeout(&[300, 200]), Span::from_millis(400));
        assert_eq!(timeout(&[300, 30]), Span::from_millis(60));
        assert_eq!(timeout(&[30, 300]), Span::from_millis(60));
        assert_eq!(timeout(&[3_000, 3_000]), MOST);
    }

    #[test]
    fn a_tick_is_timed_from_its_first_request_to_completion() {
        let mut answers = after(&[10, 10]);
        let start = Instant::ZERO;
        answers.note_requested(start, Tick::new(7));
        answers.note_requested(start + Span::from_millis(50), Tick::new(8));
        answers.note_complete(start + Span::from_millis(60), Tick::new(6));
        assert_eq!(answers.timeout(MOST), Span::from_millis(20));
        answers.note_complete(start + Span::from_millis(80), Tick::new(8));
        answers.note_requested(start, Tick::new(9));
        answers.note_complete(start + Span::from_millis(90), Tick::new(9));
        assert_eq!(answers.timeout(MOST), Span::from_millis(160));
    }
}
