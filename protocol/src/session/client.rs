//! The client's end of a connection: commands, scene replica, refresh.
//!
//! Does not wait and does not display. Call order: feed `handle_*`, then drain `poll_event` and `poll_transmit`, then
//! ask `poll_timeout`. After an `Ended` event nothing more happens.

mod body_events;
mod clock;
mod greeting;
mod reconnection;
mod recovery;
mod response_times;
mod resumption;
mod stream_selection;
mod timeouts;
mod upstream;
mod upstream_state;

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::Tick;

use self::body_events::HeldEvents;
use self::response_times::ResponseTimes;
use self::resumption::Resumption;
use self::stream_selection::StreamSelection;
use self::timeouts::RESYNC_MOST;
use super::close::CloseCode;
use super::event::Event;
use super::misuse::Misuse;
use super::pings::Pings;
use super::replica::Replica;
use super::replica_switch::{EventTarget, ReplicaSwitch};
use crate::endpoint::{Ending, Endpoint, Peer, Transmit, Wake, WakeReason};
use crate::limits::RESERVE_MAX;
use crate::message::{
    ClientMessage, Denial, Frames, Joined, SceneEvent, ServerMessage, StreamChoice, TierPolicy,
    Token,
};
use crate::packet::Datagram;
use crate::scene::{Command, IdRange, Query, SceneConfig, SceneName};
use crate::stream::{RetryTimer, StreamReceiver};
use crate::time::{Instant, Span};
use upstream_state::UpstreamState;

/// The state of the connection as the client knows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ClientState {
    Unconnected,
    Greeting,
    Lobby,
    Member,
    Ended,
}

/// The client's end of one connection.
#[derive(Debug)]
pub struct ClientSession {
    state: ClientState,
    peer: Peer,
    scene: SceneName,
    token: Option<Token>,
    config: Option<SceneConfig>,
    frames: Frames,
    replica_switch: ReplicaSwitch,
    stream_selection: StreamSelection,
    granted: IdRange,
    upstream_state: UpstreamState,
    commands: u64,
    resumption: Resumption,
    queries: u64,
    held_events: HeldEvents,
    awaited: Tick,
    response_times: ResponseTimes,
    resyncing: bool,
    resync_timer: RetryTimer,
    pings: Pings,
    round_trip: Span,
    unsent: Vec<u8>,
    out: VecDeque<Transmit>,
    events: VecDeque<Event>,
}

