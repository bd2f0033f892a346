//! Members of a load: owner, observers, followers without a copy, a commander.
//!
//! Each is a member until the load ends. Measures nothing but its own traffic.
//!
//! A follower joins as an observer does, and then counts its packets in place of reading them: a thousand copies of two
//! thousand bodies would measure the copies. It reports no losses, and asks what a member asks whose view has no news. When
//! its connection ends it comes back, as often as that happens.

use std::fmt::Display;
use std::net::{Ipv4Addr, SocketAddr};
use std::num::NonZeroU32;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bytes::Bytes;
use glam::{Quat, Vec3};
use quinn::{Connection, Endpoint, EndpointConfig, RecvStream, SendStream, TokioRuntime, VarInt};
use rhumb_client::scene::{BodyDesc, Shape, Sleep};
use rhumb_client::{Client, Event, JoinMode, JoinOptions, Replica, StreamChoice, Trust};
use rhumb_link::connection::Unnamed;
use rhumb_link::trust::client_tls;
use rhumb_link::{bind_udp, io_runtime, tuning};
use rhumb_protocol::message::{ClientMessage, Extensions, Frames, ServerMessage, VERSIONS};
use rhumb_protocol::packet::{Datagram, LossReport, Low16, PacketKind, StreamId};
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, SceneName, Stepping};
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};
use rhumb_transport::{Fingerprint, TransportCode};
use serde::{Deserialize, Serialize};
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{sleep, sleep_until, timeout};

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

/// Followers of one place, on one thread: with a thread for each, a load would measure the threads.
pub(super) struct Crowd {
    followers: u32,
    thread: JoinHandle<()>,
    /// Lets one more follower enter; the crowd ends without it.
    entrance: UnboundedSender<()>,
    counts: Arc<Counts>,
}

/// Counts of what a crowd has received so far.
#[derive(Debug, Default)]
struct Counts {
    packets: AtomicU64,
    lost: AtomicU64,
    absence: Mutex<Absence>,
}

/// Followers that have lost their connection.
#[derive(Clone, Copy, Debug, Default)]
struct Absence {
    /// Those that are not back.
    absent: usize,
    /// When the last one came back.
    back_at: Option<Instant>,
}

/// What the followers of a crowd have in common.
struct RunningCrowd {
    place: Place,
    /// Tells who waits for a follower that it is a member, or why it is none yet.
    joined: Sender<Result<(), Failure>>,
    counts: Arc<Counts>,
}

/// What a follower is to its crowd.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Attendance {
    /// It has not been a member.
    New,
    Member,
    /// It was one, and is not back.
    Absent,
}

/// The end of a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Attended {
    UntilLost,
    /// The crowd has ended.
    ToTheEnd,
}

/// A follower with a connection.
struct Follower {
    endpoint: Endpoint,
    connection: Connection,
    requests: SendStream,
    frames: Frames,
    asks_at: Instant,
    /// Its newest packet; `None` before the first one.
    newest: Option<NewestPacket>,
}

/// The newest packet of a follower's stream.
#[derive(Clone, Copy, Debug)]
struct NewestPacket {
    at: Instant,
    /// When the newest packet came that was no watermark.
    spoke_at: Instant,
    stream: StreamId,
    /// The number of the packet after it.
    next: Low16,
}

