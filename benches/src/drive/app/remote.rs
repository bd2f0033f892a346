//! One mode of the paper's protocol: a server process, and its client

use std::fmt;
use std::io;
use std::thread;
use std::time::Duration;

use glam::{Quat, Vec3};
use rhumb_app::{Logon, Message};
use rhumb_client::{Client, Entry, Inspection, Options, Trust};
use rhumb_protocol::scene::{Command, SceneTerms};
use rhumb_reckoning::{BodyId, Tick};
use rhumb_transport::Clock;

use super::copy::Copy;
use super::line::{Direct, Sockets};
use super::losses::Losses;
use super::polled::Polled;
use super::wire::{Count, Wire};
use super::words::{SIMULATION, Unsaid, Words};
use crate::drive::compare::{RecentTruth, compare};
use crate::drive::control::Played;
use crate::drive::remote::Keep;
use crate::drive::{DriveError, Housing, ServerProcess};
use crate::record::{Cause, Frame, JoinCost, Mode, Passed, Seen};

/// A server process and its client.
pub(in crate::drive) struct AppRemote {
    line: Line,
    words: Words,
    /// Ticks of a frame, and their seconds.
    ticks_each: u32,
    seconds: f32,
    keep: Keep,
    ticks: u64,
    messages: u64,
    counts: (Count, Count),
    clock: Clock,
    pub(in crate::drive) frames: Vec<Frame>,
    pub(in crate::drive) passed: Vec<Passed>,
    pub(in crate::drive) join: JoinCost,
    // Dropped last: the client says goodbye first.
    process: ServerProcess,
}

/// How such a mode is set up.
#[derive(Clone, Debug)]
pub(in crate::drive) struct AppSetup {
    pub(in crate::drive) mode: Mode,
    pub(in crate::drive) losses: Losses,
    pub(in crate::drive) terms: SceneTerms,
    pub(in crate::drive) beside: Option<Played>,
    pub(in crate::drive) housing: Housing,
    pub(in crate::drive) keep: Keep,
}

/// How often, and how long, a client looks whether it was taken in: half a minute.
const READY_LOOKS: u32 = 30_000;
const READY_PAUSE: Duration = Duration::from_millis(1);

/// Who reads the sockets.
enum Line {
    Direct(Box<Own>),
    Polled(Polled),
}

/// What a caller has that reads its sockets itself.
struct Own {
    line: Direct,
    copy: Copy,
    wire: Wire,
}

/// Why a mode of the paper's protocol did not come to its end.
#[derive(Debug)]
pub enum AppError {
    /// The script has what the protocol cannot say.
    Unsaid(Unsaid),
    /// The sockets failed, or the server ended the connection.
    Line(io::Error),
}

impl fmt::Display for AppError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unsaid(what) => write!(f, "the paper's protocol cannot say {what}"),
            Self::Line(cause) => write!(f, "the paper's protocol: {cause}"),
        }
    }
}

impl From<io::Error> for AppError {
    fn from(cause: io::Error) -> Self {
        Self::Line(cause)
    }
}

impl From<Unsaid> for AppError {
    fn from(what: Unsaid) -> Self {
        Self::Unsaid(what)
    }
}

impl AppRemote {
    /// Starts a server and logs on to it.
    pub(in crate::drive) fn start(setup: &AppSetup) -> Result<Self, DriveError> {
        let states = match setup.mode {
            Mode::AppActive => "active",
            _ => "all",
        };
        let mut more = vec![
            "--app-listen=127.0.0.1:0",
            "--app-pace=0",
            "--app-time-advanced=udp",
            "--app-states",
            states,
        ];
        if setup.mode == Mode::AppPacked {
            more.push("--app-packed");
        }
        let process = ServerProcess::start_with(&setup.housing, setup.beside.as_ref(), &more)?;
        let words = Words::new(&setup.terms).map_err(AppError::Unsaid)?;
        let ticks_each = setup.terms.cadence.every.get();
        let tick_s = setup.terms.integrator.rate.step().seconds();
        let seconds = (tick_s * f64::from(ticks_each)) as f32;
        let line = connect(&process, setup.losses, setup.keep).map_err(AppError::Line)?;
        let mut remote = Self {
            line,
            words,
            ticks_each,
            seconds,
            keep: setup.keep,
            ticks: 0,
            messages: 0,
            counts: Default::default(),
            clock: Clock::start(),
            frames: Vec::new(),
            passed: Vec::new(),
            join: JoinCost::default(),
            process,
        };
        remote.log_on(setup.terms.gravity)?;
        Ok(remote)
    }

