//! The sender of a stream: its publisher and the datagrams around updates.
//!
//! Sans-IO. Knows neither lanes nor connections, and receivers only by a number. Used by a server for its scenes, by a
//! client for its upstream, and by replays. Invariants: data for several receivers is encoded once. Watermarks follow a
//! published tick as the policy demands, so silence is never ambiguous.
//!
//! The publisher of a full stream is here too: exact states of movable bodies each tick, the naive baseline; a changed
//! stream is the same without the bodies that rest. It numbers packets and answers losses like a reckoned stream, but
//! has neither prefilter nor coding.

use alloc::boxed::Box;
use alloc::vec::Vec;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{Anchor, BodyId, BodyState, Predictor, Tick, Ticks, Track};

use super::losses::{LossTracker, Recipient, RefreshReplies, SentPackets};
use super::observation_history::ObservationHistory;
use super::publisher::Publisher;
use super::tracks::PredictionParameters;
use super::{Budget, PublisherStatistics, Silence, StreamConfig, WatermarkPolicy};
use crate::endpoint::Instant;
use crate::packet::{
    Datagram, FullPacket, FullRecord, Keyframe, LargestPacket, LossReport, Low16, PacketKind,
    RefreshRecord, RefreshWriter, StreamId, Watermark,
};

/// The publisher of a stream.
#[derive(Debug)]
enum Source {
    Reckoned(Box<Publisher>),
    Full(FullPublisher),
}

/// Calls the same method of either publisher.
macro_rules! with_publisher {
    ($source:expr, $publisher:ident => $call:expr) => {
        match $source {
            Source::Reckoned($publisher) => $call,
            Source::Full($publisher) => $call,
        }
    };
}

/// The sending end of one stream.
#[derive(Debug)]
pub struct StreamSender {
    source: Source,
    receivers: usize,
    silence: Silence,
    /// The count of scene events up to the last published tick; `None` before the first one.
    scene_events: Option<u64>,
    /// The tick and the value of the last checksum sent.
    checksum: (Tick, u64),
    mismatches: u64,
    /// The datagrams of the last tick for every receiver.
    packets: Vec<Bytes>,
    /// The repair symbols after them, for receivers that lose packets.
    symbols: Vec<Bytes>,
    losses: LossTracker,
    replies: RefreshReplies,
}

impl StreamSender {
    /// The sender of a reckoned stream without bodies, for one receiver.
    #[must_use]
    pub fn reckoned(
        stream: StreamId,
        config: &StreamConfig,
        budget: Option<Budget>,
        policy: WatermarkPolicy,
        tick: Tick,
    ) -> Self {
        let mut publisher = Publisher::new(stream, config, tick);
        if let Some(budget) = budget {
            publisher.limit(budget);
        }
        Self::new(Source::Reckoned(Box::new(publisher)), policy, tick)
    }

    /// The sender of a full or changed stream without bodies, for one receiver.
    #[must_use]
    pub fn full(
        stream: StreamId,
        largest_packet: LargestPacket,
        (policy, resting): (WatermarkPolicy, RestingBodies),
        tick: Tick,
    ) -> Self {
        let publisher = FullPublisher::new(stream, largest_packet, resting, tick);
        Self::new(Source::Full(publisher), policy, tick)
    }

    fn new(source: Source, policy: WatermarkPolicy, tick: Tick) -> Self {
        Self {
            source,
            receivers: 1,
            silence: Silence::new(policy, tick),
            scene_events: None,
            checksum: (tick, 0),
            mismatches: 0,
            packets: Vec::new(),
            symbols: Vec::new(),
            losses: LossTracker::default(),
            replies: RefreshReplies::default(),
        }
    }

    /// Adds a receiver.
    pub const fn add_receiver(&mut self) {
        self.receivers += 1;
    }

    /// Removes a receiver.
    pub fn remove_receiver(&mut self, receiver: u64) {
        self.receivers -= 1;
        self.restart_receiver(receiver);
    }

