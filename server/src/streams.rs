//! The streams of one scene: each said once, however many follow it.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::Peer;
use rhumb_protocol::limits::{HISTORY_PACKETS, STREAMS_PER_SCENE_MAX};
use rhumb_protocol::message::{Denial, StreamChoice};
use rhumb_protocol::packet::{ChecksumMismatch, LossReport, StreamId};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    Features, FullPublisher, LossTracker, MismatchReply, Observation, ObservationHistory,
    PredictionParameters, Publisher, PublisherStatistics, StreamTerms,
};
use rhumb_reckoning::{BodyId, BodyState, Tick, Ticks, Tolerance, Track};

use crate::over_budget::OverBudgetLog;
use crate::scene::Scene;

/// One stream at its source.
#[derive(Debug)]
pub(crate) enum StreamSource {
    Reckoned(Box<Publisher>),
    Full(FullPublisher),
}

impl StreamSource {
    /// What a choice of stream is made of, without bodies yet.
    pub(crate) fn new(choice: StreamChoice, id: StreamId, scene: &Scene) -> Self {
        let tick = scene.tick();
        match choice {
            StreamChoice::Within(tolerance) | StreamChoice::Capped { tolerance, .. } => {
                let config = StreamTerms {
                    tolerance,
                    integrator: scene.config().integrator,
                    publish_interval: scene.config().publish_schedule.publish_interval,
                    gravity: scene.gravity(),
                    features: Features::ALL,
                };
                let mut publisher = Publisher::new(id, &config, tick);
                if let StreamChoice::Capped { budget, .. } = choice {
                    publisher.limit(budget);
                }
                Self::Reckoned(Box::new(publisher))
            }
            StreamChoice::Full => Self::Full(FullPublisher::new(id, tick)),
        }
    }
}

/// A stream, who wants it, and how long it has been silent.
#[derive(Debug)]
pub(crate) struct Stream {
    pub(crate) choice: StreamChoice,
    source: StreamSource,
    followers: usize,
    /// Ticks that were spoken of, and of which nothing had to be said.
    silent: u32,
    /// When the sum over all tracks was last said, and what it was.
    checksums: (Tick, u64),
    /// Tracks that a member had otherwise.
    pub(crate) resynced: u64,
    over_budget: OverBudgetLog,
    /// The datagrams of the last tick.
    packets: Vec<Bytes>,
    /// The repair_symbols behind them.
    repair_symbols: Vec<Bytes>,
    /// What its members lose.
    losses: LossTracker,
    /// What makes good lost packets, as asked for since the last tick: encoded once for all who lost the same.
    refreshes: BTreeMap<(u64, u64), Vec<Bytes>>,
}

impl Stream {
    pub(crate) fn id(&self) -> StreamId {
        match &self.source {
            StreamSource::Reckoned(publisher) => publisher.stream(),
            StreamSource::Full(publisher) => publisher.stream(),
        }
    }

    pub(crate) fn tolerance(&self) -> Tolerance {
        self.choice.tolerance()
    }

    /// The tick up to which everything was said.
    pub(crate) fn tick(&self) -> Tick {
        match &self.source {
            StreamSource::Reckoned(publisher) => publisher.tick(),
            StreamSource::Full(publisher) => publisher.tick(),
        }
    }

    pub(crate) fn next_number(&self) -> u64 {
        match &self.source {
            StreamSource::Reckoned(publisher) => publisher.next_number(),
            StreamSource::Full(publisher) => publisher.next_number(),
        }
    }

    pub(crate) fn statistics(&self) -> PublisherStatistics {
        match &self.source {
            StreamSource::Reckoned(publisher) => publisher.statistics(),
            StreamSource::Full(publisher) => publisher.statistics(),
        }
    }

    /// Every body's track, in order of index.
    pub(crate) fn tracks(&self) -> Vec<(BodyId, Track)> {
        match &self.source {
            StreamSource::Reckoned(publisher) => publisher.tracks().collect(),
            StreamSource::Full(publisher) => publisher.tracks().collect(),
        }
    }

    /// The alias of a body, if it has one.
    pub(crate) fn alias(&self, id: BodyId) -> Option<u32> {
        match &self.source {
            StreamSource::Reckoned(publisher) => publisher.alias(id),
            StreamSource::Full(_) => None,
        }
    }

