//! What makes good a lost packet: what its bodies do now

use alloc::collections::BTreeMap;
use alloc::collections::btree_map::Entry;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{BodyId, Track};

use super::Publisher;
use crate::limits::{HISTORY_PACKETS, UPDATES_PER_PACKET_MAX};
use crate::packet::{
    Keyframe, LossReport, REFRESH_RECORDS_MAX, RefreshRecord, RefreshWriter, UpdatePayload,
};
use crate::stream::fec_encoder::SymbolRequest;
use crate::stream::redundancy::Redundancy;

/// Bodies that named parents in the packets that can be refreshed, at most, one counted for each parent: what could not
/// be read without a lost packet fits its refresh beside the bodies of that packet.
const PARENT_REFERENCES_MAX: usize = REFRESH_RECORDS_MAX - UPDATES_PER_PACKET_MAX;

/// Of which bodies it was said lately what could only be read by who had the track of their parent.
#[derive(Debug, Default)]
pub(super) struct ParentReferences {
    /// By parent and body, in which tick that was so last: the number of the last packet of it.
    last: BTreeMap<(u32, u32), u64>,
    /// Those of the present tick, which have no number yet: parents and bodies.
    of_now: Vec<(u32, u32)>,
}

impl ParentReferences {
    /// A body names a parent at the present tick; `false` if there is no room for that.
    fn note(&mut self, parent: u32, body: u32) -> bool {
        let full = self.last.len() >= PARENT_REFERENCES_MAX;
        match self.last.entry((parent, body)) {
            Entry::Occupied(mut known) => {
                known.insert(u64::MAX);
            }
            Entry::Vacant(_) if full => return false,
            Entry::Vacant(place) => {
                place.insert(u64::MAX);
            }
        }
        self.of_now.push((parent, body));
        true
    }

    /// Parents and bodies of the present tick, the last first.
    pub(super) fn of_now(&self) -> impl Iterator<Item = (u32, u32)> {
        self.of_now.iter().rev().copied()
    }

    /// Bodies that named a parent in a packet of this number, or a later one.
    fn since(&self, number: u64, parent: u32) -> impl Iterator<Item = u32> {
        let of_it = self.last.range((parent, 0)..=(parent, u32::MAX));
        let since = of_it.filter(move |(_, last)| **last >= number);
        since.map(|((_, body), _)| *body)
    }

    /// What was named in this tick was so in its last packet at the latest; what no refresh is asked of any more goes.
    pub(super) fn end_tick(&mut self, next: u64) {
        for naming in self.of_now.drain(..) {
            self.last.insert(naming, next.saturating_sub(1));
        }
        self.last
            .retain(|_, last| *last + HISTORY_PACKETS as u64 >= next);
    }
}

impl Publisher {
    /// Says the repair_symbols that are due after a tick that was spoken of, silent or not, and appends them to `out`.
    pub fn encode_repair_symbols(&mut self, redundancy: Redundancy, out: &mut Vec<Bytes>) {
        if self.features.redundancy {
            self.repair_symbols.end_tick(self.stream, redundancy, out);
        }
    }

    /// Answers a stream's only listener, which is sent all repair_symbols: see [`Self::answer_one`].
    pub fn answer(&mut self, loss_report: &LossReport, out: &mut Vec<Bytes>) -> Vec<u64> {
        self.answer_one(loss_report, Some(0), out)
    }

    /// Answers a listener that lost packets by repair_symbols, where these serve, and appends them to `out`. Returns the
    /// numbers of the packets that must be refreshed instead, each once.
    ///
    /// `sent_from`: what the number of the stream's next packet was when this listener began to be sent what
    /// [`Self::encode_repair_symbols`] says; `None` if it is sent none of it.
    pub fn answer_one(
        &mut self,
        loss_report: &LossReport,
        sent_from: Option<u64>,
        out: &mut Vec<Bytes>,
    ) -> Vec<u64> {
        let next = self.sent_packets.next();
        let mut lost: Vec<u64> = loss_report
            .lost
            .iter()
            .map(|lost| lost.expand(next))
            .collect();
        lost.sort_unstable();
        lost.dedup();
        let request = SymbolRequest {
            received_below: loss_report.next.expand(next),
            wanted: usize::from(loss_report.repair_symbols),
            sent_from: sent_from.unwrap_or(u64::MAX),
        };
        self.repair_symbols
            .answer(self.stream, lost.into_iter(), request, out)
    }

    /// The datagrams that say what the bodies of a lost packet do now, or `None` when it is too old to be known.
    #[must_use]
    pub fn refresh(&self, number: u64, scene_events: u64) -> Option<Vec<Bytes>> {
        let mut writer = RefreshWriter::default();
        for index in self.bodies_to_refresh(number)? {
            let Some(slot) = self.tracks.slot(index) else {
                continue;
            };
            let age = self.tick.since(slot.origin()).unwrap_or_default();
            let keyframe = Keyframe::of(&slot.track());
            writer.push(&RefreshRecord {
                index,
                alias: self.alias_table.aliases().of(index),
                age,
                keyframe,
            });
        }
        let datagrams = writer.finish(self.stream, number, self.tick.value(), scene_events);
        Some(datagrams.into_iter().map(Bytes::from).collect())
    }

