//! A raw client: sends the bytes of a case and waits for the required answers.
//!
//! It keeps no copy of a scene; see `lossy_client` for one that does. Bytes of the server that are not valid protocol
//! fail the case immediately.

use std::cell::RefCell;
use std::collections::{BTreeSet, VecDeque};
use std::rc::Rc;
use std::time::Duration;

use bytes::Bytes;
use rhumb_netsim::{RawConnection, RawEvent, RawPeerEnd, UdpRelay};
use rhumb_protocol::message::{
    ClientMessage, Denial, Extensions, Frames, Joined, SceneEvent, ServerMessage, StreamChoice,
    Token, Welcome,
};
use rhumb_protocol::scene::{Command, CommandError, IdRange, SceneConfig, SceneName};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tick;
use rhumb_transport::Clock;

use crate::grammar::hex;
use crate::log::Log;
use crate::outcome::{CaseResult, Closing, Stop};

/// A raw client.
#[derive(Debug)]
pub struct RawClient {
    /// The connection.
    pub connection: RawConnection,
    /// The scene of its connection.
    pub scene: SceneName,
    /// The id range granted to it as a member.
    pub granted: IdRange,
    /// Number of commands that it sent as a member.
    pub commands: u64,
    /// Received datagrams that the case has not taken yet.
    pub datagrams: VecDeque<Bytes>,
    /// The end of the connection, if it has ended.
    pub ended: Option<RawPeerEnd>,
    /// Types of received optional messages that the protocol does not assign, in order.
    pub greased: Vec<u8>,
    /// The token that its `Hello` shows, unless the case gives it one.
    pub(crate) token: Option<Token>,
    frames: Frames,
    received: VecDeque<ServerMessage>,
    timeout: Duration,
    clock: Clock,
    log: Log,
    closing: Rc<RefCell<Closing>>,
    scenes: Rc<RefCell<BTreeSet<SceneName>>>,
    _relay: Option<UdpRelay>,
}

impl RawClient {
    pub(crate) fn new(
        connection: RawConnection,
        relay: Option<UdpRelay>,
        scene: SceneName,
        timeout: Duration,
        log: Log,
        closing: Rc<RefCell<Closing>>,
        scenes: Rc<RefCell<BTreeSet<SceneName>>>,
    ) -> Self {
        Self {
            connection,
            scene,
            granted: IdRange::EMPTY,
            commands: 0,
            datagrams: VecDeque::new(),
            ended: None,
            greased: Vec::new(),
            token: None,
            frames: Frames::new(),
            received: VecDeque::new(),
            timeout,
            clock: Clock::start(),
            log,
            closing,
            scenes,
            _relay: relay,
        }
    }

    /// Sends bytes on the control stream.
    pub fn send_bytes(&mut self, bytes: &[u8]) {
        self.log.note(format!("> {}", hex(bytes)));
        self.connection.send_control(bytes.to_vec());
    }

    /// Sends a message.
    pub fn send(&mut self, message: &ClientMessage) {
        self.log.note(format!("> {message:?}"));
        let mut bytes = Vec::new();
        self.encode(message, &mut bytes);
        self.connection.send_control(bytes);
        if matches!(message, ClientMessage::Command(_)) {
            self.commands += 1;
        }
    }

    /// Sends several messages in one write.
    pub fn send_together(&mut self, messages: &[ClientMessage]) {
        let mut bytes = Vec::new();
        for message in messages {
            self.log.note(format!("> {message:?}"));
            self.encode(message, &mut bytes);
            self.commands += u64::from(matches!(message, ClientMessage::Command(_)));
        }
        self.connection.send_control(bytes);
    }

    /// Appends a message. A `Hello` shows the token, if there is one.
    fn encode(&self, message: &ClientMessage, bytes: &mut Vec<u8>) {
        let mut message = message.clone();
        if let (Some(token), ClientMessage::Hello { extensions, .. }) = (&self.token, &mut message)
        {
            // A case that shows a token of its own, or fills the list, means what it sends.
            let _ = extensions.insert(token.extension());
        }
        message.encode(bytes);
    }

