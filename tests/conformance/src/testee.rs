//! A client under test: subscribes to a scene and reports its state.
//!
//! It is started as `docs/book/src/implementing.md` describes: the environment gives its server and its task. It makes no
//! checks. All data passes through a [`Behaviour`]; the honest one leaves it unchanged, those of `conformance/mutants`
//! do not.

mod lines;
mod task;
mod trajectory;

use std::io::{self, Write};
use std::time::Duration;

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, IdRange, ShapeId};
use rhumb_protocol::session::{ClientSession, Event};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{BodyId, LengthBound, Tick, Tolerance};
use rhumb_transport::{ClientOptions, ClientTransport, Clock, QuicClient, Received, Trust};

pub use lines::{bits, copy_line};
pub use task::{TesteeEnvironment, TesteeTask};
pub use trajectory::{TRAJECTORY_TICKS, trajectory};

/// Hooks that may alter all data of a client; the default methods leave it unchanged.
pub trait Behaviour {
    /// Replaces received bytes of the control stream.
    fn receive_control(&mut self, bytes: &[u8]) -> Vec<u8> {
        bytes.to_vec()
    }

    /// Replaces a received datagram.
    fn receive_datagram(&mut self, session: &ClientSession, bytes: &[u8]) -> Vec<Vec<u8>> {
        let _ = session;
        vec![bytes.to_vec()]
    }

    /// Replaces a datagram before it is sent; `None` drops it.
    fn filter_datagram(&mut self, bytes: &[u8]) -> Option<Vec<u8>> {
        Some(bytes.to_vec())
    }

    /// Replaces bytes of the control stream before they are sent.
    fn filter_control(&mut self, bytes: &[u8]) -> Vec<u8> {
        bytes.to_vec()
    }

    /// The close code, if the client closes.
    fn close(&mut self, code: u32) -> Option<u32> {
        Some(code)
    }

    /// Replaces a report about the copy.
    fn write_line(&mut self, line: String) -> String {
        line
    }

    /// True if it reports a copy that has not converged.
    fn reports_unconverged(&self) -> bool {
        false
    }
}

/// The behaviour that changes nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Honest;

impl Behaviour for Honest {}

const SERVER: Peer = Peer(0);
/// The longest wait for one event.
const TURN: Span = Span::from_millis(1_000);

struct Testee<'a> {
    session: ClientSession,
    connection: QuicClient,
    clock: Clock,
    behaviour: &'a mut dyn Behaviour,
    task: TesteeTask,
    reported: Option<Tick>,
    /// The body under its authority, or the one that it requested.
    published: Option<BodyId>,
    over: bool,
}

/// Performs the task until the connection ends.
///
/// # Errors
///
/// When there is no connection, or when no process reads the reports.
pub fn run(environment: &TesteeEnvironment, behaviour: &mut dyn Behaviour) -> io::Result<()> {
    let options = ClientOptions::new(
        environment.server,
        Trust::Fingerprint(environment.fingerprint),
    );
    let connection = QuicClient::connect(options, Duration::from_secs(10))
        .map_err(|error| io::Error::other(error.to_string()))?;
    let clock = Clock::start();
    let mut session = ClientSession::new(environment.scene.clone());
    if let Some(token) = environment.token.clone() {
        session.set_token(token);
    }
    session.handle_opened(clock.now(), SERVER);
    let mut testee = Testee {
        session,
        connection,
        clock,
        behaviour,
        task: environment.task,
        reported: None,
        published: None,
        over: false,
    };
    while !testee.over {
        testee.turn()?;
    }
    // The close frame is sent when the connection is dropped.
    drop(testee);
    Ok(())
}

