//! A server made of bytes, and the client under test started against it.
//!
//! What the client is started with, and the lines that it writes, are described in `docs/implementing.md`: in short, its
//! environment has `RHUMB_ADDR`, `RHUMB_FINGERPRINT`, `RHUMB_SCENE`, `RHUMB_CASE`, `RHUMB_SEED`, and it writes a JSON object a
//! line. Exit code 127 says *unsupported*.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::io::{BufRead, BufReader};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::rc::Rc;
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::message::{ClientMessage, Frames, ServerMessage};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Span};
use rhumb_transport::{BareEnd, BareLine, BareServer, BareTerms, Certificate, Clock, Seen};

use crate::conformance::case::Case;
use crate::conformance::outcome::{Closing, Play, Stop};
use crate::conformance::trial::{Conditions, Log, Subject};
use crate::grammar::hex;

/// What a client says by its exit code that it does not have what a case tries.
const UNSUPPORTED: i32 = 127;

/// A server made of bytes, and the client under test.
#[derive(Debug)]
pub struct Host {
    /// The connection that the client opened.
    pub line: BareLine,
    /// Datagrams heard and not taken yet.
    pub datagrams: VecDeque<Bytes>,
    /// How the connection ended, if it did.
    pub ended: Option<BareEnd>,
    frames: Frames,
    heard: VecDeque<ClientMessage>,
    client: Running,
    /// Kept for its thread, on which the line lives.
    _server: BareServer,
    timeout: Duration,
    clock: Clock,
    log: Log,
    closing: Rc<RefCell<Closing>>,
}

/// The client's process, killed when dropped.
#[derive(Debug)]
struct Running {
    child: Child,
    lines: Receiver<String>,
}

impl Host {
    pub(in crate::conformance) fn start(
        conditions: &Conditions,
        case: &Case,
        log: Log,
        closing: Rc<RefCell<Closing>>,
    ) -> Result<Self, Stop> {
        let Subject::Client { listen, ref exec } = conditions.subject else {
            return Err(Stop::Inconclusive("this case is for a client".into()));
        };
        let inconclusive = |error: &dyn std::fmt::Display| Stop::Inconclusive(error.to_string());
        let certificate = Certificate::development(["localhost", "127.0.0.1", "::1"]);
        let certificate = certificate.map_err(|error| inconclusive(&error))?;
        let server = BareServer::listen(listen, &certificate, &BareTerms::default());
        let server = server.map_err(|error| inconclusive(&error))?;
        let mut client = Running::start(exec, &server, conditions, case)
            .map_err(|error| inconclusive(&error))?;
        let line = match server.accept(conditions.timeout * 5) {
            Some(line) => line.map_err(|error| Stop::Fail(format!("no connection: {error}")))?,
            None => return Err(client.why_not()),
        };
        Ok(Self {
            line,
            datagrams: VecDeque::new(),
            ended: None,
            frames: Frames::new(),
            heard: VecDeque::new(),
            client,
            _server: server,
            timeout: conditions.timeout,
            clock: Clock::start(),
            log,
            closing,
        })
    }

    /// Says bytes on the control stream.
    pub fn utter(&mut self, bytes: &[u8]) {
        self.log.note(format!("> {}", hex(bytes)));
        self.line.say(bytes.to_vec());
    }

    /// Says a message.
    pub fn say(&mut self, message: &ServerMessage) {
        self.log.note(format!("> {message:?}"));
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        self.line.say(bytes);
    }

    /// Sends a datagram.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when the client does not take one so long.
    pub fn throw(&mut self, bytes: &[u8]) -> Play {
        self.log.note(format!("> datagram {}", hex(bytes)));
        if self.line.datagram(bytes.to_vec()) {
            Ok(())
        } else {
            Stop::fail(format!(
                "the client takes no datagrams of {} bytes",
                bytes.len()
            ))
        }
    }

    fn patience(&self) -> Instant {
        let ns = u64::try_from(self.timeout.as_nanos()).unwrap_or(u64::MAX);
        self.clock.now() + Span::from_nanos(ns)
    }