    /// Sends a datagram.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when the peer does not accept a datagram of this length.
    pub fn send_datagram(&mut self, bytes: &[u8]) -> CaseResult {
        self.log.note(format!("> datagram {}", hex(bytes)));
        if self.connection.send_datagram(bytes.to_vec())
            || self.connection.datagram_bytes_max() >= Some(bytes.len())
        {
            Ok(())
        } else {
            Stop::fail(format!(
                "the peer accepts datagrams of {:?} bytes, not of {}",
                self.connection.datagram_bytes_max(),
                bytes.len()
            ))
        }
    }

    /// Processes one event, waiting for it until a moment; `false` if there was none or the connection is over.
    fn take_in(&mut self, until: Instant) -> Result<bool, Stop> {
        if self.ended.is_some() {
            return Ok(false);
        }
        match self.connection.next_event(self.clock.until(until)) {
            None => return Ok(false),
            Some(RawEvent::Control(bytes)) => self.read(&bytes)?,
            Some(RawEvent::Datagram(bytes)) => {
                self.log.note(format!("< datagram {}", hex(&bytes)));
                self.datagrams.push_back(bytes);
            }
            Some(RawEvent::Ended(end)) => {
                self.log.note(format!("< {end}"));
                self.ended = Some(end);
            }
            Some(RawEvent::Opened { both_ways }) => {
                return Stop::fail(format!(
                    "the server must not open a stream (1.1-3); bidirectional: {both_ways}"
                ));
            }
            Some(RawEvent::ControlFinished) => self.log.note("< the control stream's end"),
            Some(RawEvent::ControlReset(code)) => {
                self.log
                    .note(format!("< the control stream is reset with {code}"));
            }
        }
        Ok(true)
    }

    fn read(&mut self, bytes: &[u8]) -> CaseResult {
        self.frames.push(bytes);
        loop {
            let malformed = |why| Stop::Fail(format!("the server sends malformed bytes: {why:?}"));
            let Some(framed) = self.frames.next_frame().map_err(malformed)? else {
                return Ok(());
            };
            let Some(message) = ServerMessage::decode(&framed).map_err(malformed)? else {
                self.log
                    .note(format!("< unassigned type {:#x}", framed.kind));
                self.greased.push(framed.kind);
                continue;
            };
            self.log.note(format!("< {message:?}"));
            match message {
                ServerMessage::Created => {
                    self.scenes.borrow_mut().insert(self.scene.clone());
                }
                ServerMessage::Deleted => {
                    self.scenes.borrow_mut().remove(&self.scene);
                }
                _ => {}
            }
            self.received.push_back(message);
        }
    }

    /// The end of a default time limit that starts now.
    fn time_limit(&self) -> Instant {
        let ns = u64::try_from(self.timeout.as_nanos()).unwrap_or(u64::MAX);
        self.clock.now() + Span::from_nanos(ns)
    }

    /// The next message, if one comes in time.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when what comes is malformed.
    pub fn next_message(&mut self) -> Result<Option<ServerMessage>, Stop> {
        let until = self.time_limit();
        while self.received.is_empty() && self.take_in(until)? {}
        Ok(self.received.pop_front())
    }

    /// The next datagram, if one comes in time.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when what comes on the control stream is malformed.
    pub fn next_datagram(&mut self) -> Result<Option<Bytes>, Stop> {
        let until = self.time_limit();
        while self.datagrams.is_empty() && self.take_in(until)? {}
        Ok(self.datagrams.pop_front())
    }

    /// Processes all that has come, without waiting.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when what came on the control stream is malformed.
    pub fn take_in_all(&mut self) -> CaseResult {
        while self.take_in(self.clock.now())? {}
        Ok(())
    }

