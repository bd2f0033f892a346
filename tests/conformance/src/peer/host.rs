//! A raw server, and the client under test started against it.
//!
//! The server sends only the bytes of the case; each case checks the client's reaction.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

use bytes::Bytes;
use rhumb_netsim::{RawConnection, RawEvent, RawPeerConfig, RawPeerEnd, RawPeerServer, UdpRelay};
use rhumb_protocol::message::{ClientMessage, Frames, ServerMessage};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Span};
use rhumb_transport::{Certificate, Clock, Fingerprint};
use serde_json::Value;

use super::client_process::{ClientEnvironment, ClientProcess, reported};
use crate::conditions::{Conditions, Subject};
use crate::grammar::hex;
use crate::log::Log;
use crate::outcome::{CaseResult, Closing, Stop};

/// A raw server, and the client under test.
#[derive(Debug)]
pub struct RawServer {
    /// The connection that the client opened.
    pub connection: RawConnection,
    /// Received datagrams that the case has not taken yet.
    pub datagrams: VecDeque<Bytes>,
    /// The end of the connection, if it has ended.
    pub ended: Option<RawPeerEnd>,
    /// Received bytes of the control stream that the case has not taken yet.
    pub control_bytes: VecDeque<Bytes>,
    /// Streams that the client opened; `true` for bidirectional ones.
    pub opened: Vec<bool>,
    /// Types of received optional messages that the protocol does not assign, in order.
    pub greased: Vec<u8>,
    frames: Frames,
    received: VecDeque<ClientMessage>,
    client: ClientProcess,
    /// Kept alive for its thread, which owns the connection.
    _server: RawPeerServer,
    _relay: Option<UdpRelay>,
    timeout: Duration,
    clock: Clock,
    log: Log,
    closing: Rc<RefCell<Closing>>,
}

impl RawServer {
    pub(crate) fn start(
        conditions: &Conditions,
        case: &str,
        task: &str,
        pinned: Option<Fingerprint>,
        log: Log,
        closing: Rc<RefCell<Closing>>,
    ) -> Result<Self, Stop> {
        let Subject::Client { listen, ref exec } = conditions.subject else {
            return Err(Stop::Inconclusive("this case is for a client".into()));
        };
        let inconclusive = |error: &dyn std::fmt::Display| Stop::Inconclusive(error.to_string());
        let certificate = Certificate::development(["localhost", "127.0.0.1", "::1"]);
        let certificate = certificate.map_err(|error| inconclusive(&error))?;
        let server = RawPeerServer::listen(listen, &certificate, &RawPeerConfig::default());
        let server = server.map_err(|error| inconclusive(&error))?;
        let relay = conditions.relay(server.address(), 0)?;
        let pinned = pinned.unwrap_or_else(|| server.fingerprint());
        let environment = ClientEnvironment {
            server: relay
                .as_ref()
                .map_or_else(|| server.address(), UdpRelay::local_addr),
            fingerprint: pinned,
            scene: format!("conformance/{}", case),
            task,
            case,
            seed: conditions.seed,
            token: conditions.token.as_ref(),
        };
        let mut client = ClientProcess::start(exec, &environment, log.clone())
            .map_err(|error| inconclusive(&error))?;
        let connection = client.connected(&server, conditions.timeout * 5)?;
        Ok(Self {
            connection,
            datagrams: VecDeque::new(),
            ended: None,
            control_bytes: VecDeque::new(),
            opened: Vec::new(),
            greased: Vec::new(),
            frames: Frames::new(),
            received: VecDeque::new(),
            client,
            _server: server,
            _relay: relay,
            timeout: conditions.timeout,
            clock: Clock::start(),
            log,
            closing,
        })
    }

    /// Sends bytes on the control stream.
    pub fn send_bytes(&mut self, bytes: &[u8]) {
        self.log.note(format!("> {}", hex(bytes)));
        self.connection.send_control(bytes.to_vec());
    }

    /// Sends a message.
    pub fn send(&mut self, message: &ServerMessage) {
        self.log.note(format!("> {message:?}"));
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        self.connection.send_control(bytes);
    }

    /// Sends a datagram.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when the client does not accept a datagram of this length.
    pub fn send_datagram(&mut self, bytes: &[u8]) -> CaseResult {
        self.log.note(format!("> datagram {}", hex(bytes)));
        if self.connection.send_datagram(bytes.to_vec()) {
            Ok(())
        } else {
            Stop::fail(format!(
                "the client does not accept datagrams of {} bytes",
                bytes.len()
            ))
        }
    }

    /// Lets every later wait take longer, for a case in which data crosses the link many times.
    pub fn wait_longer(&mut self, by: Duration) {
        self.timeout += by;
    }

    /// The end of a default time limit that starts now.
    pub(super) fn time_limit(&self) -> Instant {
        let ns = u64::try_from(self.timeout.as_nanos()).unwrap_or(u64::MAX);
        self.clock.now() + Span::from_nanos(ns)
    }