/// Time between two questions of a follower without news, as of a view, and between two attempts to connect.
const AGAIN: Duration = Duration::from_millis(100);
/// Bytes of one read of news, at most.
const READ_BYTES_MAX: usize = 64 << 10;
/// Time in which a close frame leaves.
const CLOSES: Duration = Duration::from_millis(500);
/// The longest time between two watermarks, and the time after the next one for which a view predicts.
const SILENCE: Duration = Duration::from_millis(2_500);
const PREDICTED: Duration = Duration::from_millis(500);

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
        let runtime = io_runtime()?;
        let (entrance, entering) = unbounded_channel();
        let (joined, has_joined) = mpsc::channel();
        let counts = Arc::new(Counts::default());
        let running = Arc::new(RunningCrowd {
            place: place.clone(),
            joined,
            counts: Arc::clone(&counts),
        });
        let thread = thread::spawn(move || runtime.block_on(running.run(entering)));
        for number in 0..followers {
            entrance.send(())?;
            let address = place.address;
            let refused = |cause: &dyn Display| format!("follower {number} of {address}: {cause}");
            has_joined
                .recv_timeout(LIMIT)
                .map_err(|_| refused(&format!("no member within {LIMIT:?}")))?
                .map_err(|cause| refused(&cause))?;
            entered();
        }
        Ok(Self {
            followers,
            thread,
            entrance,
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

    /// Their number.
    pub(super) const fn followers(&self) -> u64 {
        self.followers as u64
    }

    /// Those that are no members now.
    pub(super) fn absent(&self) -> usize {
        self.counts.absence().absent
    }

    /// When the last one came back; `None` if none was lost.
    pub(super) fn back_at(&self) -> Option<Instant> {
        self.counts.absence().back_at
    }

    /// Closes all connections.
    pub(super) fn end(self) -> Result<(), Failure> {
        drop(self.entrance);
        let ended = self.thread.join();
        ended.map_err(|_| "the thread of a crowd panicked".into())
    }
}

impl Counts {
    fn absence(&self) -> MutexGuard<'_, Absence> {
        self.absence.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl RunningCrowd {
    async fn run(self: Arc<Self>, mut entering: UnboundedReceiver<()>) {
        let (end, has_ended) = watch::channel(());
        let mut followers = JoinSet::new();
        while entering.recv().await.is_some() {
            let (crowd, has_ended) = (Arc::clone(&self), has_ended.clone());
            followers.spawn(async move { crowd.follow(has_ended).await });
        }
        drop(end);
        // Each closes its connection; the panic of one is that of the crowd.
        followers.join_all().await;
    }

    /// One follower, as often as its connection ends, until the crowd ends.
    async fn follow(&self, mut has_ended: watch::Receiver<()>) {
        let mut attendance = Attendance::New;
        loop {
            let opened = tokio::select! {
                _ = has_ended.changed() => return,
                opened = timeout(LIMIT, self.open()) => opened,
            };
            let opened =
                opened.unwrap_or_else(|_| Err(format!("no answer within {LIMIT:?}").into()));
            match opened {
                Ok((follower, news)) => {
                    let attended = self.attend((follower, news), &mut attendance, &mut has_ended);
                    if attended.await == Attended::ToTheEnd {
                        return;
                    }
                }
                // One that was a member tries again, as often as it takes.
                Err(cause) if attendance == Attendance::New => {
                    let _ = self.joined.send(Err(cause));
                }
                Err(_) => {}
            }
            sleep(AGAIN).await;
        }
    }

    /// Connects, and asks for the scene.
    async fn open(&self) -> Result<(Follower, RecvStream), Failure> {
        let trust = Trust::Fingerprint(self.place.fingerprint);
        let config = tuning::client(client_tls(&trust)?)?;
        let socket = bind_udp((Ipv4Addr::UNSPECIFIED, 0).into())?;
        let mut local = EndpointConfig::default();
        local.cid_generator(|| Box::new(Unnamed));
        let endpoint = Endpoint::new(local, None, socket, Arc::new(TokioRuntime))?;
        let connecting = endpoint.connect_with(config, self.place.address, "localhost")?;
        let connection = connecting.await?;
        let (requests, news) = connection.open_bi().await?;
        let mut follower = Follower {
            endpoint,
            connection,
            requests,
            frames: Frames::new(),
            asks_at: Instant::now() + SILENCE,
            newest: None,
        };
        let hello = ClientMessage::Hello {
            versions: VERSIONS.to_vec(),
            scene: self.place.scene(),
            extensions: Extensions::NONE,
        };
        follower.send(&hello).await?;
        Ok((follower, news))
    }

    /// Receives until the connection or the crowd ends.
    async fn attend(
        &self,
        (mut follower, mut news): (Follower, RecvStream),
        attendance: &mut Attendance,
        has_ended: &mut watch::Receiver<()>,
    ) -> Attended {
        let asks_at = sleep_until(follower.asks_at.into());
        tokio::pin!(asks_at);
        loop {
            tokio::select! {
                _ = has_ended.changed() => break,
                received = follower.connection.read_datagram() => match received {
                    Ok(bytes) => {
                        let packets = u64::from(follower.note_packet(&bytes));
                        self.counts.packets.fetch_add(packets, Ordering::Relaxed);
                    }
                    Err(_) => return self.lose(attendance),
                },
                received = news.read_chunk(READ_BYTES_MAX, true) => {
                    let read = match received {
                        Ok(Some(chunk)) => follower.read(&chunk.bytes).await,
                        Ok(None) | Err(_) => Err("the stream has ended".into()),
                    };
                    match read {
                        Ok(true) => self.note_member(attendance),
                        Ok(false) => {}
                        Err(_) => return self.lose(attendance),
                    }
                }
                () = &mut asks_at => {
                    if Instant::now() >= follower.asks_at {
                        follower.ask();
                    }
                    asks_at.as_mut().reset(follower.asks_at.into());
                }
            }
            if asks_at.deadline() > follower.asks_at.into() {
                asks_at.as_mut().reset(follower.asks_at.into());
            }
        }
        let code = VarInt::from_u32(TransportCode::LEFT.0);
        follower.connection.close(code, b"");
        // A connection that is not closed in order ends with the process.
        let _ = timeout(CLOSES, follower.endpoint.wait_idle()).await;
        Attended::ToTheEnd
    }

    fn note_member(&self, attendance: &mut Attendance) {
        match std::mem::replace(attendance, Attendance::Member) {
            Attendance::New => {
                // Who waited may have given up.
                let _ = self.joined.send(Ok(()));
            }
            Attendance::Absent => {
                let mut absence = self.counts.absence();
                absence.absent -= 1;
                absence.back_at = Some(Instant::now());
            }
            Attendance::Member => {}
        }
    }

    fn lose(&self, attendance: &mut Attendance) -> Attended {
        if *attendance == Attendance::Member {
            *attendance = Attendance::Absent;
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
            self.counts.absence().absent += 1;
        }
        Attended::UntilLost
    }
}

impl Follower {
    /// Notes a datagram; true for what the scene's publisher sent, as the edge forwards it.
    fn note_packet(&mut self, bytes: &Bytes) -> bool {
        let Ok(datagram) = Datagram::open(bytes) else {
            return false;
        };
        let (head, mut body, at) = (datagram.head(), datagram.body(), Instant::now());
        let stream = head.stream;
        let number = Low16::decode(&mut body);
        self.newest = match (head.kind, number) {
            (PacketKind::LossReport, _) => return false,
            (PacketKind::Updates | PacketKind::UpdatesEnd, Ok(number)) => Some(NewestPacket {
                at,
                spoke_at: at,
                stream,
                next: Low16(number.0.wrapping_add(1)),
            }),
            (PacketKind::Watermark, Ok(next)) => Some(NewestPacket {
                at,
                spoke_at: self.newest.map_or(at, |newest| newest.spoke_at),
                stream,
                next,
            }),
            _ => self.newest.map(|newest| NewestPacket { at, ..newest }),
        };
        if let Some(newest) = self.newest {
            let silent = newest.at.duration_since(newest.spoke_at).min(SILENCE);
            self.asks_at = newest.at + silent + PREDICTED;
        }
        true
    }

    /// Asks for the watermark, as a view that has had no news for longer than it predicts.
    fn ask(&mut self) {
        self.asks_at = Instant::now() + AGAIN;
        let Some(newest) = self.newest else {
            return;
        };
        let report = LossReport {
            next: newest.next,
            abandoned: Low16(0),
            repair_symbols: 0,
            lost: Vec::new(),
        };
        let report = Bytes::from(report.encode(newest.stream));
        // A connection that takes none has ended, which the next read says.
        let _ = self.connection.send_datagram(report);
    }

    /// Answers what the server says; true once it says that the follower is a member.
    async fn read(&mut self, bytes: &[u8]) -> Result<bool, Failure> {
        self.frames.push(bytes);
        let mut is_member = false;
        while let Ok(Some(framed)) = self.frames.next_frame() {
            match ServerMessage::decode(&framed) {
                Ok(Some(ServerMessage::Welcome(_))) => {
                    let choice = StreamChoice::Within(Tolerance::NORMAL);
                    self.send(&ClientMessage::Join(choice)).await?;
                }
                Ok(Some(ServerMessage::SnapshotEnd)) => is_member = true,
                _ => {}
            }
        }
        Ok(is_member)
    }

    async fn send(&mut self, message: &ClientMessage) -> Result<(), Failure> {
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        Ok(self.requests.write_all(&bytes).await?)
    }
}

/// Time between two commands of a commander.
const COMMAND_EVERY: Duration = Duration::from_millis(50);
/// Time between two looks of it at its connection.
const COMMAND_LOOK: Duration = Duration::from_millis(5);
/// Metres a second by one command: a power of two, so that speeds are exact. The ball has one kilogramme.
const FASTER: f32 = 1.0 / 64.0;
/// Metres above the scene.
const HEIGHT: f32 = 1_000.0;

/// Commands of a member in the whole run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Commanded {
    /// Commands that it gave.
    pub given: u64,
    /// Those that were applied, a command that was applied twice counted twice; `None` if the body is gone.
    pub applied: Option<u64>,
    /// Those that were refused.
    pub refused: u64,
}

/// A member that commands until the end, and what of it was applied.
///
/// Its ball floats above all others, without gravity or damping. Each command is the same impulse, so that the ball's speed
/// is the number of commands that were applied: one that is lost or applied twice shows. The caller ends edges and routers
/// meanwhile.
pub(super) struct Commander {
    body: BodyId,
    notes: Arc<AnswerNotes>,
    thread: JoinHandle<Result<Commanded, Failure>>,
}

#[derive(Default)]
struct AnswerNotes {
    stop: AtomicBool,
    /// When the newest command was given that has an answer.
    answered: Mutex<Option<Instant>>,
    /// The longest time to an answer since it was asked for, nanoseconds.
    slowest_ns: AtomicU64,
}

impl AnswerNotes {
    fn answered(&self) -> MutexGuard<'_, Option<Instant>> {
        self.answered.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Commander {
    /// Joins a scene, adds its ball, and begins.
    pub(super) fn enter(place: &Place) -> Result<Self, Failure> {
        let mut client = place.join(JoinMode::Join)?;
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).mass(1.0);
        let ball = ball.gravity_scale(0.0).sleep(Sleep::Never);
        let body = client.add_body(ball.at(0.0, HEIGHT, 0.0))?;
        let notes = Arc::new(AnswerNotes::default());
        let noted = Arc::clone(&notes);
        let thread = thread::spawn(move || keep_commanding(client, body, &noted));
        Ok(Self {
            body,
            notes,
            thread,
        })
    }

    /// True if a command that was given after a moment has an answer.
    pub(super) fn is_answered_since(&self, moment: Instant) -> bool {
        let answered = *self.notes.answered();
        answered.is_some_and(|answered| answered > moment)
    }

    /// The longest time from a command to its answer since the last call.
    pub(super) fn take_slowest(&self) -> Duration {
        Duration::from_nanos(self.notes.slowest_ns.swap(0, Ordering::Relaxed))
    }

    /// Ends it once all of its commands have answers, and looks at its ball at the server.
    pub(super) fn end(self, server: &Place) -> Result<Commanded, Failure> {
        self.notes.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.join();
        let commanded = ended.map_err(|_| "the thread of a commander panicked")??;
        let mut exact = server.join_stream(JoinMode::Join, StreamChoice::Full)?;
        // The answers have come, so that the first snapshot has all of them.
        exact.idle(LIMIT / 20)?;
        let complete = exact.statistics().complete;
        let stream = exact.replica().map(Replica::stream);
        let motion = stream.and_then(|stream| stream.predicted_motion(self.body, complete));
        let speed = motion.map(|motion| motion.twist().linear.x);
        Ok(Commanded {
            applied: speed.map(|speed| (speed / f64::from(FASTER)).round() as u64),
            ..commanded
        })
    }
}

/// Commands until the notes say stop, and until all commands have answers.
fn keep_commanding(
    mut client: Client,
    body: BodyId,
    notes: &AnswerNotes,
) -> Result<Commanded, Failure> {
    let mut commanded = Commanded::default();
    let mut waiting: Vec<(u64, Instant)> = Vec::new();
    let mut due = Instant::now();
    loop {
        let stops = notes.stop.load(Ordering::Relaxed);
        if stops && waiting.is_empty() {
            return Ok(commanded);
        }
        let now = Instant::now();
        if stops && now > due + LIMIT {
            return Err("a command has no answer".into());
        }
        if !stops && now >= due {
            let impulse = Vec3::X * FASTER;
            let number = client.command(Command::Impulse { id: body, impulse })?;
            commanded.given += 1;
            waiting.push((number, now));
            due = now + COMMAND_EVERY;
        }
        client.idle(COMMAND_LOOK)?;
        while let Some((_, event)) = client.poll_event() {
            match event {
                Event::Applied { through, .. } => note_answers(&mut waiting, through, notes),
                Event::Refused { .. } => commanded.refused += 1,
                _ => {}
            }
        }
    }
}

fn note_answers(waiting: &mut Vec<(u64, Instant)>, through: u64, notes: &AnswerNotes) {
    waiting.retain(|(number, given)| {
        if *number > through {
            return true;
        }
        let took = u64::try_from(given.elapsed().as_nanos()).unwrap_or(u64::MAX);
        notes.slowest_ns.fetch_max(took, Ordering::Relaxed);
        let mut answered = notes.answered();
        *answered = (*answered).max(Some(*given));
        false
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_that_of_all_commands_up_to_its_number() {
        let (notes, given) = (AnswerNotes::default(), Instant::now());
        let later = given + Duration::from_secs(1);
        let mut waiting = vec![(1, given), (2, later), (3, later)];
        note_answers(&mut waiting, 2, &notes);
        assert_eq!(waiting, [(3, later)]);
        assert_eq!(*notes.answered(), Some(later));
        note_answers(&mut waiting, 1, &notes);
        assert_eq!(waiting.len(), 1);
    }
}
