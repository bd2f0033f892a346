//! What makes good a lost packet: what its bodies do now

use alloc::collections::BTreeMap;
use alloc::collections::btree_map::Entry;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{BodyId, Track};

use super::Publisher;
use crate::limits::{HISTORY_PACKETS, UPDATES_PER_PACKET_MAX};
use crate::packet::{Echo, REPAIR_RECORDS, RepairRecord, RepairWriter, Saying, TrackSaying};
use crate::stream::parities::Asker;
use crate::stream::redundancy::Redundancy;

/// Bodies that named carriers in the packets that can be repaired, at most, one counted for each carrier: what could not
/// be read without a lost packet fits its repair beside the bodies of that packet.
const NAMINGS_MAX: usize = REPAIR_RECORDS - UPDATES_PER_PACKET_MAX;

/// Of which bodies it was said lately what could only be read by who had the track of their carrier.
#[derive(Debug, Default)]
pub(super) struct Namings {
    /// By carrier and body, in which tick that was so last: the number of the last packet of it.
    last: BTreeMap<(u32, u32), u64>,
    /// Those of the present tick, which have no number yet: carriers and bodies.
    of_now: Vec<(u32, u32)>,
}

impl Namings {
    /// A body names a carrier at the present tick; `false` if there is no room for that.
    fn note(&mut self, carrier: u32, body: u32) -> bool {
        let full = self.last.len() >= NAMINGS_MAX;
        match self.last.entry((carrier, body)) {
            Entry::Occupied(mut known) => {
                known.insert(u64::MAX);
            }
            Entry::Vacant(_) if full => return false,
            Entry::Vacant(place) => {
                place.insert(u64::MAX);
            }
        }
        self.of_now.push((carrier, body));
        true
    }

    /// Carriers and bodies of the present tick, the last first.
    pub(super) fn of_now(&self) -> impl Iterator<Item = (u32, u32)> {
        self.of_now.iter().rev().copied()
    }

    /// Bodies that named a carrier in a packet of this number, or a later one.
    fn since(&self, number: u64, carrier: u32) -> impl Iterator<Item = u32> {
        let of_it = self.last.range((carrier, 0)..=(carrier, u32::MAX));
        let since = of_it.filter(move |(_, last)| **last >= number);
        since.map(|((_, body), _)| *body)
    }

    /// What was named in this tick was so in its last packet at the latest; what no repair is asked of any more goes.
    pub(super) fn end_tick(&mut self, next: u64) {
        for naming in self.of_now.drain(..) {
            self.last.insert(naming, next.saturating_sub(1));
        }
        self.last
            .retain(|_, last| *last + HISTORY_PACKETS as u64 >= next);
    }
}

impl Publisher {
    /// Says the parities that are due after a tick that was spoken of, silent or not, and appends them to `out`.
    pub fn say_parities(&mut self, redundancy: Redundancy, out: &mut Vec<Bytes>) {
        if self.features.redundancy {
            self.parities.end_tick(self.stream, redundancy, out);
        }
    }

    /// Answers a stream's only listener, which is sent all parities: see [`Self::answer_one`].
    pub fn answer(&mut self, echo: &Echo, out: &mut Vec<Bytes>) -> Vec<u64> {
        self.answer_one(echo, Some(0), out)
    }

    /// Answers a listener that lost packets by parities, where these serve, and appends them to `out`. Returns the
    /// numbers of the packets that must be repaired instead, each once.
    ///
    /// `sent_from`: what the number of the stream's next packet was when this listener began to be sent what
    /// [`Self::say_parities`] says; `None` if it is sent none of it.
    pub fn answer_one(
        &mut self,
        echo: &Echo,
        sent_from: Option<u64>,
        out: &mut Vec<Bytes>,
    ) -> Vec<u64> {
        let next = self.history.next();
        let mut lost: Vec<u64> = echo.lost.iter().map(|lost| lost.expand(next)).collect();
        lost.sort_unstable();
        lost.dedup();
        let asker = Asker {
            heard: echo.next.expand(next),
            wanted: usize::from(echo.parities),
            sent_from: sent_from.unwrap_or(u64::MAX),
        };
        self.parities
            .answer(self.stream, lost.into_iter(), asker, out)
    }

    /// The datagrams that say what the bodies of a lost packet do now, or `None` when it is too old to be known.
    #[must_use]
    pub fn repair(&self, number: u64, notices: u64) -> Option<Vec<Bytes>> {
        let mut writer = RepairWriter::default();
        for index in self.bodies_to_repair(number)? {
            let Some(slot) = self.tracks.slot(index) else {
                continue;
            };
            let age = self.tick.since(slot.origin()).unwrap_or_default();
            let whole = TrackSaying::of(&slot.track());
            writer.push(&RepairRecord {
                index,
                seat: self.usher.seats().of(index),
                age,
                whole,
            });
        }
        let datagrams = writer.finish(self.stream, number, self.tick.value(), notices);
        Some(datagrams.into_iter().map(Bytes::from).collect())
    }

