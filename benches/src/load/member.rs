//! Members of a load: an owner, and followers with a copy or without.
//!
//! Each has a thread, and is a member until the load ends. Measures nothing but its own traffic.
//!
//! Each has a thread. Their notes are shared, and evaluated by the caller at the end of a part. Invariant: a copy is
//! compared at a tick of which it has all, so that every breach is a fault.
//!
//! A follower joins as an observer does, and then counts its packets in place of reading them: a thousand copies of two
//! thousand bodies would measure the copies. It reports no losses. When its connection ends it comes back, as often as
//! that happens.

use std::collections::hash_map::RandomState;
use std::collections::{BTreeMap, HashMap};
use std::hash::BuildHasher as _;
use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bytes::Bytes;
use glam::{Quat, Vec3};
use rhumb_client::{Client, Event, JoinMode, JoinOptions, StreamChoice, TapChannel, Trust};
use rhumb_protocol::message::{ClientMessage, Extensions, Frames, ServerMessage, VERSIONS};
use rhumb_protocol::packet::{Datagram, PacketKind};
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, SceneName, Stepping};
use rhumb_reckoning::{
    BodyId, BodyState, Divergence, Metres, Motion, Tick, Tolerance, ToleranceScale,
};
use rhumb_transport::{ClientOptions, ClientTransport, Fingerprint, QuicClient, Received};
use serde::{Deserialize, Serialize};

use super::rig::{LIMIT, script, take_ids};
use crate::output::Failure;

/// Time between two looks of a member at the clock.
const PAUSE: Duration = Duration::from_millis(50);
/// Time for which a member that was interrupted tries to come back.
const RESUMES_WITHIN: Duration = Duration::from_secs(60);

/// A scene of a server.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) address: SocketAddr,
    pub(super) fingerprint: Fingerprint,
    pub(super) number: u32,
}

/// Contents of a scene.
pub(super) struct Contents {
    pub(super) script: String,
    pub(super) bodies: u32,
    pub(super) seed: u64,
    /// Time after which the bodies are put back where they began.
    pub(super) reset: Duration,
    /// Ticks between publications.
    pub(super) publish_interval: NonZeroU32,
}

impl Place {
    pub(super) fn scene(&self) -> SceneName {
        let name = format!("load/{}", self.number);
        name.parse().expect("a valid name")
    }

    pub(super) fn join(&self, mode: JoinMode) -> Result<Client, Failure> {
        self.join_stream(mode, JoinOptions::default().stream)
    }

    pub(super) fn join_stream(
        &self,
        mode: JoinMode,
        stream: StreamChoice,
    ) -> Result<Client, Failure> {
        let trust = Trust::Fingerprint(self.fingerprint);
        let options = JoinOptions {
            mode,
            stream,
            resume_within: Some(RESUMES_WITHIN),
            ..JoinOptions::default()
        };
        let connection = Client::connect(&self.address.to_string(), trust)?;
        Ok(connection.join_with(self.scene().as_str(), options)?)
    }
}

/// A member that follows its scene until the load ends.
pub(super) struct Member(JoinHandle<MemberEnd>);

/// The end of a member.
#[derive(Debug)]
pub(super) struct MemberEnd {
    /// Cause of its end, unless the load ended it.
    pub(super) error: Option<String>,
    /// UDP payload received.
    pub(super) received_bytes: u64,
    /// Time that it was a member, seconds.
    pub(super) seconds: f64,
}

impl Member {
    /// Creates the scene and places its bodies; then puts them back again and again.
    pub(super) fn own(
        place: &Place,
        contents: &Contents,
        stop: &Arc<AtomicBool>,
    ) -> Result<Self, Failure> {
        let mut script = script(&contents.script, contents.bodies, contents.seed)?;
        let mut config = SceneConfig {
            stepping: Stepping::FreeRunning,
            ..script.config()
        };
        config.publish_schedule.publish_interval = contents.publish_interval;
        let mut client = place.join(JoinMode::Create(config))?;
        let mut commands = Vec::new();
        script.commands(Tick::ZERO, &mut commands);
        let mut resets = Resets::new(&commands);
        take_ids(&mut client, &commands)?;
        for command in commands {
            client.command(command)?;
        }
        client.flush();
        let period = contents.reset;
        // The scenes' resets are spread over the period.
        let first = period * (place.number % 16 + 1) / 16;
        let mut due = Instant::now() + first;
        Ok(Self::follow(client, stop, move |client| {
            if Instant::now() < due {
                return Ok(());
            }
            due += period;
            resets.reset(client)
        }))
    }