    /// What pulled from which tick on, oldest first, if tracks refer to more than one gravity.
    pub(crate) fn gravity_changes(&self) -> Vec<(Tick, Vec3)> {
        let changes: Vec<_> = match &self.source {
            StreamSource::Reckoned(publisher) => publisher.gravity_changes().collect(),
            StreamSource::Full(_) => Vec::new(),
        };
        if changes.len() > 1 {
            changes
        } else {
            Vec::new()
        }
    }

    pub(crate) fn place(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
        motion: BodyState,
    ) {
        match &mut self.source {
            StreamSource::Reckoned(publisher) => {
                let placed = publisher.place(id, parameters, track);
                debug_assert!(placed, "the scene keeps the limits of its streams");
            }
            StreamSource::Full(publisher) => {
                publisher.place(id, track.origin, motion, track.is_resting());
            }
        }
    }

    fn remove(&mut self, id: BodyId) {
        match &mut self.source {
            StreamSource::Reckoned(publisher) => publisher.remove(id),
            StreamSource::Full(publisher) => publisher.remove(id),
        }
    }

    pub(crate) fn watermark(&self, scene_events: u64) -> Bytes {
        match &self.source {
            StreamSource::Reckoned(publisher) => publisher.watermark(scene_events),
            StreamSource::Full(publisher) => publisher.watermark(scene_events),
        }
    }

    /// A member says how far it heard: what gives it back what it lost, or makes it good, and a watermark for what it could not
    /// know of.
    pub(crate) fn answer(
        &mut self,
        peer: Peer,
        loss_report: &LossReport,
        scene_events: u64,
    ) -> Vec<Bytes> {
        let next = self.next_number();
        // What was said unasked so far went to who was known to lose packets then.
        let sent_from = self.losses.loses_from(peer.0);
        self.losses.hear(peer.0, loss_report, next);
        let mut datagrams = Vec::new();
        let lost: BTreeSet<u64> = match &mut self.source {
            StreamSource::Reckoned(publisher) => {
                let lost = publisher.answer_one(loss_report, sent_from, &mut datagrams);
                lost.into_iter().collect()
            }
            StreamSource::Full(_) => loss_report
                .lost
                .iter()
                .map(|lost| lost.expand(next))
                .collect(),
        };
        for number in lost {
            match self.refresh(number, scene_events) {
                Some(refresh) => datagrams.extend_from_slice(refresh),
                // Forgotten: the watermark below tells the member how much it missed, and it asks for everything.
                None => tracing::debug!(number, "a lost packet is no longer known"),
            }
        }
        datagrams.push(self.watermark(scene_events));
        datagrams
    }

