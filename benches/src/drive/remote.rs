//! One remote mode: a server process, a client, and what its caller saw.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use glam::{Quat, Vec3};
use rhumb_client::{
    Client, ErrorBound, Event, Inspection, JoinMode, JoinOptions, PipelineDepth, StreamChoice,
    Trust, WireStatistics,
};
use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_protocol::session::Replica;
use rhumb_protocol::stream::Subscriber;
use rhumb_reckoning::{BodyId, Tick, Ticks, Tolerance};
use rhumb_transport::{Clock, LinkConfig, UdpRelay};

use super::compare::{RecentTruth, ViewErrors, compare};
use super::control::ScriptChoice;
use super::{DriveError, PATIENCE, ServerCpu, ServerProcess};
use crate::record::{Breach, CapturedPacket, Cause, CopiedPose, Frame, JoinCost, PacketDirection};

/// How a remote mode is set up.
#[derive(Clone, Debug)]
pub(super) struct Setup<'a> {
    pub(super) stream: StreamChoice,
    pub(super) depth: PipelineDepth,
    /// Free running only: how many ticks later than it can be spoken of the copy is shown.
    pub(super) delay: Ticks,
    pub(super) config: SceneConfig,
    /// Whose controller acts at the server, if it has one.
    pub(super) controller_script: Option<ScriptChoice>,
    pub(super) cpu: ServerCpu,
    pub(super) link: &'a LinkConfig,
    pub(super) seed: u64,
    /// Bodies that are placed in all, later ones included; what the first commands place is counted anyway.
    pub(super) bodies: u32,
    pub(super) keep: Retention,
}

/// What is kept of each frame beside what it cost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Retention {
    /// Every byte that passed and every pose that changed.
    Everything,
    /// Nothing: a run may be as long as it likes.
    Costs,
}

/// What the tap wrote since it was last emptied.
type Tape = Arc<Mutex<Vec<(PacketDirection, Bytes)>>>;

/// A server process and its client.
pub(super) struct Remote {
    client: Client,
    depth: PipelineDepth,
    bodies: u32,
    /// Body indices that the client has given out.
    reserved: u32,
    keep: Retention,
    tape: Tape,
    clock: Clock,
    wire: WireStatistics,
    updates: u64,
    pub(super) frames: Vec<Frame>,
    /// Frames whose truth is not known yet, oldest first.
    pending: VecDeque<PendingFrame>,
    pub(super) captured: Vec<CapturedPacket>,
    pub(super) breaches: Vec<Breach>,
    pub(super) join: JoinCost,
    // Dropped last: the client says goodbye first.
    _relay: Option<UdpRelay>,
    _process: Option<ServerProcess>,
}

/// What was known of how far off a body may be, when it was shown.
#[derive(Clone, Copy, Debug)]
enum StreamKnowledge {
    /// By this factor on its tolerance at most.
    Within(f64),
    /// It was not known, for this reason.
    Unknown(Cause),
}

impl StreamKnowledge {
    /// Why it is off by so much of its tolerance.
    fn cause(self, share: f64) -> Cause {
        match self {
            Self::Within(error_scale) if share <= error_scale => Cause::Budget,
            Self::Within(_) => Cause::Fault,
            Self::Unknown(cause) => cause,
        }
    }
}

/// What a frame showed, kept until its truth is known.
#[derive(Debug)]
struct PendingFrame {
    /// Which frame.
    number: usize,
    /// Each body's pose, and why it would be off if it were, by index.
    bodies: BTreeMap<BodyId, (Vec3, Quat, StreamKnowledge)>,
}

/// The scene's name on the bench's own servers.
pub(super) const SCENE_NAME: &str = "bench";

impl Remote {
    /// Starts a server and joins its scene.
    pub(super) fn start(setup: &Setup<'_>) -> Result<Self, DriveError> {
        let process = ServerProcess::start(&setup.cpu, setup.controller_script.as_ref())?;
        let mut remote = Self::join(&process, setup)?;
        remote._process = Some(process);
        Ok(remote)
    }