    /// Restarts a receiver from a snapshot: its earlier losses no longer count.
    pub fn restart_receiver(&mut self, receiver: u64) {
        self.losses.forget(receiver);
        self.replies.forget(receiver);
    }

    /// Places a body that came into the scene. A scene event carries its first track to every receiver. Returns `false`
    /// if the table is full, which the scene's own limits prevent.
    #[must_use]
    pub fn place(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
        motion: BodyState,
    ) -> bool {
        match &mut self.source {
            Source::Reckoned(publisher) => publisher.place(id, parameters, track),
            Source::Full(publisher) => {
                publisher.place(id, track.origin, motion, track.is_resting());
                true
            }
        }
    }

    /// Removes a body that left the scene.
    pub fn remove(&mut self, id: BodyId) {
        with_publisher!(&mut self.source, publisher => publisher.remove(id));
    }

    /// Changes the gravity from this tick on.
    pub fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        if let Source::Reckoned(publisher) = &mut self.source {
            publisher.change_gravity(since, gravity);
        }
    }

    /// Publishes the present tick of the observations; `false` if no tick is due.
    ///
    /// `scene_events`: the scene's number of events up to the newest observed tick.
    pub fn publish(&mut self, observation_history: &ObservationHistory, scene_events: u64) -> bool {
        self.packets.clear();
        self.symbols.clear();
        self.replies.begin_tick();
        let before = self.tick();
        let out = &mut self.packets;
        with_publisher!(&mut self.source, publisher => {
            publisher.publish(observation_history, scene_events, out);
        });
        if self.tick() == before {
            return false;
        }
        self.close_tick(scene_events);
        let redundancy = self.losses.redundancy(self.receivers, self.next_number());
        if let Source::Reckoned(publisher) = &mut self.source {
            publisher.encode_repair_symbols(redundancy, &mut self.symbols);
        }
        true
    }

    /// The tick of the next watermark, if [`Self::publish`] has nothing to do before: called after it, while no body is
    /// observed, no scene event happens and no receiver reports. `None` for a stream with a budget, with repair symbols, and
    /// for one of exact states that has bodies.
    #[must_use]
    pub fn silent_until(&self) -> Option<Tick> {
        let has_nothing = match &self.source {
            Source::Reckoned(publisher) => !publisher.has_budget() && !self.losses.has_redundancy(),
            Source::Full(publisher) => publisher.states.iter().all(Option::is_none),
        };
        has_nothing.then(|| self.silence.next_watermark())
    }

    /// Lets published ticks pass in which [`Self::publish`] had nothing to do.
    pub fn pass(&mut self, to: Tick) {
        if to <= self.tick() {
            return;
        }
        self.packets.clear();
        self.symbols.clear();
        self.replies.begin_tick();
        with_publisher!(&mut self.source, publisher => publisher.pass(to));
    }

    /// Adds the checksum that is due to the packets of a tick, or a watermark if there are none.
    fn close_tick(&mut self, scene_events: u64) {
        let tick = self.tick();
        let before = self.scene_events.replace(scene_events);
        if !self.packets.is_empty() {
            self.silence.end(tick);
            let checksum = self.due_checksum(scene_events);
            self.packets.extend(checksum);
            return;
        }
        // A watermark tells at which tick a scene event happened. A budget is not spent on that.
        let has_budget = match &self.source {
            Source::Reckoned(publisher) => publisher.has_budget(),
            Source::Full(_) => false,
        };
        let has_news = before != Some(scene_events) && !has_budget;
        if has_news || self.silence.is_watermark_due(tick) {
            self.silence.pause(tick);
            // A checksum is also a watermark.
            let checksum = self.due_checksum(scene_events);
            self.packets
                .push(checksum.unwrap_or_else(|| self.watermark(scene_events)));
        }
    }

    /// The checksum over all tracks, if it differs from the last one and that one is at least a second old.
    fn due_checksum(&mut self, scene_events: u64) -> Option<Bytes> {
        let Source::Reckoned(publisher) = &mut self.source else {
            return None;
        };
        let (last, sum) = self.checksum;
        let age = publisher.tick().since(last)?;
        // A checksum carries no error scale, so a silent stream with a budget needs a watermark.
        let states_nothing = publisher.has_budget() && self.packets.is_empty();
        if age < publisher.second() || states_nothing || !publisher.sends_checksums() {
            return None;
        }
        let present = publisher.settle_checksum();
        if present == sum {
            return None;
        }
        self.checksum = (publisher.tick(), present);
        let checksum = publisher.checksums(scene_events);
        publisher.pay(checksum.len());
        Some(checksum)
    }

    /// The datagrams of the last tick that all receivers get.
    #[must_use]
    pub fn packets(&self) -> &[Bytes] {
        &self.packets
    }

    /// The datagrams of the last tick for one receiver: with repair symbols only if it loses packets.
    pub fn datagrams(&self, receiver: u64) -> impl Iterator<Item = &Bytes> {
        let symbols = if self.losses.loses(receiver) {
            &self.symbols[..]
        } else {
            &[]
        };
        self.packets.iter().chain(symbols)
    }

    /// The watermark of the present tick: everything up to it has been sent. It counts the scene events up to that tick, so
    /// that it tells when a body went, whenever it is sent.
    #[must_use]
    pub fn watermark(&self, scene_events: u64) -> Bytes {
        let scene_events = self.scene_events.unwrap_or(scene_events);
        with_publisher!(&self.source, publisher => publisher.watermark(scene_events))
    }

    /// Answers a loss report of a subscriber. Other datagrams are dropped.
    pub fn handle_datagram(
        &mut self,
        now: Instant,
        from: Recipient,
        datagram: &Datagram<'_>,
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        if datagram.head().kind == PacketKind::LossReport
            && let Ok(report) = LossReport::decode(datagram.body())
        {
            self.handle_report(now, from, &report, scene_events, out);
        }
    }

    /// Answers a loss report, unless the last one was answered just before. The answer holds repair symbols or
    /// refreshes of the lost packets, and a watermark for packets that the receiver does not know of. `scene_events`: the
    /// scene's number of events now.
    pub fn handle_report(
        &mut self,
        now: Instant,
        from: Recipient,
        report: &LossReport,
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        if !self.replies.allow_report(now, from.id) {
            return;
        }
        let next = self.next_number();
        // Symbols up to now went to receivers that were known to lose packets then.
        let sent_from = self.losses.loses_from(from.id);
        self.losses.add_report(from.id, report, next);
        let lost: Vec<u64> = match &mut self.source {
            Source::Reckoned(publisher) => publisher.answer_one(report, sent_from, out),
            Source::Full(_) => report.lost.iter().map(|lost| lost.expand(next)).collect(),
        };
        let source = &self.source;
        let encode =
            |number| with_publisher!(source, publisher => publisher.refresh(number, scene_events));
        (self.replies).refresh(now, from, (lost, scene_events), encode, out);
        out.push(self.watermark(scene_events));
    }

    /// The id of the stream.
    #[must_use]
    pub fn stream(&self) -> StreamId {
        with_publisher!(&self.source, publisher => publisher.stream())
    }

    /// The largest packet that it makes.
    #[must_use]
    pub fn largest_packet(&self) -> LargestPacket {
        with_publisher!(&self.source, publisher => publisher.largest_packet())
    }

    /// The tick up to which everything is published.
    #[must_use]
    pub fn tick(&self) -> Tick {
        with_publisher!(&self.source, publisher => publisher.tick())
    }

    /// The number of the next packet.
    #[must_use]
    pub fn next_number(&self) -> u64 {
        with_publisher!(&self.source, publisher => publisher.next_number())
    }

    /// Counters of everything published so far.
    #[must_use]
    pub fn statistics(&self) -> PublisherStatistics {
        with_publisher!(&self.source, publisher => publisher.statistics())
    }

    /// Counts a subscriber's request for a new snapshot because of a checksum mismatch.
    pub const fn count_mismatch(&mut self) {
        self.mismatches += 1;
    }

    /// Number of checksum mismatches of all subscribers.
    #[must_use]
    pub const fn mismatches(&self) -> u64 {
        self.mismatches
    }

    /// The number of receivers.
    #[must_use]
    pub const fn receivers(&self) -> usize {
        self.receivers
    }

    /// The publisher of a reckoned stream; None for a full stream.
    #[must_use]
    pub const fn publisher(&self) -> Option<&Publisher> {
        match &self.source {
            Source::Reckoned(publisher) => Some(publisher),
            Source::Full(_) => None,
        }
    }

    /// Every body's track, in order of index, for a late receiver.
    #[must_use]
    pub fn tracks(&self) -> Vec<(BodyId, Track)> {
        with_publisher!(&self.source, publisher => publisher.tracks().collect())
    }
}