    /// The next message that `wanted` accepts; earlier ones are skipped.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when none comes in time.
    pub fn await_message<T>(
        &mut self,
        what: &str,
        mut wanted: impl FnMut(ServerMessage) -> Option<T>,
    ) -> Result<T, Stop> {
        let until = self.time_limit();
        loop {
            while let Some(message) = self.received.pop_front() {
                if let Some(found) = wanted(message) {
                    return Ok(found);
                }
            }
            if !self.take_in(until)? && self.received.is_empty() {
                return Stop::fail(match &self.ended {
                    Some(end) => format!("no {what}: {end}"),
                    None => format!("no {what} within {:?}", self.timeout),
                });
            }
        }
    }

    /// Sends a `Ping` and returns all messages received before its `Pong`.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when there is no answer.
    pub fn barrier(&mut self) -> Result<Vec<ServerMessage>, Stop> {
        let sent = Instant::from_nanos(0x5eed_0000 + self.clock.now().as_nanos() % 0x10000);
        self.send(&ClientMessage::Ping { sent });
        let mut before = Vec::new();
        self.await_message(
            "pong: the server has stopped answering",
            |message| match message {
                ServerMessage::Pong { sent: back, .. } if back == sent => Some(()),
                other => {
                    before.push(other);
                    None
                }
            },
        )?;
        Ok(before)
    }

    /// Sends `Hello` and waits for `Welcome`.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when no `Welcome` comes.
    pub fn hello(&mut self) -> Result<Welcome, Stop> {
        self.send(&ClientMessage::Hello {
            versions: vec![1],
            scene: self.scene.clone(),
            extensions: Extensions::NONE,
        });
        self.await_message("welcome", |message| match message {
            ServerMessage::Welcome(welcome) => Some(welcome),
            _ => None,
        })
    }

    /// Creates the scene.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is denied, or when no answer comes.
    pub fn create(&mut self, config: SceneConfig) -> CaseResult {
        self.send(&ClientMessage::Create(config));
        self.await_message(
            "answer to create",
            answer(|message| matches!(message, ServerMessage::Created)),
        )?
        .or_else(|denial| Stop::fail(format!("a scene cannot be created: {denial}")))
    }

    /// Becomes a member and receives the whole snapshot.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is denied, or when the snapshot is malformed.
    pub fn join(&mut self, choice: StreamChoice) -> Result<(Joined, Vec<SceneEvent>), Stop> {
        self.send(&ClientMessage::Join(choice));
        let (joined, scene_events) = self.snapshot()?;
        self.granted = joined.granted;
        self.commands = 0;
        Ok((joined, scene_events))
    }

    /// Receives the next `Joined` and its snapshot.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not come, or when it contains other messages.
    pub fn snapshot(&mut self) -> Result<(Joined, Vec<SceneEvent>), Stop> {
        let joined = self.await_message("snapshot", |message| match message {
            ServerMessage::Joined(joined) => Some(Ok(joined)),
            ServerMessage::Denied(denial) => Some(Stop::fail(format!("denied: {denial}"))),
            _ => None,
        })??;
        let mut scene_events = Vec::new();
        loop {
            let next = self.await_message("end of the snapshot", Some)?;
            match next {
                ServerMessage::SceneEvent(scene_event) => scene_events.push(scene_event),
                ServerMessage::SnapshotEnd => return Ok((joined, scene_events)),
                other => {
                    return Stop::fail(format!(
                        "a snapshot contains scene events only (4.8-2), not {other:?}"
                    ));
                }
            }
        }
    }

    /// Sends hello, creates the scene and joins it.
    ///
    /// # Errors
    ///
    /// As those three calls.
    pub fn enter(&mut self, config: SceneConfig, choice: StreamChoice) -> Result<Joined, Stop> {
        self.hello()?;
        self.create(config)?;
        self.join(choice).map(|(joined, _)| joined)
    }

