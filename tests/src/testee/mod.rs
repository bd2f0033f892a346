//! A client under test: follows a scene and tells what it holds, line by line.
//!
//! It is started as `docs/book/src/implementing.md` says: told by its environment where to go and what to task. It judges nothing.
//! What it hears, says and tells passes by a [`Behaviour`]; the honest one leaves all as it is, those of `conformance/mutants`
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
use rhumb_transport::{ClientOptions, Clock, QuicClient, Received, Trust};

pub use lines::{bits, copy_line, moving};
pub use task::{TesteeOrders, TesteeTask};
pub use trajectory::{COURSE_TICKS, trajectory};

/// What a client does to all that passes through it; each part is honest unless it is written otherwise.
pub trait Behaviour {
    /// What it takes bytes of the control stream for.
    fn receive_control(&mut self, bytes: &[u8]) -> Vec<u8> {
        bytes.to_vec()
    }

    /// What it takes a datagram for.
    fn receive_datagram(&mut self, session: &ClientSession, bytes: &[u8]) -> Vec<Vec<u8>> {
        let _ = session;
        vec![bytes.to_vec()]
    }

    /// What it says in place of a datagram.
    fn filter_datagram(&mut self, bytes: &[u8]) -> Option<Vec<u8>> {
        Some(bytes.to_vec())
    }

    /// What it says in place of bytes of the control stream.
    fn filter_control(&mut self, bytes: &[u8]) -> Vec<u8> {
        bytes.to_vec()
    }

    /// The code that it closes with, if it does.
    fn close(&mut self, code: u32) -> Option<u32> {
        Some(code)
    }

    /// What it writes in place of a line about its copy.
    fn write_line(&mut self, line: String) -> String {
        line
    }

    /// Whether it tells of a copy that is not converged.
    fn reports_unconverged(&self) -> bool {
        false
    }
}

/// Who leaves all as it is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Honest;

impl Behaviour for Honest {}

const SERVER: Peer = Peer(0);
/// The longest that a turn waits for something to come; then the next one begins.
const TURN: Span = Span::from_millis(1_000);

struct Testee<'a> {
    session: ClientSession,
    connection: QuicClient,
    clock: Clock,
    habit: &'a mut dyn Behaviour,
    task: TesteeTask,
    told: Option<Tick>,
    /// The body that it drives, or wants to.
    driven: Option<BodyId>,
    over: bool,
}

/// Does as it was ordered until the connection ends.
///
/// # Errors
///
/// When there is no connection, or nobody reads what is told.
pub fn run(orders: &TesteeOrders, habit: &mut dyn Behaviour) -> io::Result<()> {
    let options = ClientOptions::new(orders.server, Trust::Fingerprint(orders.fingerprint));
    let connection = QuicClient::connect(options, Duration::from_secs(10))
        .map_err(|error| io::Error::other(error.to_string()))?;
    let clock = Clock::start();
    let mut session = ClientSession::new(orders.scene.clone());
    session.handle_opened(clock.now(), SERVER);
    let mut testee = Testee {
        session,
        connection,
        clock,
        habit,
        task: orders.task,
        told: None,
        driven: None,
        over: false,
    };
    while !testee.over {
        testee.turn()?;
    }
    // The close frame leaves with the connection.
    drop(testee);
    Ok(())
}

