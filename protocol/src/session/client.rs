//! The client's end of a connection: commands, scene replica, refresh.
//!
//! Does not wait and does not display. Call order: feed `handle_*`, then drain `poll_event` and `poll_transmit`, then
//! ask `poll_timeout`. After an `Ended` event nothing more happens. Messages of later versions are accepted or refused
//! by their code, and unknown messages that a client may ignore are skipped (PROTOCOL 3.5).

mod cells;
mod handshake;
mod membership;
mod outbox;
mod subscription;
mod upstream;

use alloc::borrow::ToOwned;
use alloc::collections::{BTreeMap, VecDeque};
use alloc::string::String;
use alloc::vec::Vec;

pub use cells::CellState;
use handshake::ClientHandshake;
use membership::ClientMembership;
pub use membership::StandingEvents;
use outbox::{ClientOutbox, ClockSampler, Resumption};
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};

use super::replica::Replica;
use super::{CloseCode, Event, Misuse};
use crate::endpoint::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake};
use crate::limits::RESERVE_MAX;
use crate::message::{
    ClientMessage, Denial, Extension, Frames, Joined, ServerMessage, SessionKey, StreamChoice,
    TierPolicy, Token, Welcome,
};
use crate::packet::{Datagram, LargestPacket};
use crate::scene::{
    BodyDesc, Cell, CellGrid, Command, IdRange, Query, SceneConfig, SceneName, Stepping,
};
use crate::stream::PublisherStatistics;
use crate::wire::Malformed;

/// The round trip that counts until one is measured.
const ROUND_TRIP: Span = Span::from_millis(20);

/// The client's end of one connection.
#[derive(Debug)]
pub struct ClientSession {
    state: ClientState,
    handshake: ClientHandshake,
    config: Option<SceneConfig>,
    /// The address of the server that has the scene, if this one said that it has not.
    elsewhere: Option<String>,
    received: ServerMessages,
    granted: IdRange,
    membership: ClientMembership,
    resumption: Resumption,
    clock: ClockSampler,
    outbox: ClientOutbox,
    events: VecDeque<Event>,
}

impl ClientSession {
    /// A session for a scene, before the connection opens.
    #[must_use]
    pub fn new(scene: SceneName) -> Self {
        Self {
            state: ClientState::Unconnected,
            handshake: ClientHandshake { scene, token: None },
            config: None,
            elsewhere: None,
            received: ServerMessages::new(Frames::new()),
            granted: IdRange::EMPTY,
            membership: ClientMembership::new(LargestPacket::DEFAULT),
            resumption: Resumption::default(),
            clock: ClockSampler::new(ROUND_TRIP),
            outbox: ClientOutbox::new(),
            events: VecDeque::new(),
        }
    }

    /// Sets the token of the `Hello`.
    pub fn set_token(&mut self, token: Token) {
        self.handshake.token = Some(token);
    }

    /// Keeps what an edge needs to answer for the stream: the bodies of its last packets. Called before the connection opens.
    pub const fn relay(&mut self) {
        self.membership.subscription.relay();
    }

    /// Creates the scene; answered by `Created` or `Denied`.
    ///
    /// # Errors
    ///
    /// [`Misuse`] before the welcome, as a member, or for a config that is invalid.
    pub fn create(&mut self, config: SceneConfig) -> Result<(), Misuse> {
        self.state.must_be(ClientState::Lobby)?;
        config.check().map_err(Misuse::Invalid)?;
        self.outbox.send(&ClientMessage::Create(config));
        Ok(())
    }

    /// Requests membership; answered by `Joined` or `Denied`.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] before the welcome or as a member.
    pub fn join(&mut self, choice: StreamChoice) -> Result<(), Misuse> {
        self.state.must_be(ClientState::Lobby)?;
        self.outbox.send(&ClientMessage::Join(choice));
        Ok(())
    }

    /// Takes the scene by cells from the next join on, if the server divides it: the replica then has what is in no cell,
    /// and [`Self::take_cells`] adds cells. A server that does not know of cells gives the whole scene.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] before the welcome or as a member.
    pub fn join_cells(&mut self) -> Result<(), Misuse> {
        self.state.must_be(ClientState::Lobby)?;
        self.membership.cells.join(&mut self.outbox);
        Ok(())
    }

    /// The grid of the cells of a scene that was joined by cells; `None` if it is not divided.
    #[must_use]
    pub const fn cell_grid(&self) -> Option<CellGrid> {
        self.membership.cells.grid()
    }

