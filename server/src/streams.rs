//! The streams of one scene.
//!
//! A stream is published once for all members that subscribe to the same choice. Streams do not depend on each other,
//! so that several threads may publish them: the packets are the same on any number of threads.

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::Peer;
use rhumb_protocol::limits::STREAMS_PER_SCENE_MAX;
use rhumb_protocol::message::{Denial, SceneEvent, ServerMessage, StreamChoice};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{BodyDesc, BodyKind, PublishSchedule, Stepping};
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, OverBudget, PredictionParameters,
    Publisher, RestingBodies, StreamConfig, StreamSender, WatermarkPolicy,
};
use rhumb_reckoning::{Anchor, BodyId, BodyState, Predictor, Tick, Tolerance, Track};
use tracing::Level;

use crate::engine::StepThreads;
use crate::scene::Scene;

/// A stream and its choice.
#[derive(Debug)]
pub(crate) struct Stream {
    pub(crate) choice: StreamChoice,
    pub(crate) sender: StreamSender,
    over_budget: OverBudgetLog,
    /// True if a tick was published since the log was written.
    unlogged: bool,
}

impl Stream {
    /// A stream of this choice without bodies, for one member.
    pub(crate) fn new(
        choice: StreamChoice,
        id: StreamId,
        largest_packet: LargestPacket,
        scene: &Scene,
    ) -> Self {
        let tick = scene.tick();
        let config = scene.config();
        let policy = match config.stepping {
            Stepping::Lockstep => WatermarkPolicy::LOCKSTEP,
            Stepping::FreeRunning => WatermarkPolicy::free_running(
                config.integrator.rate,
                config.publish_schedule.publish_interval,
            ),
        };
        let budget = match choice {
            StreamChoice::Capped { budget, .. } => Some(budget),
            StreamChoice::Within(_) | StreamChoice::Full | StreamChoice::Changed => None,
        };
        let sender = match choice {
            StreamChoice::Within(tolerance) | StreamChoice::Capped { tolerance, .. } => {
                let config = StreamConfig {
                    tolerance,
                    integrator: config.integrator,
                    publish_interval: config.publish_schedule.publish_interval,
                    largest_packet,
                    gravity: scene.gravity(),
                    features: Features::ALL,
                };
                StreamSender::reckoned(id, &config, budget, policy, tick)
            }
            StreamChoice::Full => {
                StreamSender::full(id, largest_packet, (policy, RestingBodies::Sent), tick)
            }
            StreamChoice::Changed => {
                StreamSender::full(id, largest_packet, (policy, RestingBodies::LeftOut), tick)
            }
        };
        Self::of(choice, sender)
    }

    fn of(choice: StreamChoice, sender: StreamSender) -> Self {
        Self {
            choice,
            sender,
            over_budget: OverBudgetLog::default(),
            unlogged: false,
        }
    }

    pub(crate) fn id(&self) -> StreamId {
        self.sender.stream()
    }

    pub(crate) fn tolerance(&self) -> Tolerance {
        self.choice.tolerance()
    }

    /// The alias of a body; `None` for a body without one.
    pub(crate) fn alias(&self, id: BodyId) -> Option<u32> {
        self.sender.publisher()?.alias(id)
    }

    /// Each gravity with its first tick, oldest first; empty unless the tracks refer to more than one.
    pub(crate) fn gravity_changes(&self) -> Vec<(Tick, Vec3)> {
        let publisher = self.sender.publisher().into_iter();
        let changes: Vec<_> = publisher.flat_map(Publisher::gravity_changes).collect();
        if changes.len() > 1 {
            changes
        } else {
            Vec::new()
        }
    }

    pub(crate) fn insert(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
        motion: BodyState,
    ) {
        let placed = self.sender.place(id, parameters, track, motion);
        debug_assert!(placed, "the scene keeps the limits of its streams");
    }

    fn publish(&mut self, observation_history: &ObservationHistory, scene_events: u64) {
        self.unlogged = self.sender.publish(observation_history, scene_events);
    }

