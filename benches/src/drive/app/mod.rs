//! The paper's protocol as a mode: its client and the measurement of it.

mod replica;
mod sockets;

use std::time::Duration;
use std::{io, thread};

use glam::{Quat, Vec3};
use rhumb_app::{Logon, Message};
use rhumb_client::{Client, Inspection, JoinMode, JoinOptions, Trust};
use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_reckoning::{BodyId, Tick};
use rhumb_transport::Clock;

use self::replica::AppReplica;
use self::sockets::Polled;
use self::sockets::{Count, Direct, Sockets, WireCounter};
use crate::drive::DriveError;
use crate::drive::compare::{RecentTruth, compare};
use crate::drive::process::{ScriptChoice, ServerCpu, ServerProcess};
use crate::drive::remote::Retention;
use crate::record::{CapturedPacket, Cause, CopiedPose, Frame, JoinCost, Mode};
use replica::{MessageWriter, SIMULATION};

pub use self::replica::{Defect, Defects};
pub use replica::{AppError, Unsupported};

/// A server process and its client.
pub(in crate::drive) struct AppRemote {
    connection: PaperConnection,
    writer: MessageWriter,
    /// Ticks per frame, and their duration in seconds.
    ticks_each: u32,
    seconds: f32,
    keep: Retention,
    ticks: u64,
    messages: u64,
    counts: (Count, Count),
    clock: Clock,
    pub(in crate::drive) frames: Vec<Frame>,
    pub(in crate::drive) captured: Vec<CapturedPacket>,
    pub(in crate::drive) join: JoinCost,
    // Dropped last, so that the client can close the connection.
    process: ServerProcess,
}

/// Setup of such a mode.
#[derive(Clone, Debug)]
pub(in crate::drive) struct AppSetup {
    pub(in crate::drive) mode: Mode,
    pub(in crate::drive) defects: Defects,
    pub(in crate::drive) config: SceneConfig,
    pub(in crate::drive) controller_script: Option<ScriptChoice>,
    pub(in crate::drive) cpu: ServerCpu,
    pub(in crate::drive) keep: Retention,
}

/// Attempts to wait for readiness, and the pause between them: half a minute in total.
const READY_ATTEMPTS: u32 = 30_000;
const READY_PAUSE: Duration = Duration::from_millis(1);

/// The thread that reads the sockets.
enum PaperConnection {
    Direct(Box<DirectReader>),
    Polled(Polled),
}