    /// The datagrams that make good a lost packet; none when it is not known any more.
    fn refresh(&mut self, number: u64, scene_events: u64) -> Option<&[Bytes]> {
        if self.refreshes.len() >= HISTORY_PACKETS {
            self.refreshes.clear();
        }
        let entry = match self.refreshes.entry((number, scene_events)) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(place) => place.insert(match &self.source {
                StreamSource::Reckoned(publisher) => publisher.refresh(number, scene_events),
                StreamSource::Full(publisher) => publisher.refresh(number, scene_events),
            }?),
        };
        Some(entry)
    }

    /// Says what must be said now, if a tick is spoken of. A silent stream watermarks ever more rarely, within bounds.
    fn publish(&mut self, at: &PublishContext, observation_history: &ObservationHistory) {
        self.packets.clear();
        self.repair_symbols.clear();
        self.refreshes.clear();
        let before = self.tick();
        match &mut self.source {
            StreamSource::Reckoned(publisher) => {
                publisher.publish(observation_history, at.scene_events, &mut self.packets);
            }
            StreamSource::Full(publisher) => {
                publisher.publish(observation_history, at.scene_events, &mut self.packets);
            }
        }
        if self.tick() == before {
            return;
        }
        if let StreamSource::Reckoned(publisher) = &self.source {
            self.over_budget.log_once_a_second(publisher, at.second);
        }
        self.vouch_or_sum_up(at);
        let redundancy = self.losses.redundancy(self.followers, self.next_number());
        if let StreamSource::Reckoned(publisher) = &mut self.source {
            publisher.encode_repair_symbols(redundancy, &mut self.repair_symbols);
        }
    }

    /// What goes with the packets of a tick, or in place of them.
    fn vouch_or_sum_up(&mut self, at: &PublishContext) {
        if !self.packets.is_empty() {
            self.silent = 0;
            let checksums = self.due_checksums(at);
            self.packets.extend(checksums);
            return;
        }
        self.silent += 1;
        let due = self.silent.is_power_of_two() && self.silent < at.watermark_within;
        if due || self.silent.is_multiple_of(at.watermark_within) {
            // A checksums watermarks too.
            let checksums = self.due_checksums(at);
            self.packets
                .push(checksums.unwrap_or_else(|| self.watermark(at.scene_events)));
        }
    }

    /// What says the sum over all tracks, if that is another than the one said last, and that is a second ago.
    fn due_checksums(&mut self, at: &PublishContext) -> Option<Bytes> {
        let StreamSource::Reckoned(publisher) = &mut self.source else {
            return None;
        };
        let (last, sum) = self.checksums;
        let age = publisher.tick().since(last)?;
        // A checksums states nothing of a budget's over_budget: silence is watermark_tick for by what does.
        let capped = matches!(self.choice, StreamChoice::Capped { .. });
        if age < at.second || publisher.state_checksum() == sum || capped && self.packets.is_empty()
        {
            return None;
        }
        self.checksums = (publisher.tick(), publisher.state_checksum());
        let checksums = publisher.checksums(at.scene_events);
        publisher.pay(checksums.len());
        Some(checksums)
    }

    /// Answers a member whose sum over some tracks is another.
    pub(crate) fn answer_mismatch(
        &mut self,
        mismatch: ChecksumMismatch,
        scene_events: u64,
    ) -> Vec<Bytes> {
        let StreamSource::Reckoned(publisher) = &self.source else {
            return Vec::new();
        };
        match publisher.answer_mismatch(mismatch, scene_events) {
            MismatchReply::Sums(datagram) => vec![datagram],
            MismatchReply::Resync(id, datagrams) => {
                self.resynced += 1;
                let name = id.map(tracing::field::display);
                tracing::warn!(stream = %publisher.stream(), body = name, "a member's track was another");
                datagrams
            }
        }
    }
}

/// The circumstances of what is said of a tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PublishContext {
    /// SceneEvents given up to this tick.
    pub(crate) scene_events: u64,
    /// A silent stream watermarks at least once in so many ticks that are spoken of: one where somebody waits for this very
    /// tick.
    pub(crate) watermark_within: u32,
    /// Ticks in a second, at least one.
    pub(crate) second: Ticks,
}

/// All streams of a scene that somebody follows.
#[derive(Debug)]
pub(crate) struct Streams {
    streams: Vec<Stream>,
    /// What all reckoned streams speak of.
    observation_history: ObservationHistory,
}

impl Streams {
    /// None yet; they will be said by this publish_schedule.
    pub(crate) fn new(publish_schedule: PublishSchedule) -> Self {
        Self {
            streams: Vec::new(),
            observation_history: ObservationHistory::new(publish_schedule),
        }
    }

    pub(crate) fn get(&self, id: StreamId) -> Option<&Stream> {
        self.streams.iter().find(|stream| stream.id() == id)
    }

    pub(crate) fn get_mut(&mut self, id: StreamId) -> Option<&mut Stream> {
        self.streams.iter_mut().find(|stream| stream.id() == id)
    }

    /// The datagrams of a stream's last tick that a member is sent: repair_symbols only if it loses packets, whoever else does.
    pub(crate) fn packets(&self, id: StreamId, peer: Peer) -> impl Iterator<Item = &Bytes> {
        let stream = self.get(id);
        let packets = stream.map_or(&[][..], |stream| &stream.packets);
        let repair_symbols = stream
            .filter(|stream| stream.losses.loses(peer.0))
            .map_or(&[][..], |stream| &stream.repair_symbols);
        packets.iter().chain(repair_symbols)
    }

    /// The stream of a choice, if somebody follows it.
    pub(crate) fn of_choice(&self, choice: StreamChoice) -> Option<StreamId> {
        let found = self.streams.iter().find(|stream| stream.choice == choice);
        found.map(Stream::id)
    }

