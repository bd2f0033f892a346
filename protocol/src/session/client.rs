//! The client's end of a connection: wishes, its copy of the scene, repair.
//!
//! Does not wait and does not display. Poll order: feed `handle_*`, then drain `poll_event` and `poll_transmit`, then ask
//! `poll_timeout`. After an `Ended` event nothing more happens.

mod answers;
mod choosing;
mod clock;
mod driving;
mod greeting;
mod watching;

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::Tick;

use self::answers::Answers;
use self::choosing::Choosing;
use self::watching::{DISORDER, REPAIR_MOST, RESYNC_MOST, SILENCE, SILENCE_MOST};
use super::close::CloseCode;
use super::copies::{Copies, Told};
use super::event::Event;
use super::misuse::Misuse;
use super::patience::Patience;
use super::pings::Pings;
use super::replica::Replica;
use crate::endpoint::{Ending, Endpoint, Peer, Transmit, Wake, WakeReason};
use crate::limits::RESERVE_MAX;
use crate::message::{
    ClientMessage, Denial, Frames, Joined, Moves, Notice, ServerMessage, StreamChoice,
};
use crate::scene::{Command, IdRange, SceneName, SceneTerms};
use crate::time::{Instant, Span};
use driving::Wheel;

/// How far the conversation has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Unconnected,
    Greeting,
    Lobby,
    Member,
    Ended,
}

/// The client's end of one connection.
#[derive(Debug)]
pub struct ClientSession {
    state: State,
    peer: Peer,
    scene: SceneName,
    terms: Option<SceneTerms>,
    frames: Frames,
    copies: Copies,
    choosing: Choosing,
    granted: IdRange,
    wheel: Wheel,
    commands: u64,
    awaited: Tick,
    answers: Answers,
    resyncing: bool,
    touch: Patience,
    /// When it told last what it lost, and how many packets that were.
    reported: (Instant, u64),
    doubt: Patience,
    silence: Patience,
    pings: Pings,
    round_trip: Span,
    unsent: Vec<u8>,
    out: VecDeque<Transmit>,
    events: VecDeque<Event>,
}

