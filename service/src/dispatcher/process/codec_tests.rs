//! Messages of worker processes: round trips, shared payloads, damage.

use std::sync::Arc;

use bytes::Bytes;
use proptest::prelude::*;
use rhumb_protocol::message::Role;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Ending, LinkReport, Peer, Span, Transmit};
use rhumb_scene::{Permit, Quotas};

use super::super::message::{
    FromProcess, FromWorker, ToProcess, Vitals, WorkerId, WorkerInput, WorkerOutput,
};
use super::codec::{decode_from, decode_to, encode_from, encode_to};
use crate::directory::ServerPlace;
use crate::durable::{Generation, LogTail};
use crate::flight::FlightCause;
use crate::metrics::{SCENE_VALUES, SceneValues};

fn bytes() -> impl Strategy<Value = Bytes> {
    proptest::collection::vec(any::<u8>(), 0..300).prop_map(Bytes::from)
}

fn name() -> impl Strategy<Value = SceneName> {
    "[a-z/]{1,64}".prop_map(|name| name.parse().unwrap())
}

fn permit() -> impl Strategy<Value = Permit> {
    let client = proptest::option::of("[a-z]{1,20}".prop_map(|name| Arc::from(name.as_str())));
    let role = prop_oneof![
        Just(Role::Observer),
        Just(Role::Controller),
        Just(Role::Owner)
    ];
    let small = any::<[Option<u32>; 4]>();
    let quotas =
        (small, any::<Option<u64>>()).prop_map(|([bodies, commands, members, scenes], load)| {
            Quotas {
                bodies,
                commands,
                load,
                members,
                scenes,
            }
        });
    let permit = |(client, role, quotas, owns)| Permit {
        client,
        role,
        quotas,
        owns,
    };
    (client, role, quotas, any::<bool>()).prop_map(permit)
}

fn input() -> impl Strategy<Value = WorkerInput> {
    let peer = || any::<u64>().prop_map(Peer);
    let ending = prop_oneof![
        any::<u32>().prop_map(Ending::Closed),
        Just(Ending::TimedOut),
        Just(Ending::Broken)
    ];
    let link =
        any::<[u64; 4]>().prop_map(|[waiting_bytes, sent_bytes, over, round_trip]| LinkReport {
            waiting_bytes,
            sent_bytes,
            over: Span::from_nanos(over),
            round_trip: Span::from_nanos(round_trip),
        });
    let tail = prop_oneof![Just(LogTail::Kept), Just(LogTail::LeftOut)];
    prop_oneof![
        (peer(), permit()).prop_map(|(peer, permit)| WorkerInput::Opened(peer, Arc::new(permit))),
        (peer(), bytes()).prop_map(|(peer, bytes)| WorkerInput::Control(peer, bytes)),
        (peer(), any::<usize>()).prop_map(|(peer, bytes)| WorkerInput::ControlTaken(peer, bytes)),
        (peer(), bytes()).prop_map(|(peer, bytes)| WorkerInput::Datagram(peer, bytes)),
        (peer(), link).prop_map(|(peer, link)| WorkerInput::Link(peer, link)),
        (peer(), ending).prop_map(|(peer, ending)| WorkerInput::Ended(peer, ending)),
        (tail, any::<Option<u64>>())
            .prop_map(|(tail, generation)| WorkerInput::Restore(tail, generation.map(Generation))),
        Just(WorkerInput::Follow),
        "[ -~]{0,60}".prop_map(|place| WorkerInput::Move(ServerPlace(place))),
        Just(WorkerInput::Wake),
        Just(WorkerInput::End),
    ]
}

fn to_process() -> impl Strategy<Value = ToProcess> {
    prop_oneof![
        (any::<u32>(), name()).prop_map(|(id, name)| ToProcess::Begin(WorkerId(id), name)),
        any::<(u64, u64)>().prop_map(|(scenes, load)| ToProcess::Elsewhere { scenes, load }),
        (any::<u32>(), input()).prop_map(|(id, input)| ToProcess::Input(WorkerId(id), input)),
    ]
}

/// An output whose transmissions share some payloads.
fn output() -> impl Strategy<Value = WorkerOutput> {
    let payloads = proptest::collection::vec(bytes(), 1..4);
    let transmits = proptest::collection::vec(any::<(u8, u64, u8, u32)>(), 0..40);
    let handled = proptest::collection::vec(any::<(u64, usize)>(), 0..4);
    let rest = (handled, any::<u64>(), any::<[bool; 2]>());
    (payloads, transmits, rest).prop_map(
        |(payloads, transmits, (handled, inputs, [has_scene, is_ready]))| {
            let transmits = transmits.into_iter().map(|(kind, peer, place, code)| {
                let (to, bytes) = (
                    Peer(peer),
                    payloads[usize::from(place) % payloads.len()].clone(),
                );
                match kind % 3 {
                    0 => Transmit::Control { to, bytes },
                    1 => Transmit::State { to, bytes },
                    _ => Transmit::Close { to, code },
                }
            });
            WorkerOutput {
                transmits: transmits.collect(),
                handled: handled
                    .into_iter()
                    .map(|(peer, bytes)| (Peer(peer), bytes))
                    .collect(),
                inputs,
                has_scene,
                is_ready,
            }
        },
    )
}