    /// Takes these cells and no others, each by a stream. What is asked for twice is sent once. A copy of a cell comes with
    /// its snapshot, and goes at once; one that changes its stream stays until the new one has caught up.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], [`Misuse::NotDivided`] without a grid, [`Misuse::TooManyCells`] and [`Misuse::CellPlace`]; then all stays as
    /// it was.
    pub fn take_cells(&mut self, cells: &BTreeMap<Cell, StreamChoice>) -> Result<(), Misuse> {
        self.must_be_in_session()?;
        if self.cell_grid().is_none() {
            return Err(Misuse::NotDivided);
        }
        self.membership.cells.take(cells, &mut self.outbox)
    }

    /// The copies of the cells whose snapshots have come, in order, with ids of the cell: see [`Replica::id_in_scene`].
    pub fn cells(&self) -> impl Iterator<Item = (Cell, &Replica)> {
        self.membership.cells.copies()
    }

    /// The same, for draining their changes.
    pub fn cells_mut(&mut self) -> impl Iterator<Item = (Cell, &mut Replica)> {
        self.membership.cells.copies_mut()
    }

    /// True for a cell that was asked for and whose snapshot has not come.
    #[must_use]
    pub fn awaits_cell(&self, cell: Cell) -> bool {
        self.membership.cells.awaits(cell)
    }

    /// The copy of a cell, as [`Self::cells`] has it.
    #[must_use]
    pub fn cell(&self, cell: Cell) -> Option<&Replica> {
        self.membership.cells.copy(cell)
    }

    /// The cells that are taken, in order.
    pub fn taken_cells(&self) -> impl Iterator<Item = (Cell, CellState)> {
        self.membership.cells.states()
    }

    /// The copy that has a body now, and the body's id there: the replica of the scene, or that of a cell. Of two that have
    /// it, that with the newer track.
    #[must_use]
    pub fn copy_of(&self, body: BodyId) -> Option<(&Replica, BodyId)> {
        self.membership.copy_of(body)
    }

    /// The descriptor of a body, by its id in the scene; `None` if no copy has it.
    #[must_use]
    pub fn body(&self, id: BodyId) -> Option<BodyDesc> {
        let (copy, local) = self.copy_of(id)?;
        let desc = copy.body(local)?;
        Some(BodyDesc { id, ..desc })
    }

    /// The newest tick up to which replica and cells are complete, if any. Free-running, it may go back with a new cell.
    #[must_use]
    pub fn complete(&self) -> Option<Tick> {
        self.membership.complete()
    }

