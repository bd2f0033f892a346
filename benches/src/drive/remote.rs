//! One remote mode: a server process, a client, and its frames.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use glam::{Quat, Vec3};
use rhumb_client::{
    Client, ErrorBound, Event, Inspection, JoinMode, JoinOptions, PipelineDepth, Refusals,
    StreamChoice, Trust, WireStatistics,
};
use rhumb_netsim::{LinkConfig, UdpRelay};
use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_protocol::session::Replica;
use rhumb_protocol::stream::Subscriber;
use rhumb_reckoning::{BodyId, Tick, Ticks, Tolerance};
use rhumb_transport::Clock;

use super::compare::{RecentTruth, ViewErrors, compare};
use super::process::{SERVER_TIMEOUT, ScriptChoice, ServerCpu, ServerProcess};
use crate::drive::DriveError;
use crate::record::{Breach, CapturedPacket, Cause, CopiedPose, Frame, JoinCost, PacketDirection};

/// Setup of a remote mode.
#[derive(Clone, Debug)]
pub(super) struct Setup<'a> {
    pub(super) stream: StreamChoice,
    pub(super) depth: PipelineDepth,
    /// Free running only: ticks by which the view lags behind the newest tick that can be shown.
    pub(super) delay: Ticks,
    pub(super) config: SceneConfig,
    /// Script whose controller runs at the server, if any.
    pub(super) controller_script: Option<ScriptChoice>,
    pub(super) cpu: ServerCpu,
    pub(super) link: &'a LinkConfig,
    pub(super) seed: u64,
    /// Number of bodies placed in total, later ones included; bodies of the first commands are counted anyway.
    pub(super) bodies: u32,
    pub(super) keep: Retention,
}

/// The data of each frame that are kept besides its cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Retention {
    /// All packets and all changed poses.
    Everything,
    /// Nothing more, so a run may have any length.
    Costs,
}

/// Packets recorded since the log was last emptied.
type PacketLog = Arc<Mutex<Vec<(PacketDirection, Bytes)>>>;

/// A server process and its client.
pub(super) struct Remote {
    client: Client,
    depth: PipelineDepth,
    bodies: u32,
    /// Body indices that the client has given out.
    reserved: u32,
    keep: Retention,
    packet_log: PacketLog,
    clock: Clock,
    wire: WireStatistics,
    updates: u64,
    pub(super) frames: Vec<Frame>,
    /// Frames whose truth is not yet known, oldest first.
    pending: VecDeque<PendingFrame>,
    pub(super) captured: Vec<CapturedPacket>,
    pub(super) breaches: Vec<Breach>,
    pub(super) join: JoinCost,
    // Dropped last, so that the client can close the connection.
    _relay: Option<UdpRelay>,
    _process: Option<ServerProcess>,
}

/// Error bound of a body that the stream stated when the body was shown.
#[derive(Clone, Copy, Debug)]
enum StreamKnowledge {
    /// The error is at most this factor times the tolerance.
    Within(f64),
    /// Unknown, for this reason.
    Unknown(Cause),
}

impl StreamKnowledge {
    /// Cause of an error of `share` times the tolerance.
    fn cause(self, share: f64) -> Cause {
        match self {
            Self::Within(error_scale) if share <= error_scale => Cause::Budget,
            Self::Within(_) => Cause::Fault,
            Self::Unknown(cause) => cause,
        }
    }
}

/// A frame's poses, kept until its truth is known.
#[derive(Debug)]
struct PendingFrame {
    /// Number of the frame.
    number: usize,
    /// Pose of each body, and the error bound known for it.
    bodies: BTreeMap<BodyId, (Vec3, Quat, StreamKnowledge)>,
}

/// Name of the scene on the benchmark's own servers.
const SCENE_NAME: &str = "bench";