    /// Logs the bodies over budget of a tick that was just published.
    fn log(&mut self) {
        if core::mem::take(&mut self.unlogged)
            && let Some(publisher) = self.sender.publisher()
        {
            self.over_budget.log_once_a_second(publisher);
        }
    }
}

/// All streams of a scene.
#[derive(Debug)]
pub(crate) struct Streams {
    streams: Vec<Stream>,
    /// The observations that all streams share.
    observation_history: ObservationHistory,
    /// The threads that publish.
    threads: StepThreads,
}

impl Streams {
    /// An empty set, for this publish schedule, published on these threads.
    pub(crate) fn new(publish_schedule: PublishSchedule, threads: StepThreads) -> Self {
        Self {
            streams: Vec::new(),
            observation_history: ObservationHistory::new(publish_schedule),
            threads,
        }
    }

    /// True if no member receives any.
    pub(crate) fn is_empty(&self) -> bool {
        self.streams.is_empty()
    }

    pub(crate) fn get(&self, id: StreamId) -> Option<&Stream> {
        self.streams.iter().find(|stream| stream.id() == id)
    }

    pub(crate) fn get_mut(&mut self, id: StreamId) -> Option<&mut Stream> {
        self.streams.iter_mut().find(|stream| stream.id() == id)
    }

    /// The datagrams of a stream's last tick for one member; repair symbols are included only if this member loses
    /// packets.
    pub(crate) fn packets(&self, id: StreamId, peer: Peer) -> impl Iterator<Item = &Bytes> {
        let stream = self.get(id).into_iter();
        stream.flat_map(move |stream| stream.sender.datagrams(peer.0))
    }

    /// Bodies whose updates wait for a budget, in all streams.
    pub(crate) fn waiting(&self) -> usize {
        let publishers = self.streams.iter().filter_map(|s| s.sender.publisher());
        publishers.map(Publisher::waiting).sum()
    }

    /// The datagrams of the last tick of all streams, without repair symbols.
    pub(crate) fn all_packets(&self) -> impl Iterator<Item = &Bytes> {
        self.streams
            .iter()
            .flat_map(|stream| stream.sender.packets())
    }

    /// The id of the stream of a choice; `None` if there is no such stream.
    pub(crate) fn of_choice(&self, choice: StreamChoice) -> Option<StreamId> {
        let found = self.streams.iter().find(|stream| stream.choice == choice);
        found.map(Stream::id)
    }

    /// Adds a member to the stream of a choice; `None` if the stream does not exist yet.
    ///
    /// # Errors
    ///
    /// [`Denial::TooManyStreams`] when the scene cannot have another stream.
    pub(crate) fn subscribe(&mut self, choice: StreamChoice) -> Result<Option<StreamId>, Denial> {
        if let Some(stream) = self
            .streams
            .iter_mut()
            .find(|stream| stream.choice == choice)
        {
            stream.sender.add_receiver();
            return Ok(Some(stream.id()));
        }
        if self.streams.len() >= STREAMS_PER_SCENE_MAX {
            return Err(Denial::TooManyStreams);
        }
        Ok(None)
    }

    /// Adds a stream with one member.
    pub(crate) fn begin(&mut self, stream: Stream) -> &mut Stream {
        self.streams.push(stream);
        self.streams.last_mut().expect("one was just added")
    }

    /// Starts a new snapshot for a member, which makes its earlier losses irrelevant.
    pub(crate) fn begin_snapshot(&mut self, id: StreamId, peer: Peer) {
        if let Some(stream) = self.get_mut(id) {
            stream.sender.restart_receiver(peer.0);
        }
    }

    /// Removes a member from a stream, and ends the stream if it has no members left.
    pub(crate) fn unsubscribe(&mut self, id: StreamId, peer: Peer) {
        if let Some(stream) = self.get_mut(id) {
            stream.sender.remove_receiver(peer.0);
        }
        self.streams.retain(|stream| stream.sender.receivers() > 0);
    }

    pub(crate) fn insert(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
        motion: BodyState,
    ) {
        for stream in &mut self.streams {
            stream.insert(id, parameters, track, motion);
        }
    }

