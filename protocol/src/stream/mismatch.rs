//! Finding and refreshing a track that two ends do not agree on.
//!
//! That never happens but by a fault of an implementation or of memory; a copy that has one is made right without a new
//! snapshot. Sums are compared only where both ends stand at the same packet and the same scene_event (PROTOCOL 6.12).

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::BodyId;

use super::publisher::Publisher;
use super::tracks::Tracks;
use crate::limits::{CHECKSUM_RANGES_MAX, INDICES_MAX};
use crate::packet::{
    ChecksumMismatch, Checksums, IndexRanges, Keyframe, Low16, RefreshRecord, RefreshWriter,
};

/// What a publisher answers to a mismatch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum MismatchReply {
    /// The sums over parts of the range.
    Sums(Bytes),
    /// The track of the one body that was doubted, which there may be none of.
    Resync(Option<BodyId>, Vec<Bytes>),
}

impl MismatchReply {
    /// What to send.
    #[must_use]
    pub fn into_datagrams(self) -> Vec<Bytes> {
        match self {
            Self::Sums(datagram) => alloc::vec![datagram],
            Self::Resync(_, datagrams) => datagrams,
        }
    }
}

impl Publisher {
    /// The sum over all tracks, by which two ends can be compared.
    #[must_use]
    pub fn state_checksum(&self) -> u64 {
        self.table().state_checksum().value()
    }

    /// The datagram that says the sum over all tracks. `scene_events`: how many the scene has given.
    #[must_use]
    pub fn checksums(&self, scene_events: u64) -> Bytes {
        let sums = alloc::vec![self.state_checksum()];
        self.sums(IndexRanges::ALL, sums, scene_events)
    }

    /// Answers a member whose sum over a range is another.
    #[must_use]
    pub fn answer_mismatch(&self, mismatch: ChecksumMismatch, scene_events: u64) -> MismatchReply {
        let range = mismatch.range;
        if range.stride > 1 {
            let parts = range.cut();
            let end = range.first as usize + range.stride as usize;
            let sums = sums(self.table(), parts, end);
            return MismatchReply::Sums(self.sums(parts, sums, scene_events));
        }
        let index = range.first;
        let mut writer = RefreshWriter::default();
        let slot = self.table().slot(index);
        if let Some(slot) = slot {
            let age = self.tick().since(slot.origin()).unwrap_or_default();
            let keyframe = Keyframe::of(&slot.track());
            writer.push(&RefreshRecord {
                index,
                alias: None,
                age,
                keyframe,
            });
        }
        // It makes good a packet that was not sent yet: so it is told from refreshes.
        let datagrams = writer.finish(
            self.stream(),
            self.next_number(),
            self.tick().value(),
            scene_events,
        );
        let datagrams = datagrams.into_iter().map(Bytes::from).collect();
        MismatchReply::Resync(slot.map(|slot| slot.id(index)), datagrams)
    }

    fn sums(&self, ranges: IndexRanges, sums: Vec<u64>, scene_events: u64) -> Bytes {
        let checksums = Checksums {
            next: Low16::of(self.next_number()),
            tick: Low16::of(self.tick().value()),
            scene_events: Low16::of(scene_events),
            ranges,
            sums,
        };
        Bytes::from(checksums.encode(self.stream()))
    }
}

/// The sums over ranges of indices below `end`.
fn sums(tracks: &Tracks, ranges: IndexRanges, end: usize) -> Vec<u64> {
    let stride = ranges.stride as usize;
    let places = (ranges.first as usize..end).step_by(stride);
    let sum = |first: usize| {
        tracks
            .state_checksum_of(first..(first + stride).min(end))
            .value()
    };
    places.take(CHECKSUM_RANGES_MAX).map(sum).collect()
}

/// What a subscriber does not agree on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MismatchSearch {
    range: Option<IndexRanges>,
}

impl MismatchSearch {
    /// What to ask for.
    pub(super) fn mismatch(self) -> Option<ChecksumMismatch> {
        self.range.map(|range| ChecksumMismatch { range })
    }

    /// The body that is doubted, if it is known to be one.
    pub(super) fn index(self) -> Option<u32> {
        let range = self.range.filter(|range| range.stride == 1)?;
        Some(range.first)
    }

    /// It was made right.
    pub(super) fn end(&mut self) {
        self.range = None;
    }

