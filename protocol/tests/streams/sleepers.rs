//! Sleeping bodies cost a publisher nothing, however many there are.

use core::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    ObservationHistory, PredictionParameters, Publisher, PublisherStatistics, StreamConfig,
};
use rhumb_reckoning::{BodyId, BodyState, Integrator, Metres, Rate, Tick, Track};

use crate::terms::{TERMS, awake};

/// The number of awake bodies, from index zero on.
const AWAKE: u32 = 10;
const TICKS: u64 = 300;

fn lying(index: u32, height: f32) -> BodyState {
    BodyState::new(
        [index as f32, height, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [0.0; 3],
        [0.0; 3],
    )
    .expect("these numbers are finite")
}

fn publisher(bodies: u32) -> Publisher {
    let config = StreamConfig {
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).expect("four is not zero"),
        },
        gravity: Vec3::NEG_Y,
        ..TERMS
    };
    let parameters = PredictionParameters::plain(Metres::new(0.5));
    let mut publisher = Publisher::new(StreamId(0), &config, Tick::ZERO);
    for index in 0..bodies {
        let track = Track::resting(Tick::ZERO, lying(index, 0.0));
        assert!(publisher.place(BodyId::new(index, 0), &parameters, track));
    }
    publisher
}

/// Runs a scene of which some bodies are awake and jolt now and then. Returns the publisher's counters and datagrams.
fn run(bodies: u32, moving: u32) -> (PublisherStatistics, Vec<Bytes>) {
    let mut publisher = publisher(bodies);
    let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    let mut out = Vec::new();
    for tick in 1..=TICKS {
        let observations = awake(moving, |index| lying(index, (tick / 7 % 5) as f32));
        observation_history.observe(Tick::new(tick), &observations);
        publisher.publish(&observation_history, 0, &mut out);
    }
    (publisher.statistics(), out)
}

#[test]
fn ten_thousand_sleeping_bodies_are_not_scanned() {
    let (statistics, datagrams) = run(10_000, 0);
    assert_eq!(statistics, PublisherStatistics::default());
    assert!(datagrams.is_empty());
}

#[test]
fn sleeping_bodies_cost_neither_work_nor_bytes() {
    let (few, said_of_few) = run(AWAKE, AWAKE);
    let (many, said_of_many) = run(10_000, AWAKE);
    assert_eq!(few.checked, u64::from(AWAKE) * TICKS);
    assert!(few.updates > u64::from(AWAKE));
    assert_eq!(few, many);
    assert_eq!(said_of_few, said_of_many);
}