    pub(crate) fn remove(&mut self, id: BodyId) {
        for stream in &mut self.streams {
            stream.sender.remove(id);
        }
    }

    pub(crate) fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        for stream in &mut self.streams {
            stream.sender.change_gravity(since, gravity);
        }
    }

    /// Stores the observations of a tick.
    pub(crate) fn observe(&mut self, tick: Tick, observations: &[Observation]) {
        self.observation_history.observe(tick, observations);
    }

    /// See [`StreamSender::silent_until`]; the first of all streams.
    pub(crate) fn silent_until(&self) -> Option<Tick> {
        let until = self.streams.iter().map(|of| of.sender.silent_until());
        until.min().flatten()
    }

    /// See [`StreamSender::pass`].
    pub(crate) fn pass(&mut self, to: Tick) {
        for stream in &mut self.streams {
            stream.sender.pass(to);
        }
    }

    /// Publishes every stream. The log is written afterwards, in the order of the streams.
    pub(crate) fn publish(&mut self, scene_events: u64) {
        let observation_history = &self.observation_history;
        self.threads.on_each(&mut self.streams, |stream| {
            stream.publish(observation_history, scene_events);
        });
        self.streams.iter_mut().for_each(Stream::log);
    }
}

/// Assigns names to streams.
///
/// Short, and not reused soon: late datagrams of an ended stream must not be taken for those of another. Invariant: a free
/// name is reused only after [`REST`] other streams were named, however few names are free; long names fill the gap.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StreamNames {
    small: u32,
    large: u32,
    /// Number of names assigned.
    given: u64,
    /// For each small name: the count of names when it was last in use; `None` if never.
    taken: [Option<u64>; StreamId::SMALL.end as usize],
}

/// Number of other streams named before a small name is reused. A member that moves through cells begins dozens within a few
/// milliseconds, while datagrams of the streams before wait at its end.
const REST: u64 = 4_096;

impl StreamNames {
    /// The names of the server's scene of this number: a new scene under an old name starts elsewhere.
    pub(crate) const fn of_scene(number: u64) -> Self {
        Self {
            small: (number % StreamId::SMALL.end as u64) as u32,
            large: StreamId::SMALL.end,
            given: 0,
            taken: [None; StreamId::SMALL.end as usize],
        }
    }

    /// A name for a new stream: none that is in use or was until lately.
    pub(crate) fn next(&mut self, is_taken: impl Fn(StreamId) -> bool) -> StreamId {
        for (name, taken) in StreamId::SMALL.zip(&mut self.taken) {
            if is_taken(StreamId(name)) {
                *taken = Some(self.given);
            }
        }
        self.given += 1;
        for _ in StreamId::SMALL {
            let name = self.small;
            self.small = (name + 1) % StreamId::SMALL.end;
            let taken = &mut self.taken[name as usize];
            if taken.is_none_or(|taken| self.given - taken > REST) {
                *taken = Some(self.given);
                return StreamId(name);
            }
        }
        let name = StreamId(self.large);
        self.large = self.large.checked_add(1).unwrap_or(StreamId::SMALL.end);
        name
    }
}

/// Last logged state of a stream's budget.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct OverBudgetLog {
    /// True if bodies waited then.
    waited: bool,
    /// Tick of the last line; `None` before the first.
    logged_at: Option<Tick>,
}