/// State of a caller that reads its sockets itself.
struct DirectReader {
    connection: Direct,
    replica: AppReplica,
    wire: WireCounter,
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
            "--app-datagram-rate=0",
            "--app-time-advanced=udp",
            "--app-states",
            states,
        ];
        if setup.mode == Mode::AppPacked {
            more.push("--app-packed");
        }
        let process =
            ServerProcess::start_with(&setup.cpu, setup.controller_script.as_ref(), &more)?;
        let writer = MessageWriter::new(&setup.config).map_err(AppError::Unsupported)?;
        let ticks_each = setup.config.publish_schedule.publish_interval.get();
        let tick_s = setup.config.integrator.rate.step().seconds();
        let seconds = (tick_s * f64::from(ticks_each)) as f32;
        let connection =
            connect(&process, setup.defects, setup.keep).map_err(AppError::PaperConnection)?;
        let mut remote = Self {
            connection,
            writer,
            ticks_each,
            seconds,
            keep: setup.keep,
            ticks: 0,
            messages: 0,
            counts: Default::default(),
            clock: Clock::start(),
            frames: Vec::new(),
            captured: Vec::new(),
            join: JoinCost::default(),
            process,
        };
        remote.log_on(setup.config.gravity)?;
        Ok(remote)
    }

    fn log_on(&mut self, gravity: Vec3) -> Result<(), DriveError> {
        let logon = Message::Logon(Logon::new(SIMULATION, "bench"));
        let encoded = self.encoded(&logon);
        self.connection
            .send_datagram(&encoded)
            .map_err(AppError::PaperConnection)?;
        let world = self.encoded(&MessageWriter::world(gravity));
        self.connection
            .send(vec![encoded, world])
            .map_err(AppError::PaperConnection)?;
        Ok(())
    }

    fn encoded(&mut self, message: &Message) -> Vec<u8> {
        let mut bytes = Vec::new();
        message.encode((self.messages as u32) << 16, &mut bytes);
        self.messages += 1;
        bytes
    }

    /// Encodes commands and tracks the bodies they place.
    fn encode(&mut self, commands: &[Command]) -> Result<Vec<Vec<u8>>, DriveError> {
        let mut encoded = Vec::new();
        for command in commands {
            self.writer
                .encode(command, &mut encoded)
                .map_err(AppError::Unsupported)?;
            self.connection.with(|replica, _| match *command {
                Command::AddBody { desc, motion } => {
                    let [px, py, pz, x, y, z, w, ..] = motion.parts();
                    let rotation = Quat::from_xyzw(x, y, z, w);
                    replica.place(desc.id, Vec3::new(px, py, pz), rotation);
                }
                Command::RemoveBody { id } => replica.remove(id),
                _ => {}
            });
        }
        Ok(encoded
            .iter()
            .map(|message| self.encoded(message))
            .collect())
    }

    /// Sends the commands before the first step; the traffic counts as joining.
    pub(in crate::drive) fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        let encoded = self.encode(commands)?;
        self.connection
            .send(encoded)
            .map_err(AppError::PaperConnection)?;
        self.connection
            .await_ready()
            .map_err(AppError::PaperConnection)?;
        self.connection.with(|_, wire| {
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

    /// One frame: commands, advance, and the end of the frame.
    pub(in crate::drive) fn frame(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        let begun = self.clock.now();
        let mut encoded = self.encode(commands)?;
        let advance = Message::AdvanceTime((SIMULATION, self.seconds));
        encoded.push(self.encoded(&advance));
        self.connection
            .frame(encoded)
            .map_err(AppError::PaperConnection)?;
        let frame_ns = self.clock.now().since(begun).as_nanos();
        self.ticks += u64::from(self.ticks_each);
        self.record_frame(frame_ns);
        Ok(())
    }

    /// Records the cost of the frame and the poses it shows.
    fn record_frame(&mut self, frame_ns: u64) {
        let number = self.frames.len() as u32;
        let before = self.counts;
        let (mut frame, taken) = self.connection.with(|replica, wire| {
            self.counts = (wire.down, wire.up);
            let mut changed = std::mem::take(&mut replica.changed);
            changed.sort_unstable();
            changed.dedup();
            let updates = std::mem::take(&mut replica.states);
            if self.keep == Retention::Costs {
                changed.clear();
            }
            let poses = changed.into_iter().filter_map(|id| {
                let (position, rotation) = replica.pose(id)?;
                Some(CopiedPose {
                    id,
                    position: position.to_array(),
                    rotation: rotation.to_array(),
                    resting: false,
                })
            });
            let frame = Frame {
                frame_ns,
                updates,
                changed: poses.collect(),
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
        self.captured.extend(
            taken
                .into_iter()
                .map(|(direction, bytes)| CapturedPacket::new(number, direction, bytes)),
        );
        self.frames.push(frame);
    }

    /// Removes and returns the last frame.
    pub(in crate::drive) fn take_frame(&mut self) -> Option<Frame> {
        self.frames.pop()
    }

    /// Frames so far whose end message was lost.
    pub(in crate::drive) fn ends_lost(&mut self) -> u64 {
        self.connection.with(|replica, _| replica.lost)
    }

    /// Ticks advanced so far.
    pub(in crate::drive) const fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Records the errors of the last frame against the truth; returns how many bodies the copy lacks.
    pub(in crate::drive) fn record_errors(&mut self, recent: &RecentTruth) -> Option<u32> {
        let number = self.frames.len().checked_sub(1)?;
        let tick = self.frames[number].tick;
        let errors = self.connection.with(|replica, _| {
            let shown = |id: BodyId| replica.pose(id);
            compare(recent, tick, shown, None, |_, _| Cause::Late)
        })?;
        let frame = &mut self.frames[number];
        frame.errors_m = errors.errors_m;
        frame.exact = errors.exact;
        Some(errors.missing)
    }

    /// The server's report on the scene at the end, requested by a native client that joins for it.
    pub(in crate::drive) fn inspect(&mut self) -> Result<Inspection, DriveError> {
        let scene = format!("app/{SIMULATION}");
        let trust = Trust::Fingerprint(self.process.fingerprint);
        let options = JoinOptions {
            mode: JoinMode::Join,
            ..JoinOptions::default()
        };
        let mut client = Client::connect(&self.process.address.to_string(), trust)?
            .join_with(&scene, options)?;
        // A client that lost the end of a frame may be ahead of its server.
        let mut attempts = READY_ATTEMPTS;
        loop {
            let inspection = client.inspect()?;
            if inspection.tick.value() >= self.ticks {
                return Ok(inspection);
            }
            attempts -= 1;
            if attempts == 0 {
                let cause = io::ErrorKind::TimedOut.into();
                return Err(AppError::PaperConnection(cause).into());
            }
            thread::sleep(READY_PAUSE);
        }
    }
}

fn connect(
    process: &ServerProcess,
    defects: Defects,
    keep: Retention,
) -> io::Result<PaperConnection> {
    let server = process.beside.ok_or(io::ErrorKind::AddrNotAvailable)?;
    let sockets = Sockets::open(server, defects)?;
    let replica = AppReplica::new(defects);
    Ok(if defects.poll {
        PaperConnection::Polled(Polled::start(
            sockets,
            defects,
            replica,
            WireCounter::new(keep),
        )?)
    } else {
        PaperConnection::Direct(Box::new(DirectReader {
            connection: Direct::new(sockets, defects)?,
            replica,
            wire: WireCounter::new(keep),
        }))
    })
}

impl PaperConnection {
    fn send(&mut self, messages: Vec<Vec<u8>>) -> io::Result<()> {
        match self {
            Self::Direct(reader) => reader.connection.send(&messages, &mut reader.wire),
            Self::Polled(connection) => {
                connection.send(messages);
                Ok(())
            }
        }
    }

    fn send_datagram(&mut self, bytes: &[u8]) -> io::Result<()> {
        match self {
            Self::Direct(reader) => reader.connection.send_datagram(bytes, &mut reader.wire),
            Self::Polled(connection) => connection.send_datagram(bytes),
        }
    }

    /// Waits until the server has admitted the client.
    fn await_ready(&mut self) -> io::Result<()> {
        let mut attempts = READY_ATTEMPTS;
        while !self.with(|replica, _| replica.ready) {
            attempts -= 1;
            if attempts == 0 {
                return Err(io::ErrorKind::TimedOut.into());
            }
            thread::sleep(READY_PAUSE);
            if let Self::Direct(reader) = self {
                let DirectReader {
                    connection,
                    replica,
                    wire,
                } = &mut **reader;
                connection.receive_tcp(replica, wire)?;
            }
        }
        Ok(())
    }

    /// Sends messages and waits until one more frame ends.
    fn frame(&mut self, messages: Vec<Vec<u8>>) -> io::Result<()> {
        match self {
            Self::Direct(reader) => {
                let DirectReader {
                    connection,
                    replica,
                    wire,
                } = &mut **reader;
                connection.catch_up(replica, wire)?;
                connection.send(&messages, wire)?;
                connection.receive(replica, wire)
            }
            Self::Polled(connection) => {
                let awaited = connection.with(|replica, _| replica.await_end());
                connection.send(messages);
                connection.receive(awaited)
            }
        }
    }

    fn with<T>(&mut self, inspect: impl FnOnce(&mut AppReplica, &mut WireCounter) -> T) -> T {
        match self {
            Self::Direct(reader) => inspect(&mut reader.replica, &mut reader.wire),
            Self::Polled(connection) => connection.with(inspect),
        }
    }
}