impl Testee<'_> {
    fn turn(&mut self) -> io::Result<()> {
        self.go_on()?;
        let end = self.clock.now() + TURN;
        let wake = self
            .session
            .poll_timeout()
            .map_or(end, |wake| wake.at.min(end));
        if let Some(received) = self.connection.recv(self.clock.until(wake)) {
            self.take_in(received)?;
        }
        self.session.handle_timeout(self.clock.now());
        self.go_on()
    }

    fn take_in(&mut self, received: Received) -> io::Result<()> {
        let now = self.clock.now();
        match received {
            Received::Control(bytes) => {
                let bytes = self.habit.receive_control(&bytes);
                self.session.handle_control(now, SERVER, &bytes);
                self.tell_copy()
            }
            Received::State(bytes) => {
                for bytes in self.habit.receive_datagram(&self.session, &bytes) {
                    self.session.handle_datagram(now, SERVER, &bytes);
                    self.tell_copy()?;
                }
                Ok(())
            }
            Received::Ended(ending) => {
                self.session.handle_ended(now, SERVER, ending);
                Ok(())
            }
        }
    }

    /// Says what is to be sent, and does what follows from what happened.
    fn go_on(&mut self) -> io::Result<()> {
        loop {
            while let Some(transmit) = self.session.poll_transmit() {
                self.send(transmit);
            }
            let Some(event) = self.session.poll_event() else {
                return Ok(());
            };
            self.heed(&event)?;
        }
    }

    fn send(&mut self, transmit: Transmit) {
        match transmit {
            Transmit::Control { bytes, .. } => {
                let bytes = self.habit.filter_control(&bytes);
                self.connection.send_control(bytes.into());
            }
            Transmit::State { bytes, .. } => {
                if let Some(bytes) = self.habit.filter_datagram(&bytes) {
                    self.connection.send_state(bytes.into());
                }
            }
            Transmit::Close { code, .. } => {
                if let Some(code) = self.habit.close(code) {
                    self.connection.close(code);
                }
            }
        }
    }

    fn heed(&mut self, event: &Event) -> io::Result<()> {
        let now = self.clock.now();
        match event {
            Event::Welcomed(_) => self.wishes(|session, task| session.join(task.choice())),
            Event::Joined(granted) => {
                tell("{\"is\":\"joined\"}")?;
                self.tell_copy()?;
                match self.task {
                    TesteeTask::Advance { .. } => self.ask_on(now),
                    TesteeTask::Change { to, .. } => {
                        self.wishes(|session, _| session.subscribe(within(to)))
                    }
                    TesteeTask::TakeAuthority { within } => self.begin_to_drive(*granted, within),
                    TesteeTask::Subscribe { .. } | TesteeTask::Full | TesteeTask::Capped { .. } => {
                    }
                }
            }
            Event::AuthorityGrant(_) => self.drive_on(now),
            Event::SubscriptionChanged(_) => {
                tell("{\"is\":\"following\"}")?;
                self.told = None;
                self.tell_copy()?;
            }
            Event::ChecksumMismatch => tell("{\"is\":\"mismatch\"}")?,
            Event::Deleted => tell("{\"is\":\"deleted\"}")?,
            Event::SceneFaulted(_) => tell("{\"is\":\"faulted\"}")?,
            Event::Ended(ending) => {
                let code = match ending {
                    Ending::Closed(code) => code.to_string(),
                    Ending::TimedOut | Ending::Broken => "null".to_owned(),
                };
                tell(&format!("{{\"is\":\"ended\",\"code\":{code}}}"))?;
                self.over = true;
            }
            _ => {}
        }
        Ok(())
    }

    /// Does what is requested_authority; what the session does not allow now is left.
    fn wishes<T, E>(&mut self, task: impl FnOnce(&mut ClientSession, TesteeTask) -> Result<T, E>) {
        // The server may have ended what this is about; then there is nothing to task.
        let _ = task(&mut self.session, self.task);
    }

    /// In lockstep: asks for the next tick.
    fn ask_on(&mut self, now: Instant) {
        let TesteeTask::Advance { ticks, .. } = self.task else {
            return;
        };
        let complete = self
            .session
            .replica()
            .map(|copy| copy.stream().complete().value());
        if let Some(next) = complete.map(|tick| tick + 1).filter(|next| *next <= ticks) {
            self.wishes(|session, _| session.advance(now, Tick::new(next)));
        }
    }

    /// Adds a body where its trajectory is at the scene's tick, and asks to drive it.
    fn begin_to_drive(&mut self, granted: IdRange, micrometres: u32) {
        let (Some(id), Some(copy)) = (granted.id(0), self.session.replica()) else {
            return;
        };
        let command = Command::AddBody {
            desc: BodyDesc::plain(id, BodyKind::Kinematic, ShapeId(0)),
            motion: trajectory(copy.stream().complete()).stilled(),
        };
        self.driven = Some(id);
        self.wishes(|session, _| session.command(command));
        self.wishes(|session, _| session.take_authority(surface(micrometres), &[id]));
    }

    /// Says where its body is at the next tick, and asks for it; nothing before it may.
    fn drive_on(&mut self, now: Instant) {
        let (Some(id), Some(copy)) = (self.driven, self.session.replica()) else {
            return;
        };
        let next = copy.stream().complete().next();
        if next > Tick::new(COURSE_TICKS) {
            return;
        }
        let sent = self.session.publish(next, &[(id, trajectory(next))]);
        if sent == Ok(true) {
            self.wishes(|session, _| session.advance(now, next));
        }
    }

    /// Tells of a tick that has become complete.
    fn tell_copy(&mut self) -> io::Result<()> {
        let Some(copy) = self.session.replica() else {
            return Ok(());
        };
        let anyway = self.habit.reports_unconverged();
        let tick = if anyway {
            copy.stream().watermark_tick()
        } else {
            copy.stream().complete()
        };
        if self.told == Some(tick) || !(anyway || copy.stream().is_converged()) {
            return Ok(());
        }
        self.told = Some(tick);
        tell(&self.habit.write_line(copy_line(copy, tick)))?;
        let now = self.clock.now();
        self.ask_on(now);
        self.drive_on(now);
        Ok(())
    }
}

/// A stream within so many micrometres.
fn within(micrometres: u32) -> StreamChoice {
    StreamChoice::Within(surface(micrometres))
}

fn surface(micrometres: u32) -> Tolerance {
    let length = LengthBound::from_micrometres(micrometres);
    Tolerance::Surface(length.expect("orders are checked when they are read"))
}

/// Writes a line at once.
fn tell(line: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{line}")?;
    out.flush()
}
