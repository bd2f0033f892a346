//! Corrections applied four at a time equal corrections applied singly.
//!
//! One subscriber receives the updates in one packet, the other in a packet each. If a packet has two updates of a
//! body, which no publisher sends, only the first counts.

use glam::Vec3;
use proptest::prelude::*;
use rhumb_protocol::packet::{
    Age, LargestPacket, PredictionMode, StreamId, Update, UpdatePayload, UpdateWriter,
};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{PredictionParameters, StreamStart, Subscriber};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Integrator, Metres, Predictor, Rate, Residual, Tick, Tolerance,
    Track,
};

const BODIES: u32 = 9;
const STREAM: StreamId = StreamId(1);
const RECEIVED: Tick = Tick::new(30);

/// The track of a body in flight, or of one at rest.
fn track(index: u32) -> Track {
    let rests = index.is_multiple_of(4);
    let place = index as f32;
    let state = BodyState::new(
        [place, 1.0, -place],
        [0.6, 0.0, 0.0, 0.8],
        [place, 0.5, 0.0],
        [0.1, place, 2.0],
    );
    let state = state.expect("these numbers are finite");
    Track {
        origin: Tick::new(u64::from(index)),
        predictor: if rests {
            Predictor::Rest
        } else {
            Predictor::Ballistic
        },
        anchor: Anchor::Exact(if rests { state.stilled() } else { state }),
        parent: None,
    }
}

fn subscriber() -> Subscriber {
    let mut subscriber = Subscriber::new(&StreamStart {
        stream: STREAM,
        tolerance: Tolerance::NORMAL,
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: std::num::NonZeroU32::MIN,
        },
        publish_interval: PublishSchedule::EACH_TICK.publish_interval,
        largest_packet: LargestPacket::DEFAULT,
        gravity: Vec3::new(0.0, -9.8, 0.0),
        tick: Tick::ZERO,
        next: 0,
        scene_events: 0,
    });
    for index in 0..BODIES {
        let parameters = PredictionParameters::plain(Metres::new(0.5));
        assert!(subscriber.place(BodyId::new(index, 0), &parameters, track(index)));
    }
    subscriber.handle_snapshot_end();
    subscriber
}

/// A correction of a body, sometimes of a revision that the body does not have.
fn correction() -> impl Strategy<Value = (u32, UpdatePayload)> {
    let steps = || proptest::array::uniform3(-40..40);
    let mode = prop_oneof![
        Just(PredictionMode::Same),
        Just(PredictionMode::World {
            predictor: Predictor::Uniform,
            parent_age: None
        }),
    ];
    let of = prop_oneof![9 => Just(0), 1 => Just(1)];
    (0..BODIES, mode, steps(), steps(), of).prop_map(|(body, mode, position, turn, off)| {
        let residual = Residual {
            position,
            turn,
            velocity: None,
        };
        let age = Age::new(30 - body + off);
        let payload = UpdatePayload::Residual {
            mode,
            age,
            residual,
        };
        (body, payload)
    })
}

fn packet(number: u64, updates: &[(u32, (u32, UpdatePayload))]) -> Vec<u8> {
    let mut writer = UpdateWriter::new(STREAM, number, RECEIVED.value(), 0);
    for (alias, (body, payload)) in updates {
        assert!(writer.push(&Update {
            alias: *alias,
            body: Some(*body),
            payload: *payload,
        }));
    }
    writer.finish(true)
}

proptest! {
    #[test]
    fn packet_updates_equal_sequential_updates(corrections in proptest::collection::vec(correction(), 1..24)) {
        let (mut together, mut one_by_one) = (subscriber(), subscriber());
        let aliased: Vec<_> = (0..).zip(corrections).collect();
        together.handle_datagram(&packet(0, &aliased));
        for (number, update) in (0..).zip(&aliased) {
            one_by_one.handle_datagram(&packet(number, &[*update]));
        }
        prop_assert_eq!(together.state_checksum(), one_by_one.state_checksum());
        for index in 0..BODIES {
            let id = BodyId::new(index, 0);
            prop_assert_eq!(together.track(id), one_by_one.track(id));
            prop_assert_eq!(together.predicted_motion(id, Tick::new(12)), one_by_one.predicted_motion(id, Tick::new(12)));
            let is_updated = aliased.iter().any(|(_, (body, payload))| {
                let fits = matches!(payload, UpdatePayload::Residual { age, .. } if *age == Age::new(30 - index));
                *body == index && fits
            });
            prop_assert_eq!(together.track(id).map(|track| track.origin == RECEIVED), Some(is_updated));
        }
        prop_assert_eq!(together.statistics().updates, one_by_one.statistics().updates);
        prop_assert_eq!(together.statistics().unread, one_by_one.statistics().unread);
    }
}