impl Testee<'_> {
    fn turn(&mut self) -> io::Result<()> {
        self.flush()?;
        let end = self.clock.now() + TURN;
        let wake = self
            .session
            .poll_timeout()
            .map_or(end, |wake| wake.at.min(end));
        if let Some(received) = self.connection.recv(self.clock.until(wake)) {
            self.take_in(received)?;
        }
        self.session.handle_timeout(self.clock.now());
        self.flush()
    }

    fn take_in(&mut self, received: Received) -> io::Result<()> {
        let now = self.clock.now();
        match received {
            Received::Control(bytes) => {
                let bytes = self.behaviour.receive_control(&bytes);
                self.session.handle_control(now, SERVER, &bytes);
                self.report_copy()
            }
            Received::State(bytes) => {
                for bytes in self.behaviour.receive_datagram(&self.session, &bytes) {
                    self.session.handle_datagram(now, SERVER, &bytes);
                    self.report_copy()?;
                }
                Ok(())
            }
            Received::Ended(ending) => {
                self.session.handle_ended(now, SERVER, ending);
                Ok(())
            }
        }
    }

    /// Sends pending data, and reacts to events.
    fn flush(&mut self) -> io::Result<()> {
        loop {
            while let Some(transmit) = self.session.poll_transmit() {
                self.send(transmit);
            }
            let Some(event) = self.session.poll_event() else {
                return Ok(());
            };
            self.handle_event(&event)?;
        }
    }

    fn send(&mut self, transmit: Transmit) {
        match transmit {
            Transmit::Control { bytes, .. } => {
                let bytes = self.behaviour.filter_control(&bytes);
                self.connection.send_control(bytes.into());
            }
            Transmit::State { bytes, .. } => {
                if let Some(bytes) = self.behaviour.filter_datagram(&bytes) {
                    self.connection.send_state(bytes.into());
                }
            }
            Transmit::Close { code, .. } => {
                if let Some(code) = self.behaviour.close(code) {
                    self.connection.close(code);
                }
            }
        }
    }

    fn handle_event(&mut self, event: &Event) -> io::Result<()> {
        let now = self.clock.now();
        match event {
            Event::Welcomed(_) => self.attempt(|session, task| session.join(task.choice())),
            Event::Joined(granted) => {
                report("{\"is\":\"joined\"}")?;
                self.report_copy()?;
                match self.task {
                    TesteeTask::Advance { .. } => self.advance(now),
                    TesteeTask::Change { to, .. } => {
                        self.attempt(|session, _| session.subscribe(within(to)));
                    }
                    TesteeTask::TakeAuthority { within } => {
                        self.request_authority(*granted, within);
                    }
                    TesteeTask::Subscribe { .. } | TesteeTask::Full | TesteeTask::Capped { .. } => {
                    }
                }
            }
            Event::AuthorityGrant(_) => self.publish_next(now),
            Event::SubscriptionChanged(_) => {
                report("{\"is\":\"following\"}")?;
                self.reported = None;
                self.report_copy()?;
            }
            Event::ChecksumMismatch => report("{\"is\":\"mismatch\"}")?,
            Event::Deleted => report("{\"is\":\"deleted\"}")?,
            Event::SceneFaulted { .. } => report("{\"is\":\"faulted\"}")?,
            Event::Ended(ending) => {
                let code = match ending {
                    Ending::Closed(code) => code.to_string(),
                    Ending::TimedOut | Ending::Broken => "null".to_owned(),
                };
                report(&format!("{{\"is\":\"ended\",\"code\":{code}}}"))?;
                self.over = true;
            }
            _ => {}
        }
        Ok(())
    }

    /// Performs a step of the task; calls that the session refuses at present are skipped.
    fn attempt<T, E>(&mut self, task: impl FnOnce(&mut ClientSession, TesteeTask) -> Result<T, E>) {
        // The server may have ended the membership; then there is nothing to do.
        let _ = task(&mut self.session, self.task);
    }

    /// In lockstep: requests the next tick.
    fn advance(&mut self, now: Instant) {
        let TesteeTask::Advance { ticks, .. } = self.task else {
            return;
        };
        let complete = self
            .session
            .replica()
            .map(|copy| copy.stream().complete().value());
        if let Some(next) = complete.map(|tick| tick + 1).filter(|next| *next <= ticks) {
            self.attempt(|session, _| session.advance(now, Tick::new(next)));
        }
    }

    /// Adds a body at its trajectory's state of the scene's tick, and requests authority over it.
    fn request_authority(&mut self, granted: IdRange, micrometres: u32) {
        let (Some(id), Some(copy)) = (granted.id(0), self.session.replica()) else {
            return;
        };
        let command = Command::AddBody {
            desc: BodyDesc::plain(id, BodyKind::Kinematic, ShapeId(0)),
            motion: trajectory(copy.stream().complete()).stilled(),
        };
        self.published = Some(id);
        self.attempt(|session, _| session.command(command));
        self.attempt(|session, _| session.take_authority(surface(micrometres), &[id]));
    }

    /// Publishes the state of its body for the next tick, and only then requests that tick.
    fn publish_next(&mut self, now: Instant) {
        let (Some(id), Some(copy)) = (self.published, self.session.replica()) else {
            return;
        };
        let next = copy.stream().complete().next();
        if next > Tick::new(TRAJECTORY_TICKS) {
            return;
        }
        let sent = self.session.publish(next, &[(id, trajectory(next))]);
        if sent == Ok(true) {
            self.attempt(|session, _| session.advance(now, next));
        }
    }

    /// Reports a tick that has become complete.
    fn report_copy(&mut self) -> io::Result<()> {
        let Some(copy) = self.session.replica() else {
            return Ok(());
        };
        let anyway = self.behaviour.reports_unconverged();
        let tick = if anyway {
            copy.stream().watermark_tick()
        } else {
            copy.stream().complete()
        };
        if self.reported == Some(tick) || !(anyway || copy.stream().is_converged()) {
            return Ok(());
        }
        self.reported = Some(tick);
        report(&self.behaviour.write_line(copy_line(copy, tick)))?;
        let now = self.clock.now();
        self.advance(now);
        self.publish_next(now);
        Ok(())
    }
}

/// A stream with this tolerance in micrometres.
fn within(micrometres: u32) -> StreamChoice {
    StreamChoice::Within(surface(micrometres))
}

fn surface(micrometres: u32) -> Tolerance {
    let length = LengthBound::from_micrometres(micrometres);
    Tolerance::Surface(length.expect("tasks are validated when they are parsed"))
}

/// Writes a line and flushes it.
fn report(line: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{line}")?;
    out.flush()
}
