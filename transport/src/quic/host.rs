//! The host thread's loop: inputs in, timeouts on time, transmissions out.
//!
//! Touches no socket: it speaks to connections that the I/O thread drives. It sleeps whenever there is nothing to do.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::mpsc::{Receiver, RecvTimeoutError, TryRecvError};
use std::thread;
use std::time::Duration;

use bytes::Bytes;
use quinn::SendDatagramError;
use rhumb_protocol::{Endpoint, Peer, Span, Transmit};

use super::code::TransportCode;
use super::input::{Input, Line};
use super::tuning::{CLOSE_LEAVES, DATAGRAM_SEND_BYTES};
use super::watch::ServerWatch;
use crate::app::{AppDoor, AppHooks};
use crate::clock::Clock;
use crate::gauge::Gauge;

/// Why a server stopped without being asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ServeError {
    /// The thread with the sockets is gone: it failed, and the log says why.
    IoThreadLost,
}

/// What the host thread knows of the network.
#[derive(Debug)]
pub(super) struct Host {
    clock: Clock,
    inputs: Receiver<Input>,
    lines: BTreeMap<Peer, Standing>,
    /// Datagrams of the drain in progress: they leave after its control bytes, so that both can share a packet.
    states: Vec<(Peer, Bytes)>,
    watch: ServerWatch,
    door: Option<AppDoor>,
}

#[derive(Debug)]
struct Standing {
    line: Line,
    talk: Talk,
    gauge: Gauge,
    /// Bytes of datagrams that were handed over.
    handed_bytes: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Talk {
    Open,
    /// Closed from here: only its end is still of interest.
    Closing,
}

/// Whether the loop goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Flow {
    Go,
    Stop,
}

/// Inputs handled before transmissions and timers have their turn.
const INPUTS_PER_TURN: usize = 256;

impl Host {
    pub(super) fn new(inputs: Receiver<Input>, watch: ServerWatch, door: Option<AppDoor>) -> Self {
        Self {
            clock: Clock::start(),
            inputs,
            lines: BTreeMap::new(),
            states: Vec::new(),
            watch,
            door,
        }
    }

    /// Runs until stopped.
    pub(super) fn run<E: Endpoint>(
        &mut self,
        endpoint: &mut E,
        app: &AppHooks<E>,
    ) -> Result<(), ServeError> {
        loop {
            self.report(endpoint);
            self.drain(endpoint);
            if let Some(door) = &mut self.door {
                app.drain(endpoint, door);
            }
            if self.wait(endpoint, app)? == Flow::Stop {
                return Ok(());
            }
            let now = self.clock.now();
            if endpoint.poll_timeout().is_some_and(|wake| wake.at <= now) {
                endpoint.handle_timeout(now);
            }
        }
    }

    /// Closes every connection and waits a little for the news to leave.
    pub(super) fn close_all(&mut self) {
        for standing in self.lines.values() {
            standing.line.closing.now(TransportCode::GOING_AWAY.0);
        }
        let told = |standing: &Standing| standing.line.closing.has_told();
        let mut patience = CLOSE_LEAVES;
        while !self.lines.values().all(told) && !patience.is_zero() {
            thread::sleep(STEP);
            patience = patience.saturating_sub(STEP);
        }
    }

    /// Waits for an input or the endpoint's next moment, and handles what came.
    fn wait<E: Endpoint>(
        &mut self,
        endpoint: &mut E,
        app: &AppHooks<E>,
    ) -> Result<Flow, ServeError> {
        let first = match endpoint.poll_timeout() {
            Some(wake) => match self.inputs.recv_timeout(self.clock.until(wake.at)) {
                Ok(input) => input,
                Err(RecvTimeoutError::Timeout) => return Ok(Flow::Go),
                Err(RecvTimeoutError::Disconnected) => return Err(ServeError::IoThreadLost),
            },
            None => self.inputs.recv().map_err(|_| ServeError::IoThreadLost)?,
        };
        let mut input = first;
        for _ in 0..INPUTS_PER_TURN {
            if self.handle(endpoint, app, input)? == Flow::Stop {
                return Ok(Flow::Stop);
            }
            input = match self.inputs.try_recv() {
                Ok(next) => next,
                Err(TryRecvError::Empty) => return Ok(Flow::Go),
                Err(TryRecvError::Disconnected) => return Err(ServeError::IoThreadLost),
            };
        }
        self.handle(endpoint, app, input)
    }

