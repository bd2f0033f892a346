//! Every message round-trips; other bytes are refused.
//!
//! Proved by building bodies of every type from random bytes, by cutting streams anywhere, and by reading noise.

use glam::Vec3;
use proptest::prelude::*;
use rhumb_app::{
    ConvexMesh, ErrorReport, FramedMessage, HeightGrid, Id, Kind, MESSAGE_BYTES_MAX,
    MalformedMessage, Message, MessageFraming, TriangleMesh,
};

/// Bytes of the body of each type whose length is fixed.
fn fixed(kind: Kind) -> Option<usize> {
    (0..200).find(|bytes| {
        let variable = matches!(
            kind,
            Kind::Error | Kind::AddConvexMesh | Kind::AddTriangleMesh | Kind::AddHeightField
        );
        !variable && Message::decode(kind, &vec![0; *bytes]).is_ok()
    })
}

fn encoded(message: &Message, index: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    message.encode(index, &mut bytes);
    bytes
}

fn number() -> impl Strategy<Value = f32> {
    any::<u32>().prop_map(f32::from_bits)
}

fn points() -> impl Strategy<Value = Vec<Vec3>> {
    let point = [number(), number(), number()].prop_map(Vec3::from_array);
    prop::collection::vec(point, 0..20)
}

fn id() -> impl Strategy<Value = Id> {
    any::<(u32, u32)>().prop_map(|(simulation, object)| Id { simulation, object })
}

fn message() -> impl Strategy<Value = Message> {
    let plain = (
        prop::sample::select(Kind::ALL),
        prop::collection::vec(any::<u8>(), 200),
    )
        .prop_filter_map("of fixed length", |(kind, noise)| {
            Message::decode(kind, &noise[..fixed(kind)?]).ok()
        });
    let text = (any::<u32>(), ".{0,80}")
        .prop_map(|(index, text)| Message::Error(ErrorReport { index, text }));
    let hull = (id(), points())
        .prop_map(|(shape, points)| Message::AddConvexMesh(ConvexMesh { shape, points }));
    let triangles = prop::collection::vec(any::<[u32; 3]>(), 0..20);
    let mesh = (id(), points(), triangles).prop_map(|(shape, points, triangles)| {
        Message::AddTriangleMesh(TriangleMesh {
            shape,
            points,
            triangles,
        })
    });
    let heights = (id(), 0..9_u32, 0..9_u32, number()).prop_map(|(shape, rows, columns, some)| {
        Message::AddHeightField(HeightGrid {
            shape,
            rows,
            columns,
            row_spacing: some,
            column_spacing: 1.0,
            heights: vec![some; (rows * columns) as usize],
        })
    });
    prop_oneof![8 => plain, 1 => text, 1 => hull, 1 => mesh, 1 => heights]
}

fn read_all(frames: &mut MessageFraming) -> Result<Vec<FramedMessage>, MalformedMessage> {
    let mut decoded = Vec::new();
    while let Some(framed) = frames.next_message()? {
        decoded.push(framed);
    }
    Ok(decoded)
}

proptest! {
    #[test]
    fn messages_round_trip_however_their_stream_is_cut(
        messages in prop::collection::vec((message(), 1..=u32::MAX), 1..8),
        cut in 1_usize..400,
    ) {
        let stream: Vec<u8> = messages.iter().flat_map(|(message, index)| encoded(message, *index)).collect();
        let mut frames = MessageFraming::default();
        let mut again = Vec::new();
        for piece in stream.chunks(cut) {
            frames.push(piece);
            for framed in read_all(&mut frames).unwrap() {
                again.extend(encoded(&framed.message, framed.index));
            }
        }
        // Compared as bytes: NaN does not equal itself.
        prop_assert_eq!(again, stream);
    }

    #[test]
    fn every_truncation_of_a_datagram_is_refused(message in message()) {
        let bytes = encoded(&message, 7);
        prop_assert!(Message::from_datagram(&bytes).is_ok());
        for cut in 0..bytes.len() {
            prop_assert_eq!(Message::from_datagram(&bytes[..cut]), Err(MalformedMessage::Truncated));
        }
        let more = [bytes.clone(), bytes].concat();
        prop_assert!(Message::from_datagram(&more).is_ok());
    }

    #[test]
    fn every_truncation_of_a_body_is_refused(message in message()) {
        let bytes = encoded(&message, 7);
        let body = &bytes[24..];
        // A text may end at any byte.
        let text = matches!(message, Message::Error(_));
        for cut in 0..if text { 4 } else { body.len() } {
            prop_assert_eq!(Message::decode(message.kind(), &body[..cut]), Err(MalformedMessage::Truncated));
        }
        if !text {
            let longer = [body, &[0]].concat();
            prop_assert_eq!(Message::decode(message.kind(), &longer), Err(MalformedMessage::TrailingBytes));
        }
    }

    #[test]
    fn noise_never_panics_and_decoded_noise_encodes_back(
        noise in prop::collection::vec(any::<u8>(), 0..400),
        kind in prop::sample::select(Kind::ALL),
    ) {
        let mut frames = MessageFraming::default();
        frames.push(&noise);
        let _ = read_all(&mut frames);
        let _ = Message::from_datagram(&noise);
        if let Ok(message) = Message::decode(kind, &noise) {
            let bytes = encoded(&message, 0);
            if !matches!(message, Message::Error(_)) {
                prop_assert_eq!(&bytes[24..], &noise[..]);
            }
        }
    }

    #[test]
    fn a_wrong_byte_in_a_header_never_panics(message in message(), place in 0_usize..24, byte in any::<u8>()) {
        let mut bytes = encoded(&message, 7);
        bytes[place] = byte;
        let mut frames = MessageFraming::default();
        frames.push(&bytes);
        let _ = read_all(&mut frames);
    }
}