    /// The stream of a choice with one follower more, or what makes a new one.
    pub(crate) fn subscribe(&mut self, choice: StreamChoice) -> Result<Option<StreamId>, Denial> {
        if let Some(stream) = self
            .streams
            .iter_mut()
            .find(|stream| stream.choice == choice)
        {
            stream.followers += 1;
            return Ok(Some(stream.id()));
        }
        if self.streams.len() >= STREAMS_PER_SCENE_MAX {
            return Err(Denial::TooManyStreams);
        }
        Ok(None)
    }

    /// Adds a stream with one follower.
    pub(crate) fn begin(&mut self, choice: StreamChoice, source: StreamSource) -> &mut Stream {
        self.streams.push(Stream {
            choice,
            source,
            followers: 1,
            silent: 0,
            checksums: (Tick::ZERO, 0),
            resynced: 0,
            over_budget: OverBudgetLog::default(),
            packets: Vec::new(),
            repair_symbols: Vec::new(),
            losses: LossTracker::default(),
            refreshes: BTreeMap::new(),
        });
        self.streams.last_mut().expect("one was just added")
    }

    /// A member is told a stream from a snapshot on: what it lost before it counts no more.
    pub(crate) fn begin_snapshot(&mut self, id: StreamId, peer: Peer) {
        if let Some(stream) = self.get_mut(id) {
            stream.losses.forget(peer.0);
        }
    }

    /// A member follows a stream no more; one that nobody follows ends.
    pub(crate) fn unsubscribe(&mut self, id: StreamId, peer: Peer) {
        if let Some(stream) = self.get_mut(id) {
            stream.followers -= 1;
            stream.losses.forget(peer.0);
        }
        self.streams.retain(|stream| stream.followers > 0);
    }

    pub(crate) fn place(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
        motion: BodyState,
    ) {
        for stream in &mut self.streams {
            stream.place(id, parameters, track, motion);
        }
    }

    pub(crate) fn remove(&mut self, id: BodyId) {
        for stream in &mut self.streams {
            stream.remove(id);
        }
    }