impl OverBudgetLog {
    /// Logs when a budget does not suffice, with its worst body, and when it suffices again: at most one line a
    /// second. At trace level every affected body is logged.
    pub(crate) fn log_once_a_second(&mut self, publisher: &Publisher) {
        let (stream, tick) = (publisher.stream(), publisher.tick());
        let waits = |since: Tick| tick.since(since).unwrap_or_default().count();
        if tracing::enabled!(Level::TRACE) {
            for OverBudget { body, share, since } in publisher.over_budget() {
                if share > 1.0 {
                    let ticks = waits(since);
                    tracing::trace!(
                        %stream, %tick, %body, share, ticks, cause = "budget",
                        "a body exceeds its tolerance"
                    );
                }
            }
        }
        let waiting = publisher.waiting();
        let since_logged = self.logged_at.and_then(|logged_at| tick.since(logged_at));
        let quiet = since_logged.is_some_and(|ticks| ticks < publisher.second());
        if quiet || (waiting == 0 && !self.waited) {
            return;
        }
        *self = Self {
            waited: waiting > 0,
            logged_at: Some(tick),
        };
        let Some(worst) = publisher.worst_waiting() else {
            let over_budget = publisher.statistics().over_budget;
            tracing::info!(%stream, over_budget, "the budget suffices again");
            return;
        };
        let OverBudget { body, share, since } = worst;
        let ticks = waits(since);
        tracing::info!(%stream, waiting, %body, share, ticks, cause = "budget", "bodies wait for an update");
    }
}

/// Appends the snapshot from its changes of gravity on: bodies, joints, silent publishers, and the end (PROTOCOL 4.8).
/// Its shapes go before, in the bytes of their events.
pub(crate) fn append_snapshot(
    scene: &Scene,
    stream: &Stream,
    silences: impl Iterator<Item = SceneEvent>,
    bytes: &mut Vec<u8>,
) {
    let mut add = |scene_event| ServerMessage::SceneEvent(scene_event).encode(bytes);
    // A track continues under the gravity of its time.
    for (since, gravity) in stream.gravity_changes() {
        add(SceneEvent::GravityChanged { since, gravity });
    }
    for (id, track) in stream.sender.tracks() {
        if let Some(config) = scene.body(id) {
            add(scene_event(scene, *config, track, stream.alias(id)));
        }
    }
    for (id, joint) in scene.joints().iter() {
        let joint = *joint;
        add(SceneEvent::JointAdded { id, joint });
    }
    silences.for_each(add);
    ServerMessage::SnapshotEnd.encode(bytes);
}

/// Event of a body that is in a scene, with its motion.
pub(crate) fn scene_event(
    scene: &Scene,
    desc: BodyDesc,
    track: Track,
    alias: Option<u32>,
) -> SceneEvent {
    SceneEvent::BodyPlaced {
        desc,
        inertia: scene.inertia(desc.id),
        track,
        alias,
    }
}

/// Parameters of a body's predictions.
pub(crate) fn parameters(scene: &Scene, id: BodyId) -> Option<PredictionParameters> {
    let desc = scene.body(id)?;
    let shape = scene.shape(desc.shape)?;
    let damping = scene.config().damping;
    Some(PredictionParameters::of(
        desc,
        shape,
        damping,
        scene.inertia(id),
    ))
}

/// The track of a body before its first update.
pub(crate) fn first_track(
    tick: Tick,
    (motion, activity): (BodyState, Activity),
    desc: &BodyDesc,
    tumbles: bool,
) -> Track {
    let activity = if desc.enabled {
        activity
    } else {
        Activity::Asleep
    };
    let predictor = match (activity, desc.kind) {
        (Activity::Asleep, _) | (_, BodyKind::Fixed) => Predictor::Rest,
        (Activity::Awake, BodyKind::Dynamic) if tumbles => Predictor::BallisticTorqueFree,
        (Activity::Awake, BodyKind::Dynamic) => Predictor::Ballistic,
        (Activity::Awake, BodyKind::Kinematic) => Predictor::Uniform,
    };
    let resting = predictor == Predictor::Rest;
    Track {
        origin: tick,
        predictor,
        anchor: Anchor::Exact(if resting { motion.stilled() } else { motion }),
        parent: None,
    }
}