/// The state of a body in the stream.
#[derive(Clone, Copy, Debug)]
struct FullBody {
    id: BodyId,
    /// The tick of the state: that of its placement, or of the last published one.
    since: Tick,
    motion: BodyState,
    /// A fixed body is sent after it was moved, not every tick.
    fixed: bool,
    /// True if it was observed since it was last sent.
    observed: bool,
}

/// The part of resting bodies in a stream of exact states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestingBodies {
    /// Their states, at every tick: a full stream.
    Sent,
    /// Nothing: a changed stream.
    LeftOut,
}

impl FullBody {
    /// True if its last record still tells its state: it was not observed since, and the uniform track of the record
    /// stays where it is.
    fn rests(&self) -> bool {
        let [.., vx, vy, vz, wx, wy, wz] = self.motion.parts();
        !self.observed && [vx, vy, vz, wx, wy, wz] == [0.0; 6]
    }
}

/// The publisher of one full stream.
#[derive(Debug)]
struct FullPublisher {
    stream: StreamId,
    largest_packet: LargestPacket,
    resting: RestingBodies,
    states: Vec<Option<FullBody>>,
    sent_packets: SentPackets,
    tick: Tick,
    statistics: PublisherStatistics,
}

impl FullPublisher {
    /// Lets published ticks pass in which nothing is to be sent.
    const fn pass(&mut self, to: Tick) {
        self.tick = to;
    }