    /// Follows a scene, and commands nothing.
    pub(super) fn observe(place: &Place, stop: &Arc<AtomicBool>) -> Result<Self, Failure> {
        let client = place.join(JoinMode::Join)?;
        Ok(Self::follow(client, stop, |_| Ok(())))
    }

    fn follow(
        mut client: Client,
        stop: &Arc<AtomicBool>,
        mut work: impl FnMut(&mut Client) -> Result<(), Failure> + Send + 'static,
    ) -> Self {
        let stop = Arc::clone(stop);
        Self(thread::spawn(move || {
            let begun = Instant::now();
            let before = client.statistics().wire.received_bytes;
            let mut error = None;
            while error.is_none() && !stop.load(Ordering::Relaxed) {
                let turn = work(&mut client).and_then(|()| Ok(client.idle(PAUSE)?));
                error = turn.err().map(|error| error.to_string());
                while client.poll_event().is_some() {}
            }
            MemberEnd {
                error,
                received_bytes: client.statistics().wire.received_bytes - before,
                seconds: begun.elapsed().as_secs_f64(),
            }
        }))
    }

    /// Waits until the member has seen the end of the load.
    pub(super) fn end(self) -> MemberEnd {
        self.0.join().unwrap_or_else(|_| MemberEnd {
            error: Some("its thread panicked".to_owned()),
            received_bytes: 0,
            seconds: 0.0,
        })
    }
}

/// The states in which the bodies of a scene began.
struct Resets(Vec<(BodyId, BodyState)>);

impl Resets {
    fn new(commands: &[Command]) -> Self {
        let movable = commands.iter().filter_map(|command| match command {
            Command::AddBody { desc, motion } if desc.kind == BodyKind::Dynamic => {
                Some((desc.id, *motion))
            }
            _ => None,
        });
        Self(movable.collect())
    }

    fn reset(&mut self, client: &mut Client) -> Result<(), Failure> {
        for &(id, motion) in &self.0 {
            let position = Vec3::from_array(motion.position());
            let rotation = Quat::from_array(motion.rotation());
            client.command(Command::SetPose {
                id,
                position,
                rotation,
            })?;
            let [.., lx, ly, lz, ax, ay, az] = motion.parts();
            let (linear, angular) = (Vec3::new(lx, ly, lz), Vec3::new(ax, ay, az));
            client.command(Command::SetVelocity {
                id,
                linear,
                angular,
            })?;
        }
        client.flush();
        Ok(())
    }
}

/// Time between two looks of a member at its copy.
const LOOK: Duration = Duration::from_millis(5);
/// Rounding of f32 numbers in an error, as a share of the tolerance.
const ROUNDING: f64 = 1e-3;

/// The end to which a member is connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Watch {
    Server,
    /// An edge, by its number.
    Edge(usize),
}

/// The comparison of copies with the server's states.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// Bodies of copies that were compared, once a tick.
    pub compared: u64,
    /// Samples that were further off than their tolerance.
    pub breaches: u64,
    /// The greatest error, in tolerances.
    pub worst: f64,
    /// Checksums of copies that differed from the server's, in the whole run.
    pub mismatches: u64,
}

/// All members with a copy.
pub(super) struct Watchers {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    bodies: Vec<WatchedBody>,
}

#[derive(Clone, Copy, Debug)]
struct WatchedBody {
    id: BodyId,
    radius: Metres,
    scale: ToleranceScale,
}