    /// The bodies of a lost packet, and those that could not be read without it, in order of index: no more than fit.
    fn bodies_to_refresh(&self, number: u64) -> Option<Vec<u32>> {
        let lost = self.sent_packets.bodies(number)?;
        let mut bodies = lost.to_vec();
        for parent in lost {
            bodies.extend(self.parent_references.since(number, *parent));
        }
        bodies.sort_unstable();
        bodies.dedup();
        Some(bodies)
    }

    /// Notes if what is said of a body can be read only by who has its parent's track. Where one more of these would not
    /// fit a refresh, the same track is said keyframe.
    pub(super) fn readable(
        &mut self,
        index: u32,
        before: Option<BodyId>,
        payload: UpdatePayload,
        track: &Track,
    ) -> UpdatePayload {
        let parent = track.parent.or(before);
        match parent.filter(|_| payload.names_parent()) {
            Some(parent) if !self.parent_references.note(parent.index(), index) => {
                UpdatePayload::Keyframe(Keyframe::of(track))
            }
            _ => payload,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::REFRESH_PARTS_MAX;
    use crate::packet::StreamId;
    use crate::scene::PublishSchedule;
    use crate::stream::features::Features;
    use crate::stream::observation::{Activity, Observation};
    use crate::stream::observation_history::ObservationHistory;
    use crate::stream::publisher::StreamTerms;
    use crate::stream::subscriber::Subscriber;
    use crate::stream::tracks::PredictionParameters;
    use core::num::NonZeroU32;
    use glam::Vec3;
    use rhumb_reckoning::{
        Anchor, BodyState, Integrator, Metres, Predictor, Rate, Tick, Tolerance,
    };

    /// More than fit the refresh of a packet; the first is the one that carries the others.
    const BODIES: u32 = 1_500;

    /// Where a body is at a tick: all are jolted alike.
    fn motion(body: u32, tick: u64) -> BodyState {
        let jolt = |axis: u64| {
            let mixed = ((tick << 8) + axis + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((mixed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 3.0
        };
        let at = [(body % 40) as f32, (body / 40) as f32, 0.0];
        let at = [0, 1, 2].map(|axis| at[axis] + jolt(axis as u64));
        BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("a jolt is finite")
    }

    fn ends() -> (Publisher, Subscriber) {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::MIN,
        };
        let (stream, tolerance, publish_interval) = (
            StreamId(3),
            Tolerance::NORMAL,
            PublishSchedule::EACH_TICK.publish_interval,
        );
        let config = StreamTerms {
            tolerance,
            integrator,
            publish_interval,
            gravity: Vec3::ZERO,
            features: Features::ALL,
        };
        let mut publisher = Publisher::new(stream, &config, Tick::ZERO);
        let mut subscriber = Subscriber::new(&config.start(stream, Tick::ZERO));
        for body in 0..BODIES {
            let parameters =
                PredictionParameters::plain(Metres::new(if body == 0 { 50.0 } else { 0.5 }));
            let track = Track {
                origin: Tick::ZERO,
                predictor: Predictor::Uniform,
                anchor: Anchor::Exact(motion(body, 0)),
                parent: None,
            };
            assert!(publisher.place(BodyId::new(body, 0), &parameters, track));
            assert!(subscriber.place(BodyId::new(body, 0), &parameters, track));
        }
        subscriber.handle_snapshot_end();
        (publisher, subscriber)
    }

    fn say(
        publisher: &mut Publisher,
        observation_history: &mut ObservationHistory,
        tick: u64,
    ) -> Vec<Bytes> {
        let seen = |body| Observation {
            id: BodyId::new(body, 0),
            motion: motion(body, tick),
            activity: Activity::Awake,
        };
        let seen: Vec<_> = (0..BODIES).map(seen).collect();
        observation_history.observe(Tick::new(tick), &seen);
        let mut said = Vec::new();
        publisher.publish(observation_history, 0, &mut said);
        assert!(publisher.parent_references.last.len() <= PARENT_REFERENCES_MAX);
        said
    }

    #[test]
    fn a_packet_that_hundreds_have_built_on_since_is_made_good() {
        let (mut publisher, mut subscriber) = ends();
        let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
        for tick in 1..=30 {
            let said = say(&mut publisher, &mut observation_history, tick);
            // The first ticks are lost: of bodies, and of who carries them then.
            let received_below = if tick < 4 { &[][..] } else { &said };
            received_below
                .iter()
                .for_each(|packet| subscriber.handle_datagram(packet));
        }
        let needed = |number| {
            publisher
                .bodies_to_refresh(number)
                .map(|bodies| bodies.len())
        };
        let most = subscriber.missing_packets().filter_map(needed).max();
        assert!(
            most > Some(PARENT_REFERENCES_MAX) && most <= Some(REFRESH_RECORDS_MAX),
            "{most:?}"
        );
        let missing: Vec<u64> = subscriber.missing_packets().collect();
        for number in missing {
            let refresh = publisher.refresh(number, 0).expect("it is remembered");
            assert!(refresh.len() <= usize::from(REFRESH_PARTS_MAX));
            refresh
                .iter()
                .for_each(|part| subscriber.handle_datagram(part));
        }
        assert!(subscriber.is_converged());
        assert_eq!(subscriber.statistics().malformed, 0);
        assert_eq!(subscriber.state_checksum(), publisher.state_checksum());
    }
}