    /// A stream without bodies.
    #[must_use]
    pub(crate) fn new(
        stream: StreamId,
        largest_packet: LargestPacket,
        resting: RestingBodies,
        tick: Tick,
    ) -> Self {
        Self {
            stream,
            largest_packet,
            resting,
            states: Vec::new(),
            sent_packets: SentPackets::default(),
            tick,
            statistics: PublisherStatistics::default(),
        }
    }

    /// The id of the stream.
    #[must_use]
    pub(crate) const fn stream(&self) -> StreamId {
        self.stream
    }

    /// The largest packet that it makes.
    #[must_use]
    pub(crate) const fn largest_packet(&self) -> LargestPacket {
        self.largest_packet
    }

    /// The number of the next packet.
    #[must_use]
    pub(crate) const fn next_number(&self) -> u64 {
        self.sent_packets.next()
    }

    /// The tick up to which everything is published.
    #[must_use]
    pub(crate) const fn tick(&self) -> Tick {
        self.tick
    }

    /// Counters of everything published so far.
    #[must_use]
    pub(crate) const fn statistics(&self) -> PublisherStatistics {
        self.statistics
    }

    /// Places a body that came into the scene after the step to `since`. A `fixed` body is sent again only after it is
    /// observed.
    pub(crate) fn place(&mut self, id: BodyId, since: Tick, motion: BodyState, fixed: bool) {
        let index = id.index() as usize;
        if index >= self.states.len() {
            self.states.resize(index + 1, None);
        }
        self.states[index] = Some(FullBody {
            id,
            since,
            motion,
            fixed,
            observed: false,
        });
    }

