//! A listener that need not look back: what it forgets, nobody misses
//!
//! Two listeners hear the same of a stream that loses packets; one of them is told again and again from which tick on
//! it will be asked. Of every tick from there on both believe the same, to the bit, and bound it alike.

use bytes::Bytes;
use glam::Vec3;
use proptest::prelude::*;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::Cadence;
use rhumb_protocol::stream::{
    Activity, Features, Manner, Observation, Publisher, StreamTerms, Subscriber, Witness,
};
use rhumb_reckoning::{
    Anchor, BodyId, Integrator, Metres, Predictor, Rate, Tick, Tolerance, Track, Verbatim,
};

const BODIES: u32 = 10;
/// From this one on bodies go along with the first, as if it held them.
const GATHERED: u32 = 5;

/// Where a body is at a tick: it hops, the last ones as the first one does.
fn motion(body: u32, tick: u64) -> Verbatim {
    let hops = if body < GATHERED { body } else { 0 };
    let phase = ((tick + u64::from(hops) * 3) % 7) as f32 / 7.0;
    let height = 2.0 * phase * (1.0 - phase);
    Verbatim::new(
        [body as f32, height, tick as f32 * 0.02],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 1.2],
        [0.0; 3],
    )
    .expect("a hop is finite")
}

fn ends() -> (Publisher, Subscriber) {
    let tolerance = Tolerance::from_metres(Metres::new(0.02)).expect("two centimetres");
    let integrator = Integrator {
        rate: Rate::HZ_60,
        substeps: std::num::NonZeroU32::MIN,
    };
    let (stream, gravity) = (StreamId(3), Vec3::new(0.0, -9.8, 0.0));
    let every = Cadence::EACH_TICK.every;
    let terms = StreamTerms {
        tolerance,
        integrator,
        every,
        gravity,
        features: Features::ALL,
    };
    let mut publisher = Publisher::new(stream, &terms, Tick::ZERO);
    let mut subscriber = Subscriber::new(&terms.start(stream, Tick::ZERO));
    for body in 0..BODIES {
        let manner = Manner::plain(Metres::new(if body == 0 { 4.0 } else { 0.5 }));
        let track = Track {
            origin: Tick::ZERO,
            predictor: Predictor::Ballistic,
            anchor: Anchor::Verbatim(motion(body, 0)),
            carrier: None,
        };
        assert!(publisher.place(BodyId::new(body, 0), &manner, track));
        assert!(subscriber.place(BodyId::new(body, 0), &manner, track));
    }
    subscriber.handle_snapshot_end();
    (publisher, subscriber)
}

/// Has a witness see all bodies at a tick.
fn see(witness: &mut Witness, tick: u64) -> &Witness {
    let seen = |body| Observation {
        id: BodyId::new(body, 0),
        motion: motion(body, tick),
        activity: Activity::Awake,
    };
    let seen: Vec<_> = (0..BODIES).map(seen).collect();
    witness.observe(Tick::new(tick), &seen);
    witness
}

/// What becomes of a tick's packets, and how far back it is looked from now on.
#[derive(Clone, Copy, Debug)]
struct Turn {
    lost: bool,
    repaired: bool,
    back: u64,
}

fn turn() -> impl Strategy<Value = Turn> {
    let part = (prop::bool::weighted(0.2), prop::bool::weighted(0.3));
    (part, 0_u64..12).prop_map(|((lost, repaired), back)| Turn {
        lost,
        repaired,
        back,
    })
}

proptest! {
    #[test]
    fn what_is_forgotten_is_never_asked_for(turns in proptest::collection::vec(turn(), 1..120)) {
        let (mut publisher, mut mindful) = ends();
        let mut forgetful = mindful.clone();
        let mut witness = Witness::new(Cadence::EACH_TICK);
        let mut from = 0;
        for (tick, turn) in (1..).zip(&turns) {
            let mut said: Vec<Bytes> = Vec::new();
            publisher.publish(see(&mut witness, tick), 0, &mut said);
            if turn.lost {
                said.clear();
            }
            if turn.repaired {
                let missing: Vec<u64> = mindful.missing_packets().collect();
                let repairs = missing.iter().filter_map(|number| publisher.repair(*number, 0));
                said.extend(repairs.flatten());
            }
            for datagram in &said {
                mindful.handle_datagram(datagram);
                forgetful.handle_datagram(datagram);
            }
            from = from.max(tick.saturating_sub(turn.back));
            forgetful.forget_before(Tick::new(from));
            prop_assert_eq!(mindful.statistics(), forgetful.statistics());
            for (body, at) in (0..BODIES).flat_map(|body| (from..=tick + 1).map(move |at| (body, at))) {
                let (id, at) = (BodyId::new(body, 0), Tick::new(at));
                prop_assert_eq!(mindful.believed(id, at), forgetful.believed(id, at));
                prop_assert_eq!(mindful.bound_at(id, at), forgetful.bound_at(id, at));
            }
        }
    }
}

#[test]
fn the_gathered_are_held() {
    let (mut publisher, _) = ends();
    let mut witness = Witness::new(Cadence::EACH_TICK);
    for tick in 1..40 {
        publisher.publish(see(&mut witness, tick), 0, &mut Vec::new());
    }
    let held = publisher
        .tracks()
        .filter(|(_, track)| track.carrier.is_some());
    assert!(held.count() > 0);
}
