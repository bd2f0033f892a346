//! Finding and repairing a track that two ends do not agree on.
//!
//! That never happens but by a fault of an implementation or of memory; a copy that has one is made right without a new
//! snapshot. Sums are compared only where both ends stand at the same packet and the same notice (PROTOCOL 6.12).

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::BodyId;

use super::publisher::Publisher;
use super::tracks::Tracks;
use crate::limits::{DIGEST_RANGES_MAX, INDICES_MAX};
use crate::packet::{Digest, Doubt, Low16, Ranges, RepairRecord, RepairWriter, TrackSaying};

/// What a publisher answers to a doubt.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reassurance {
    /// The sums over parts of the range.
    Sums(Bytes),
    /// The track of the one body that was doubted, which there may be none of.
    Amendment(Option<BodyId>, Vec<Bytes>),
}

impl Publisher {
    /// The sum over all tracks, by which two ends can be compared.
    #[must_use]
    pub fn agreement(&self) -> u64 {
        self.table().agreement().value()
    }

    /// The datagram that says the sum over all tracks. `notices`: how many the scene has given.
    #[must_use]
    pub fn digest(&self, notices: u64) -> Bytes {
        let sums = alloc::vec![self.agreement()];
        self.sums(Ranges::ALL, sums, notices)
    }

    /// Answers a member whose sum over a range is another.
    #[must_use]
    pub fn reassure(&self, doubt: Doubt, notices: u64) -> Reassurance {
        let range = doubt.range;
        if range.stride > 1 {
            let parts = range.cut();
            let end = range.first as usize + range.stride as usize;
            let sums = sums(self.table(), parts, end);
            return Reassurance::Sums(self.sums(parts, sums, notices));
        }
        let index = range.first;
        let mut writer = RepairWriter::default();
        let slot = self.table().slot(index);
        if let Some(slot) = slot {
            let age = self.tick().since(slot.origin()).unwrap_or_default();
            let whole = TrackSaying::of(&slot.track());
            writer.push(&RepairRecord {
                index,
                seat: None,
                age,
                whole,
            });
        }
        // It makes good a packet that was not sent yet: so it is told from repairs.
        let datagrams = writer.finish(
            self.stream(),
            self.next_number(),
            self.tick().value(),
            notices,
        );
        let datagrams = datagrams.into_iter().map(Bytes::from).collect();
        Reassurance::Amendment(slot.map(|slot| slot.id(index)), datagrams)
    }

    fn sums(&self, ranges: Ranges, sums: Vec<u64>, notices: u64) -> Bytes {
        let digest = Digest {
            next: Low16::of(self.next_number()),
            tick: Low16::of(self.tick().value()),
            notices: Low16::of(notices),
            ranges,
            sums,
        };
        Bytes::from(digest.encode(self.stream()))
    }
}

/// The sums over ranges of indices below `end`.
fn sums(tracks: &Tracks, ranges: Ranges, end: usize) -> Vec<u64> {
    let stride = ranges.stride as usize;
    let places = (ranges.first as usize..end).step_by(stride);
    let sum = |first: usize| {
        tracks
            .agreement_of(first..(first + stride).min(end))
            .value()
    };
    places.take(DIGEST_RANGES_MAX).map(sum).collect()
}

/// What a subscriber does not agree on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Doubts {
    range: Option<Ranges>,
}