impl ClientSession {
    /// A session for a scene, before the connection opens.
    #[must_use]
    pub fn new(scene: SceneName) -> Self {
        Self {
            state: ClientState::Unconnected,
            peer: Peer(0),
            scene,
            token: None,
            config: None,
            frames: Frames::new(),
            replica_switch: ReplicaSwitch::new(),
            stream_selection: StreamSelection::new(),
            granted: IdRange::EMPTY,
            upstream_state: UpstreamState::new(),
            commands: 0,
            resumption: Resumption::default(),
            queries: 0,
            held_events: HeldEvents::new(),
            awaited: Tick::ZERO,
            response_times: ResponseTimes::new(),
            resyncing: false,
            resync_timer: RetryTimer::new(Span::ZERO, RESYNC_MOST),
            pings: Pings::new(),
            round_trip: Span::from_millis(20),
            unsent: Vec::new(),
            out: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    /// Has the `Hello` carry a token.
    pub fn set_token(&mut self, token: Token) {
        self.token = Some(token);
    }

    /// Ends the membership; answered by `Left`.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] unless the client is a member. The methods below return the same error.
    pub fn leave(&mut self) -> Result<(), Misuse> {
        self.as_member(&ClientMessage::Leave)
    }

    /// Deletes the scene for all members; answered by `Deleted` or `Denied`.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] before the welcome.
    pub fn delete(&mut self) -> Result<(), Misuse> {
        if self.state != ClientState::Member {
            self.must_be(ClientState::Lobby)?;
        }
        self.send(&ClientMessage::Delete);
        Ok(())
    }

    /// Requests more body indices; answered by `Reserved` or `Denied`.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], and [`Misuse::Indices`] for zero or more than [`RESERVE_MAX`]; nothing is sent then.
    pub fn reserve(&mut self, count: u32) -> Result<(), Misuse> {
        if count == 0 || count > RESERVE_MAX {
            return Err(Misuse::Indices(count));
        }
        self.as_member(&ClientMessage::Reserve { count })
    }

    /// Queues a command; returns the number that its answer will name. Between two connections of a session it waits
    /// for the second.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], and [`Misuse::Invalid`] for a number out of range; nothing is sent then.
    pub fn command(&mut self, command: Command) -> Result<u64, Misuse> {
        command.check().map_err(Misuse::Invalid)?;
        let resuming = self.is_resuming();
        if !resuming {
            self.must_be(ClientState::Member)?;
        }
        self.resumption.note_command(self.commands, &command);
        if !resuming {
            self.send(&ClientMessage::Command(command));
        }
        self.commands += 1;
        Ok(self.commands - 1)
    }

    /// Asks where bodies are; returns the number that the answer, a `QueryResult`, will name.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], [`Misuse::Invalid`] for a number out of range, and [`Misuse::Queries`] for no query or too
    /// many; nothing is sent then.
    pub fn query(&mut self, queries: Vec<Query>) -> Result<u64, Misuse> {
        Query::total_cost(&queries).ok_or(Misuse::Queries)?;
        for query in &queries {
            query.check().map_err(Misuse::Invalid)?;
        }
        self.as_member(&ClientMessage::Query(queries))?;
        self.queries += 1;
        Ok(self.queries - 1)
    }

    /// Lets the scene step to a tick. The stream answers with a watermark at that tick or later.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`].
    pub fn advance(&mut self, now: Instant, to: Tick) -> Result<(), Misuse> {
        if self.is_resuming() {
            self.resumption.note_advance(to);
            return Ok(());
        }
        self.as_member(&ClientMessage::Advance { to })?;
        self.resumption.note_advance(to);
        if !self.awaits() {
            // With no request pending, the receiver measured silence; the answer now has its own timeout.
            self.replica_switch
                .receivers_mut()
                .for_each(StreamReceiver::end_silence);
        }
        self.awaited = self.awaited.max(to);
        self.response_times.note_requested(now, to);
        self.await_tick(now);
        Ok(())
    }

    /// Subscribes to another stream; answered by `SubscriptionChanged` or `Denied`.
    ///
    /// The replica keeps the present stream until the new one is complete. Over a bad link a full stream may never
    /// become complete; a later choice then replaces this one, and only the last choice counts. `TierChanged` reports
    /// that the server moves the member to another stream because the link does not carry this one. The application may
    /// answer that with another choice.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`].
    pub fn subscribe(&mut self, choice: StreamChoice) -> Result<(), Misuse> {
        self.must_be(ClientState::Member)?;
        self.stream_selection.select(choice);
        self.request_stream();
        Ok(())
    }

    /// Sets the streams that the server may move this member to over a weak link. Default: down to coarse (20 cm).
    ///
    /// # Errors
    ///
    /// As [`Self::leave`].
    pub fn set_tier_policy(&mut self, tier_policy: TierPolicy) -> Result<(), Misuse> {
        self.as_member(&ClientMessage::TierPolicy(tier_policy))
    }

    /// Requests a description of the scene's state; answered by `Inspected`.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`].
    pub fn inspect(&mut self) -> Result<(), Misuse> {
        self.as_member(&ClientMessage::Inspect)
    }

    /// Ends the session and closes the connection with `code`.
    pub fn close(&mut self, code: CloseCode) {
        if matches!(self.state, ClientState::Unconnected | ClientState::Ended) {
            return;
        }
        self.flush();
        self.out.push_back(Transmit::Close {
            to: self.peer,
            code: code.0,
        });
        self.state = ClientState::Ended;
        self.events.push_back(Event::Ended(Ending::Closed(code.0)));
    }

    /// The replica of the scene; None until its snapshot is complete.
    #[must_use]
    pub const fn replica(&self) -> Option<&Replica> {
        self.replica_switch.shown()
    }

    /// The replica, for draining its changes.
    pub const fn replica_mut(&mut self) -> Option<&mut Replica> {
        self.replica_switch.shown_mut()
    }

    /// The config of the scene; None before the welcome or joining.
    #[must_use]
    pub const fn config(&self) -> Option<&SceneConfig> {
        self.config.as_ref()
    }

    /// The latest measured round trip.
    #[must_use]
    pub const fn round_trip(&self) -> Span {
        self.round_trip
    }

    /// The next event for the application, oldest first.
    pub fn poll_event(&mut self) -> Option<Event> {
        if let Some(replica) = self.replica_switch.shown() {
            self.held_events
                .release(replica.stream().complete(), &mut self.events);
        }
        self.events.pop_front()
    }

    fn must_be(&self, state: ClientState) -> Result<(), Misuse> {
        if self.state == state {
            Ok(())
        } else {
            Err(Misuse::NotNow)
        }
    }

    fn as_member(&mut self, message: &ClientMessage) -> Result<(), Misuse> {
        self.must_be(ClientState::Member)?;
        self.send(message);
        Ok(())
    }

    fn send(&mut self, message: &ClientMessage) {
        message.encode(&mut self.unsent);
    }

    fn flush(&mut self) {
        if !self.unsent.is_empty() {
            let bytes = Bytes::from(core::mem::take(&mut self.unsent));
            self.out.push_back(Transmit::Control {
                to: self.peer,
                bytes,
            });
        }
    }

    fn handle_message(&mut self, now: Instant, message: ServerMessage) -> Result<(), CloseCode> {
        match message {
            ServerMessage::Welcome(welcome) => self.handle_welcome(now, welcome)?,
            ServerMessage::Created => self.events.push_back(Event::Created),
            ServerMessage::Joined(joined) => self.begin_snapshot(&joined)?,
            ServerMessage::SnapshotEnd => self.end_snapshot(now)?,
            ServerMessage::Left => self.end_membership(Event::Left),
            ServerMessage::Deleted => self.end_membership(Event::Deleted),
            ServerMessage::Reserved(range) => self.events.push_back(Event::Reserved(range)),
            ServerMessage::Denied(denial) => {
                // Other denials answer requests that are not about streams.
                if matches!(denial, Denial::TooManyStreams | Denial::SceneFaulted) {
                    self.stream_selection.handle_denied();
                    self.request_stream();
                }
                self.events.push_back(Event::Denied(denial));
                if self.state == ClientState::Lobby && self.can_reconnect() {
                    // The scene of the session is gone.
                    return Err(CloseCode::DONE);
                }
            }
            ServerMessage::Applied { through, tick } => {
                self.resumption.note_applied(through, tick);
                self.events.push_back(Event::Applied { through, tick });
            }
            ServerMessage::Refused { number, error } => {
                self.events.push_back(Event::Refused { number, error });
            }
            ServerMessage::SceneEvent(scene_event) => self.handle_scene_event(&scene_event)?,
            ServerMessage::Pong {
                sent,
                tick,
                since_tick_ns,
            } => self.handle_pong(now, sent, tick, Span::from_nanos(since_tick_ns)),
            ServerMessage::Inspection(inspection) => {
                self.events.push_back(Event::Inspected(inspection));
            }
            ServerMessage::AuthorityGrant(upstream) => self.handle_authority_grant(&upstream),
            ServerMessage::AuthorityDenied(error) => self.handle_authority_denied(error),
            ServerMessage::TierChanged { to, cause } => {
                self.stream_selection.handle_tier_changed(to);
                self.events.push_back(Event::TierChanged { to, cause });
            }
            ServerMessage::Session(state) => self.handle_session(state)?,
            ServerMessage::Durable { commands, tick } => {
                self.resumption.finish(commands, tick);
                self.events.push_back(Event::Durable { commands, tick });
            }
            ServerMessage::QueryResult(result) => {
                self.events.push_back(Event::QueryResult(result));
            }
            ServerMessage::TickEvents(events) => self.held_events.push(events),
        }
        Ok(())
    }

    fn begin_snapshot(&mut self, joined: &Joined) -> Result<(), CloseCode> {
        if !matches!(self.state, ClientState::Lobby | ClientState::Member) {
            return Err(CloseCode::VIOLATION);
        }
        joined.config.check().map_err(|_| CloseCode::VIOLATION)?;
        if joined.extensions.has_unknown_critical() {
            return Err(CloseCode::EXTENSION);
        }
        self.config = Some(joined.config);
        self.granted = joined.granted;
        self.replica_switch.begin(joined);
        self.note_choice(joined.choice);
        self.stream_selection.handle_joined(joined.choice);
        self.request_stream();
        Ok(())
    }

    fn end_snapshot(&mut self, now: Instant) -> Result<(), CloseCode> {
        self.replica_switch.end_snapshot()?;
        if self.state != ClientState::Member {
            self.state = ClientState::Member;
            self.queries = 0;
            self.send(&ClientMessage::Ping { sent: now });
            self.pings.begin(now);
            if !self.resume() {
                self.commands = 0;
                self.events.push_back(Event::Joined(self.granted));
            }
        }
        self.resyncing = false;
        self.request_stream();
        self.watch(now);
        Ok(())
    }

    /// Requests the selected stream, unless an answer or a snapshot that could be mistaken for its answer is pending.
    fn request_stream(&mut self) {
        if !self.resyncing
            && let Some(choice) = self.stream_selection.take_request()
        {
            self.send(&ClientMessage::Subscribe(choice));
        }
    }

    /// Shows the next replica if it has caught up, and reports the change of subscription. A client that selects
    /// another stream meanwhile skips the one between; the server sends that stream no more.
    fn switch_replica(&mut self) {
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
            self.events.push_back(Event::SubscriptionChanged(choice));
        }
        self.send(&ClientMessage::Subscribed(stream));
    }

    fn end_membership(&mut self, event: Event) {
        self.state = ClientState::Lobby;
        self.resumption = Resumption::default();
        self.replica_switch = ReplicaSwitch::new();
        self.upstream_state = UpstreamState::new();
        self.held_events = HeldEvents::new();
        self.stream_selection = StreamSelection::new();
        self.resyncing = false;
        self.awaited = Tick::ZERO;
        self.response_times = ResponseTimes::new();
        self.resync_timer.end();
        self.pings.end();
        self.events.push_back(event);
    }

    fn handle_scene_event(&mut self, scene_event: &SceneEvent) -> Result<(), CloseCode> {
        if self.replica_switch.handle_scene_event(scene_event)? == EventTarget::Snapshot {
            return Ok(());
        }
        match *scene_event {
            SceneEvent::BodyPlaced { desc, .. } => {
                self.events.push_back(Event::BodyPlaced(desc.id));
            }
            SceneEvent::BodyRemoved { id, cause } => {
                self.upstream_state.remove(id);
                self.events.push_back(Event::BodyRemoved { id, cause });
            }
            SceneEvent::SceneFaulted { tick, cause } => {
                self.events.push_back(Event::SceneFaulted { tick, cause });
            }
            SceneEvent::SceneRestored { tick } => self.events.push_back(Event::SceneRestored(tick)),
            SceneEvent::ShapeAdded { .. }
            | SceneEvent::ShapeRemoved { .. }
            | SceneEvent::JointAdded { .. }
            | SceneEvent::JointRemoved { .. }
            | SceneEvent::Unknown { .. }
            | SceneEvent::GravityChanged { .. } => {}
        }
        Ok(())
    }

    fn send_states(&mut self, datagrams: Vec<Bytes>) {
        let to = self.peer;
        let states = datagrams.into_iter();
        self.out
            .extend(states.map(|bytes| Transmit::State { to, bytes }));
    }
}

impl Endpoint for ClientSession {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        if self.state != ClientState::Unconnected {
            return;
        }
        self.peer = peer;
        self.state = ClientState::Greeting;
        self.greet(now, peer);
    }