    fn log_on(&mut self, gravity: Vec3) -> Result<(), DriveError> {
        let logon = Message::Logon(Logon::new(SIMULATION, "bench"));
        let encoded = self.encoded(&logon);
        self.line.send_datagram(&encoded).map_err(AppError::Line)?;
        let world = self.encoded(&Words::world(gravity));
        self.line
            .send(vec![encoded, world])
            .map_err(AppError::Line)?;
        Ok(())
    }

    fn encoded(&mut self, message: &Message) -> Vec<u8> {
        let mut bytes = Vec::new();
        message.encode((self.messages as u32) << 16, &mut bytes);
        self.messages += 1;
        bytes
    }

    /// Says commands, and knows what they place.
    fn say(&mut self, commands: &[Command]) -> Result<Vec<Vec<u8>>, DriveError> {
        let mut said = Vec::new();
        for command in commands {
            self.words
                .say(command, &mut said)
                .map_err(AppError::Unsaid)?;
            self.line.with(|copy, _| match *command {
                Command::AddBody { terms, motion } => {
                    let [px, py, pz, x, y, z, w, ..] = motion.parts();
                    let rotation = Quat::from_xyzw(x, y, z, w);
                    copy.place(terms.id, Vec3::new(px, py, pz), rotation);
                }
                Command::RemoveBody { id } => copy.remove(id),
                _ => {}
            });
        }
        Ok(said.iter().map(|message| self.encoded(message)).collect())
    }

    /// Gives the commands before the first step, and counts all that as joining.
    pub(in crate::drive) fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        let said = self.say(commands)?;
        self.line.send(said).map_err(AppError::Line)?;
        self.line.await_ready().map_err(AppError::Line)?;
        self.line.with(|_, wire| {
            wire.take();
            self.counts = (wire.down, wire.up);
        });
        let (down, up) = self.counts;
        self.join = JoinCost {
            wire_bytes_down: down.bytes,
            wire_datagrams_down: down.packets,
            wire_bytes_up: up.bytes,
            wire_datagrams_up: up.packets,
        };
        Ok(())
    }

    /// One frame: command, advance, and hear that it is over.
    pub(in crate::drive) fn frame(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        let begun = self.clock.now();
        let mut said = self.say(commands)?;
        let advance = Message::AdvanceTime((SIMULATION, self.seconds));
        said.push(self.encoded(&advance));
        self.line.frame(said).map_err(AppError::Line)?;
        let frame_ns = self.clock.now().since(begun).as_nanos();
        self.ticks += u64::from(self.ticks_each);
        self.note_frame(frame_ns);
        Ok(())
    }

    /// Writes down what the frame cost and what it showed.
    fn note_frame(&mut self, frame_ns: u64) {
        let number = self.frames.len() as u32;
        let before = self.counts;
        let (mut frame, taken) = self.line.with(|copy, wire| {
            self.counts = (wire.down, wire.up);
            let mut changed = std::mem::take(&mut copy.changed);
            changed.sort_unstable();
            changed.dedup();
            let updates = std::mem::take(&mut copy.states);
            if self.keep == Keep::Costs {
                changed.clear();
            }
            let seen = changed.into_iter().filter_map(|id| {
                let (position, rotation) = copy.pose(id)?;
                Some(Seen {
                    id,
                    position: position.to_array(),
                    rotation: rotation.to_array(),
                    resting: false,
                })
            });
            let frame = Frame {
                frame_ns,
                updates,
                seen: seen.collect(),
                ..Frame::default()
            };
            (frame, wire.take())
        });
        let (down, up) = (self.counts.0.since(before.0), self.counts.1.since(before.1));
        frame.tick = Tick::new(self.ticks);
        frame.wire_bytes_down = down.bytes;
        frame.wire_datagrams_down = down.packets;
        frame.wire_bytes_up = up.bytes;
        frame.wire_datagrams_up = up.packets;
        self.passed.extend(
            taken
                .into_iter()
                .map(|(way, bytes)| Passed::new(number, way, bytes)),
        );
        self.frames.push(frame);
    }

    /// The last frame, which is not kept.
    pub(in crate::drive) fn take_frame(&mut self) -> Option<Frame> {
        self.frames.pop()
    }

    /// Frames so far whose end was not heard.
    pub(in crate::drive) fn ends_lost(&mut self) -> u64 {
        self.line.with(|copy, _| copy.lost)
    }

    /// Ticks that have passed.
    pub(in crate::drive) const fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Judges the last frame against the truth; returns how many bodies its copy lacks.
    pub(in crate::drive) fn judge(&mut self, recent: &RecentTruth) -> Option<u32> {
        let number = self.frames.len().checked_sub(1)?;
        let tick = self.frames[number].tick;
        let errors = self.line.with(|copy, _| {
            let shown = |id: BodyId| copy.pose(id);
            compare(recent, tick, shown, None, |_, _| Cause::Late)
        })?;
        let frame = &mut self.frames[number];
        frame.errors_m = errors.errors_m;
        frame.exact = errors.exact;
        Some(errors.missing)
    }

    /// What the server says of the scene at the end, to a native client that joins for it.
    pub(in crate::drive) fn inspect(&mut self) -> Result<Inspection, DriveError> {
        let scene = format!("app/{SIMULATION}");
        let options = Options::new(
            self.process.address.to_string(),
            Trust::Fingerprint(self.process.fingerprint),
            scene.parse().expect("a number names a scene"),
            Entry::Join,
        );
        let mut client = Client::open(options)?;
        // A client that lost the end of a frame may be ahead of its server.
        let mut looks = READY_LOOKS;
        loop {
            let inspection = client.inspect()?;
            if inspection.tick.value() >= self.ticks {
                return Ok(inspection);
            }
            looks -= 1;
            if looks == 0 {
                let cause = io::ErrorKind::TimedOut.into();
                return Err(AppError::Line(cause).into());
            }
            thread::sleep(READY_PAUSE);
        }
    }
}

