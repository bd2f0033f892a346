//! Fuzzes the codec of DIS, and the entities made of datagrams.
//!
//! Promises: what is read is written again bit for bit; an error is in words; entities stay within their number, and
//! their poses are finite or theirs to refuse; whatever arrives, later sound states are taken in.

use std::time::Duration;

use rhumb_dis::foreign::{ForeignConfig, ForeignEntities};
use rhumb_dis::geodesy::{Geodetic, SceneAxes, TangentFrame};
use rhumb_dis::glam::{DQuat, DVec3};
use rhumb_dis::pdu::{Bundle, Pdu, TimeBase};
use rhumb_dis::published::{Kind, Observed, Publisher, PublisherConfig};

/// Most entities of the target.
const ENTITIES: usize = 3;

/// The first byte chooses: a datagram; or datagrams of a script, each behind its length and the time that passes.
pub fn dis_datagrams(data: &[u8]) {
    let Some((form, bytes)) = data.split_first() else {
        return;
    };
    if form % 2 == 0 {
        datagram(bytes);
    } else {
        script(bytes);
    }
}

fn datagram(bytes: &[u8]) {
    let mut end = 0;
    for read in Bundle::new(bytes) {
        match read {
            Ok((frame, pdu)) => {
                let mut written = vec![0; frame.len()];
                assert_eq!(pdu.encode(&mut written), Ok(frame.len()));
                assert_eq!(written, frame, "a pdu has one encoding");
                assert_eq!(Pdu::decode(frame).map(|pdu| pdu.header), Ok(pdu.header));
                end += frame.len();
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
    assert!(end <= bytes.len(), "no byte is read twice");
}

fn script(mut bytes: &[u8]) {
    let place = Geodetic::from_degrees(48.0, 11.0, 500.0).expect("in range");
    let mut entities = ForeignEntities::new(ForeignConfig {
        exercise: 1,
        site: 2,
        application: 3,
        frame: TangentFrame::new(place, SceneAxes::YUp),
        axes: SceneAxes::YUp,
        timeout: ForeignConfig::TIMEOUT,
        reach: 1_000.0,
        entities_max: ENTITIES,
        pdus_per_second: 1_000,
    });
    let mut now = Duration::from_secs(3_590);
    let mut read = 0;
    while let Some((&[length, pause], rest)) = bytes.split_first_chunk() {
        let (datagram, rest) = rest.split_at(rest.len().min(usize::from(length)));
        bytes = rest;
        now += Duration::from_millis(100 * u64::from(pause));
        read += Bundle::new(datagram).count() as u64;
        // A refusal is of the sender's bytes.
        if let Err(error) = entities.handle_datagram(now, datagram) {
            assert!(!error.to_string().is_empty());
        }
        entities.handle_timeout(now);
        assert!(entities.poses(now).count() <= ENTITIES);
        while entities.poll_event().is_some() {}
    }
    let counts = entities.statistics();
    let handled = [
        counts.used,
        counts.ignored,
        counts.malformed,
        counts.stale,
        counts.too_many,
        counts.no_place,
    ];
    let handled: u64 = handled.into_iter().sum();
    assert_eq!(handled, read, "every pdu is counted once: {counts:?}");
    now += 2 * ForeignConfig::TIMEOUT;
    entities.handle_timeout(now);
    assert_eq!(entities.poses(now).count(), 0, "the silent are gone");
    assert_eq!(entities.handle_datagram(now, &sound_state(now)), Ok(()));
    assert_eq!(entities.poses(now).count(), 1, "a sound state is taken in");
}

/// The state of a body by another gateway, at a moment.
fn sound_state(now: Duration) -> Vec<u8> {
    let place = Geodetic::from_degrees(48.0, 11.0, 500.0).expect("in range");
    let mut other = Publisher::new(PublisherConfig {
        exercise: 1,
        site: 9,
        application: 9,
        frame: TangentFrame::new(place, SceneAxes::YUp),
        axes: SceneAxes::YUp,
        base: TimeBase::Absolute,
        datagram_bytes: 1_400,
        states_per_second: 1,
    });
    other.handle_bodies(
        now,
        &[Observed {
            key: 1,
            kind: Kind::default(),
            position: DVec3::ZERO,
            rotation: DQuat::IDENTITY,
            velocity: DVec3::X,
            acceleration: DVec3::ZERO,
            spin: DVec3::ZERO,
        }],
    );
    let mut datagram = [0; 1_400];
    let bytes = other.poll_datagram(&mut datagram).expect("a state");
    datagram[..bytes].to_vec()
}