    /// Begins a session with the next join. A client that draws its key at random can resume the session over another
    /// connection, by [`Self::reconnect`].
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] before the welcome or as a member.
    pub fn begin_session(&mut self, key: SessionKey) -> Result<(), Misuse> {
        self.state.must_be(ClientState::Lobby)?;
        let request = ClientMessage::Session(self.resumption.begin(key));
        self.outbox.send(&request);
        Ok(())
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
        let is_member = self.state.must_be(ClientState::Member);
        is_member.or(self.state.must_be(ClientState::Lobby))?;
        self.outbox.send(&ClientMessage::Delete);
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
        let resuming = self.must_be_in_session()?;
        let number = self.resumption.note_command(&command);
        if !resuming {
            self.outbox.send(&ClientMessage::Command(command));
        }
        Ok(number)
    }

    /// Asks where bodies are; returns the number that the answer, a `QueryResult`, will name. Numbering continues over
    /// the connections of a session; queries that one left unanswered get no answer.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], [`Misuse::Invalid`] for a number out of range, and [`Misuse::Hits`] and
    /// [`Misuse::QueryCost`]; nothing is sent then.
    pub fn query(&mut self, queries: Vec<Query>) -> Result<u64, Misuse> {
        if let Some(query) = queries.iter().find(|query| !query.has_valid_hits()) {
            return Err(Misuse::Hits(query.hits));
        }
        let cost = queries.iter().map(Query::cost).fold(0, u32::saturating_add);
        Query::total_cost(&queries).ok_or(Misuse::QueryCost(cost))?;
        let checked = queries.iter().try_for_each(Query::check);
        checked.map_err(Misuse::Invalid)?;
        self.as_member(&ClientMessage::Query(queries))?;
        Ok(self.membership.note_query())
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
        self.membership.advance(now, to);
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
        self.state.must_be(ClientState::Member)?;
        let subscription = &mut self.membership.subscription;
        subscription.select(choice, &mut self.outbox);
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

    /// Bounds the packets of later upstreams. A transport that takes only smaller datagrams needs it.
    pub const fn set_largest_packet(&mut self, largest_packet: LargestPacket) {
        self.membership.upstream.set_largest_packet(largest_packet);
    }

    /// Takes authority over these kinematic bodies in place of the earlier ones; an empty list ends it. Answered by
    /// `AuthorityGrant` or `AuthorityDenied`; for a body that no copy has, a grant waits for its cell. Between two connections of a
    /// session it waits for the second.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], [`Misuse::AuthorityUnanswered`] while an earlier request is unanswered, and
    /// [`Misuse::TooManyAuthorityBodies`].
    pub fn take_authority(
        &mut self,
        tolerance: Tolerance,
        bodies: &[BodyId],
    ) -> Result<(), Misuse> {
        let outbox = (!self.must_be_in_session()?).then_some(&mut self.outbox);
        self.membership.upstream.take(tolerance, bodies, outbox)
    }

    /// Publishes the states of the bodies under the member's authority, where the server's prediction exceeds the
    /// tolerance. A body without a state stands still at its last place.
    ///
    /// Returns whether the states were published: `false` before the authority is granted, also over the next
    /// connection of a session, while all of the bodies wait for their cells, and for a tick not after the last one.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], [`Misuse::NoAuthority`], and [`Misuse::Invalid`] for a number out of range; nothing is sent
    /// then.
    pub fn publish(&mut self, tick: Tick, motions: &[(BodyId, BodyState)]) -> Result<bool, Misuse> {
        self.must_be_in_session()?;
        let stepping = self.stepping();
        let upstream = &mut self.membership.upstream;
        upstream.publish(tick, motions, stepping, &mut self.outbox)
    }

    /// Makes the session ready for another connection: it joins the scene again by itself, and sends again what was not
    /// done. [`Event::Resumed`] reports that the session is resumed; the replica is absent until then. Then it requests
    /// its authority over bodies again; other requests that were not answered are lost. If the scene has no place for
    /// it now, the session closes with [`CloseCode::BUSY`], and may try again; if it is denied for good,
    /// [`Event::Denied`] says so before the end.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] unless a connection of a member with a session has ended.
    pub fn reconnect(&mut self) -> Result<(), Misuse> {
        self.state.must_be(ClientState::Ended)?;
        if !self.can_reconnect() {
            return Err(Misuse::NotNow);
        }
        let fresh = Self::new(self.handshake.scene.clone());
        let before = core::mem::replace(self, fresh);
        self.handshake = before.handshake;
        self.membership = before.membership.over_next_connection();
        self.resumption = before.resumption;
        self.config = before.config;
        self.clock = ClockSampler::new(before.clock.round_trip());
        self.events = before.events;
        Ok(())
    }

    /// Ends the session and closes the connection with `code`.
    pub fn close(&mut self, code: CloseCode) {
        if !self.state.is_open() {
            return;
        }
        self.outbox.close(code);
        self.state = ClientState::Ended;
        self.events.push_back(Event::Ended(Ending::Closed(code.0)));
    }

    /// The replica of the scene; None until its snapshot is complete.
    #[must_use]
    pub const fn replica(&self) -> Option<&Replica> {
        self.membership.subscription.shown()
    }

    /// The replica, for draining its changes.
    pub const fn replica_mut(&mut self) -> Option<&mut Replica> {
        self.membership.subscription.shown_mut()
    }

    /// Asks the server up to which tick everything has been sent, unless it was asked within `pause`.
    ///
    /// A free-running stream in which nothing happens says so in growing pauses, 2.5 s at most.
    pub fn query_watermark(&mut self, now: Instant, pause: Span) {
        self.membership.query(now, pause, &mut self.outbox);
    }

    /// The config of the scene; None before the welcome or joining.
    #[must_use]
    pub const fn config(&self) -> Option<&SceneConfig> {
        self.config.as_ref()
    }

    /// The latest measured round trip.
    #[must_use]
    pub const fn round_trip(&self) -> Span {
        self.clock.round_trip()
    }

    /// The bodies under the member's authority that are published, in rising order.
    pub fn authority_bodies(&self) -> impl Iterator<Item = BodyId> {
        self.membership.upstream.bodies()
    }

    /// Counters of the upstream since the authority was granted.
    #[must_use]
    pub fn upstream(&self) -> Option<PublisherStatistics> {
        self.membership.upstream.statistics()
    }

    /// The address of the server that has the scene, if this connection ended because another one has it.
    #[must_use]
    pub fn elsewhere(&self) -> Option<&str> {
        self.elsewhere.as_deref()
    }

    /// True if the member has a session in a scene that survives its server.
    #[must_use]
    pub const fn is_durable(&self) -> bool {
        self.resumption.is_durable()
    }

    /// True if another connection could resume the session.
    #[must_use]
    pub const fn can_reconnect(&self) -> bool {
        self.resumption.can_reconnect()
    }

    /// The number of commands that may have to be sent again.
    #[must_use]
    pub fn unfinished_commands(&self) -> usize {
        self.resumption.unfinished_commands()
    }

    /// The next event for the application, oldest first.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.membership.release_events(&mut self.events);
        self.events.pop_front()
    }

    fn as_member(&mut self, message: &ClientMessage) -> Result<(), Misuse> {
        self.state.must_be(ClientState::Member)?;
        self.outbox.send(message);
        Ok(())
    }

    /// Refuses a call of a client that is no member, unless another connection is to make it one again: `true` then.
    fn must_be_in_session(&self) -> Result<bool, Misuse> {
        match self.is_resuming() {
            true => Ok(true),
            false => self.state.must_be(ClientState::Member).map(|()| false),
        }
    }

    /// True if the client was a member, and another connection is to make it one again.
    const fn is_resuming(&self) -> bool {
        !matches!(self.state, ClientState::Member | ClientState::Ended) && self.can_reconnect()
    }

    /// The stepping of the scene.
    fn stepping(&self) -> Stepping {
        self.config
            .map_or(Stepping::FreeRunning, |config| config.stepping)
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
                let rejoins = self.state == ClientState::Lobby && self.can_reconnect();
                if rejoins && denial.is_transient() {
                    return Err(CloseCode::BUSY);
                }
                // Other denials answer requests that are not about streams.
                if matches!(denial, Denial::TooManyStreams | Denial::SceneFaulted) {
                    self.membership.subscription.handle_denied(&mut self.outbox);
                }
                self.events.push_back(Event::Denied(denial));
                if rejoins {
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
            ServerMessage::Pong {
                sent,
                tick,
                since_tick_ns,
            } => {
                self.membership.cells.handle_pong(sent);
                let is_member = self.state == ClientState::Member;
                let scene = self.config.as_ref().filter(|_| is_member);
                let since_tick = Span::from_nanos(since_tick_ns);
                let seen = self.clock.handle_pong(now, sent, (tick, since_tick), scene);
                self.events.extend(seen);
            }
            ServerMessage::Session(state) if self.state == ClientState::Lobby => {
                self.resumption.handle_state(state, &mut self.events)?;
            }
            ServerMessage::Session(_) => return Err(CloseCode::VIOLATION),
            ServerMessage::Durable { commands, tick } => {
                self.resumption.finish(commands, tick);
                self.events.push_back(Event::Durable { commands, tick });
            }
            // The server closes next.
            ServerMessage::Moved { address } => self.elsewhere = place_of(&address),
            ServerMessage::OfCell { cell, news } => {
                let config = self.config.as_ref();
                let (outbox, events) = (&mut self.outbox, &mut self.events);
                (self.membership).handle_cell((cell, &news), config, outbox, events)?;
            }
            about_scene => {
                let config = self.config.as_ref();
                let (outbox, events) = (&mut self.outbox, &mut self.events);
                self.membership
                    .handle_message(about_scene, config, outbox, events)?;
            }
        }
        Ok(())
    }

    fn handle_welcome(&mut self, now: Instant, welcome: Welcome) -> Result<(), CloseCode> {
        if self.state != ClientState::Greeting {
            return Err(CloseCode::VIOLATION);
        }
        ClientHandshake::check(&welcome)?;
        if let Some(place) = welcome.extensions.value(Extension::ELSEWHERE) {
            self.elsewhere = place_of(place);
            return Err(CloseCode::SCENE_ELSEWHERE);
        }
        self.state = ClientState::Lobby;
        self.config = welcome.scene;
        self.outbox.send(&ClientMessage::Ping { sent: now });
        if self.can_reconnect() {
            self.membership.cells.ask(&mut self.outbox);
            self.resumption.rejoin(&mut self.outbox);
        } else {
            self.events.push_back(Event::Welcomed(welcome));
        }
        Ok(())
    }

    fn begin_snapshot(&mut self, joined: &Joined) -> Result<(), CloseCode> {
        if !matches!(self.state, ClientState::Lobby | ClientState::Member) {
            return Err(CloseCode::VIOLATION);
        }
        ClientHandshake::check_joined(joined)?;
        self.config = Some(joined.config);
        self.granted = joined.granted;
        self.resumption.note_choice(joined.choice);
        self.membership.begin_snapshot(joined, &mut self.outbox);
        Ok(())
    }

    fn end_snapshot(&mut self, now: Instant) -> Result<(), CloseCode> {
        self.membership.subscription.end_snapshot()?;
        if self.state != ClientState::Member {
            self.state = ClientState::Member;
            self.membership.begin();
            self.outbox.send(&ClientMessage::Ping { sent: now });
            self.clock.begin(now);
            if let Some((state, awaited)) = self.resumption.resume(&mut self.outbox) {
                self.membership.await_also(awaited);
                self.membership.upstream.regain(&mut self.outbox);
                self.events.push_back(Event::Resumed(state));
            } else {
                self.resumption.begin_membership();
                self.events.push_back(Event::Joined(self.granted));
            }
        }
        self.membership.subscription.end_resync(&mut self.outbox);
        self.update(now);
        Ok(())
    }

    /// Shows a replica that has caught up and restarts the timers.
    fn update(&mut self, now: Instant) {
        let (config, outbox) = (self.config.as_ref(), &mut self.outbox);
        self.membership
            .update(now, config, outbox, &mut self.events);
    }

    fn end_membership(&mut self, event: Event) {
        self.state = ClientState::Lobby;
        self.resumption.end();
        self.membership.end();
        self.clock.end();
        self.events.push_back(event);
    }
}