    pub(crate) fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        for stream in &mut self.streams {
            if let StreamSource::Reckoned(publisher) = &mut stream.source {
                publisher.change_gravity(since, gravity);
            }
        }
    }

    /// Keeps what was seen after a tick, as far as somebody will look at it.
    pub(crate) fn observe(&mut self, tick: Tick, observations: &[Observation]) {
        self.observation_history.observe(tick, observations);
    }

    /// Says what must be said of a tick that was observed.
    pub(crate) fn publish(&mut self, at: &PublishContext) {
        for stream in &mut self.streams {
            stream.publish(at, &self.observation_history);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_protocol::packet::{Head, Low16, PacketKind};
    use rhumb_protocol::stream::{Activity, Budget};
    use rhumb_protocol::wire::Wire;
    use rhumb_protocol::wire::bytes::Reader;
    use rhumb_reckoning::{Integrator, Metres, Rate};
    use std::io::{self, Write};
    use std::num::NonZeroU32;
    use std::sync::{Arc, Mutex};

    const BODIES: u32 = 50;
    const STREAM: StreamId = StreamId(1);
    const SECOND: u64 = 60;
    const BURST: u32 = 1_150;

    /// Where a body is at a tick: somewhere else each time.
    fn motion(body: u32, tick: u64) -> BodyState {
        let far = |axis: u64| {
            let seed = (tick << 16) + (u64::from(body) << 4) + axis + 1;
            let mixed = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((mixed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 10.0
        };
        let at = [far(0), far(1), far(2)];
        BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("it is finite")
    }

    /// One stream with a budget, of bodies that never rest.
    fn capped(bytes_per_second: u32) -> Streams {
        let budget = Budget::new(bytes_per_second, BURST).expect("within the limits");
        let tolerance = Tolerance::NORMAL;
        let config = StreamTerms {
            tolerance,
            integrator: Integrator {
                rate: Rate::HZ_60,
                substeps: NonZeroU32::MIN,
            },
            publish_interval: PublishSchedule::EACH_TICK.publish_interval,
            gravity: Vec3::ZERO,
            features: Features::ALL,
        };
        let mut publisher = Publisher::new(STREAM, &config, Tick::ZERO);
        publisher.limit(budget);
        let mut streams = Streams::new(PublishSchedule::EACH_TICK);
        let choice = StreamChoice::Capped { tolerance, budget };
        streams.begin(choice, StreamSource::Reckoned(Box::new(publisher)));
        for body in 0..BODIES {
            let parameters = PredictionParameters::plain(Metres::new(0.5));
            let begun = motion(body, 0);
            let track = Track::resting(Tick::ZERO, begun);
            streams.place(BodyId::new(body, 0), &parameters, track, begun);
        }
        streams
    }

    /// Has a tick published.
    fn publish(streams: &mut Streams, tick: u64) {
        let seen = |body| Observation {
            id: BodyId::new(body, 0),
            motion: motion(body, tick),
            activity: Activity::Awake,
        };
        let observations: Vec<_> = (0..BODIES).map(seen).collect();
        streams.observe(Tick::new(tick), &observations);
        streams.publish(&PublishContext {
            scene_events: 0,
            watermark_within: 150,
            second: Ticks::new(SECOND as u32),
        });
    }

    /// What is logged, as text.
    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<Vec<u8>>>);

    impl Write for Log {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().expect("nobody panics").write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// What is logged at a level while a stream with little budget is published for so many seconds; and that stream.
    fn logged(level: tracing::Level, seconds: u64) -> (String, Streams) {
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
        let text = String::from_utf8(log.0.lock().expect("nobody panics").clone());
        (text.expect("a log is text"), streams)
    }

    #[test]
    fn the_worst_over_budget_body_is_logged_once_a_second() {
        let (text, _) = logged(tracing::Level::INFO, 5);
        let lines: Vec<_> = text.lines().collect();
        assert!((4..=5).contains(&lines.len()), "{text}");
        for log_line in &lines {
            let fields = ["waiting=", "body=", "share=", "ticks=", "cause=\"budget\""];
            for field in fields {
                assert!(log_line.contains(field), "{log_line}");
            }
        }
    }

    #[test]
    fn every_over_budget_body_is_logged_at_trace_level() {
        let (text, streams) = logged(tracing::Level::TRACE, 1);
        let lines = text
            .lines()
            .filter(|log_line| log_line.contains("a body is off"));
        let lines: Vec<_> = lines.collect();
        let StreamSource::Reckoned(publisher) = &streams.streams[0].source else {
            panic!("it has a budget");
        };
        let over_budget = publisher.statistics().over_budget;
        assert!(
            over_budget > 0 && lines.len() as u64 == over_budget,
            "{over_budget}"
        );
        for log_line in &lines {
            let fields = ["tick=", "body=", "share=", "ticks=", "cause=\"budget\""];
            for field in fields {
                assert!(log_line.contains(field), "{log_line}");
            }
        }
    }

    #[test]
    fn a_budget_pays_for_sent_checksums() {
        let (rate, seconds) = (600, 20);
        let mut streams = capped(rate);
        let (mut bytes, mut sums) = (0, 0);
        for tick in 1..=seconds * SECOND {
            publish(&mut streams, tick);
            for packet in streams.packets(STREAM, Peer(0)) {
                let head = Head::decode(&mut Reader::new(packet)).expect("a head");
                let watermarks = matches!(
                    head.kind,
                    PacketKind::Watermark | PacketKind::WatermarkOverBudget
                );
                bytes += if watermarks { 0 } else { packet.len() };
                sums += u64::from(head.kind == PacketKind::Checksums);
            }
        }
        assert!(sums >= seconds - 2, "{sums}");
        // A word and a sum may overdraw.
        let most = BURST as usize + (seconds as usize) * rate as usize + 100;
        assert!(bytes <= most, "{bytes} of {most}");
        assert!(
            bytes + 200 > most,
            "a tight budget is used: {bytes} of {most}"
        );
    }

    #[test]
    fn a_refresh_for_two_members_is_encoded_once() {
        let mut streams = capped(100_000);
        publish(&mut streams, 1);
        let stream = &mut streams.streams[0];
        let next = stream.next_number();
        let loss_report = LossReport {
            next: Low16::of(next),
            gone: Low16::of(1),
            repair_symbols: 0,
            lost: vec![Low16::of(next - 1)],
        };
        let [one, other] = [1, 2].map(|member| stream.answer(Peer(member), &loss_report, 0));
        assert!(one.len() > 1, "a refresh, and a watermark behind it");
        for (one, other) in one[..one.len() - 1].iter().zip(&other) {
            assert_eq!(one.as_ptr(), other.as_ptr(), "the same bytes, not a copy");
        }
    }
}