    /// Compares sums that were said of the tracks as they stand here; `true` if they are other sums.
    ///
    /// A sum over all tracks does not begin the search again while it goes on.
    pub(super) fn compare(&mut self, tracks: &Tracks, said: &Checksums) -> bool {
        let stride = said.ranges.stride as usize;
        let range = |place: usize| {
            let first = said.ranges.first as usize + place * stride;
            first..first + stride
        };
        let differs = |(place, sum): &(usize, &u64)| {
            let own = if said.ranges == IndexRanges::ALL {
                tracks.state_checksum()
            } else {
                tracks.state_checksum_of(range(*place))
            };
            own.value() != **sum
        };
        // A range behind all indices has no bodies, and no mismatch can name it.
        let may_be = |(place, _): &(usize, &u64)| range(*place).start < INDICES_MAX as usize;
        let mut sums = said.sums.iter().enumerate().take_while(may_be);
        let found = sums.find(differs);
        let searching = said.ranges == IndexRanges::ALL && self.range.is_some();
        if found.is_some() && searching {
            return true;
        }
        self.range = found.map(|(place, _)| IndexRanges {
            first: range(place).start as u32,
            stride: said.ranges.stride,
        });
        found.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::StreamId;
    use crate::scene::PublishSchedule;
    use crate::stream::features::Features;
    use crate::stream::observation::{Activity, Observation};
    use crate::stream::observation_history::ObservationHistory;
    use crate::stream::publisher::StreamTerms;
    use crate::stream::subscriber::Subscriber;
    use crate::stream::tracks::PredictionParameters;
    use alloc::vec;
    use core::num::NonZeroU32;
    use glam::Vec3;
    use rhumb_reckoning::{
        Anchor, BodyState, Integrator, Metres, Predictor, Rate, Tick, Tolerance, Track,
    };

    /// The first carries all others but the last, which hops about by itself.
    const BODIES: u32 = 6;
    const LONER: u32 = BODIES - 1;

    /// Where a body is at a tick.
    fn motion(body: u32, tick: u64) -> BodyState {
        let mode = if body == LONER { 7 } else { 1 };
        let jolt = |axis: u64| {
            let mixed = ((tick << 8) + axis + mode).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((mixed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 3.0
        };
        let at = [body as f32, jolt(0), jolt(1)];
        BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("a jolt is finite")
    }

    fn parameters(body: u32) -> PredictionParameters {
        PredictionParameters::plain(Metres::new(if body == 0 { 5.0 } else { 0.5 }))
    }

    struct Ends {
        publisher: Publisher,
        subscriber: Subscriber,
        observation_history: ObservationHistory,
        tick: u64,
    }

    impl Ends {
        /// Both, after so many ticks of which everything was heard.
        fn after(ticks: u64) -> Self {
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
            let start = config.start(stream, Tick::ZERO);
            let mut ends = Self {
                publisher: Publisher::new(stream, &config, Tick::ZERO),
                subscriber: Subscriber::new(&start),
                observation_history: ObservationHistory::new(PublishSchedule::EACH_TICK),
                tick: 0,
            };
            for body in 0..BODIES {
                let (id, parameters) = (BodyId::new(body, 0), parameters(body));
                let track = Track {
                    origin: Tick::ZERO,
                    predictor: Predictor::Uniform,
                    anchor: Anchor::Exact(motion(body, 0)),
                    parent: None,
                };
                assert!(ends.publisher.place(id, &parameters, track));
                assert!(ends.subscriber.place(id, &parameters, track));
            }
            ends.subscriber.handle_snapshot_end();
            for _ in 0..ticks {
                ends.pass();
            }
            ends
        }

        /// A tick of which everything is heard.
        fn pass(&mut self) {
            let said = self.say();
            self.apply(&said);
        }

        /// A tick.
        fn say(&mut self) -> Vec<Bytes> {
            self.tick += 1;
            let seen = |body| Observation {
                id: BodyId::new(body, 0),
                motion: motion(body, self.tick),
                activity: Activity::Awake,
            };
            let seen: Vec<_> = (0..BODIES).map(seen).collect();
            self.observation_history
                .observe(Tick::new(self.tick), &seen);
            let mut said = Vec::new();
            self.publisher
                .publish(&self.observation_history, 0, &mut said);
            assert!(!said.is_empty());
            said
        }

        fn apply(&mut self, said: &[Bytes]) {
            for datagram in said {
                self.subscriber.handle_datagram(datagram);
            }
        }

        fn track(&self, id: BodyId) -> Track {
            let mut tracks = self.publisher.tracks();
            let found = tracks.find(|(other, _)| *other == id);
            found.expect("it is there").1
        }

        /// A body is predicted_motion to be elsewhere, by a track as old as its own, and in the alias that it has.
        fn mislead(&mut self, id: BodyId) {
            let track = Track {
                predictor: Predictor::Uniform,
                anchor: Anchor::Exact(motion(id.index(), 1_000)),
                parent: None,
                ..self.track(id)
            };
            let parameters = parameters(id.index());
            assert!(self.subscriber.place(id, &parameters, track));
            if let Some(alias) = self.publisher.alias(id) {
                self.subscriber.alias(id, alias);
            }
        }

        /// What makes the one wrong track right, said by now.
        fn resync(&mut self) -> Vec<Bytes> {
            let checksums = self.publisher.checksums(0);
            self.apply(&[checksums]);
            loop {
                let mismatch = self.subscriber.mismatch().expect("a track is another");
                match self.publisher.answer_mismatch(mismatch, 0) {
                    MismatchReply::Sums(sums) => self.apply(&[sums]),
                    MismatchReply::Resync(_, datagrams) => return datagrams,
                }
            }
        }

        fn agree(&self) -> bool {
            self.subscriber.is_converged()
                && self.subscriber.state_checksum() == self.publisher.state_checksum()
        }
    }

    #[test]
    fn late_resync_is_ignored() {
        let mut ends = Ends::after(20);
        let id = BodyId::new(LONER, 0);
        ends.mislead(id);
        let late = ends.resync();
        ends.pass();
        let (before, complete) = (ends.subscriber.track(id), ends.subscriber.complete());
        ends.apply(&late);
        assert_eq!(ends.subscriber.track(id), before);
        assert_eq!(ends.subscriber.complete(), complete);
        assert_eq!(ends.subscriber.statistics().refreshes, 0);
        // Its alias is still known, so that it is heard of by that.
        ends.pass();
        assert_eq!(ends.subscriber.statistics().unread, 0);
        assert!(ends.subscriber.is_converged() && !ends.agree());
        let resync = ends.resync();
        ends.apply(&resync);
        assert!(ends.agree());
    }

    #[test]
    fn resync_does_not_replace_its_packet() {
        let mut ends = Ends::after(20);
        ends.mislead(BodyId::new(LONER, 0));
        let late = ends.resync();
        ends.say();
        ends.pass();
        let missing: Vec<u64> = ends.subscriber.missing_packets().collect();
        assert!(!missing.is_empty());
        ends.apply(&late);
        assert!(
            ends.subscriber
                .missing_packets()
                .eq(missing.iter().copied())
        );
        assert_eq!(ends.subscriber.statistics().resynced, 0);
        let resync = ends.resync();
        ends.apply(&resync);
        assert_eq!(ends.subscriber.statistics().resynced, 1);
        for number in missing {
            let refresh = ends.publisher.refresh(number, 0);
            ends.apply(&refresh.expect("it is remembered"));
        }
        assert!(ends.agree());
    }

    #[test]
    fn resynced_children_change_with_their_parent() {
        let mut ends = Ends::after(20);
        let held = ends
            .publisher
            .tracks()
            .find(|(_, track)| track.parent.is_some());
        let (id, _) = held.expect("some are attached_motion");
        ends.mislead(id);
        ends.pass();
        let resync = ends.resync();
        ends.apply(&resync);
        assert!(ends.agree());
        let mut changed = Vec::new();
        ends.subscriber.drain_changed(&mut changed);
        ends.pass();
        assert_ne!(ends.track(id).origin, Tick::new(ends.tick));
        changed.clear();
        ends.subscriber.drain_changed(&mut changed);
        assert!(changed.contains(&id.index()), "{changed:?}");
    }

    #[test]
    fn ranges_beyond_all_indices_never_mismatch() {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::MIN,
        };
        let tracks = Tracks::new(Tolerance::NORMAL, integrator, NonZeroU32::MIN, Vec3::ZERO);
        let checksums = |sums| Checksums {
            next: Low16(0),
            tick: Low16(0),
            scene_events: Low16(0),
            ranges: IndexRanges {
                first: 1,
                stride: INDICES_MAX - 1,
            },
            sums,
        };
        let mut mismatches = MismatchSearch::default();
        assert!(!mismatches.compare(&tracks, &checksums(vec![0, 1])));
        assert_eq!(mismatches.mismatch(), None);
        assert!(mismatches.compare(&tracks, &checksums(vec![1, 1])));
        assert_eq!(
            mismatches.mismatch().map(|mismatch| mismatch.range.first),
            Some(1)
        );
    }
}