impl Endpoint for ClientSession {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        if self.state != ClientState::Unconnected {
            return;
        }
        self.outbox.open(peer);
        self.state = ClientState::Greeting;
        self.handshake.greet(now, peer, &mut self.outbox);
    }

    fn handle_control(&mut self, now: Instant, _from: Peer, bytes: &[u8]) {
        if !self.state.is_open() {
            return;
        }
        self.received.push(bytes);
        loop {
            let result = match self.received.next() {
                Ok(None) => break,
                Ok(Some(message)) => self.handle_message(now, message),
                Err(malformed) => Err(malformed.into()),
            };
            if let Err(code) = result {
                return self.close(code);
            }
        }
        self.update(now);
    }

    fn handle_datagram(&mut self, now: Instant, _from: Peer, bytes: &[u8]) {
        if self.state == ClientState::Ended {
            return;
        }
        let Ok(datagram) = Datagram::open(bytes) else {
            return;
        };
        let (stepping, round_trip) = (self.stepping(), self.clock.round_trip());
        let outbox = &mut self.outbox;
        if self
            .membership
            .upstream
            .handle_feedback(now, round_trip, &datagram, stepping, outbox)
        {
            return;
        }
        if (self.membership).handle_cell_datagram(now, &datagram, outbox, &mut self.events) {
            return;
        }
        if let Some(tick) = self.membership.subscription.handle_datagram(&datagram) {
            self.clock.note_shown(now, tick, self.config.as_ref());
        }
        self.update(now);
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
        let round_trip = self.clock.round_trip();
        self.membership
            .report(now, round_trip, &mut self.outbox, &mut self.events);
        if self.clock.take_due(now, self.config.as_ref()) {
            self.outbox.send(&ClientMessage::Ping { sent: now });
        }
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.outbox.poll()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        if self.state == ClientState::Ended {
            return None;
        }
        let ping = self.clock.due(self.config.as_ref());
        let due = self.membership.due().chain(ping);
        due.min_by_key(|wake| wake.at)
    }
}

