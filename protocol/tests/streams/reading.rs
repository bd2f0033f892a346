//! Reading of packets, refreshes and repair symbols, one datagram at a time.
//!
//! Each test writes the datagrams of a stream by hand, in an order that a link may produce.

use crate::terms::TERMS;
use rhumb_protocol::packet::{
    Age, Keyframe, LargestPacket, PredictionMode, RefreshRecord, RefreshWriter, RepairSymbol,
    StreamId, Update, UpdatePayload, UpdateWriter,
};
use rhumb_protocol::stream::{PredictionParameters, StreamConfig, Subscriber};
use rhumb_reckoning::{Anchor, BodyId, BodyState, Metres, Predictor, Residual, Tick, Ticks, Track};
use std::num::NonZeroU32;

const STREAM: StreamId = StreamId(3);
/// The tick of the snapshot.
const START: u64 = 10;
const BODIES: u32 = 3;

fn id(index: u32) -> BodyId {
    BodyId::new(index, 0)
}

fn state(x: f32, speed: f32) -> BodyState {
    BodyState::new(
        [x, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [speed, 0.0, 0.0],
        [0.0; 3],
    )
    .expect("a finite state")
}

/// A body that moves uniformly.
fn moving(x: f32) -> Keyframe {
    Keyframe {
        predictor: Predictor::Uniform,
        anchor: Anchor::Exact(state(x, 1.0)),
        parent: None,
    }
}

/// A subscriber of a stream of moving bodies, with the snapshot complete.
fn subscriber() -> Subscriber {
    subscriber_within(LargestPacket::DEFAULT)
}

fn subscriber_within(largest_packet: LargestPacket) -> Subscriber {
    let config = StreamConfig {
        largest_packet,
        ..TERMS
    };
    let mut subscriber = Subscriber::new(&config.start(STREAM, Tick::new(START)));
    let parameters = PredictionParameters::plain(Metres::new(0.5));
    for index in 0..BODIES {
        let track = moving(index as f32).track(Tick::new(START - 5));
        assert!(subscriber.place(id(index), &parameters, track));
    }
    subscriber.handle_snapshot_end();
    subscriber
}

/// The last packet of a tick.
fn packet(number: u64, tick: u64, scene_events: u64, updates: &[Update]) -> Vec<u8> {
    let mut writer = UpdateWriter::new(STREAM, number, tick, scene_events);
    for update in updates {
        assert!(writer.push(update), "the updates fit a packet");
    }
    writer.finish(true)
}

/// An update with a keyframe; it assigns the alias to the body.
fn keyframe(index: u32, x: f32) -> Update {
    Update {
        alias: index,
        body: Some(index),
        payload: UpdatePayload::Keyframe(moving(x)),
    }
}

/// A correction of the track of this origin, by alias.
fn correction(alias: u32, mode: PredictionMode, origin: u64, tick: u64) -> Update {
    let age = Age::of(Tick::new(origin), Tick::new(tick), NonZeroU32::MIN);
    Update {
        alias,
        body: None,
        payload: UpdatePayload::Residual {
            mode,
            age: age.expect("the origin is not after the tick"),
            residual: Residual {
                position: [3, 0, -2],
                turn: [0; 3],
                velocity: None,
            },
        },
    }
}

fn record(index: u32, age: u32, x: f32) -> RefreshRecord {
    RefreshRecord {
        index,
        alias: Some(index),
        age: Ticks::new(age),
        keyframe: moving(x),
    }
}

/// The parts of a refresh.
fn refresh(lost: u64, tick: u64, scene_events: u64, records: &[RefreshRecord]) -> Vec<Vec<u8>> {
    let mut writer = RefreshWriter::within(LargestPacket::DEFAULT);
    records.iter().for_each(|record| writer.push(record));
    writer.finish(STREAM, lost, tick, scene_events)
}

fn tracks(subscriber: &Subscriber) -> Vec<Option<Track>> {
    (0..BODIES)
        .map(|index| subscriber.track(id(index)))
        .collect()
}

/// PROTOCOL 5.8-6: a packet of one byte more than the stream states is refused, one of that size is read.
#[test]
fn a_packet_larger_than_the_stream_states_is_refused() {
    let sized = |bytes: usize| {
        // Bodies that are not in the scene fill the packet up.
        (0..200).find_map(|count| {
            let updates: Vec<_> = (0..count).map(|index| keyframe(index, 5.0)).collect();
            Some(packet(0, 11, 0, &updates)).filter(|packet| packet.len() >= bytes)
        })
    };
    let datagram = sized(800).expect("a packet holds as many updates");
    let of = |bytes: usize| LargestPacket::new(bytes as u32).expect("within the limits");
    let mut subscriber = subscriber_within(of(datagram.len() - 1));
    let before = tracks(&subscriber);
    subscriber.handle_datagram(&datagram);
    assert_eq!(tracks(&subscriber), before);
    assert_eq!(subscriber.statistics().malformed, 1);
    assert!(subscriber.is_converged(), "its number was not read");
    let mut subscriber = subscriber_within(of(datagram.len()));
    subscriber.handle_datagram(&datagram);
    assert_ne!(tracks(&subscriber), before);
    assert_eq!(subscriber.statistics().malformed, 0);
}

/// PROTOCOL 5.11-1, 6.5-1: the first record is well formed, the second has an origin before tick 0.
#[test]
fn a_refresh_with_a_negative_origin_changes_nothing() {
    let mut subscriber = subscriber();
    subscriber.handle_datagram(&packet(1, 12, 0, &[keyframe(0, 5.0)]));
    let (before, statistics) = (tracks(&subscriber), subscriber.statistics());
    let records = [record(1, 0, 7.0), record(2, 13, 8.0)];
    for part in refresh(0, 12, 0, &records) {
        subscriber.handle_datagram(&part);
    }
    assert_eq!(tracks(&subscriber), before);
    assert_eq!(subscriber.missing(), 1);
    let after = subscriber.statistics();
    assert_eq!(
        (after.malformed, after.refreshes),
        (statistics.malformed + 1, statistics.refreshes)
    );
    // The alias of the first record is not assigned either: an update by that alias finds no body.
    let by_alias = correction(1, PredictionMode::Same, START - 5, 13);
    subscriber.handle_datagram(&packet(2, 13, 0, &[by_alias]));
    assert_eq!(tracks(&subscriber), before);
    assert_eq!(subscriber.missing_packets().collect::<Vec<_>>(), [0, 2]);
}

/// PROTOCOL 6.5-2, 6.6-11: a packet that was rebuilt before its scene event was received waits for it, also if an
/// earlier packet arrives late in between.
#[test]
fn a_rebuilt_packet_waits_for_its_scene_events() {
    let mut subscriber = subscriber();
    let late = packet(0, 11, 0, &[keyframe(0, 4.0)]);
    let rebuilt = packet(1, 12, 1, &[keyframe(1, 5.0)]);
    let last = packet(2, 13, 0, &[keyframe(2, 6.0)]);
    subscriber.handle_datagram(&last);
    let symbol = RepairSymbol::of(4, &[(1, &rebuilt), (2, &last)]).expect("both can be covered");
    subscriber.handle_datagram(&symbol.encode(STREAM));
    subscriber.handle_datagram(&late);
    let origin = |subscriber: &Subscriber, index| subscriber.track(id(index)).map(|at| at.origin);
    assert_eq!(origin(&subscriber, 0), Some(Tick::new(11)));
    assert_eq!(
        origin(&subscriber, 1),
        Some(Tick::new(START - 5)),
        "its scene event is not here"
    );
    assert_eq!(subscriber.missing_packets().collect::<Vec<_>>(), [1]);
    subscriber.apply_scene_event();
    assert_eq!(origin(&subscriber, 1), Some(Tick::new(12)));
    assert!(subscriber.is_converged());
    let statistics = subscriber.statistics();
    assert_eq!((statistics.duplicates, statistics.malformed), (0, 0));
}

/// PROTOCOL 6.2-2: an update that attaches a body to one that the scene no longer has is ignored.
#[test]
fn an_attachment_to_a_removed_parent_is_ignored() {
    let mut subscriber = subscriber();
    subscriber.handle_datagram(&packet(0, 11, 0, &[keyframe(0, 4.0), keyframe(1, 5.0)]));
    assert!(subscriber.remove(id(1)));
    subscriber.apply_scene_event();
    let attached = PredictionMode::Attached {
        parent: 1,
        parent_age: Age::new(1),
    };
    let before = tracks(&subscriber);
    let updates = [correction(0, attached, 11, 12), keyframe(2, 6.0)];
    subscriber.handle_datagram(&packet(1, 12, 1, &updates));
    assert_eq!(tracks(&subscriber)[..2], before[..2]);
    assert_eq!(
        subscriber.track(id(2)).map(|track| track.origin),
        Some(Tick::new(12))
    );
    assert!(subscriber.is_converged(), "the packet is not missing");
}

/// PROTOCOL 6.7-7: the record's track is as new as the present one, which stays; the body's past is unknown.
#[test]
fn a_refresh_record_of_equal_origin_keeps_the_track() {
    let mut subscriber = subscriber();
    subscriber.handle_datagram(&packet(1, 12, 0, &[keyframe(0, 5.0)]));
    let before = tracks(&subscriber);
    let earlier = Tick::new(11);
    assert_ne!(
        subscriber.predicted_motion(id(0), earlier),
        before[0].and_then(|track| subscriber_motion(track, earlier)),
        "the previous track shows the body before tick 12"
    );
    for part in refresh(0, 13, 0, &[record(0, 1, 99.0)]) {
        subscriber.handle_datagram(&part);
    }
    assert_eq!(tracks(&subscriber), before, "equal origin");
    assert_eq!(
        subscriber.predicted_motion(id(0), earlier),
        before[0].and_then(|track| subscriber_motion(track, earlier)),
        "the previous track is forgotten"
    );
    assert!(subscriber.is_converged());
    subscriber.handle_datagram(&packet(2, 14, 0, &[keyframe(1, 6.0)]));
    assert_eq!(subscriber.complete(), Tick::new(14));
    for part in refresh(2, 15, 0, &[record(0, 3, 99.0)]) {
        subscriber.handle_datagram(&part);
    }
    assert_eq!(tracks(&subscriber)[0], before[0]);
}

/// The motion of a track in a subscriber that never had another one.
fn subscriber_motion(track: Track, tick: Tick) -> Option<rhumb_reckoning::Motion> {
    let mut other = subscriber();
    let parameters = PredictionParameters::plain(Metres::new(0.5));
    assert!(other.place(id(0), &parameters, track));
    other.predicted_motion(id(0), tick)
}

/// PROTOCOL 6.7-8: parts of an older refresh add nothing to a newer one, whichever of the three parts of its name is
/// smaller.
#[test]
fn parts_of_a_stale_refresh_do_not_count() {
    let of = |tick, scene_events, count| {
        let records: Vec<_> = (0..count).map(|index| record(index, 1, 1.0)).collect();
        refresh(0, tick, scene_events, &records)
    };
    let newest = of(14, 1, 60);
    for stale in [of(13, 1, 60), of(14, 0, 60)] {
        let mut subscriber = subscriber();
        subscriber.apply_scene_event();
        subscriber.handle_datagram(&packet(1, 12, 0, &[keyframe(0, 5.0)]));
        assert_eq!(stale.len(), newest.len());
        assert!(newest.len() > 1, "several parts");
        subscriber.handle_datagram(&newest[0]);
        for part in &stale[1..] {
            subscriber.handle_datagram(part);
        }
        assert_eq!(subscriber.missing(), 1, "the names differ");
        // All parts of the stale refresh change nothing either, because a newer one has begun.
        for part in &stale {
            subscriber.handle_datagram(part);
        }
        assert_eq!(subscriber.missing(), 1, "a smaller name no longer counts");
        for part in &newest[1..] {
            subscriber.handle_datagram(part);
        }
        assert!(subscriber.is_converged());
    }
    let fewer_parts = of(14, 1, 60);
    let more_parts = of(14, 1, 100);
    assert!(more_parts.len() > fewer_parts.len());
    let mut subscriber = subscriber();
    subscriber.apply_scene_event();
    subscriber.handle_datagram(&packet(1, 12, 0, &[keyframe(0, 5.0)]));
    subscriber.handle_datagram(&more_parts[0]);
    for part in &fewer_parts {
        subscriber.handle_datagram(part);
    }
    assert_eq!(subscriber.missing(), 1, "fewer parts are a smaller name");
    for part in &more_parts[1..] {
        subscriber.handle_datagram(part);
    }
    assert!(subscriber.is_converged());
}