impl Remote {
    /// Starts a server and joins its scene.
    pub(super) fn start(setup: &Setup<'_>) -> Result<Self, DriveError> {
        let process = ServerProcess::start(&setup.cpu, setup.controller_script.as_ref())?;
        let mut remote = Self::join(&process, setup)?;
        remote._process = Some(process);
        Ok(remote)
    }

    /// Joins a scene on a server that the caller owns.
    pub(super) fn join(process: &ServerProcess, setup: &Setup<'_>) -> Result<Self, DriveError> {
        let relay = if *setup.link == LinkConfig::PERFECT {
            None
        } else {
            let any_port = "127.0.0.1:0".parse().expect("an address of loopback");
            Some(UdpRelay::start(
                any_port,
                process.address,
                *setup.link,
                setup.seed,
            )?)
        };
        let address = relay.as_ref().map_or(process.address, UdpRelay::local_addr);
        let options = JoinOptions {
            mode: JoinMode::CreateOrJoin(setup.config),
            stream: setup.stream,
            delay_ticks: f64::from(setup.delay.count()),
            whole_ticks: true,
            smooth: false,
            refusals: Refusals::Events,
            ..JoinOptions::default()
        };
        let trust = Trust::Fingerprint(process.fingerprint);
        let connection = Client::connect_within(&address.to_string(), trust, SERVER_TIMEOUT)?;
        let mut client = connection.join_with(SCENE_NAME, options)?;
        let packet_log = PacketLog::default();
        if setup.keep == Retention::Everything {
            record(&mut client, Arc::clone(&packet_log));
        }
        Ok(Self {
            client,
            depth: setup.depth,
            bodies: setup.bodies,
            reserved: 0,
            keep: setup.keep,
            packet_log,
            clock: Clock::start(),
            wire: WireStatistics::default(),
            updates: 0,
            frames: Vec::new(),
            pending: VecDeque::new(),
            captured: Vec::new(),
            breaches: Vec::new(),
            join: JoinCost::default(),
            _relay: relay,
            _process: None,
        })
    }