    fn take_in(&mut self, until: Instant) -> Result<bool, Stop> {
        if self.ended.is_some() {
            return Ok(false);
        }
        match self.line.hear(self.clock.until(until)) {
            None => return Ok(false),
            Some(Seen::Control(bytes)) => self.read(&bytes)?,
            Some(Seen::Datagram(bytes)) => {
                self.log.note(format!("< datagram {}", hex(&bytes)));
                self.datagrams.push_back(bytes);
            }
            Some(Seen::Ended(end)) => {
                self.log.note(format!("< {end}"));
                self.ended = Some(end);
            }
            Some(Seen::Opened { both_ways }) => {
                self.log.note(format!("< a stream, both ways: {both_ways}"));
            }
            Some(Seen::ControlFinished | Seen::ControlReset(_)) => {
                self.log.note("< the control stream's end");
            }
        }
        Ok(true)
    }

    fn read(&mut self, bytes: &[u8]) -> Play {
        self.frames.push(bytes);
        let malformed = |why| Stop::Fail(format!("the client says what is malformed: {why:?}"));
        while let Some(framed) = self.frames.next_frame().map_err(malformed)? {
            if let Some(message) = ClientMessage::decode(&framed).map_err(malformed)? {
                self.log.note(format!("< {message:?}"));
                self.heard.push_back(message);
            }
        }
        Ok(())
    }

    /// The next message that is what is awaited; others that come before are passed over.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when none comes in time; [`Stop::Unsupported`] when the client has said so.
    pub fn await_message<T>(
        &mut self,
        what: &str,
        mut is: impl FnMut(ClientMessage) -> Option<T>,
    ) -> Result<T, Stop> {
        let until = self.patience();
        loop {
            while let Some(message) = self.heard.pop_front() {
                if let Some(found) = is(message) {
                    return Ok(found);
                }
            }
            if !self.take_in(until)? && self.heard.is_empty() {
                if self.client.has_given_up() {
                    return Err(Stop::Unsupported("the client's exit code says so".into()));
                }
                return Stop::fail(format!("no {what}: {:?}", self.ended));
            }
        }
    }

    /// The next line that the client wrote, if one comes in time.
    #[must_use]
    pub fn line_written(&mut self) -> Option<String> {
        let line = self.client.lines.recv_timeout(self.timeout).ok();
        self.log.note(format!("< line {line:?}"));
        line
    }

    /// That the client ends the connection; another code than this is noted as the closing verdict.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it stays.
    pub fn must_be_closed(&mut self, code: CloseCode) -> Play {
        let until = self.patience();
        while self.take_in(until)? {}
        let code = u64::from(code.0);
        let (closing, play) = match &self.ended {
            None => {
                let why = format!("the client goes on; it must close with {code}");
                (Closing::Unclean("it stays open".into()), Stop::fail(why))
            }
            Some(BareEnd::Closed(seen)) if *seen == code => (Closing::Clean, Ok(())),
            Some(BareEnd::Closed(seen)) => {
                let (wanted, seen) = (vec![code], *seen);
                (Closing::WrongCode { wanted, seen }, Ok(()))
            }
            Some(other) => (Closing::Unclean(other.to_string()), Ok(())),
        };
        *self.closing.borrow_mut() = closing;
        play
    }
}

impl Running {
    fn start(
        exec: &str,
        server: &BareServer,
        conditions: &Conditions,
        case: &Case,
    ) -> std::io::Result<Self> {
        let mut child = Command::new("sh")
            .args(["-c", &format!("exec {exec}")])
            .env("RHUMB_ADDR", server.address().to_string())
            .env("RHUMB_FINGERPRINT", server.fingerprint().to_string())
            .env("RHUMB_SCENE", format!("conformance/{}", case.id))
            .env("RHUMB_CASE", &case.id)
            .env("RHUMB_SEED", conditions.seed.to_string())
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()?;
        let (written, lines) = mpsc::channel();
        if let Some(out) = child.stdout.take() {
            thread::Builder::new().spawn(move || read_lines(out, &written))?;
        }
        Ok(Self { child, lines })
    }

    /// Whether it ended and said that it has not what was asked for.
    fn has_given_up(&mut self) -> bool {
        let ended = self.child.try_wait().ok().flatten();
        ended.and_then(|status| status.code()) == Some(UNSUPPORTED)
    }

    fn why_not(&mut self) -> Stop {
        if self.has_given_up() {
            Stop::Unsupported("the client's exit code says so".into())
        } else {
            Stop::Inconclusive("the client did not connect".into())
        }
    }
}

fn read_lines(out: ChildStdout, written: &mpsc::Sender<String>) {
    for line in BufReader::new(out).lines().map_while(Result::ok) {
        if written.send(line).is_err() {
            return;
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // One that has ended already needs no ending.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