/// The motion of each body at a tick; `None` for a body that is not there.
type Row = Vec<Option<Motion>>;

/// The notes of members.
#[derive(Default)]
struct Shared {
    hash: RandomState,
    stop: AtomicBool,
    /// Packets of the member of the server, by their bytes.
    direct: Mutex<HashMap<u64, Instant>>,
    /// Packets of the others.
    by_edges: Mutex<Vec<(u64, Instant)>>,
    packets: AtomicU64,
    interrupted: AtomicU64,
    mismatches: AtomicU64,
    compares: AtomicBool,
    truth: Mutex<BTreeMap<Tick, Row>>,
    shown: Mutex<Vec<(Tick, Row)>>,
    fault: Mutex<Option<(usize, Tick, Instant)>>,
    back: Mutex<Vec<Duration>>,
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Watchers {
    pub(super) fn new(contents: &Contents) -> Result<Self, Failure> {
        let mut commands = Vec::new();
        let mut script = script(&contents.script, contents.bodies, contents.seed)?;
        script.commands(Tick::ZERO, &mut commands);
        let radius_of = |command: &Command| match command {
            Command::AddShape { id, shape } => Some((*id, shape.bounding_radius())),
            _ => None,
        };
        let radii: BTreeMap<_, _> = commands.iter().filter_map(radius_of).collect();
        let body = |command: &Command| match command {
            Command::AddBody { desc, .. } => Some(WatchedBody {
                id: desc.id,
                radius: *radii.get(&desc.shape)?,
                scale: desc.tolerance_scale,
            }),
            _ => None,
        };
        Ok(Self {
            shared: Arc::default(),
            threads: Vec::new(),
            bodies: commands.iter().filter_map(body).collect(),
        })
    }

    /// Follows a scene until the end.
    pub(super) fn watch(&mut self, mut client: Client, of: Watch) {
        let shared = Arc::clone(&self.shared);
        client.record(move |channel, bytes| {
            if channel == TapChannel::StateDown {
                shared.note_arrival(of, bytes);
            }
        });
        let shared = Arc::clone(&self.shared);
        let ids: Vec<_> = self.bodies.iter().map(|body| body.id).collect();
        self.threads.push(thread::spawn(move || {
            let mut member = WatchedMember {
                client,
                of,
                complete: Tick::ZERO,
                back_from: None,
            };
            // A look waits for what comes.
            while member.look(&shared, &ids) {
                if shared.stop.load(Ordering::Relaxed) {
                    break;
                }
            }
        }));
    }

    /// Packets of the member of the server so far.
    pub(super) fn packets(&self) -> u64 {
        self.shared.packets.load(Ordering::Relaxed)
    }

    /// Connections that were interrupted so far.
    pub(super) fn interrupted(&self) -> u64 {
        self.shared.interrupted.load(Ordering::Relaxed)
    }

    /// Packets that came until now are not timed.
    pub(super) fn forget_arrivals(&self) {
        lock(&self.shared.by_edges).clear();
        lock(&self.shared.direct).clear();
    }

    /// By how much later each packet came by an edge, nanoseconds.
    pub(super) fn added_ns(&self) -> Vec<u64> {
        let direct = lock(&self.shared.direct);
        let by_edges = lock(&self.shared.by_edges);
        let delays = by_edges.iter().filter_map(|(packet, at)| {
            let delay = at.saturating_duration_since(*direct.get(packet)?);
            u64::try_from(delay.as_nanos()).ok()
        });
        delays.collect()
    }

    /// Compares all copies with the states that a member with a full stream receives, for some time.
    pub(super) fn judge(
        &mut self,
        mut exact: Client,
        tolerance: Tolerance,
        duration: Duration,
    ) -> Result<Judged, Failure> {
        let (shared, begun) = (Arc::clone(&self.shared), Instant::now());
        let ids: Vec<_> = self.bodies.iter().map(|body| body.id).collect();
        shared.compares.store(true, Ordering::Relaxed);
        let mut complete = Tick::ZERO;
        while begun.elapsed() < duration {
            exact.idle(LOOK)?;
            while exact.poll_event().is_some() {}
            if exact.statistics().complete > complete {
                complete = exact.statistics().complete;
                lock(&shared.truth).insert(complete, row(&exact, &ids, complete));
            }
        }
        shared.compares.store(false, Ordering::Relaxed);
        let truth = std::mem::take(&mut *lock(&shared.truth));
        let shown = std::mem::take(&mut *lock(&shared.shown));
        let mut judged = Judged::default();
        for (tick, shown) in &shown {
            if let Some(truth) = truth.get(tick) {
                self.compare(truth, shown, tolerance, &mut judged);
            }
        }
        Ok(judged)
    }

    fn compare(&self, truth: &Row, shown: &Row, tolerance: Tolerance, judged: &mut Judged) {
        for ((body, truth), shown) in self.bodies.iter().zip(truth).zip(shown) {
            let share = match (truth, shown) {
                (None, None) => continue,
                (Some(truth), Some(shown)) => {
                    let apart = Divergence::between(&truth.pose(), &shown.pose());
                    tolerance.scaled(body.scale).share(&apart, body.radius)
                }
                // A body that one of them lacks.
                _ => f64::INFINITY,
            };
            judged.compared += 1;
            judged.breaches += u64::from(share > 1.0 + ROUNDING);
            judged.worst = judged.worst.max(share);
        }
    }

    /// Checksums of copies that differed so far.
    pub(super) fn mismatches(&self) -> u64 {
        self.shared.mismatches.load(Ordering::Relaxed)
    }

    /// From now on, members of an edge note when they have all of a tick later than this one.
    pub(super) fn begin_fault(&self, edge: usize, tick: Tick) {
        lock(&self.shared.back).clear();
        *lock(&self.shared.fault) = Some((edge, tick, Instant::now()));
    }

    /// The times that they noted.
    pub(super) fn back(&self) -> Vec<Duration> {
        lock(&self.shared.back).clone()
    }

    /// Ends all members.
    pub(super) fn end(self) -> Result<(), Failure> {
        self.shared.stop.store(true, Ordering::Relaxed);
        for thread in self.threads {
            let ended = thread.join();
            ended.map_err(|_| "the thread of a member panicked")?;
        }
        Ok(())
    }
}

impl Shared {
    fn note_arrival(&self, of: Watch, bytes: &[u8]) {
        let (packet, now) = (self.hash.hash_one(bytes), Instant::now());
        match of {
            Watch::Server => {
                self.packets.fetch_add(1, Ordering::Relaxed);
                lock(&self.direct).entry(packet).or_insert(now);
            }
            Watch::Edge(_) => lock(&self.by_edges).push((packet, now)),
        }
    }
}

/// The motions of bodies in a copy.
fn row(client: &Client, ids: &[BodyId], tick: Tick) -> Row {
    let stream = client.replica().map(rhumb_client::Replica::stream);
    let motion = |id: &BodyId| stream?.predicted_motion(*id, tick);
    ids.iter().map(motion).collect()
}

struct WatchedMember {
    client: Client,
    of: Watch,
    complete: Tick,
    /// The beginning of the last fault from which it came back.
    back_from: Option<Instant>,
}

impl WatchedMember {
    /// One look; false once the connection is over for good.
    fn look(&mut self, shared: &Shared, ids: &[BodyId]) -> bool {
        if self.client.idle(LOOK).is_err() {
            shared.interrupted.fetch_add(1, Ordering::Relaxed);
            return false;
        }
        while let Some((_, event)) = self.client.poll_event() {
            let count = match event {
                Event::ChecksumMismatch => &shared.mismatches,
                Event::Interrupted(_) => &shared.interrupted,
                _ => continue,
            };
            count.fetch_add(1, Ordering::Relaxed);
        }
        let complete = self.client.statistics().complete;
        if complete > self.complete && shared.compares.load(Ordering::Relaxed) {
            let shown = row(&self.client, ids, complete);
            lock(&shared.shown).push((complete, shown));
        }
        self.complete = complete;
        let fault = *lock(&shared.fault);
        if let Some((edge, tick, since)) = fault
            && self.of == Watch::Edge(edge)
            && complete > tick
            && self.back_from != Some(since)
        {
            self.back_from = Some(since);
            lock(&shared.back).push(since.elapsed());
        }
        true
    }
}

/// Followers of one place, which a thread drives.
pub(super) struct Crowd {
    thread: JoinHandle<()>,
    tasks: Sender<Task>,
    counts: Arc<Counts>,
}

/// Counts of what a crowd has received so far.
#[derive(Debug, Default)]
struct Counts {
    packets: AtomicU64,
    lost: AtomicU64,
    absence: Mutex<Absence>,
}

/// Followers that have lost their connection and are not back.
#[derive(Clone, Copy, Debug, Default)]
struct Absence {
    absent: usize,
    /// The first loss of those that are not all repaired.
    since: Option<Instant>,
    /// The duration of the last absence, until all were back.
    lasted: Option<Duration>,
}

enum Task {
    /// This follower has something to receive.
    Receive(usize),
    /// An attempt of this follower to connect has ended.
    Opened(usize, Option<QuicClient>),
    /// The crowd ends.
    End,
}

struct Follower {
    connection: QuicClient,
    frames: Frames,
    /// True while the loop knows that something has come.
    has_news: Arc<AtomicBool>,
    is_member: bool,
}

impl Crowd {
    /// Followers who are all members of a place's scene.
    ///
    /// # Errors
    ///
    /// One of them is not connected, or is no member in time.
    pub(super) fn enter(
        place: &Place,
        followers: u32,
        entered: &dyn Fn(),
    ) -> Result<Self, Failure> {
        let (tasks, receiver) = mpsc::channel();
        let (joined, has_joined) = mpsc::channel();
        let counts = Arc::new(Counts::default());
        let running = RunningCrowd {
            place: place.clone(),
            followers: BTreeMap::new(),
            tasks: tasks.clone(),
            joined,
            counts: Arc::clone(&counts),
        };
        let thread = thread::spawn(move || running.run(&receiver));
        for number in 0..followers as usize {
            let connection = connect(place)?;
            tasks.send(Task::Opened(number, Some(connection)))?;
            has_joined.recv_timeout(LIMIT)?;
            entered();
        }
        Ok(Self {
            thread,
            tasks,
            counts,
        })
    }