/// An address as text; `None` if it is none.
fn place_of(bytes: &[u8]) -> Option<String> {
    let is_text = !bytes.is_empty() && bytes.iter().all(u8::is_ascii_graphic);
    let text = core::str::from_utf8(bytes).ok().filter(|_| is_text)?;
    Some(text.to_owned())
}

/// The bytes that are not decoded yet.
#[derive(Debug)]
struct ServerMessages {
    frames: Frames,
}

impl ServerMessages {
    const fn new(frames: Frames) -> Self {
        Self { frames }
    }

    /// Adds received bytes.
    fn push(&mut self, bytes: &[u8]) {
        self.frames.push(bytes);
    }

    /// The next message; `None` until more bytes come.
    fn next(&mut self) -> Result<Option<ServerMessage>, Malformed> {
        while let Some(framed) = self.frames.next_frame()? {
            if let Some(message) = ServerMessage::decode(&framed)? {
                return Ok(Some(message));
            }
        }
        Ok(None)
    }
}

/// The state of the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ClientState {
    Unconnected,
    Greeting,
    Lobby,
    Member,
    Ended,
}

impl ClientState {
    /// Refuses a call of the application in any other state.
    fn must_be(self, state: Self) -> Result<(), Misuse> {
        if self == state {
            Ok(())
        } else {
            Err(Misuse::NotNow)
        }
    }

    /// True while messages may come.
    const fn is_open(self) -> bool {
        !matches!(self, Self::Unconnected | Self::Ended)
    }
}
