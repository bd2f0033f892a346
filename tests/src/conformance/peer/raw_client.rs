//! A client made of bytes: says what a case wants, waits for what must come.
//!
//! Keeps no copy of a scene; see `follower` for one that does. What a server says that is not of the protocol fails the case
//! at once, whatever the case is about.

use std::cell::RefCell;
use std::collections::{BTreeSet, VecDeque};
use std::rc::Rc;
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::message::{
    ClientMessage, Denial, Extensions, Frames, Joined, SceneEvent, ServerMessage, StreamChoice,
    Welcome,
};
use rhumb_protocol::scene::{Command, CommandError, IdRange, SceneConfig, SceneName};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tick;
use rhumb_transport::{Clock, RawConnection, RawEvent, RawPeerEnd, UdpRelay};

use crate::conformance::outcome::{CaseResult, Closing, Stop};
use crate::conformance::trial::Log;
use crate::grammar::hex;

/// A client made of bytes.
#[derive(Debug)]
pub struct RawClient {
    /// The connection itself.
    pub line: RawConnection,
    /// What its connection is about.
    pub scene: SceneName,
    /// What it was granted, as a member.
    pub granted: IdRange,
    /// Commands that it said, as a member.
    pub commands: u64,
    /// Datagrams received and not taken yet.
    pub datagrams: VecDeque<Bytes>,
    /// How the connection ended, if it did.
    pub ended: Option<RawPeerEnd>,
    /// Types of messages that nobody need know, as they came.
    pub greased: Vec<u8>,
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
    pub(in crate::conformance) fn new(
        line: RawConnection,
        relay: Option<UdpRelay>,
        scene: SceneName,
        timeout: Duration,
        log: Log,
        closing: Rc<RefCell<Closing>>,
        scenes: Rc<RefCell<BTreeSet<SceneName>>>,
    ) -> Self {
        Self {
            line,
            scene,
            granted: IdRange::EMPTY,
            commands: 0,
            datagrams: VecDeque::new(),
            ended: None,
            greased: Vec::new(),
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

    /// Says bytes on the control stream.
    pub fn utter(&mut self, bytes: &[u8]) {
        self.log.note(format!("> {}", hex(bytes)));
        self.line.say(bytes.to_vec());
    }

    /// Says a message.
    pub fn say(&mut self, message: &ClientMessage) {
        self.log.note(format!("> {message:?}"));
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        self.line.say(bytes);
        if matches!(message, ClientMessage::Command(_)) {
            self.commands += 1;
        }
    }

    /// Says messages in one piece.
    pub fn say_together(&mut self, messages: &[ClientMessage]) {
        let mut bytes = Vec::new();
        for message in messages {
            self.log.note(format!("> {message:?}"));
            message.encode(&mut bytes);
            self.commands += u64::from(matches!(message, ClientMessage::Command(_)));
        }
        self.line.say(bytes);
    }

    /// Sends a datagram.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when the peer does not take one so long.
    pub fn throw(&mut self, bytes: &[u8]) -> CaseResult {
        self.log.note(format!("> datagram {}", hex(bytes)));
        if self.line.datagram(bytes.to_vec()) || self.line.datagram_bytes_max() >= Some(bytes.len())
        {
            Ok(())
        } else {
            Stop::fail(format!(
                "the peer takes datagrams of {:?} bytes, and not of {}",
                self.line.datagram_bytes_max(),
                bytes.len()
            ))
        }
    }

    /// Takes in one thing that was seen, waiting for it until a moment; `false` when nothing was, or the connection is over.
    fn take_in(&mut self, until: Instant) -> Result<bool, Stop> {
        if self.ended.is_some() {
            return Ok(false);
        }
        match self.line.hear(self.clock.until(until)) {
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
                    "a server opens no stream (1.1-3); both ways: {both_ways}"
                ));
            }
            Some(RawEvent::ControlFinished) => self.log.note("< the control stream's end"),
            Some(RawEvent::ControlReset(code)) => {
                self.log
                    .note(format!("< the control stream is broken off with {code}"));
            }
        }
        Ok(true)
    }

    fn read(&mut self, bytes: &[u8]) -> CaseResult {
        self.frames.push(bytes);
        loop {
            let malformed = |why| Stop::Fail(format!("the server says what is malformed: {why:?}"));
            let Some(framed) = self.frames.next_frame().map_err(malformed)? else {
                return Ok(());
            };
            let Some(message) = ServerMessage::decode(&framed).map_err(malformed)? else {
                self.log
                    .note(format!("< type {:#x}, which nobody need know", framed.kind));
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

    /// Until when a wait that begins now lasts.
    fn patience(&self) -> Instant {
        let ns = u64::try_from(self.timeout.as_nanos()).unwrap_or(u64::MAX);
        self.clock.now() + Span::from_nanos(ns)
    }

    /// The next message, if one comes in time.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when what comes is malformed.
    pub fn next_message(&mut self) -> Result<Option<ServerMessage>, Stop> {
        let until = self.patience();
        while self.received.is_empty() && self.take_in(until)? {}
        Ok(self.received.pop_front())
    }

    /// The next datagram, if one comes in time.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when what comes on the control stream is malformed.
    pub fn next_datagram(&mut self) -> Result<Option<Bytes>, Stop> {
        let until = self.patience();
        while self.datagrams.is_empty() && self.take_in(until)? {}
        Ok(self.datagrams.pop_front())
    }

    /// The next message that is what is awaited; others that come before are passed over.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when none comes in time.
    pub fn await_message<T>(
        &mut self,
        what: &str,
        mut is: impl FnMut(ServerMessage) -> Option<T>,
    ) -> Result<T, Stop> {
        let until = self.patience();
        loop {
            while let Some(message) = self.received.pop_front() {
                if let Some(found) = is(message) {
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

    /// All that came before the answer to a `Ping` said now.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when there is no answer.
    pub fn barrier(&mut self) -> Result<Vec<ServerMessage>, Stop> {
        let sent = Instant::from_nanos(0x5eed_0000 + self.clock.now().as_nanos() % 0x10000);
        self.say(&ClientMessage::Ping { sent });
        let mut before = Vec::new();
        self.await_message(
            "pong: the conversation does not go on",
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

    /// Says hello and is welcomed.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is not.
    pub fn hello(&mut self) -> Result<Welcome, Stop> {
        self.say(&ClientMessage::Hello {
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
    /// [`Stop::Fail`] when it is denied, or nothing comes.
    pub fn create(&mut self, config: SceneConfig) -> CaseResult {
        self.say(&ClientMessage::Create(config));
        self.await_message(
            "answer to create",
            answer(|message| matches!(message, ServerMessage::Created)),
        )?
        .or_else(|denial| Stop::fail(format!("a scene cannot be created: {denial}")))
    }

    /// Becomes a member, and hears the whole snapshot.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is denied, or what comes is no snapshot.
    pub fn join(&mut self, choice: StreamChoice) -> Result<(Joined, Vec<SceneEvent>), Stop> {
        self.say(&ClientMessage::Join(choice));
        let (joined, scene_events) = self.snapshot()?;
        self.granted = joined.granted;
        self.commands = 0;
        Ok((joined, scene_events))
    }

    /// The next `Joined` and its snapshot.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not come, or something else stands in it.
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
                        "a snapshot holds scene_events (4.8-2), not {other:?}"
                    ));
                }
            }
        }
    }

    /// Greets, creates the scene and joins it.
    ///
    /// # Errors
    ///
    /// As those three.
    pub fn enter(&mut self, config: SceneConfig, choice: StreamChoice) -> Result<Joined, Stop> {
        self.hello()?;
        self.create(config)?;
        self.join(choice).map(|(joined, _)| joined)
    }

    /// Commands, and waits for what came of it.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when no answer comes.
    pub fn command(&mut self, command: Command) -> Result<Result<Tick, CommandError>, Stop> {
        self.say(&ClientMessage::Command(command));
        self.outcome_of(self.commands - 1)
    }

    /// What came of the command of this number.
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

    /// Commands what must be applied.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is refused.
    pub fn must(&mut self, command: Command) -> Result<Tick, Stop> {
        let said = format!("{command:?}");
        self.command(command)?
            .map_err(|error| Stop::Fail(format!("{said} is refused: {error}")))
    }

    /// Deletes the scene.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is not.
    pub fn delete(&mut self) -> CaseResult {
        self.say(&ClientMessage::Delete);
        self.await_message(
            "answer to delete",
            answer(|message| matches!(message, ServerMessage::Deleted)),
        )?
        .or_else(|denial| Stop::fail(format!("a scene cannot be deleted: {denial}")))
    }

    /// That the server ends the connection, whatever it says before; another code than this is noted as the closing verdict.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it stays, or vanishes without a word.
    pub fn must_be_closed(&mut self, code: CloseCode) -> CaseResult {
        self.must_be_closed_with(&[u64::from(code.0)])
    }

    /// The same where several codes would do.
    ///
    /// # Errors
    ///
    /// As [`Self::must_be_closed`].
    pub fn must_be_closed_with(&mut self, codes: &[u64]) -> CaseResult {
        let until = self.patience();
        while self.take_in(until)? {}
        let (closing, play) = match &self.ended {
            None => {
                let why = format!("the server goes on; it must close with {codes:?}");
                (Closing::Unclean("it stays open".into()), Stop::fail(why))
            }
            Some(RawPeerEnd::Closed(seen)) if codes.contains(seen) => (Closing::Clean, Ok(())),
            Some(RawPeerEnd::Closed(seen)) => {
                let (wanted, seen) = (codes.to_vec(), *seen);
                (Closing::WrongCode { wanted, seen }, Ok(()))
            }
            Some(other) => (Closing::Unclean(other.to_string()), Ok(())),
        };
        *self.closing.borrow_mut() = closing;
        play
    }

    /// Leaves the connection to who follows by it.
    pub(super) fn into_parts(self) -> Parts {
        Parts {
            line: self.line,
            scene: self.scene,
            timeout: self.timeout,
            log: self.log,
            scenes: self.scenes,
            relay: self._relay,
        }
    }
}

/// What a follower takes over.
pub(super) struct Parts {
    pub(super) line: RawConnection,
    pub(super) scene: SceneName,
    pub(super) timeout: Duration,
    pub(super) log: Log,
    pub(super) scenes: Rc<RefCell<BTreeSet<SceneName>>>,
    pub(super) relay: Option<UdpRelay>,
}

/// The answer to a request: what is said for yes, or a denial.
fn answer(
    yes: impl Fn(&ServerMessage) -> bool,
) -> impl FnMut(ServerMessage) -> Option<Result<(), Denial>> {
    move |message| match message {
        ServerMessage::Denied(denial) => Some(Err(denial)),
        other => yes(&other).then_some(Ok(())),
    }
}
