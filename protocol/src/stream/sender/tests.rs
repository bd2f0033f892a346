//! The sender of a stream: watermarks, checksums, refreshes, resting bodies.

use core::num::NonZeroU32;

use rhumb_reckoning::{Metres, Rate};

use super::*;
use crate::endpoint::Span;
use crate::packet::Low16;
use crate::scene::PublishSchedule;
use crate::stream::observation_history::{Activity, Observation};

const BODIES: u32 = 10;

/// A different position for each tick.
fn motion(body: u32, tick: u64) -> BodyState {
    let at = [(body * 10) as f32, (tick * tick % 17) as f32, 0.0];
    BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("it is finite")
}

fn sender(policy: WatermarkPolicy) -> StreamSender {
    let (stream, config) = (StreamId(1), StreamConfig::PLAIN);
    let mut sender = StreamSender::reckoned(stream, &config, None, policy, Tick::ZERO);
    for body in 0..BODIES {
        let parameters = PredictionParameters::plain(Metres::new(0.5));
        let track = Track::resting(Tick::ZERO, motion(body, 0));
        assert!(sender.place(BodyId::new(body, 0), &parameters, track, motion(body, 0)));
    }
    sender
}

/// Publishes a tick with the positions of tick `at` and returns the kinds of the datagrams for every receiver.
fn publish(sender: &mut StreamSender, tick: u64, at: u64) -> Vec<PacketKind> {
    let observation = |body| Observation {
        id: BodyId::new(body, 0),
        motion: motion(body, at),
        activity: Activity::Awake,
    };
    let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    observation_history.observe(
        Tick::new(tick),
        &(0..BODIES).map(observation).collect::<Vec<_>>(),
    );
    assert!(sender.publish(&observation_history, 0));
    let kind = |datagram: &Bytes| Datagram::open(datagram).map(|datagram| datagram.head().kind);
    let kinds = sender.datagrams(0).map(kind);
    kinds
        .collect::<Result<_, _>>()
        .expect("a sender sends datagrams")
}

/// The answer to a receiver that lost the newest packet.
fn answer(sender: &mut StreamSender, id: u64) -> Vec<Bytes> {
    let next = sender.next_number();
    let report = LossReport {
        next: Low16::of(next),
        abandoned: Low16::of(1),
        repair_symbols: 0,
        lost: alloc::vec![Low16::of(next - 1)],
    };
    let round_trip = Span::ZERO;
    let mut answers = Vec::new();
    sender.handle_report(
        Instant::ZERO,
        Recipient { id, round_trip },
        &report,
        0,
        &mut answers,
    );
    answers
}

#[test]
fn a_silent_stream_states_its_watermark_by_the_schedule() {
    let every = NonZeroU32::MIN;
    let free = WatermarkPolicy::free_running(Rate::HZ_60, every);
    for (policy, expected) in [
        (WatermarkPolicy::LOCKSTEP, &[1, 2, 3, 4, 5, 6, 7, 8, 9][..]),
        (free, &[1, 2, 4, 8]),
        (WatermarkPolicy::upstream(Rate::HZ_60), &[4, 8]),
    ] {
        let mut sender = sender(policy);
        assert_eq!(publish(&mut sender, 1, 1), [PacketKind::UpdatesEnd]);
        let silent = (2..=10).filter(|tick| {
            let kinds = publish(&mut sender, *tick, 1);
            assert!(kinds.is_empty() || kinds == [PacketKind::Watermark]);
            !kinds.is_empty()
        });
        assert!(silent.map(|tick| tick - 1).eq(expected.iter().copied()));
    }
}

#[test]
fn a_checksum_that_changed_is_sent_once_a_second() {
    let mut sender = sender(WatermarkPolicy::LOCKSTEP);
    let is_sent = |tick: &u64| publish(&mut sender, *tick, *tick).contains(&PacketKind::Checksums);
    assert!((1..=200).filter(is_sent).eq([60, 120, 180]));
    let is_sent = |tick: &u64| publish(&mut sender, *tick, 200).contains(&PacketKind::Checksums);
    assert!(
        (201..=400).filter(is_sent).eq([240]),
        "an unchanged checksum is not sent again"
    );
}

#[test]
fn a_refresh_is_encoded_once_for_all_listeners_of_a_lost_packet() {
    let mut sender = sender(WatermarkPolicy::LOCKSTEP);
    publish(&mut sender, 1, 1);
    let [one, other] = [1, 2].map(|id| answer(&mut sender, id));
    assert!(one.len() > 1, "a refresh and then a watermark");
    for (one, other) in one[..one.len() - 1].iter().zip(&other) {
        assert_eq!(
            one.as_ptr(),
            other.as_ptr(),
            "the two receivers share the bytes"
        );
    }
}

const STILL: u32 = 0;
const FALLING: u32 = 1;
const GLIDING: u32 = 2;
const FIXED: u32 = 3;

fn along_x(speed: f32) -> BodyState {
    BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [speed, 0.0, 0.0], [0.0; 3]).expect("a state")
}

/// Records of each of three ticks: a body falls, one has come to rest in the first, and one with a velocity was observed
/// then only.
fn records(resting: RestingBodies) -> [u64; 3] {
    let mut publisher =
        FullPublisher::new(StreamId(1), LargestPacket::DEFAULT, resting, Tick::ZERO);
    let id = |index| BodyId::new(index, 0);
    for index in [STILL, FALLING, GLIDING, FIXED] {
        publisher.place(id(index), Tick::ZERO, along_x(0.0), index == FIXED);
    }
    let mut history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    let mut before = 0;
    [1, 2, 3].map(|tick| {
        let speeds = [(STILL, 0.0), (FALLING, 1.0), (GLIDING, 1.0)];
        let observed = speeds
            .into_iter()
            .filter(|(body, _)| tick == 1 || *body == FALLING);
        let observations: Vec<_> = observed
            .map(|(body, speed)| Observation {
                id: id(body),
                motion: along_x(speed),
                activity: Activity::Awake,
            })
            .collect();
        history.observe(Tick::new(tick), &observations);
        publisher.publish(&history, 0, &mut Vec::new());
        let sent = publisher.statistics().updates;
        sent - core::mem::replace(&mut before, sent)
    })
}

#[test]
fn a_changed_stream_leaves_out_bodies_that_rest_and_a_full_one_does_not() {
    assert_eq!(records(RestingBodies::Sent), [3, 3, 3]);
    assert_eq!(records(RestingBodies::LeftOut), [3, 2, 2]);
}