    /// Sends a command and waits for its outcome.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when no answer comes.
    pub fn command(&mut self, command: Command) -> Result<Result<Tick, CommandError>, Stop> {
        self.send(&ClientMessage::Command(command));
        self.outcome_of(self.commands - 1)
    }

    /// Waits for the outcome of the command of this number.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when no answer comes.
    pub fn outcome_of(&mut self, number: u64) -> Result<Result<Tick, CommandError>, Stop> {
        let mut refused = None;
        let tick = self.await_message("answer to a command", |message| match message {
            ServerMessage::Refused { number: of, error } if of == number => {
                refused = Some(error);
                None
            }
            ServerMessage::Applied { through, tick } if through >= number => Some(tick),
            _ => None,
        })?;
        Ok(refused.map_or(Ok(tick), Err))
    }

    /// Sends a command that must be applied; returns its tick.
    ///
    /// # Errors
    ///
    /// [`Stop::refused`] when it is refused.
    pub fn must(&mut self, command: Command) -> Result<Tick, Stop> {
        let sent = command.clone();
        self.command(command)?
            .map_err(|error| Stop::refused(&sent, &error))
    }

    /// Deletes the scene.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is denied.
    pub fn delete(&mut self) -> CaseResult {
        self.send(&ClientMessage::Delete);
        self.await_message(
            "answer to delete",
            answer(|message| matches!(message, ServerMessage::Deleted)),
        )?
        .or_else(|denial| Stop::fail(format!("a scene cannot be deleted: {denial}")))
    }

    /// Requires that the server closes the connection; another code than this one is recorded as the closing verdict.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when the connection stays open, or is lost without a close.
    pub fn must_be_closed(&mut self, code: CloseCode) -> CaseResult {
        self.must_be_closed_with(&[u64::from(code.0)])
    }

    /// The same with several acceptable codes.
    ///
    /// # Errors
    ///
    /// As [`Self::must_be_closed`].
    pub fn must_be_closed_with(&mut self, codes: &[u64]) -> CaseResult {
        let until = self.time_limit();
        while self.take_in(until)? {}
        let (closing, play) = match &self.ended {
            None => {
                let why =
                    format!("the server keeps the connection; it must close with one of {codes:?}");
                (Closing::Unclean("it stays open".into()), Stop::fail(why))
            }
            Some(RawPeerEnd::Closed(received)) if codes.contains(received) => {
                (Closing::Clean, Ok(()))
            }
            Some(RawPeerEnd::Closed(received)) => {
                let (wanted, received) = (codes.to_vec(), *received);
                (Closing::WrongCode { wanted, received }, Ok(()))
            }
            Some(other) => (Closing::Unclean(other.to_string()), Ok(())),
        };
        *self.closing.borrow_mut() = closing;
        play
    }

    /// Hands the connection over to a [`LossyClient`](super::LossyClient).
    pub(super) fn into_parts(self) -> Parts {
        Parts {
            connection: self.connection,
            scene: self.scene,
            timeout: self.timeout,
            log: self.log,
            scenes: self.scenes,
            relay: self._relay,
        }
    }
}

/// The parts that a [`LossyClient`](super::LossyClient) takes over.
pub(super) struct Parts {
    pub(super) connection: RawConnection,
    pub(super) scene: SceneName,
    pub(super) timeout: Duration,
    pub(super) log: Log,
    pub(super) scenes: Rc<RefCell<BTreeSet<SceneName>>>,
    pub(super) relay: Option<UdpRelay>,
}

/// The answer to a request: the message that `yes` accepts, or a denial.
fn answer(
    yes: impl Fn(&ServerMessage) -> bool,
) -> impl FnMut(ServerMessage) -> Option<Result<(), Denial>> {
    move |message| match message {
        ServerMessage::Denied(denial) => Some(Err(denial)),
        other => yes(&other).then_some(Ok(())),
    }
}