    /// Removes a body that left the scene.
    pub(crate) fn remove(&mut self, id: BodyId) {
        if let Some(state) = self.states.get_mut(id.index() as usize) {
            *state = None;
        }
    }

    /// Every body's state as a track, in order of index.
    pub(crate) fn tracks(&self) -> impl Iterator<Item = (BodyId, Track)> {
        self.states
            .iter()
            .flatten()
            .map(|state| (state.id, self.track(state)))
    }

    fn track(&self, state: &FullBody) -> Track {
        if state.fixed {
            return Track::resting(state.since, state.motion);
        }
        Track {
            origin: state.since,
            predictor: Predictor::Uniform,
            anchor: Anchor::Exact(state.motion),
            parent: None,
        }
    }

    /// Appends the datagrams with the state of every movable body, unless it rests and is left out, at the present
    /// published tick, if there is one.
    pub(crate) fn publish(
        &mut self,
        observation_history: &ObservationHistory,
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        let Some(tick) = observation_history.due_after(self.tick) else {
            return;
        };
        self.tick = tick;
        for observation in observation_history.at(tick).unwrap_or_default() {
            let state = self.states.get_mut(observation.id.index() as usize);
            if let Some(Some(state)) = state
                && state.id == observation.id
                && state.since <= tick
            {
                (state.motion, state.observed) = (observation.motion, true);
            }
        }
        let mut records = Vec::with_capacity(self.states.len());
        for state in self.states.iter_mut().flatten() {
            if state.since > tick {
                continue;
            }
            state.since = tick;
            let is_sent = match self.resting {
                _ if state.fixed => state.observed,
                RestingBodies::Sent => true,
                RestingBodies::LeftOut => !state.rests(),
            };
            state.observed = false;
            if is_sent {
                records.push(FullRecord {
                    index: state.id.index(),
                    motion: state.motion,
                });
            }
        }
        let fitting = FullPacket::records_within(self.largest_packet);
        let packets = records.len().div_ceil(fitting);
        let mut packet = FullPacket {
            number: Low16(0),
            tick: Low16::of(tick.value()),
            scene_events: Low16::of(scene_events),
            ends_tick: false,
            records: Vec::with_capacity(fitting),
        };
        for (place, chunk) in records.chunks(fitting).enumerate() {
            packet.number = Low16::of(self.sent_packets.next());
            packet.ends_tick = place + 1 == packets;
            packet.records.clear();
            packet.records.extend_from_slice(chunk);
            self.sent_packets
                .record(chunk.iter().map(|record| record.index));
            let datagram = packet.encode(self.stream);
            self.statistics.updates += chunk.len() as u64;
            self.statistics.packets += 1;
            self.statistics.bytes += datagram.len() as u64;
            out.push(Bytes::from(datagram));
        }
    }

    /// The watermark for the silence since the last packet.
    #[must_use]
    pub(crate) fn watermark(&self, scene_events: u64) -> Bytes {
        let watermark = Watermark {
            next: Low16::of(self.sent_packets.next()),
            tick: Low16::of(self.tick.value()),
            scene_events: Low16::of(scene_events),
        };
        Bytes::from(watermark.encode(self.stream))
    }

    /// The datagrams with the present states of the bodies in a lost packet; `None` for a packet that is too old.
    #[must_use]
    pub(crate) fn refresh(&self, number: u64, scene_events: u64) -> Option<Vec<Bytes>> {
        let mut writer = RefreshWriter::within(self.largest_packet);
        for &index in self.sent_packets.bodies(number)? {
            if let Some(Some(state)) = self.states.get(index as usize) {
                let keyframe = Keyframe::of(&self.track(state));
                let age = Ticks::ZERO;
                writer.push(&RefreshRecord {
                    index,
                    alias: None,
                    age,
                    keyframe,
                });
            }
        }
        let datagrams = writer.finish(self.stream, number, self.tick.value(), scene_events);
        Some(datagrams.into_iter().map(Bytes::from).collect())
    }
}

#[cfg(test)]
mod tests;