    /// The current time.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.clock.now()
    }

    /// Adds a line to the log.
    pub(super) fn note(&self, line: impl Into<String>) {
        self.log.note(line);
    }

    /// Processes one event, waiting for it until a moment; `false` if there was none or the connection is over.
    pub(super) fn take_in(&mut self, until: Instant) -> Result<bool, Stop> {
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
                self.opened.push(both_ways);
                self.log.note(format!("< a stream, both ways: {both_ways}"));
            }
            Some(RawEvent::ControlFinished | RawEvent::ControlReset(_)) => {
                self.log.note("< the control stream's end");
            }
        }
        Ok(true)
    }

    fn read(&mut self, bytes: &[u8]) -> CaseResult {
        self.control_bytes.push_back(Bytes::copy_from_slice(bytes));
        self.frames.push(bytes);
        let malformed = |why| Stop::Fail(format!("the client sends malformed bytes: {why:?}"));
        while let Some(framed) = self.frames.next_frame().map_err(malformed)? {
            if let Some(message) = ClientMessage::decode(&framed).map_err(malformed)? {
                self.log.note(format!("< {message:?}"));
                self.received.push_back(message);
            } else {
                self.greased.push(framed.kind);
            }
        }
        Ok(())
    }

    /// The next message that `wanted` accepts; earlier ones are skipped.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when none comes in time; [`Stop::Unsupported`] when the client has declared so.
    pub fn await_message<T>(
        &mut self,
        what: &str,
        mut wanted: impl FnMut(ClientMessage) -> Option<T>,
    ) -> Result<T, Stop> {
        let until = self.time_limit();
        loop {
            while let Some(message) = self.received.pop_front() {
                if let Some(found) = wanted(message) {
                    return Ok(found);
                }
            }
            if !self.take_in(until)? && self.received.is_empty() {
                self.must_be_supported()?;
                return Stop::fail(format!("no {what}: {:?}", self.ended));
            }
        }
    }

    /// All messages of the client until it is silent for this long.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it sends malformed bytes.
    pub fn listen(&mut self, silence: Duration) -> Result<Vec<ClientMessage>, Stop> {
        let ns = u64::try_from(silence.as_nanos()).unwrap_or(u64::MAX);
        loop {
            let until = self.clock.now() + Span::from_nanos(ns);
            if !self.take_in(until)? {
                return Ok(self.received.drain(..).collect());
            }
        }
    }

    /// The next datagram that the client sends, if one comes in time.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it sends malformed bytes.
    pub fn next_datagram(&mut self) -> Result<Option<Bytes>, Stop> {
        let until = self.time_limit();
        while self.datagrams.is_empty() && self.take_in(until)? {}
        Ok(self.datagrams.pop_front())
    }

    /// The reports that the client wrote since the last call.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when a line is not a JSON object.
    pub fn lines_written(&mut self) -> Result<Vec<Value>, Stop> {
        let lines: Vec<_> = self.client.lines.try_iter().collect();
        lines
            .into_iter()
            .map(|line| self.read_line(&line))
            .collect()
    }

    /// The next report of the client, if one comes in time.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is not a JSON object.
    pub fn next_line(&mut self) -> Result<Option<Value>, Stop> {
        let line = self.client.lines.recv_timeout(self.timeout).ok();
        line.map(|line| self.read_line(&line)).transpose()
    }

    fn read_line(&self, line: &str) -> Result<Value, Stop> {
        self.log.note(format!("< line {line}"));
        reported(line)
    }

    /// Stops the case if the client's process has ended and declared the feature unsupported.
    ///
    /// # Errors
    ///
    /// [`Stop::Unsupported`] then; [`Stop::Fail`] if the feature is mandatory.
    pub fn must_be_supported(&mut self) -> CaseResult {
        self.client.gave_up().map_or(Ok(()), Err)
    }

    /// True if the client closed the connection with this code.
    #[must_use]
    pub fn ended_as(&self, code: u64) -> bool {
        self.ended == Some(RawPeerEnd::Closed(code))
    }

    /// Requires that the client's process exits by itself.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not.
    pub fn must_exit(&mut self) -> CaseResult {
        let until = self.time_limit();
        while self.clock.now() < until {
            if self.client.has_ended() {
                return Ok(());
            }
            let next = self.clock.now() + Span::from_millis(5);
            if !self.take_in(next)? && self.ended.is_some() {
                // The connection gives no more events, so wait for a report instead.
                let _ = self.client.lines.recv_timeout(Duration::from_millis(5));
            }
        }
        Stop::fail("the client's process does not exit after the end of its connection")
    }

    /// Requires that the client closes the connection; another code than this one is recorded as the closing verdict.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it keeps the connection open.
    pub fn must_be_closed(&mut self, code: CloseCode) -> CaseResult {
        let until = self.time_limit();
        while self.take_in(until)? {}
        let code = u64::from(code.0);
        let (closing, play) = match &self.ended {
            None => {
                let why = format!("the client keeps the connection; it must close with {code}");
                (Closing::Unclean("it stays open".into()), Stop::fail(why))
            }
            Some(RawPeerEnd::Closed(received)) if *received == code => (Closing::Clean, Ok(())),
            Some(RawPeerEnd::Closed(received)) => {
                let (wanted, received) = (vec![code], *received);
                (Closing::WrongCode { wanted, received }, Ok(()))
            }
            Some(other) => (Closing::Unclean(other.to_string()), Ok(())),
        };
        *self.closing.borrow_mut() = closing;
        play
    }
}