impl Doubts {
    /// What to ask for.
    pub(super) fn doubt(self) -> Option<Doubt> {
        self.range.map(|range| Doubt { range })
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
    pub(super) fn compare(&mut self, tracks: &Tracks, said: &Digest) -> bool {
        let stride = said.ranges.stride as usize;
        let range = |place: usize| {
            let first = said.ranges.first as usize + place * stride;
            first..first + stride
        };
        let differs = |(place, sum): &(usize, &u64)| {
            let own = if said.ranges == Ranges::ALL {
                tracks.agreement()
            } else {
                tracks.agreement_of(range(*place))
            };
            own.value() != **sum
        };
        // A range behind all indices has no bodies, and no doubt can name it.
        let may_be = |(place, _): &(usize, &u64)| range(*place).start < INDICES_MAX as usize;
        let mut sums = said.sums.iter().enumerate().take_while(may_be);
        let found = sums.find(differs);
        let searching = said.ranges == Ranges::ALL && self.range.is_some();
        if found.is_some() && searching {
            return true;
        }
        self.range = found.map(|(place, _)| Ranges {
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
    use crate::scene::Cadence;
    use crate::stream::features::Features;
    use crate::stream::observation::{Activity, Observation};
    use crate::stream::publisher::StreamTerms;
    use crate::stream::subscriber::Subscriber;
    use crate::stream::tracks::Manner;
    use crate::stream::witness::Witness;
    use alloc::vec;
    use core::num::NonZeroU32;
    use glam::Vec3;
    use rhumb_reckoning::{
        Anchor, Integrator, Metres, Predictor, Rate, Tick, Tolerance, Track, Verbatim,
    };

    /// The first carries all others but the last, which hops about by itself.
    const BODIES: u32 = 6;
    const LONER: u32 = BODIES - 1;

    /// Where a body is at a tick.
    fn motion(body: u32, tick: u64) -> Verbatim {
        let course = if body == LONER { 7 } else { 1 };
        let jolt = |axis: u64| {
            let mixed = ((tick << 8) + axis + course).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((mixed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 3.0
        };
        let at = [body as f32, jolt(0), jolt(1)];
        Verbatim::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("a jolt is finite")
    }

    fn manner(body: u32) -> Manner {
        Manner::plain(Metres::new(if body == 0 { 5.0 } else { 0.5 }))
    }

    struct Ends {
        publisher: Publisher,
        subscriber: Subscriber,
        witness: Witness,
        tick: u64,
    }

    impl Ends {
        /// Both, after so many ticks of which everything was heard.
        fn after(ticks: u64) -> Self {
            let integrator = Integrator {
                rate: Rate::HZ_60,
                substeps: NonZeroU32::MIN,
            };
            let (stream, tolerance, every) =
                (StreamId(3), Tolerance::NORMAL, Cadence::EACH_TICK.every);
            let terms = StreamTerms {
                tolerance,
                integrator,
                every,
                gravity: Vec3::ZERO,
                features: Features::ALL,
            };
            let start = terms.start(stream, Tick::ZERO);
            let mut ends = Self {
                publisher: Publisher::new(stream, &terms, Tick::ZERO),
                subscriber: Subscriber::new(&start),
                witness: Witness::new(Cadence::EACH_TICK),
                tick: 0,
            };
            for body in 0..BODIES {
                let (id, manner) = (BodyId::new(body, 0), manner(body));
                let track = Track {
                    origin: Tick::ZERO,
                    predictor: Predictor::Uniform,
                    anchor: Anchor::Verbatim(motion(body, 0)),
                    carrier: None,
                };
                assert!(ends.publisher.place(id, &manner, track));
                assert!(ends.subscriber.place(id, &manner, track));
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
            self.hear(&said);
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
            self.witness.observe(Tick::new(self.tick), &seen);
            let mut said = Vec::new();
            self.publisher.publish(&self.witness, 0, &mut said);
            assert!(!said.is_empty());
            said
        }

        fn hear(&mut self, said: &[Bytes]) {
            for datagram in said {
                self.subscriber.handle_datagram(datagram);
            }
        }

        fn track(&self, id: BodyId) -> Track {
            let mut tracks = self.publisher.tracks();
            let found = tracks.find(|(other, _)| *other == id);
            found.expect("it is there").1
        }

        /// A body is believed to be elsewhere, by a track as old as its own, and in the seat that it has.
        fn mislead(&mut self, id: BodyId) {
            let track = Track {
                predictor: Predictor::Uniform,
                anchor: Anchor::Verbatim(motion(id.index(), 1_000)),
                carrier: None,
                ..self.track(id)
            };
            let manner = manner(id.index());
            assert!(self.subscriber.place(id, &manner, track));
            if let Some(seat) = self.publisher.seat(id) {
                self.subscriber.seat(id, seat);
            }
        }

        /// What makes the one wrong track right, said by now.
        fn amendment(&mut self) -> Vec<Bytes> {
            let digest = self.publisher.digest(0);
            self.hear(&[digest]);
            loop {
                let doubt = self.subscriber.doubt().expect("a track is another");
                match self.publisher.reassure(doubt, 0) {
                    Reassurance::Sums(sums) => self.hear(&[sums]),
                    Reassurance::Amendment(_, datagrams) => return datagrams,
                }
            }
        }

        fn agree(&self) -> bool {
            self.subscriber.is_settled()
                && self.subscriber.agreement() == self.publisher.agreement()
        }
    }

    #[test]
    fn an_amendment_that_comes_after_the_packet_of_its_number_means_nothing() {
        let mut ends = Ends::after(20);
        let id = BodyId::new(LONER, 0);
        ends.mislead(id);
        let late = ends.amendment();
        ends.pass();
        let (before, complete) = (ends.subscriber.track(id), ends.subscriber.complete());
        ends.hear(&late);
        assert_eq!(ends.subscriber.track(id), before);
        assert_eq!(ends.subscriber.complete(), complete);
        assert_eq!(ends.subscriber.statistics().repairs, 0);
        // Its seat is still known, so that it is heard of by that.
        ends.pass();
        assert_eq!(ends.subscriber.statistics().unread, 0);
        assert!(ends.subscriber.is_settled() && !ends.agree());
        let amendment = ends.amendment();
        ends.hear(&amendment);
        assert!(ends.agree());
    }

    #[test]
    fn an_amendment_does_not_make_good_the_packet_of_its_number() {
        let mut ends = Ends::after(20);
        ends.mislead(BodyId::new(LONER, 0));
        let late = ends.amendment();
        ends.say();
        ends.pass();
        let missing: Vec<u64> = ends.subscriber.missing_packets().collect();
        assert!(!missing.is_empty());
        ends.hear(&late);
        assert!(
            ends.subscriber
                .missing_packets()
                .eq(missing.iter().copied())
        );
        assert_eq!(ends.subscriber.statistics().amended, 0);
        let amendment = ends.amendment();
        ends.hear(&amendment);
        assert_eq!(ends.subscriber.statistics().amended, 1);
        for number in missing {
            let repair = ends.publisher.repair(number, 0);
            ends.hear(&repair.expect("it is remembered"));
        }
        assert!(ends.agree());
    }

    #[test]
    fn what_an_amendment_has_held_changes_with_its_holder() {
        let mut ends = Ends::after(20);
        let held = ends
            .publisher
            .tracks()
            .find(|(_, track)| track.carrier.is_some());
        let (id, _) = held.expect("some are carried");
        ends.mislead(id);
        ends.pass();
        let amendment = ends.amendment();
        ends.hear(&amendment);
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
    fn no_range_behind_all_indices_is_doubted() {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::MIN,
        };
        let tracks = Tracks::new(Tolerance::NORMAL, integrator, NonZeroU32::MIN, Vec3::ZERO);
        let digest = |sums| Digest {
            next: Low16(0),
            tick: Low16(0),
            notices: Low16(0),
            ranges: Ranges {
                first: 1,
                stride: INDICES_MAX - 1,
            },
            sums,
        };
        let mut doubts = Doubts::default();
        assert!(!doubts.compare(&tracks, &digest(vec![0, 1])));
        assert_eq!(doubts.doubt(), None);
        assert!(doubts.compare(&tracks, &digest(vec![1, 1])));
        assert_eq!(doubts.doubt().map(|doubt| doubt.range.first), Some(1));
    }
}