    /// The bodies of a lost packet, and those that could not be read without it, in order of index: no more than fit.
    fn bodies_to_repair(&self, number: u64) -> Option<Vec<u32>> {
        let lost = self.history.bodies(number)?;
        let mut bodies = lost.to_vec();
        for carrier in lost {
            bodies.extend(self.namings.since(number, *carrier));
        }
        bodies.sort_unstable();
        bodies.dedup();
        Some(bodies)
    }

    /// Notes if what is said of a body can be read only by who has its carrier's track. Where one more of these would not
    /// fit a repair, the same track is said whole.
    pub(super) fn readable(
        &mut self,
        index: u32,
        before: Option<BodyId>,
        saying: Saying,
        track: &Track,
    ) -> Saying {
        let carrier = track.carrier.or(before);
        match carrier.filter(|_| saying.names_carrier()) {
            Some(carrier) if !self.namings.note(carrier.index(), index) => {
                Saying::Whole(TrackSaying::of(track))
            }
            _ => saying,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::REPAIR_PARTS_MAX;
    use crate::packet::StreamId;
    use crate::scene::Cadence;
    use crate::stream::features::Features;
    use crate::stream::observation::{Activity, Observation};
    use crate::stream::publisher::StreamTerms;
    use crate::stream::subscriber::Subscriber;
    use crate::stream::tracks::Manner;
    use crate::stream::witness::Witness;
    use core::num::NonZeroU32;
    use glam::Vec3;
    use rhumb_reckoning::{Anchor, Integrator, Metres, Predictor, Rate, Tick, Tolerance, Verbatim};

    /// More than fit the repair of a packet; the first is the one that carries the others.
    const BODIES: u32 = 1_500;

    /// Where a body is at a tick: all are jolted alike.
    fn motion(body: u32, tick: u64) -> Verbatim {
        let jolt = |axis: u64| {
            let mixed = ((tick << 8) + axis + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((mixed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 3.0
        };
        let at = [(body % 40) as f32, (body / 40) as f32, 0.0];
        let at = [0, 1, 2].map(|axis| at[axis] + jolt(axis as u64));
        Verbatim::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("a jolt is finite")
    }

    fn ends() -> (Publisher, Subscriber) {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::MIN,
        };
        let (stream, tolerance, every) = (StreamId(3), Tolerance::NORMAL, Cadence::EACH_TICK.every);
        let terms = StreamTerms {
            tolerance,
            integrator,
            every,
            gravity: Vec3::ZERO,
            features: Features::ALL,
        };
        let mut publisher = Publisher::new(stream, &terms, Tick::ZERO);
        let mut subscriber = Subscriber::new(&terms.start(stream, Tick::ZERO));
        for body in 0..BODIES {
            let manner = Manner::plain(Metres::new(if body == 0 { 50.0 } else { 0.5 }));
            let track = Track {
                origin: Tick::ZERO,
                predictor: Predictor::Uniform,
                anchor: Anchor::Verbatim(motion(body, 0)),
                carrier: None,
            };
            assert!(publisher.place(BodyId::new(body, 0), &manner, track));
            assert!(subscriber.place(BodyId::new(body, 0), &manner, track));
        }
        subscriber.handle_snapshot_end();
        (publisher, subscriber)
    }

    fn say(publisher: &mut Publisher, witness: &mut Witness, tick: u64) -> Vec<Bytes> {
        let seen = |body| Observation {
            id: BodyId::new(body, 0),
            motion: motion(body, tick),
            activity: Activity::Awake,
        };
        let seen: Vec<_> = (0..BODIES).map(seen).collect();
        witness.observe(Tick::new(tick), &seen);
        let mut said = Vec::new();
        publisher.publish(witness, 0, &mut said);
        assert!(publisher.namings.last.len() <= NAMINGS_MAX);
        said
    }

    #[test]
    fn a_packet_that_hundreds_have_built_on_since_is_made_good() {
        let (mut publisher, mut subscriber) = ends();
        let mut witness = Witness::new(Cadence::EACH_TICK);
        for tick in 1..=30 {
            let said = say(&mut publisher, &mut witness, tick);
            // The first ticks are lost: of bodies, and of who carries them then.
            let heard = if tick < 4 { &[][..] } else { &said };
            heard
                .iter()
                .for_each(|packet| subscriber.handle_datagram(packet));
        }
        let needed = |number| {
            publisher
                .bodies_to_repair(number)
                .map(|bodies| bodies.len())
        };
        let most = subscriber.missing_packets().filter_map(needed).max();
        assert!(
            most > Some(NAMINGS_MAX) && most <= Some(REPAIR_RECORDS),
            "{most:?}"
        );
        let missing: Vec<u64> = subscriber.missing_packets().collect();
        for number in missing {
            let repair = publisher.repair(number, 0).expect("it is remembered");
            assert!(repair.len() <= usize::from(REPAIR_PARTS_MAX));
            repair
                .iter()
                .for_each(|part| subscriber.handle_datagram(part));
        }
        assert!(subscriber.is_settled());
        assert_eq!(subscriber.statistics().malformed, 0);
        assert_eq!(subscriber.agreement(), publisher.agreement());
    }
}