impl ClientSession {
    /// A conversation about a scene, not begun yet.
    #[must_use]
    pub const fn new(scene: SceneName) -> Self {
        Self {
            state: State::Unconnected,
            peer: Peer(0),
            scene,
            terms: None,
            frames: Frames::new(),
            copies: Copies::new(),
            choosing: Choosing::new(),
            granted: IdRange::EMPTY,
            wheel: Wheel::new(),
            commands: 0,
            awaited: Tick::ZERO,
            answers: Answers::new(),
            resyncing: false,
            touch: Patience::new(Span::ZERO, RESYNC_MOST),
            reported: (Instant::ZERO, 0),
            doubt: Patience::new(DISORDER, REPAIR_MOST),
            silence: Patience::new(SILENCE, SILENCE_MOST),
            pings: Pings::new(),
            round_trip: Span::from_millis(20),
            unsent: Vec::new(),
            out: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    /// Creates the scene; answered by `Created` or `Denied`.
    ///
    /// # Errors
    ///
    /// [`Misuse`] before the welcome, as a member, or for terms that are wrong.
    pub fn create(&mut self, terms: SceneTerms) -> Result<(), Misuse> {
        self.must_be(State::Lobby)?;
        terms.check().map_err(Misuse::Invalid)?;
        self.say(&ClientMessage::Create(terms));
        Ok(())
    }

    /// Becomes a member; answered by `Joined` or `Denied`.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] before the welcome or as a member.
    pub fn join(&mut self, choice: StreamChoice) -> Result<(), Misuse> {
        self.must_be(State::Lobby)?;
        self.say(&ClientMessage::Join(choice));
        Ok(())
    }

    /// Is a member no longer; answered by `Left`.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] unless a member; so for the verbs below.
    pub fn leave(&mut self) -> Result<(), Misuse> {
        self.as_member(&ClientMessage::Leave)
    }

    /// Ends the scene for everyone; answered by `Deleted` or `Denied`.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] before the welcome.
    pub fn delete(&mut self) -> Result<(), Misuse> {
        if self.state != State::Member {
            self.must_be(State::Lobby)?;
        }
        self.say(&ClientMessage::Delete);
        Ok(())
    }

    /// Asks for more body indices; answered by `Reserved` or `Denied`.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], and [`Misuse::Indices`] for none or more than [`RESERVE_MAX`], which is then not sent.
    pub fn reserve(&mut self, count: u32) -> Result<(), Misuse> {
        if count == 0 || count > RESERVE_MAX {
            return Err(Misuse::Indices(count));
        }
        self.as_member(&ClientMessage::Reserve { count })
    }

    /// Wishes something; returns the number that its answer will name.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`], and [`Misuse::Invalid`] for a wrong number, which is then not sent.
    pub fn command(&mut self, command: Command) -> Result<u64, Misuse> {
        command.check().map_err(Misuse::Invalid)?;
        self.as_member(&ClientMessage::Command(command))?;
        self.commands += 1;
        Ok(self.commands - 1)
    }

    /// Lets the scene step to a tick; answered by the stream, which vouches for it.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`].
    pub fn advance(&mut self, now: Instant, to: Tick) -> Result<(), Misuse> {
        self.as_member(&ClientMessage::Advance { to })?;
        if !self.awaits() {
            // Until now it waited as one does who asked for nothing.
            self.silence.end();
        }
        self.awaited = self.awaited.max(to);
        self.answers.ask(now, to);
        self.await_tick(now);
        Ok(())
    }

    /// Follows another stream; answered by `Following` or `Denied`, and until then the copy is by the present one. That may
    /// take as long as the other one is not complete, which a full stream over a bad link may never be: then one that is
    /// chosen meanwhile takes its place, and only the last is followed. `Moved` tells where the server puts another in its
    /// place because the link does not carry it; that, too, may be answered by another choice.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`].
    pub fn follow(&mut self, choice: StreamChoice) -> Result<(), Misuse> {
        self.must_be(State::Member)?;
        self.choosing.want(choice);
        self.ask_for_stream();
        Ok(())
    }

    /// Says where the server may move this member when its link is thin: to coarse (20 cm) unless this says otherwise.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`].
    pub fn allow(&mut self, moves: Moves) -> Result<(), Misuse> {
        self.as_member(&ClientMessage::Moves(moves))
    }

    /// Asks how the scene is; answered by `Inspected`.
    ///
    /// # Errors
    ///
    /// As [`Self::leave`].
    pub fn inspect(&mut self) -> Result<(), Misuse> {
        self.as_member(&ClientMessage::Inspect)
    }

    /// Says goodbye.
    pub fn close(&mut self, code: CloseCode) {
        if matches!(self.state, State::Unconnected | State::Ended) {
            return;
        }
        self.flush();
        self.out.push_back(Transmit::Close {
            to: self.peer,
            code: code.0,
        });
        self.state = State::Ended;
        self.events.push_back(Event::Ended(Ending::Closed(code.0)));
    }

    /// The copy of the scene, once it is whole.
    #[must_use]
    pub const fn replica(&self) -> Option<&Replica> {
        self.copies.shown()
    }

    /// The copy, to drain its changes.
    pub const fn replica_mut(&mut self) -> Option<&mut Replica> {
        self.copies.shown_mut()
    }

    /// The terms of the scene, once it was welcomed to or joined.
    #[must_use]
    pub const fn terms(&self) -> Option<&SceneTerms> {
        self.terms.as_ref()
    }

    /// The last round trip that was measured.
    #[must_use]
    pub const fn round_trip(&self) -> Span {
        self.round_trip
    }

    /// The next thing that the application should know.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    fn must_be(&self, state: State) -> Result<(), Misuse> {
        if self.state == state {
            Ok(())
        } else {
            Err(Misuse::NotNow)
        }
    }

    fn as_member(&mut self, message: &ClientMessage) -> Result<(), Misuse> {
        self.must_be(State::Member)?;
        self.say(message);
        Ok(())
    }

    fn say(&mut self, message: &ClientMessage) {
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

    fn hear(&mut self, now: Instant, message: ServerMessage) -> Result<(), CloseCode> {
        match message {
            ServerMessage::Welcome(welcome) => self.hear_welcome(now, welcome)?,
            ServerMessage::Created => self.events.push_back(Event::Created),
            ServerMessage::Joined(joined) => self.begin_snapshot(&joined)?,
            ServerMessage::SnapshotEnd => self.end_snapshot(now)?,
            ServerMessage::Left => self.end_membership(Event::Left),
            ServerMessage::Deleted => self.end_membership(Event::Deleted),
            ServerMessage::Reserved(range) => self.events.push_back(Event::Reserved(range)),
            ServerMessage::Denied(denial) => {
                // Only what stands in the way of a stream denies one.
                if matches!(denial, Denial::TooManyStreams | Denial::SceneFaulted) {
                    self.choosing.hear_denied();
                    self.ask_for_stream();
                }
                self.events.push_back(Event::Denied(denial));
            }
            ServerMessage::Applied { through, tick } => {
                self.events.push_back(Event::Applied { through, tick });
            }
            ServerMessage::Refused { number, error } => {
                self.events.push_back(Event::Refused { number, error });
            }
            ServerMessage::Notice(notice) => self.hear_notice(&notice)?,
            ServerMessage::Pong {
                sent,
                tick,
                since_tick_ns,
            } => self.hear_pong(now, sent, tick, Span::from_nanos(since_tick_ns)),
            ServerMessage::Inspection(inspection) => {
                self.events.push_back(Event::Inspected(inspection));
            }
            ServerMessage::Driving(driving) => self.hear_driving(&driving),
            ServerMessage::NotDriving(error) => self.hear_not_driving(error),
            ServerMessage::Moved { to, cause } => {
                self.choosing.hear_moved(to);
                self.events.push_back(Event::Moved { to, cause });
            }
        }
        Ok(())
    }

    fn begin_snapshot(&mut self, joined: &Joined) -> Result<(), CloseCode> {
        if !matches!(self.state, State::Lobby | State::Member) {
            return Err(CloseCode::VIOLATION);
        }
        joined.terms.check().map_err(|_| CloseCode::VIOLATION)?;
        if joined.extensions.ask_too_much() {
            return Err(CloseCode::EXTENSION);
        }
        self.terms = Some(joined.terms);
        self.granted = joined.granted;
        self.copies.begin(joined);
        self.choosing.hear_joined(joined.choice);
        self.ask_for_stream();
        Ok(())
    }

    fn end_snapshot(&mut self, now: Instant) -> Result<(), CloseCode> {
        self.copies.end_snapshot()?;
        if self.state != State::Member {
            self.state = State::Member;
            self.commands = 0;
            self.say(&ClientMessage::Ping { sent: now });
            self.pings.begin(now);
            self.events.push_back(Event::Joined(self.granted));
        }
        self.resyncing = false;
        self.ask_for_stream();
        self.watch(now);
        Ok(())
    }

    /// Asks for the stream that is wanted, unless an answer, or a snapshot that could be taken for one, is to come.
    fn ask_for_stream(&mut self) {
        if !self.resyncing
            && let Some(choice) = self.choosing.ask()
        {
            self.say(&ClientMessage::Follow(choice));
        }
    }

    /// Takes the copy that was filled for the present one, if it is time. Who asks for another stream leaves out the one
    /// between: the server says that no more.
    fn change_copies(&mut self) {
        let shown = self.copies.shown();
        let goes_on = shown.is_some_and(|copy| !copy.stream().has_lost_touch());
        if self.choosing.is_asking() && goes_on {
            return;
        }
        let Some(before) = self.copies.catch_up() else {
            return;
        };
        let Some(copy) = self.copies.shown() else {
            return;
        };
        let (choice, stream) = (copy.choice(), copy.stream().stream());
        if self.choosing.take_news() || before.choice() != choice {
            self.events.push_back(Event::Following(choice));
        }
        self.say(&ClientMessage::Followed(stream));
    }

    fn end_membership(&mut self, event: Event) {
        self.state = State::Lobby;
        self.copies = Copies::new();
        self.wheel = Wheel::new();
        self.choosing = Choosing::new();
        self.resyncing = false;
        self.awaited = Tick::ZERO;
        self.answers = Answers::new();
        self.doubt.end();
        self.touch.end();
        self.silence.end();
        self.pings.end();
        self.events.push_back(event);
    }

    fn hear_notice(&mut self, notice: &Notice) -> Result<(), CloseCode> {
        if self.copies.hear_notice(notice)? == Told::Snapshot {
            return Ok(());
        }
        match *notice {
            Notice::BodyPlaced { terms, .. } => self.events.push_back(Event::BodyPlaced(terms.id)),
            Notice::BodyRemoved { id, cause } => {
                self.wheel.remove(id);
                self.events.push_back(Event::BodyRemoved { id, cause });
            }
            Notice::SceneFaulted { tick } => self.events.push_back(Event::SceneFaulted(tick)),
            Notice::ShapeAdded { .. }
            | Notice::ShapeRemoved { .. }
            | Notice::JointAdded { .. }
            | Notice::JointRemoved { .. }
            | Notice::Unknown { .. }
            | Notice::GravityChanged { .. } => {}
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
        if self.state != State::Unconnected {
            return;
        }
        self.peer = peer;
        self.state = State::Greeting;
        self.greet(now, peer);
    }

    fn handle_control(&mut self, now: Instant, _from: Peer, bytes: &[u8]) {
        if matches!(self.state, State::Unconnected | State::Ended) {
            return;
        }
        self.frames.push(bytes);
        loop {
            let heard = match self.frames.next_frame() {
                Ok(None) => break,
                Ok(Some(framed)) => ServerMessage::decode(&framed),
                Err(malformed) => Err(malformed),
            };
            let result = match heard {
                Ok(Some(message)) => self.hear(now, message),
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
        if self.state == State::Ended {
            return;
        }
        if self.hear_of_upstream(now, bytes) {
            return;
        }
        let vouched = |copies: &Copies| copies.shown().map(|copy| copy.stream().vouched());
        let before = vouched(&self.copies);
        self.copies.handle_datagram(bytes);
        let after = vouched(&self.copies).filter(|_| before != vouched(&self.copies));
        if let Some(tick) = after {
            self.note_shown(now, tick);
        }
        while let Some(id) = self.copies.shown_mut().and_then(Replica::poll_amended) {
            self.events.push_back(Event::Amended(id));
        }
        self.watch(now);
    }

    fn handle_ended(&mut self, _now: Instant, _peer: Peer, ending: Ending) {
        if self.state != State::Ended {
            self.state = State::Ended;
            self.events.push_back(Event::Ended(ending));
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        if self.state == State::Ended {
            return;
        }
        self.ask_what_is_due(now);
        if self.ping_due().is_some_and(|due| due <= now) {
            self.say(&ClientMessage::Ping { sent: now });
            self.pings.asked(now);
        }
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        if self.out.is_empty() {
            self.flush();
        }
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        if self.state == State::Ended {
            return None;
        }
        let timers = [
            (self.copies.missing_due(), WakeReason::Repair),
            (self.doubt.due(), WakeReason::Repair),
            (self.touch_due(), WakeReason::Repair),
            (self.silence.due(), WakeReason::Vouch),
            (self.ping_due(), WakeReason::Ping),
        ];
        timers
            .into_iter()
            .filter_map(|(due, reason)| due.map(|at| Wake { at, reason }))
            .min_by_key(|wake| wake.at)
    }
}