    /// Datagrams of the stream so far, of all followers.
    pub(super) fn packets(&self) -> u64 {
        self.counts.packets.load(Ordering::Relaxed)
    }

    /// Connections that have ended so far.
    pub(super) fn lost(&self) -> u64 {
        self.counts.lost.load(Ordering::Relaxed)
    }

    /// The time from the first of the last losses until all were members again; `None` if some are not, or none was lost.
    pub(super) fn absence(&self) -> Option<Duration> {
        let absence = self.counts.absence();
        absence.lasted.filter(|_| absence.absent == 0)
    }

    /// Closes all connections.
    pub(super) fn end(self) -> Result<(), Failure> {
        // A thread that has ended is noticed by the join.
        let _ = self.tasks.send(Task::End);
        let ended = self.thread.join();
        ended.map_err(|_| "the thread of a crowd panicked".into())
    }
}

impl Counts {
    fn absence(&self) -> MutexGuard<'_, Absence> {
        self.absence.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn connect(place: &Place) -> Result<QuicClient, Failure> {
    let options = ClientOptions::new(place.address, Trust::Fingerprint(place.fingerprint));
    Ok(QuicClient::connect(options, LIMIT)?)
}

struct RunningCrowd {
    place: Place,
    followers: BTreeMap<usize, Follower>,
    tasks: Sender<Task>,
    joined: Sender<()>,
    counts: Arc<Counts>,
}

impl RunningCrowd {
    fn run(mut self, tasks: &Receiver<Task>) {
        while let Ok(task) = tasks.recv() {
            match task {
                Task::Receive(number) => self.receive(number),
                Task::Opened(number, Some(connection)) => self.open(number, connection),
                Task::Opened(number, None) => self.come_back(number),
                Task::End => break,
            }
        }
        // Closing waits for each connection in turn: all at once.
        let closing = self.followers.into_values();
        let closing: Vec<_> = closing
            .map(|follower| thread::spawn(move || drop(follower)))
            .collect();
        for closed in closing {
            // A connection that is not closed in order ends with the process.
            let _ = closed.join();
        }
    }