    fn handle<E: Endpoint>(
        &mut self,
        endpoint: &mut E,
        app: &AppHooks<E>,
        input: Input,
    ) -> Result<Flow, ServeError> {
        let now = self.clock.now();
        match input {
            Input::Opened { peer, line } => {
                self.lines.insert(
                    peer,
                    Standing {
                        line,
                        talk: Talk::Open,
                        gauge: Gauge::new(now),
                        handed_bytes: 0,
                    },
                );
                endpoint.handle_opened(now, peer);
            }
            Input::Control { peer, piece } => {
                if self.talks(peer) {
                    endpoint.handle_control(now, peer, &piece.bytes);
                }
            }
            Input::State { peer, piece } => {
                if self.talks(peer) {
                    endpoint.handle_datagram(now, peer, &piece.bytes);
                }
            }
            Input::Ended { peer, ending } => {
                self.lines.remove(&peer);
                endpoint.handle_ended(now, peer, ending);
            }
            Input::App(input) => {
                if let Some(door) = &mut self.door {
                    app.handle(endpoint, now, input, door);
                }
            }
            Input::Stop => return Ok(Flow::Stop),
            Input::IoOver => return Err(ServeError::IoThreadLost),
        }
        Ok(Flow::Go)
    }

    /// Tells the endpoint how the links of those do to whom it said something lately.
    fn report<E: Endpoint>(&mut self, endpoint: &mut E) {
        let now = self.clock.now();
        for (peer, standing) in &mut self.lines {
            if standing.talk == Talk::Closing || !standing.gauge.is_due(now) {
                continue;
            }
            let connection = &standing.line.connection;
            let free = connection.datagram_send_buffer_space();
            let waiting = DATAGRAM_SEND_BYTES.saturating_sub(free) as u64;
            let round_trip = u64::try_from(connection.rtt().as_nanos()).unwrap_or(u64::MAX);
            let handed = standing.handed_bytes;
            let report = (standing.gauge).read(now, handed, waiting, Span::from_nanos(round_trip));
            endpoint.handle_link(now, *peer, &report);
        }
    }

    fn drain<E: Endpoint>(&mut self, endpoint: &mut E) {
        while let Some(transmit) = endpoint.poll_transmit() {
            match transmit {
                Transmit::Control { to, bytes } => self.send_control(to, bytes),
                Transmit::State { to, bytes } => self.states.push((to, bytes)),
                Transmit::Close { to, code } => {
                    self.send_states();
                    if let Some(standing) = open(&mut self.lines, to) {
                        standing.line.control.close(&standing.line.closing, code);
                        standing.talk = Talk::Closing;
                    }
                }
            }
        }
        self.send_states();
    }

    fn send_control(&mut self, to: Peer, bytes: Bytes) {
        let Some(standing) = open(&mut self.lines, to) else {
            return;
        };
        if standing.line.control.send(bytes).is_err() {
            standing.line.closing.now(TransportCode::CONTROL_OVERFLOW.0);
            standing.talk = Talk::Closing;
            self.watch.count(|counters| &counters.control_overflows);
            tracing::warn!(peer = to.0, "control lane too slow, closing");
        }
    }

    fn send_states(&mut self) {
        for (to, bytes) in self.states.drain(..) {
            let Some(standing) = open(&mut self.lines, to) else {
                continue;
            };
            let bytes_len = bytes.len();
            standing.handed_bytes += bytes_len as u64;
            match standing.line.connection.send_datagram(bytes) {
                Ok(()) | Err(SendDatagramError::ConnectionLost(_)) => {}
                Err(cause) => {
                    self.watch.count(|counters| &counters.state_oversized);
                    tracing::warn!(peer = to.0, bytes_len, %cause, "state datagram not sent");
                }
            }
        }
    }

    fn talks(&mut self, peer: Peer) -> bool {
        open(&mut self.lines, peer).is_some()
    }
}

/// The line of a peer that was not closed from here.
fn open(lines: &mut BTreeMap<Peer, Standing>, peer: Peer) -> Option<&mut Standing> {
    lines
        .get_mut(&peer)
        .filter(|standing| standing.talk == Talk::Open)
}

/// How often to look whether the close frames have left.
const STEP: Duration = Duration::from_millis(1);

impl fmt::Display for ServeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::IoThreadLost => f.write_str("the server's i/o thread failed; see its log"),
        }
    }
}

impl std::error::Error for ServeError {}