    /// Joins the scene of a server that somebody else keeps.
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
            ..JoinOptions::default()
        };
        let trust = Trust::Fingerprint(process.fingerprint);
        let connection = Client::connect_within(&address.to_string(), trust, PATIENCE)?;
        let mut client = connection.join_with(SCENE_NAME, options)?;
        let tape = Tape::default();
        if setup.keep == Retention::Everything {
            record(&mut client, Arc::clone(&tape));
        }
        Ok(Self {
            client,
            depth: setup.depth,
            bodies: setup.bodies,
            reserved: 0,
            keep: setup.keep,
            tape,
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

    /// Gives the commands before the first step, waits until they are applied, and counts all that as joining.
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

    /// Has as many body indices in a row as a script needs. Whoever joins before that has those that follow the first ones.
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

    /// Counts all that was so far as joining.
    pub(super) fn begin(&mut self) -> Result<(), DriveError> {
        self.client.wait(PipelineDepth::LOCKSTEP)?;
        self.tape().clear();
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

    /// One frame of a remote simulator: command, advance, and have every pose of the tick that the call returns.
    pub(super) fn frame(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        let begun = self.clock.now();
        for command in commands {
            self.client.command(command.clone())?;
        }
        let tick = self.client.advance(self.depth)?;
        let frame_ns = self.clock.now().since(begun).as_nanos();
        self.note_frame(tick, frame_ns);
        Ok(())
    }

    /// One frame of a simulator that follows a free-running scene; returns the tick shown.
    pub(super) fn follow(&mut self) -> Result<Tick, DriveError> {
        let begun = self.clock.now();
        let at = self.client.poll()?;
        let frame_ns = self.clock.now().since(begun).as_nanos();
        self.note_frame(at.tick, frame_ns);
        Ok(at.tick)
    }

    /// The tick that a pipelined server still owes, as a frame of its own.
    pub(super) fn last_frame(&mut self) -> Result<(), DriveError> {
        let begun = self.clock.now();
        let tick = self.client.wait(PipelineDepth::LOCKSTEP)?;
        let frame_ns = self.clock.now().since(begun).as_nanos();
        if self.frames.last().is_none_or(|last| last.tick < tick) {
            self.note_frame(tick, frame_ns);
        }
        Ok(())
    }

    /// Takes the last frame out again, if its caller keeps its own account.
    pub(super) fn take_frame(&mut self) -> Option<Frame> {
        self.frames.pop()
    }

    fn tape(&self) -> std::sync::MutexGuard<'_, Vec<(PacketDirection, Bytes)>> {
        self.tape.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes down what the frame cost and what it showed.
    fn note_frame(&mut self, tick: Tick, frame_ns: u64) {
        let statistics = self.client.statistics();
        let (wire, before) = (statistics.wire, self.wire);
        self.wire = wire;
        let view = self.client.view();
        let seen = |place: usize| CopiedPose {
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
            updates: statistics.stream.updates - self.updates,
            ..Frame::default()
        };
        if self.keep == Retention::Everything {
            frame.seen = view.changed().map(seen).collect();
            frame.gone = view.removed().to_vec();
        }
        self.updates = statistics.stream.updates;
        let number = self.frames.len() as u32;
        let taken = std::mem::take(&mut *self.tape());
        self.captured.extend(
            taken
                .into_iter()
                .map(|(direction, bytes)| CapturedPacket::new(number, direction, bytes)),
        );
        self.frames.push(frame);
    }

    /// Judges the last frame against the truth; returns how many bodies its copy lacks, or nothing when that truth is not
    /// known.
    pub(super) fn judge(
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

    /// What is known of how far off a body may be that is shown as of a tick.
    fn knowledge(&self, id: BodyId, tick: Tick) -> StreamKnowledge {
        let client = &self.client;
        let stream = client.replica().map(Replica::stream);
        match client.error_bound_at(id, tick) {
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

    /// Keeps what the last frame showed, to be judged when its truth is known.
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

    /// Whether no frame waits for its truth.
    pub(super) fn is_judged(&self) -> bool {
        self.pending.is_empty()
    }

    /// Judges the frames that were kept, oldest first, as far as their tick has come; returns how many are left.
    pub(super) fn judge_kept(
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
            if errors.is_none() && !recent.has_come(tick) {
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

    /// Sums over tracks in which the copy differed from what the server said.
    pub(super) fn mismatches(&self) -> u64 {
        self.client.statistics().stream.mismatches
    }

    /// What the server says of itself at the end.
    pub(super) fn inspect(&mut self) -> Result<Inspection, DriveError> {
        Ok(self.client.inspect()?)
    }
}

/// Writes down all that passes.
fn record(client: &mut Client, tape: Tape) {
    client.record(move |direction, bytes| {
        let direction = match direction {
            rhumb_client::TapChannel::ControlDown => PacketDirection::ControlDown,
            rhumb_client::TapChannel::ControlUp => PacketDirection::ControlUp,
            rhumb_client::TapChannel::StateDown => PacketDirection::StateDown,
            rhumb_client::TapChannel::StateUp => PacketDirection::StateUp,
        };
        let mut tape = tape.lock().unwrap_or_else(PoisonError::into_inner);
        tape.push((direction, Bytes::copy_from_slice(bytes)));
    });
}