    fn open(&mut self, number: usize, connection: QuicClient) {
        let hello = ClientMessage::Hello {
            versions: VERSIONS.to_vec(),
            scene: self.place.scene(),
            extensions: Extensions::NONE,
        };
        let has_news = Arc::new(AtomicBool::new(false));
        send(&connection, &hello);
        let (known, tasks) = (Arc::clone(&has_news), self.tasks.clone());
        connection.on_arrival(move || {
            if !known.swap(true, Ordering::AcqRel) {
                let _ = tasks.send(Task::Receive(number));
            }
        });
        let follower = Follower {
            connection,
            frames: Frames::new(),
            has_news,
            is_member: false,
        };
        self.followers.insert(number, follower);
    }

    fn receive(&mut self, number: usize) {
        let Some(follower) = self.followers.get_mut(&number) else {
            return;
        };
        follower.has_news.store(false, Ordering::Release);
        let was_member = follower.is_member;
        while let Some(received) = follower.connection.recv(Duration::ZERO) {
            match received {
                Received::Control(bytes) => follower.read(&bytes),
                Received::State(bytes) => {
                    let packets = u64::from(is_of_stream(&bytes));
                    self.counts.packets.fetch_add(packets, Ordering::Relaxed);
                }
                Received::Ended(_) => return self.lose(number),
            }
        }
        if follower.is_member && !was_member {
            self.note_member();
        }
    }