/// Every body of a scene at present, in order of index.
pub(crate) fn everything(scene: &Scene) -> Vec<(BodyId, PredictionParameters, Track, BodyState)> {
    let mut observations = Vec::new();
    scene.observe_all(&mut observations);
    let first = |observation: &Observation| {
        let id = observation.id;
        let desc = scene.body(id)?;
        let parameters = parameters(scene, id)?;
        let tumbles = parameters.inertia.is_some();
        let state = (observation.motion, observation.activity);
        let track = first_track(scene.tick(), state, desc, tumbles);
        Some((id, parameters, track, observation.motion))
    };
    observations.iter().filter_map(first).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::io::{self, Write};
    use std::num::NonZeroU32;
    use std::sync::{Arc, Mutex, Once};

    use rhumb_protocol::packet::{Head, LargestPacket, PacketKind};
    use rhumb_protocol::stream::{Activity, Budget};
    use rhumb_protocol::wire::Wire;
    use rhumb_protocol::wire::bytes::Reader;
    use rhumb_reckoning::{Integrator, Metres, Rate};

    use super::*;

    const BODIES: u32 = 50;
    const STREAM: StreamId = StreamId(1);
    const SECOND: u64 = 60;
    const BURST: u32 = 1_150;

    /// State of a body at a tick: a pseudo-random position, at rest.
    fn motion(body: u32, tick: u64) -> BodyState {
        let far = |axis: u64| {
            let seed = (tick << 16) + (u64::from(body) << 4) + axis + 1;
            let mixed = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((mixed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 10.0
        };
        let at = [far(0), far(1), far(2)];
        BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
            .expect("every number is finite")
    }

    /// The sender of a stream without bodies.
    fn sender(id: StreamId, tolerance: Tolerance, budget: Option<Budget>) -> StreamSender {
        let config = StreamConfig {
            tolerance,
            integrator: Integrator {
                rate: Rate::HZ_60,
                substeps: NonZeroU32::MIN,
            },
            publish_interval: PublishSchedule::EACH_TICK.publish_interval,
            largest_packet: LargestPacket::DEFAULT,
            gravity: Vec3::ZERO,
            features: Features::ALL,
        };
        let policy = WatermarkPolicy::free_running(Rate::HZ_60, config.publish_interval);
        StreamSender::reckoned(id, &config, budget, policy, Tick::ZERO)
    }

    /// Places the bodies, which never rest.
    fn populate(streams: &mut Streams) {
        for body in 0..BODIES {
            let parameters = PredictionParameters::plain(Metres::new(0.5));
            let initial = motion(body, 0);
            let track = Track::resting(Tick::ZERO, initial);
            streams.insert(BodyId::new(body, 0), &parameters, track, initial);
        }
    }

    /// One capped stream, with bodies that never rest.
    fn capped(bytes_per_second: u32) -> Streams {
        let budget = Budget::new(bytes_per_second, BURST).expect("within the limits");
        let tolerance = Tolerance::NORMAL;
        let mut streams = Streams::new(PublishSchedule::EACH_TICK, StepThreads::default());
        let choice = StreamChoice::Capped { tolerance, budget };
        let sender = sender(STREAM, tolerance, Some(budget));
        streams.begin(Stream::of(choice, sender));
        populate(&mut streams);
        streams
    }

    /// Observes and publishes a tick.
    fn publish(streams: &mut Streams, tick: u64) {
        let observation = |body| Observation {
            id: BodyId::new(body, 0),
            motion: motion(body, tick),
            activity: Activity::Awake,
        };
        let observations: Vec<_> = (0..BODIES).map(observation).collect();
        streams.observe(Tick::new(tick), &observations);
        streams.publish(0);
    }

    /// Collects the log as text.
    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<Vec<u8>>>);

    impl Write for Log {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().expect("no thread panics").write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Publishes a stream with a small budget for some seconds; returns the log at a level, and the stream.
    fn logged(level: Level, seconds: u64) -> (String, Streams) {
        // Without it, a line that another test's thread reaches first, where nothing listens, is off for all threads.
        static LISTENS: Once = Once::new();
        LISTENS.call_once(|| {
            tracing::subscriber::set_global_default(tracing_subscriber::registry())
                .expect("no other test sets one");
        });
        let log = Log::default();
        let writer = log.clone();
        let subscriber = tracing_subscriber::fmt()
            .with_ansi(false)
            .with_max_level(level)
            .with_writer(move || writer.clone())
            .finish();
        let mut streams = capped(600);
        tracing::subscriber::with_default(subscriber, || {
            for tick in 1..=seconds * SECOND {
                publish(&mut streams, tick);
            }
        });
        let text = String::from_utf8(log.0.lock().expect("no thread panics").clone());
        (text.expect("a log is text"), streams)
    }

    /// Asserts that a line of the log names the field and what it says of an over-budget body.
    fn assert_names(log_line: &str, field: &str) {
        for field in [field, "body=", "share=", "ticks=", "cause=\"budget\""] {
            assert!(log_line.contains(field), "{log_line}");
        }
    }

    #[test]
    fn the_worst_over_budget_body_is_logged_once_a_second() {
        let (text, _) = logged(Level::INFO, 5);
        let lines: Vec<_> = text.lines().collect();
        assert!((4..=5).contains(&lines.len()), "{text}");
        for log_line in &lines {
            assert_names(log_line, "waiting=");
        }
    }

    #[test]
    fn every_over_budget_body_is_logged_at_trace_level() {
        let (text, streams) = logged(Level::TRACE, 1);
        let lines = text
            .lines()
            .filter(|log_line| log_line.contains("a body exceeds its tolerance"));
        let lines: Vec<_> = lines.collect();
        let over_budget = streams.streams[0].sender.statistics().over_budget;
        assert!(
            over_budget > 0 && lines.len() as u64 == over_budget,
            "{over_budget}"
        );
        for log_line in &lines {
            assert_names(log_line, "tick=");
        }
    }

    #[test]
    fn a_budget_pays_for_sent_checksums() {
        let (rate, seconds) = (600, 20);
        let mut streams = capped(rate);
        let (mut bytes, mut checksums) = (0, 0);
        for tick in 1..=seconds * SECOND {
            publish(&mut streams, tick);
            for packet in streams.packets(STREAM, Peer(0)) {
                let head = Head::decode(&mut Reader::new(packet)).expect("a head");
                let watermarks = matches!(
                    head.kind,
                    PacketKind::Watermark | PacketKind::WatermarkOverBudget
                );
                bytes += if watermarks { 0 } else { packet.len() };
                checksums += u64::from(head.kind == PacketKind::Checksums);
            }
        }
        assert!(checksums >= seconds - 2, "{checksums}");
        // One packet and one checksum may overdraw the budget.
        let most = BURST as usize + (seconds as usize) * rate as usize + 100;
        assert!(bytes <= most, "{bytes} of {most}");
        assert!(
            bytes + 200 > most,
            "a tight budget is used: {bytes} of {most}"
        );
    }

    #[test]
    fn small_names_come_first_and_are_not_reused_soon() {
        let mut names = StreamNames::of_scene(18);
        let given: Vec<u32> = (0..17)
            .map(|_| names.next(|name| name == StreamId(4)).0)
            .collect();
        let expected = [3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 0, 1, 2, 15, 16, 17];
        assert_eq!(given, expected);
        assert_eq!(names.next(|name| name.0 < 15), StreamId(18));
    }

    #[test]
    fn a_freed_name_rests_even_without_other_free_small_names() {
        let mut names = StreamNames::of_scene(0);
        for name in 0..14 {
            assert_eq!(names.next(|taken| taken.0 < name), StreamId(name));
        }
        // One member changes its tier again and again, while all others keep theirs.
        let mut last = StreamId(13);
        let mut given = Vec::new();
        for _ in 0..2 * REST + 30 {
            let present = last;
            last = names.next(|name| name.0 < 13 || name == present);
            given.push(last);
        }
        let mut before = BTreeMap::new();
        for (place, name) in given.iter().enumerate() {
            if let Some(before) = before.insert(name, place) {
                assert!(
                    place - before > REST as usize,
                    "{name} at {before}, {place}"
                );
            }
        }
        let small = given
            .iter()
            .filter(|name| StreamId::SMALL.contains(&name.0));
        assert!(small.count() >= 4, "they come again");
    }
}