#[test]
fn a_torque_without_a_header_is_decoded() {
    let mut bytes = vec![0; 24];
    let torque = Message::decode(Kind::ApplyTorque, &[7; 20]).unwrap();
    bytes.extend([7; 20]);
    bytes.extend(encoded(&Message::Logoff(1), 9));
    let mut frames = MessageFraming::default();
    for byte in bytes {
        frames.push(&[byte]);
        if let Some(framed) = frames.next_message().unwrap() {
            let expected = match framed.index {
                0 => &torque,
                _ => &Message::Logoff(1),
            };
            assert_eq!(&framed.message, expected);
        }
    }
    assert_eq!(read_all(&mut frames), Ok(vec![]));
}

#[test]
fn an_invalid_header_is_refused_before_its_body_arrives() {
    let refused = |bytes: &[u8]| {
        let mut frames = MessageFraming::default();
        frames.push(bytes);
        frames.next_message().expect_err("the test makes it wrong")
    };
    let mut header = encoded(&Message::Logoff(1), 0)[..24].to_vec();
    header[11] = 29;
    assert_eq!(
        refused(&header),
        MalformedMessage::Length {
            kind: 13,
            bytes: 29
        }
    );
    header[11] = 0;
    assert_eq!(
        refused(&header),
        MalformedMessage::Length { kind: 13, bytes: 0 }
    );
    header[3] = 99;
    assert_eq!(refused(&header), MalformedMessage::UnknownKind(99));
    header[1] = 2;
    assert_eq!(refused(&header), MalformedMessage::Version(2));
    let mut mesh = [0_u8; 24];
    mesh[1] = 1;
    mesh[2..4].copy_from_slice(&306_u16.to_be_bytes());
    let bytes = MESSAGE_BYTES_MAX as u32 + 1;
    mesh[8..12].copy_from_slice(&bytes.to_be_bytes());
    assert_eq!(
        refused(&mesh),
        MalformedMessage::Length { kind: 306, bytes }
    );
}

#[test]
fn excessive_counts_are_refused_before_any_allocation() {
    let body = |kind, counts: &[u32]| {
        let mut body = vec![0; 8];
        for count in counts {
            body.extend(count.to_be_bytes());
        }
        body.extend([0; 8]);
        Message::decode(kind, &body)
    };
    let many = u32::MAX;
    assert_eq!(
        body(Kind::AddConvexMesh, &[many]),
        Err(MalformedMessage::Count(many))
    );
    assert_eq!(
        body(Kind::AddConvexMesh, &[60_000]),
        Err(MalformedMessage::Truncated)
    );
    assert_eq!(
        body(Kind::AddTriangleMesh, &[0, many]),
        Err(MalformedMessage::Count(many))
    );
    assert_eq!(
        body(Kind::AddHeightField, &[many, 2]),
        Err(MalformedMessage::Count(many))
    );
    assert_eq!(
        body(Kind::AddHeightField, &[513, 512]),
        Err(MalformedMessage::Count(513 * 512))
    );
    assert_eq!(
        body(Kind::AddHeightField, &[2, 2]),
        Err(MalformedMessage::Truncated)
    );
}
