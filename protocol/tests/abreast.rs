//! What a packet corrects is taken in side by side as it is one by one
//!
//! One listener hears them in one packet, the other each in a packet of its own. What a packet says twice of a body, as no
//! publisher does, is heard once: the first of it.

use glam::Vec3;
use proptest::prelude::*;
use rhumb_protocol::packet::{Age, Course, Saying, StateWriter, StreamId, Update};
use rhumb_protocol::scene::Cadence;
use rhumb_protocol::stream::{Manner, StreamStart, Subscriber};
use rhumb_reckoning::{
    Anchor, BodyId, Integrator, Metres, Predictor, Rate, Residual, Tick, Tolerance, Track, Verbatim,
};

const BODIES: u32 = 9;
const STREAM: StreamId = StreamId(1);
const HEARD: Tick = Tick::new(30);

/// A body in flight, or one that lies still.
fn track(index: u32) -> Track {
    let rests = index.is_multiple_of(4);
    let place = index as f32;
    let said = Verbatim::new(
        [place, 1.0, -place],
        [0.6, 0.0, 0.0, 0.8],
        [place, 0.5, 0.0],
        [0.1, place, 2.0],
    );
    let said = said.expect("these numbers are finite");
    Track {
        origin: Tick::new(u64::from(index)),
        predictor: if rests {
            Predictor::Rest
        } else {
            Predictor::Ballistic
        },
        anchor: Anchor::Verbatim(if rests { said.stilled() } else { said }),
        carrier: None,
    }
}

fn listener() -> Subscriber {
    let mut subscriber = Subscriber::new(&StreamStart {
        stream: STREAM,
        tolerance: Tolerance::NORMAL,
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: std::num::NonZeroU32::MIN,
        },
        every: Cadence::EACH_TICK.every,
        gravity: Vec3::new(0.0, -9.8, 0.0),
        tick: Tick::ZERO,
        next: 0,
        notices: 0,
    });
    for index in 0..BODIES {
        let manner = Manner::plain(Metres::new(0.5));
        assert!(subscriber.place(BodyId::new(index, 0), &manner, track(index)));
    }
    subscriber.handle_snapshot_end();
    subscriber
}

/// A correction of a body; now and then of another revision than it has.
fn correction() -> impl Strategy<Value = (u32, Saying)> {
    let steps = || proptest::array::uniform3(-40..40);
    let course = prop_oneof![
        Just(Course::Same),
        Just(Course::World {
            predictor: Predictor::Uniform,
            carrier_age: None
        }),
    ];
    let of = prop_oneof![9 => Just(0), 1 => Just(1)];
    (0..BODIES, course, steps(), steps(), of).prop_map(|(body, course, position, turn, off)| {
        let residual = Residual {
            position,
            turn,
            velocity: None,
        };
        let age = Age::new(30 - body + off);
        let saying = Saying::Residual {
            course,
            age,
            residual,
        };
        (body, saying)
    })
}

fn packet(number: u64, updates: &[(u32, (u32, Saying))]) -> Vec<u8> {
    let mut writer = StateWriter::new(STREAM, number, HEARD.value(), 0);
    for (seat, (body, saying)) in updates {
        assert!(writer.push(&Update {
            seat: *seat,
            body: Some(*body),
            saying: *saying,
        }));
    }
    writer.finish(true)
}

proptest! {
    #[test]
    fn what_a_packet_brings_is_heard_as_one_by_one(corrections in proptest::collection::vec(correction(), 1..24)) {
        let (mut together, mut one_by_one) = (listener(), listener());
        let seated: Vec<_> = (0..).zip(corrections).collect();
        together.handle_datagram(&packet(0, &seated));
        for (number, update) in (0..).zip(&seated) {
            one_by_one.handle_datagram(&packet(number, &[*update]));
        }
        prop_assert_eq!(together.agreement(), one_by_one.agreement());
        for index in 0..BODIES {
            let id = BodyId::new(index, 0);
            prop_assert_eq!(together.track(id), one_by_one.track(id));
            prop_assert_eq!(together.believed(id, Tick::new(12)), one_by_one.believed(id, Tick::new(12)));
            let spoken = seated.iter().any(|(_, (body, saying))| {
                let fits = matches!(saying, Saying::Residual { age, .. } if *age == Age::new(30 - index));
                *body == index && fits
            });
            prop_assert_eq!(together.track(id).map(|track| track.origin == HEARD), Some(spoken));
        }
        prop_assert_eq!(together.statistics().updates, one_by_one.statistics().updates);
        prop_assert_eq!(together.statistics().unread, one_by_one.statistics().unread);
    }
}