    fn note_member(&self) {
        // One that comes back is not awaited.
        let _ = self.joined.send(());
        let mut absence = self.counts.absence();
        if let Some(since) = absence.since {
            absence.absent -= 1;
            if absence.absent == 0 {
                absence.lasted = Some(since.elapsed());
                absence.since = None;
            }
        }
    }

    fn lose(&mut self, number: usize) {
        let Some(lost) = self.followers.remove(&number) else {
            return;
        };
        if lost.is_member {
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
            let mut absence = self.counts.absence();
            absence.absent += 1;
            absence.since.get_or_insert_with(Instant::now);
        }
        thread::spawn(move || drop(lost));
        self.come_back(number);
    }

    /// Tries again on a thread: opening waits.
    fn come_back(&self, number: usize) {
        let (place, tasks) = (self.place.clone(), self.tasks.clone());
        thread::spawn(move || {
            let connection = connect(&place).ok();
            // A crowd that has ended needs none.
            let _ = tasks.send(Task::Opened(number, connection));
        });
    }
}

impl Follower {
    fn read(&mut self, bytes: &[u8]) {
        self.frames.push(bytes);
        while let Ok(Some(framed)) = self.frames.next_frame() {
            match ServerMessage::decode(&framed) {
                Ok(Some(ServerMessage::Welcome(_))) => {
                    let choice = StreamChoice::Within(Tolerance::NORMAL);
                    send(&self.connection, &ClientMessage::Join(choice));
                }
                Ok(Some(ServerMessage::SnapshotEnd)) => self.is_member = true,
                _ => {}
            }
        }
    }
}

fn send(connection: &QuicClient, message: &ClientMessage) {
    let mut bytes = Vec::new();
    message.encode(&mut bytes);
    connection.send_control(Bytes::from(bytes));
}

/// True for what the scene's publisher sent, as the edge forwards it.
fn is_of_stream(bytes: &Bytes) -> bool {
    Datagram::open(bytes).is_ok_and(|datagram| datagram.head().kind != PacketKind::LossReport)
}
