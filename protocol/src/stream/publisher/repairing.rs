//! What makes good a lost packet: what its bodies do now

use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::Tick;

use super::Publisher;
use crate::limits::{HISTORY_PACKETS, UPDATES_PER_PACKET_MAX};
use crate::packet::{Echo, REPAIR_RECORDS, RepairRecord, RepairWriter, Saying, TrackSaying};
use crate::stream::parities::Asker;
use crate::stream::redundancy::Redundancy;

/// Updates of one tick that name a carrier's revision, at most: what needs a packet of that tick to be read fits its
/// repair beside the bodies of that packet.
pub(super) const NAMINGS_MAX: usize = REPAIR_RECORDS - UPDATES_PER_PACKET_MAX;

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
    ///
    /// Where so many others named these as carriers since that one repair would be long, it is as of the packet's own
    /// tick, and says nothing of what was spoken of since: what a listener could not read of that, it asks for by its
    /// own packets (PROTOCOL 6.6-8, 6.7-5).
    #[must_use]
    pub fn repair(&self, number: u64, notices: u64) -> Option<Vec<Bytes>> {
        let bodies = self.bodies_to_repair(number)?;
        let as_of = if bodies.len() > UPDATES_PER_PACKET_MAX {
            self.history.tick(number)?
        } else {
            self.tick
        };
        Some(self.repair_as_of(as_of, &bodies, number, notices))
    }

    /// The bodies of a lost packet, and those that could not be read without it, in order of index.
    fn bodies_to_repair(&self, number: u64) -> Option<Vec<u32>> {
        let mut bodies = self.history.bodies(number)?.to_vec();
        // Who lacks a carrier could not read what named it since.
        let lost = bodies.len();
        for naming in self.namings.iter().filter(|naming| naming.number >= number) {
            if bodies[..lost].binary_search(&naming.carrier).is_ok() {
                bodies.push(naming.body);
            }
        }
        bodies.sort_unstable();
        bodies.dedup();
        Some(bodies)
    }

    /// Says the tracks that bodies had at a tick and have still.
    fn repair_as_of(&self, tick: Tick, bodies: &[u32], number: u64, notices: u64) -> Vec<Bytes> {
        let mut writer = RepairWriter::default();
        for index in bodies {
            let Some(slot) = self.tracks.slot(*index) else {
                continue;
            };
            let Some(age) = tick.since(slot.origin()) else {
                continue;
            };
            writer.push(&RepairRecord {
                index: *index,
                seat: self.usher.seats().of(*index),
                age,
                whole: TrackSaying::of(&slot.track()),
            });
        }
        let datagrams = writer.finish(self.stream, number, tick.value(), notices);
        datagrams.into_iter().map(Bytes::from).collect()
    }

    /// Whether a repair would have room for what one update more of the present tick says.
    pub(super) fn may_say(&self, saying: &Saying) -> bool {
        // Those of the present tick have no number yet, and are the last.
        let mut newest_first = self.namings.iter().rev();
        let last = newest_first.nth(NAMINGS_MAX - 1);
        let named_fewer = last.is_none_or(|naming| naming.number != u64::MAX);
        named_fewer || !saying.names_carrier()
    }

    /// What was named in this tick was so in its last packet at the latest; what no repair is asked of any more goes.
    pub(super) fn number_namings(&mut self) {
        let next = self.history.next();
        for naming in self.namings.iter_mut().rev() {
            if naming.number != u64::MAX {
                break;
            }
            naming.number = next.saturating_sub(1);
        }
        while let Some(oldest) = self.namings.front()
            && oldest.number + (HISTORY_PACKETS as u64) < next
        {
            self.namings.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::{Head, Repair, StreamId};
    use crate::scene::Cadence;
    use crate::stream::features::Features;
    use crate::stream::observation::{Activity, Observation};
    use crate::stream::publisher::StreamTerms;
    use crate::stream::start::StreamStart;
    use crate::stream::subscriber::Subscriber;
    use crate::stream::tracks::Manner;
    use crate::stream::witness::Witness;
    use crate::wire::Wire;
    use crate::wire::bytes::Reader;
    use core::num::NonZeroU32;
    use glam::Vec3;
    use rhumb_reckoning::{
        Anchor, BodyId, Class, Damping, Integrator, Metres, Predictor, Rate, Tolerance, Track,
        Verbatim,
    };

    /// More than fit the repairs of two packets; the first is the one that carries the others.
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
        let mut subscriber = Subscriber::new(&StreamStart {
            stream,
            tolerance,
            integrator,
            every,
            gravity: Vec3::ZERO,
            tick: Tick::ZERO,
            next: 0,
            notices: 0,
        });
        for body in 0..BODIES {
            let manner = Manner {
                radius: Metres::new(if body == 0 { 50.0 } else { 0.5 }),
                damping: Damping::default(),
                gravity_scale: 1.0,
                inertia: None,
                class: Class::default(),
            };
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
        assert!(publisher.namings_of(tick) <= NAMINGS_MAX);
        said
    }

    impl Publisher {
        /// How many updates of the newest tick, which is this one, named carriers.
        fn namings_of(&self, tick: u64) -> usize {
            let number = |tick| self.history.tick(tick).map(Tick::value);
            let of_it = |naming: &&super::super::Naming| number(naming.number) == Some(tick);
            self.namings.iter().filter(of_it).count()
        }
    }

    fn tick_of(repair: &Bytes) -> u16 {
        let mut reader = Reader::new(repair);
        Head::decode(&mut reader).expect("a repair has a head");
        Repair::decode(reader).expect("it is a repair").tick.0
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
        assert!(most > Some(REPAIR_RECORDS), "{most:?}");
        let (mut rounds, mut earlier) = (0, 0);
        while !subscriber.is_settled() {
            rounds += 1;
            assert!(rounds < 10, "{} are missing", subscriber.missing());
            let missing: Vec<u64> = subscriber.missing_packets().collect();
            for number in missing {
                let repair = publisher.repair(number, 0).expect("it is remembered");
                assert!(repair.len() <= usize::from(crate::limits::REPAIR_PARTS_MAX));
                earlier += usize::from(u64::from(tick_of(&repair[0])) < publisher.tick.value());
                repair
                    .iter()
                    .for_each(|part| subscriber.handle_datagram(part));
            }
        }
        assert!(earlier > 0);
        assert_eq!(subscriber.statistics().malformed, 0);
        assert_eq!(subscriber.agreement(), publisher.agreement());
    }
}