fn from_process() -> impl Strategy<Value = FromProcess> {
    let vitals = any::<(Option<(u32, u64)>, u64, u64)>().prop_map(|(busiest, scenes, load)| {
        let busiest = busiest.map(|(id, busy)| (WorkerId(id), Span::from_nanos(busy)));
        FromProcess::Alive(Vitals {
            busiest,
            scenes,
            load,
        })
    });
    let metrics = (name(), any::<[u64; SCENE_VALUES]>())
        .prop_map(|(name, values)| (name, SceneValues(values)));
    prop_oneof![
        (any::<u32>(), output()).prop_map(|(id, output)| {
            FromProcess::Worker(WorkerId(id), FromWorker::Output(output))
        }),
        any::<u32>().prop_map(|id| FromProcess::Worker(WorkerId(id), FromWorker::Over)),
        vitals,
        proptest::collection::vec(metrics, 0..3).prop_map(FromProcess::Metrics),
        (name(), bytes()).prop_map(|(name, entries)| FromProcess::Flight(name, entries)),
        name().prop_map(|name| FromProcess::WriteFlight(name, FlightCause::EnginePanicked)),
    ]
}

fn frames(message: &FromProcess) -> Vec<Bytes> {
    let mut frames = Vec::new();
    assert!(encode_from(message, &mut |frame| {
        frames.push(Bytes::copy_from_slice(frame));
        true
    }));
    frames
}

proptest! {
    #[test]
    fn a_message_to_a_process_round_trips_and_no_part_of_it_is_one(message in to_process()) {
        let frame = Bytes::from(encode_to(&message));
        prop_assert_eq!(decode_to(&frame), Ok(message));
        for end in 0..frame.len() {
            prop_assert!(decode_to(&frame.slice(..end)).is_err());
        }
    }

    #[test]
    fn a_message_of_a_process_round_trips_and_no_part_of_it_is_one(message in from_process()) {
        let frames = frames(&message);
        prop_assert_eq!(frames.len(), 1);
        prop_assert_eq!(decode_from(&frames[0]), Ok(message));
        for end in 0..frames[0].len() {
            prop_assert!(decode_from(&frames[0].slice(..end)).is_err());
        }
    }

    #[test]
    fn arbitrary_frames_are_read_without_a_panic(bytes in bytes()) {
        let (_, _) = (decode_to(&bytes), decode_from(&bytes));
    }
}

#[test]
fn a_packet_for_many_members_is_written_once() {
    let packet = Bytes::from(vec![7; 1_000]);
    let transmits = (0..200).map(|peer| Transmit::State {
        to: Peer(peer),
        bytes: packet.clone(),
    });
    let output = WorkerOutput {
        transmits: transmits.collect(),
        handled: Vec::new(),
        inputs: 1,
        has_scene: true,
        is_ready: false,
    };
    let message = FromProcess::Worker(WorkerId(1), FromWorker::Output(output));
    let frames = frames(&message);
    let bytes: usize = frames.iter().map(Bytes::len).sum();
    assert!(bytes < 1_000 + 200 * 4, "{bytes}");
}

#[test]
fn a_long_output_is_divided_and_reports_its_input_once() {
    let transmits = (0..100_u8).map(|peer| Transmit::Control {
        to: Peer(u64::from(peer)),
        bytes: Bytes::from(vec![peer; 64 << 10]),
    });
    let output = WorkerOutput {
        transmits: transmits.collect(),
        handled: vec![(Peer(1), 5)],
        inputs: 9,
        has_scene: true,
        is_ready: false,
    };
    let message = FromProcess::Worker(WorkerId(1), FromWorker::Output(output.clone()));
    let frames = frames(&message);
    assert!((6..=8).contains(&frames.len()), "{}", frames.len());
    let (mut transmits, mut handled) = (Vec::new(), Vec::new());
    for frame in &frames {
        assert!(frame.len() < rhumb_transport::CHILD_FRAME_BYTES_MAX);
        let Ok(FromProcess::Worker(_, FromWorker::Output(part))) = decode_from(frame) else {
            panic!("an output is divided into outputs");
        };
        transmits.extend(part.transmits);
        handled.extend(part.handled);
        assert_eq!((part.inputs, part.has_scene), (9, true));
    }
    assert_eq!((transmits, handled), (output.transmits, output.handled));
}
