//! The publisher of a full stream: exact states of movable bodies each tick.
//!
//! The naive baseline. It numbers packets and answers losses like a reckoned stream, but has neither prefilter nor
//! coding.

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{Anchor, BodyId, BodyState, Predictor, Tick, Ticks, Track};

use super::PublisherStatistics;
use super::losses::SentPackets;
use super::observation_history::ObservationHistory;
use crate::packet::{
    FullPacket, FullRecord, Keyframe, LargestPacket, Low16, RefreshRecord, RefreshWriter, StreamId,
    Watermark,
};

/// The state of a body in the stream.
#[derive(Clone, Copy, Debug)]
struct FullBody {
    id: BodyId,
    /// The tick of the state: that of its placement, or of the last published one.
    since: Tick,
    motion: BodyState,
    /// A fixed body is sent after it was moved, not every tick.
    fixed: bool,
    moved: bool,
}

/// The publisher of one full stream.
#[derive(Debug)]
pub(crate) struct FullPublisher {
    stream: StreamId,
    largest_packet: LargestPacket,
    states: Vec<Option<FullBody>>,
    sent_packets: SentPackets,
    tick: Tick,
    statistics: PublisherStatistics,
}

impl FullPublisher {
    /// A stream without bodies.
    #[must_use]
    pub(crate) fn new(stream: StreamId, largest_packet: LargestPacket, tick: Tick) -> Self {
        Self {
            stream,
            largest_packet,
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
            moved: false,
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

    /// Appends the datagrams with the state of every movable body at the present published tick, if there is one.
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
                (state.motion, state.moved) = (observation.motion, true);
            }
        }
        let mut records = Vec::with_capacity(self.states.len());
        for state in self.states.iter_mut().flatten() {
            if state.since > tick {
                continue;
            }
            state.since = tick;
            if !state.fixed || core::mem::take(&mut state.moved) {
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