fn connect(process: &ServerProcess, losses: Losses, keep: Keep) -> io::Result<Line> {
    let server = process.app.ok_or(io::ErrorKind::AddrNotAvailable)?;
    let sockets = Sockets::open(server, losses)?;
    let copy = Copy::new(losses);
    Ok(if losses.poll {
        Line::Polled(Polled::start(sockets, losses, copy, Wire::new(keep))?)
    } else {
        Line::Direct(Box::new(Own {
            line: Direct::new(sockets, losses)?,
            copy,
            wire: Wire::new(keep),
        }))
    })
}

impl Line {
    fn send(&mut self, messages: Vec<Vec<u8>>) -> io::Result<()> {
        match self {
            Self::Direct(own) => own.line.send(&messages, &mut own.wire),
            Self::Polled(line) => {
                line.send(messages);
                Ok(())
            }
        }
    }

    fn send_datagram(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Direct(own) => own.line.send_datagram(bytes, &mut own.wire),
            Self::Polled(line) => line.send_datagram(bytes),
        }
    }

    /// Waits until the server has taken the client in.
    fn await_ready(&mut self) -> io::Result<()> {
        let mut looks = READY_LOOKS;
        while !self.with(|copy, _| copy.ready) {
            looks -= 1;
            if looks == 0 {
                return Err(io::ErrorKind::TimedOut.into());
            }
            thread::sleep(READY_PAUSE);
            if let Self::Direct(own) = self {
                let Own { line, copy, wire } = &mut **own;
                line.hear_tcp(copy, wire)?;
            }
        }
        Ok(())
    }

    /// Sends messages, and waits until a frame more is over.
    fn frame(&mut self, messages: Vec<Vec<u8>>) -> io::Result<()> {
        match self {
            Self::Direct(own) => {
                let Own { line, copy, wire } = &mut **own;
                line.catch_up(copy, wire)?;
                line.send(&messages, wire)?;
                line.hear(copy, wire)
            }
            Self::Polled(line) => {
                let awaited = line.with(|copy, _| copy.await_end());
                line.send(messages);
                line.hear(awaited)
            }
        }
    }

    fn with<T>(&mut self, look: impl FnOnce(&mut Copy, &mut Wire) -> T) -> T {
        match self {
            Self::Direct(own) => look(&mut own.copy, &mut own.wire),
            Self::Polled(line) => line.with(look),
        }
    }
}