    /// Sends the commands before the first step and waits until they are applied; the traffic counts as joining.
    pub(super) fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        self.reserve(commands)?;
        let mut last = None;
        for command in commands {
            last = Some(self.client.command(command.clone())?);
        }
        if let Some(last) = last {
            self.await_applied(last)?;
        }
        self.begin()
    }

    /// Reserves enough consecutive body indices for the script. Call it before other clients join: their grants follow
    /// the first one.
    pub(super) fn reserve(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        let needed = commands
            .iter()
            .filter(|command| matches!(command, Command::AddBody { .. }))
            .count() as u32;
        let needed = needed.max(self.bodies);
        let more = self.client.new_ids(needed.saturating_sub(self.reserved))?;
        let expected = (self.reserved..).map(|index| BodyId::new(index, 0));
        if more
            .iter()
            .zip(expected)
            .any(|(id, expected)| *id != expected)
        {
            return Err(DriveError::NotGranted);
        }
        self.reserved += more.len() as u32;
        Ok(())
    }

    /// Counts all traffic so far as joining.
    pub(super) fn begin(&mut self) -> Result<(), DriveError> {
        self.client.wait(PipelineDepth::LOCKSTEP)?;
        self.packet_log().clear();
        self.wire = self.client.statistics().wire;
        self.join = JoinCost {
            wire_bytes_down: self.wire.received_bytes,
            wire_datagrams_down: self.wire.received_datagrams,
            wire_bytes_up: self.wire.sent_bytes,
            wire_datagrams_up: self.wire.sent_datagrams,
        };
        Ok(())
    }

    fn await_applied(&mut self, number: u64) -> Result<(), DriveError> {
        loop {
            while let Some((_, event)) = self.client.poll_event() {
                match event {
                    Event::Refused { error, .. } => {
                        return Err(DriveError::Refused(error));
                    }
                    Event::Applied { through, .. } if through >= number => {
                        return Ok(());
                    }
                    _ => {}
                }
            }
            self.client.idle(Duration::from_millis(1))?;
        }
    }

    /// One frame of a remote simulator: commands, advance, and every pose of the returned tick.
    pub(super) fn frame(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        let begun = self.clock.now();
        for command in commands {
            self.client.command(command.clone())?;
        }
        let tick = self.client.advance(self.depth)?;
        let frame_ns = self.clock.now().since(begun).as_nanos();
        self.record_frame(tick, frame_ns);
        Ok(())
    }

    /// One frame of a client of a free-running scene; returns the tick shown.
    pub(super) fn update_view(&mut self) -> Result<Tick, DriveError> {
        let begun = self.clock.now();
        let at = self.client.poll()?;
        let frame_ns = self.clock.now().since(begun).as_nanos();
        self.record_frame(at.tick, frame_ns);
        Ok(at.tick)
    }

    /// The last tick of a pipelined server, as a frame of its own.
    pub(super) fn last_frame(&mut self) -> Result<(), DriveError> {
        let begun = self.clock.now();
        let tick = self.client.wait(PipelineDepth::LOCKSTEP)?;
        let frame_ns = self.clock.now().since(begun).as_nanos();
        if self.frames.last().is_none_or(|last| last.tick < tick) {
            self.record_frame(tick, frame_ns);
        }
        Ok(())
    }

    /// Removes and returns the last frame, for callers that keep their own record.
    pub(super) fn take_frame(&mut self) -> Option<Frame> {
        self.frames.pop()
    }

    fn packet_log(&self) -> std::sync::MutexGuard<'_, Vec<(PacketDirection, Bytes)>> {
        self.packet_log
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Records the cost of the frame and the poses it shows.
    fn record_frame(&mut self, tick: Tick, frame_ns: u64) {
        let statistics = self.client.statistics();
        let (wire, before) = (statistics.wire, self.wire);
        self.wire = wire;
        let view = self.client.view();
        let pose = |place: usize| CopiedPose {
            id: view.ids()[place],
            position: view.positions()[place].to_array(),
            rotation: view.rotations()[place].to_array(),
            resting: view.resting()[place],
        };
        let mut frame = Frame {
            tick,
            frame_ns,
            wire_bytes_down: wire.received_bytes - before.received_bytes,
            wire_bytes_up: wire.sent_bytes - before.sent_bytes,
            wire_datagrams_down: wire.received_datagrams - before.received_datagrams,
            wire_datagrams_up: wire.sent_datagrams - before.sent_datagrams,
            // A stream that was changed or joined anew counts from 0.
            updates: (statistics.stream.updates.checked_sub(self.updates))
                .unwrap_or(statistics.stream.updates),
            ..Frame::default()
        };
        if self.keep == Retention::Everything {
            frame.changed = view.changed().map(pose).collect();
            frame.removed = view.removed().to_vec();
        }
        self.updates = statistics.stream.updates;
        let number = self.frames.len() as u32;
        let taken = std::mem::take(&mut *self.packet_log());
        self.captured.extend(
            taken
                .into_iter()
                .map(|(direction, bytes)| CapturedPacket::new(number, direction, bytes)),
        );
        self.frames.push(frame);
    }

    /// Records the errors of the last frame against the truth; returns how many bodies the copy lacks, or `None` if
    /// that truth is unknown.
    pub(super) fn record_errors(
        &mut self,
        recent: &RecentTruth,
        tolerance: Option<Tolerance>,
    ) -> Option<u32> {
        let number = self.frames.len().checked_sub(1)?;
        let tick = self.frames[number].tick;
        let view = self.client.view();
        let shown = |id: BodyId| {
            let place = view.place(id)?;
            Some((view.positions()[place], view.rotations()[place]))
        };
        let errors = compare(recent, tick, shown, tolerance, |id, share| {
            self.knowledge(id, tick).cause(share)
        })?;
        Some(self.take_errors(number, errors))
    }

    /// Error bound that the stream states for a body shown at a tick.
    fn knowledge(&self, id: BodyId, tick: Tick) -> StreamKnowledge {
        let client = &self.client;
        let stream = client.replica().map(Replica::stream);
        match client.tick_error_bound(id, tick) {
            Some(ErrorBound::Within(_)) => {
                let error_scale = stream.and_then(|stream| stream.error_scale_at(tick));
                StreamKnowledge::Within(error_scale.unwrap_or(1.0))
            }
            _ if tick > client.statistics().watermark_tick => StreamKnowledge::Unknown(Cause::Late),
            _ if stream.is_some_and(Subscriber::is_converged) => {
                StreamKnowledge::Unknown(Cause::Late)
            }
            _ => StreamKnowledge::Unknown(Cause::Loss),
        }
    }

    fn take_errors(&mut self, number: usize, errors: ViewErrors) -> u32 {
        let frame = &mut self.frames[number];
        frame.errors_m = errors.errors_m;
        frame.exact = errors.exact;
        self.breaches.extend(errors.breaches);
        errors.missing
    }

    /// Keeps the poses of the last frame until its truth is known.
    pub(super) fn keep(&mut self) {
        let Some(number) = self.frames.len().checked_sub(1) else {
            return;
        };
        let tick = self.frames[number].tick;
        let view = self.client.view();
        let body = |(place, id): (usize, &BodyId)| {
            let pose = (view.positions()[place], view.rotations()[place]);
            (*id, (pose.0, pose.1, self.knowledge(*id, tick)))
        };
        let bodies = view.ids().iter().enumerate().map(body).collect();
        self.pending.push_back(PendingFrame { number, bodies });
    }

    /// True if no frame waits for its truth.
    pub(super) fn has_no_pending(&self) -> bool {
        self.pending.is_empty()
    }

    /// Records the errors of pending frames, oldest first, up to the newest known tick; returns how many stay pending.
    pub(super) fn record_pending_errors(
        &mut self,
        recent: &RecentTruth,
        tolerance: Option<Tolerance>,
    ) -> usize {
        while let Some(shown) = self.pending.front() {
            let tick = self.frames[shown.number].tick;
            let pose = |id: BodyId| {
                let (position, rotation, _) = shown.bodies.get(&id)?;
                Some((*position, *rotation))
            };
            // A body that was not shown is missing and has no error.
            let cause = |id: BodyId, share: f64| {
                let knowledge = shown.bodies.get(&id).map(|body| body.2);
                knowledge.map_or(Cause::Late, |knowledge| knowledge.cause(share))
            };
            let number = shown.number;
            let errors = compare(recent, tick, pose, tolerance, cause);
            if errors.is_none() && !recent.has_reached(tick) {
                break;
            }
            self.pending.pop_front();
            if let Some(errors) = errors {
                self.take_errors(number, errors);
            }
        }
        self.pending.len()
    }

    pub(super) fn client(&mut self) -> &mut Client {
        &mut self.client
    }

    /// Track checksums in which the copy differs from the server.
    pub(super) fn mismatches(&self) -> u64 {
        self.client.statistics().stream.mismatches
    }

    /// The server's report on the scene at the end.
    pub(super) fn inspect(&mut self) -> Result<Inspection, DriveError> {
        Ok(self.client.inspect()?)
    }
}

/// Records all packets of a client.
fn record(client: &mut Client, packet_log: PacketLog) {
    client.record(move |direction, bytes| {
        let direction = match direction {
            rhumb_client::TapChannel::ControlDown => PacketDirection::ControlDown,
            rhumb_client::TapChannel::ControlUp => PacketDirection::ControlUp,
            rhumb_client::TapChannel::StateDown => PacketDirection::StateDown,
            rhumb_client::TapChannel::StateUp => PacketDirection::StateUp,
        };
        let mut packet_log = packet_log.lock().unwrap_or_else(PoisonError::into_inner);
        packet_log.push((direction, Bytes::copy_from_slice(bytes)));
    });
}