    fn handle_control(&mut self, now: Instant, _from: Peer, bytes: &[u8]) {
        if matches!(self.state, ClientState::Unconnected | ClientState::Ended) {
            return;
        }
        self.frames.push(bytes);
        loop {
            let decoded = match self.frames.next_frame() {
                Ok(None) => break,
                Ok(Some(framed)) => ServerMessage::decode(&framed),
                Err(malformed) => Err(malformed),
            };
            let result = match decoded {
                Ok(Some(message)) => self.handle_message(now, message),
                Ok(None) => Ok(()),
                Err(malformed) => Err(malformed.into()),
            };
            if let Err(code) = result {
                self.close(code);
                return;
            }
        }
        self.watch(now);
    }

    fn handle_datagram(&mut self, now: Instant, _from: Peer, bytes: &[u8]) {
        if self.state == ClientState::Ended {
            return;
        }
        let Ok(datagram) = Datagram::open(bytes) else {
            return;
        };
        if self.handle_upstream_feedback(now, &datagram) {
            return;
        }
        let watermark_tick = |replica_switch: &ReplicaSwitch| {
            replica_switch
                .shown()
                .map(|replica| replica.stream().watermark_tick())
        };
        let before = watermark_tick(&self.replica_switch);
        self.replica_switch.handle_datagram(&datagram);
        let after = watermark_tick(&self.replica_switch)
            .filter(|_| before != watermark_tick(&self.replica_switch));
        if let Some(tick) = after {
            self.note_shown(now, tick);
        }
        self.watch(now);
    }

    fn handle_ended(&mut self, _now: Instant, _peer: Peer, ending: Ending) {
        if self.state != ClientState::Ended {
            self.state = ClientState::Ended;
            self.events.push_back(Event::Ended(ending));
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        if self.state == ClientState::Ended {
            return;
        }
        self.report(now);
        if self.ping_due().is_some_and(|due| due <= now) {
            self.send(&ClientMessage::Ping { sent: now });
            self.pings.note_sent(now);
        }
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        if self.out.is_empty() {
            self.flush();
        }
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        if self.state == ClientState::Ended {
            return None;
        }
        let timers = [
            (self.resync_due(), WakeReason::Refresh),
            (self.ping_due(), WakeReason::Ping),
        ];
        let timers = timers
            .into_iter()
            .filter_map(|(due, reason)| due.map(|at| Wake { at, reason }));
        let receivers = self
            .replica_switch
            .receivers()
            .filter_map(StreamReceiver::due);
        receivers.chain(timers).min_by_key(|wake| wake.at)
    }
}
