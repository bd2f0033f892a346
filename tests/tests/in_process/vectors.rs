//! Vectors, tables and examples of the control stream agree with the codec.
//!
//! After an intended change, write the vectors with `UPDATE_VECTORS=1 cargo test -p rhumb-tests --test in_process vectors`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use rhumb_conformance::grammar::{Grammar, unhex};
use rhumb_conformance::requirements::Document;
use rhumb_conformance::vectors::{Decoded, Sender, agrees, golden, replayed, upstream_states};
use rhumb_protocol::limits;
use rhumb_protocol::message::{MAGIC, VERSIONS, is_no_version};
use rhumb_protocol::packet::{Head, PacketKind, StreamId, UpdateWriter};
use rhumb_protocol::scene::{Quantity, Shape};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::wire::{OPTIONAL, Wire};
use rhumb_tests::vectors::{control, folder, streams};
use serde_json::Value;

/// Writes golden vectors, if `UPDATE_VECTORS` is set.
fn update(name: &str, vectors: impl FnOnce() -> String) {
    if std::env::var_os("UPDATE_VECTORS").is_some() {
        std::fs::write(folder().join(name), vectors()).expect("the specification can be written");
    }
}

#[test]
fn the_golden_vectors_agree_with_the_codec() {
    let computed = control();
    update("control.json", || computed.clone());
    let golden = std::fs::read_to_string(folder().join("control.json"));
    let golden = golden.expect("the specification is in the repository");
    for (number, (is, was)) in computed.lines().zip(golden.lines()).enumerate() {
        assert_eq!(is, was, "line {}", number + 1);
    }
    assert_eq!(computed.len(), golden.len());
}

#[test]
fn a_session_that_receives_a_golden_stream_reaches_its_recorded_states() {
    // They are compiled in: the next build reads what is written here.
    update("streams.json", streams::streams);
    let golden = golden("streams.json");
    for stream in golden["streams"].as_array().expect("streams are listed") {
        let events = stream["events"].as_array().expect("events are listed");
        let states = replayed(events);
        assert!(states.len() >= 20, "{}", stream["name"]);
        for (place, expected, known) in states {
            let name = &stream["name"];
            assert!(
                agrees(&expected, &known),
                "event {place} of {name}: {known}, not {expected}"
            );
        }
        let last = &events.last().expect("a stream has events")[1];
        assert_eq!(last["converged"], true, "{}", stream["name"]);
    }
}

#[test]
fn a_session_that_receives_a_scripted_stream_reaches_its_stated_states() {
    let golden = golden("scripted.json");
    let mut wrong = Vec::new();
    for stream in golden["streams"].as_array().expect("streams are listed") {
        let events = stream["events"].as_array().expect("events are listed");
        for (place, expected, known) in replayed(events) {
            if !agrees(&expected, &known) {
                let name = &stream["name"];
                wrong.push(format!("event {place} of {name}: {known}, not {expected}"));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "{} states differ:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}

#[test]
fn a_server_moves_the_bodies_of_a_scripted_upstream_as_stated() {
    let golden = golden("scripted.json");
    let mut steps = 0;
    for upstream in golden["upstreams"]
        .as_array()
        .expect("upstreams are listed")
    {
        let events = upstream["events"].as_array().expect("events are listed");
        let stated: Vec<_> = events.iter().filter(|event| event[0] == "step").collect();
        let states = upstream_states(events);
        assert_eq!(states.len(), stated.len());
        for (state, event) in states.iter().zip(&stated) {
            assert_eq!(
                *state, event[2],
                "the step to {} of {}",
                event[1], upstream["name"]
            );
        }
        steps += states.len();
    }
    assert!(steps >= 20);
}

/// The bytes of a shape of the vectors of radii.
fn shape_bytes(case: &Value) -> Vec<u8> {
    let numbers = |values: &[Value]| -> Vec<u8> {
        let digits = values
            .iter()
            .map(|one| unhex(one.as_str().expect("digits")));
        digits.flat_map(|bits| bits.into_iter().rev()).collect()
    };
    let extents = case["extents"].as_array().expect("extents are listed");
    let all = numbers(extents);
    let bytes = |head: &[u8]| [head, &all[..]].concat();
    match case["shape"].as_str().expect("a name") {
        "ball" => bytes(&[0]),
        "cuboid" => bytes(&[1]),
        "capsule" => bytes(&[2]),
        "cylinder" => bytes(&[3]),
        "hull" => bytes(&[4, (extents.len() / 3) as u8]),
        "heights" => {
            let rows = case["rows"].as_u64().expect("a number of rows") as u8;
            let columns = (extents.len() - 2) as u8 / rows;
            let (spacings, heights) = extents.split_at(2);
            [
                vec![5, rows, columns],
                numbers(spacings),
                vec![0],
                numbers(heights),
            ]
            .concat()
        }
        "mesh" => [bytes(&[6, (extents.len() / 3) as u8, 1, 0]), vec![0, 1, 2]].concat(),
        "compound" => {
            let unturned: Vec<u8> = [0.0_f32, 0.0, 0.0, 1.0].map(f32::to_le_bytes).concat();
            let ball = |ball: &[Value]| {
                let (at, radius) = ball.split_at(3);
                [numbers(at), unturned.clone(), vec![0], numbers(radius)].concat()
            };
            let balls: Vec<_> = extents.chunks(4).map(ball).collect();
            [vec![7, balls.len() as u8], balls.concat()].concat()
        }
        "rounded cuboid" => bytes(&[8]),
        "cone" => bytes(&[9]),
        "half-space" => bytes(&[10]),
        other => panic!("no such shape: {other}"),
    }
}

#[test]
fn the_radius_of_each_shape_is_that_of_the_vectors() {
    let golden = golden("reckoning.json");
    let cases = golden["radii"].as_array().expect("radii are listed");
    let mut kinds = BTreeSet::new();
    for case in cases {
        let bytes = shape_bytes(case);
        let mut reader = Reader::new(&bytes);
        let shape = Shape::decode(&mut reader).expect("a shape");
        reader.finish().expect("nothing behind it");
        let radius = shape.bounding_radius().metres();
        let digits = format!("{:016x}", radius.to_bits());
        assert_eq!(digits, case["radius"][0], "{case}");
        kinds.insert(bytes[0]);
    }
    assert_eq!(kinds.len(), 11, "every kind of shape has a case");
}

#[test]
fn a_datagram_that_breaks_one_rule_is_refused() {
    let golden = golden("scripted.json");
    let refused = golden["refused"].as_array().expect("datagrams are listed");
    let accepted = refused.iter().filter(|line| {
        let bytes = unhex(line["bytes"].as_str().expect("digits"));
        crate::bits::read(&bytes).is_ok()
    });
    let accepted: Vec<_> = accepted
        .map(|line| (&line["breaks"], &line["name"]))
        .collect();
    assert!(refused.len() >= 40 && accepted.is_empty(), "{accepted:?}");
}

#[test]
fn the_golden_vectors_are_many() {
    let vectors: Value = serde_json::from_str(&control()).expect("vectors are JSON");
    let count = |name: &str| vectors[name].as_array().expect("a section").len();
    assert!(count("client messages") + count("server messages") >= 150);
    assert!(count("refused client messages") + count("refused server messages") >= 150);
}

/// The value of each limit in code.
fn limits_in_code() -> BTreeMap<&'static str, f64> {
    macro_rules! limits {
        ($($name:ident)*) => {
            BTreeMap::from([$((stringify!($name), limits::$name as f64)),*])
        };
    }
    limits! {
        DATAGRAM_BYTES_MAX LARGEST_PACKET_MIN UPDATES_PER_PACKET_MAX MESSAGE_BYTES_MAX LONG_MESSAGE_BYTES_MAX
        SCENE_NAME_BYTES_MAX VERSIONS_MAX BUDGET_MIN BUDGET_MAX BUDGET_BURST_MAX
        EXTENSIONS_MAX EXTENSION_BYTES_MAX BODIES_MAX INDICES_MAX SHAPES_MAX JOINTS_MAX
        CELL_EDGE_MIN CELLS_PER_MEMBER_MAX STREAMS_PER_SCENE_MAX SCENES_MAX MEMBERS_PER_SCENE_MAX DAMPINGS_MAX AUTHORITY_BODIES_MAX UPSTREAM_WATERMARK_MS
        UPSTREAM_GRACE_MS GRANT GRANTED_MAX RESERVE_MAX PENDING_COMMANDS_MAX CONTROL_WAITING_BYTES_MAX RANGES_PER_MEMBER_MAX ADVANCE_TICKS_MAX
        JOINTS_BESIDE JOINTS_PER_BODY SWEPT_BODIES_MAX CHARACTERS_MAX VEHICLES_MAX WHEELS_MAX MASS_MIN MASS_MAX GYRATION_MIN GYRATION_MAX MOMENT_MAX STIFFNESS_MAX
        QUERY_COST_MAX SHAPE_CAST_COST HITS_MAX EVENTS_PER_TICK_MAX EVENTS_HELD_MAX STANDING_PAIRS_MAX
        COORDINATE_MAX LINEAR_MAX ANGULAR_MAX GRAVITY_MAX FORCE_MAX EXTENT_MIN EXTENT_MAX
        HULL_POINTS_MIN HULL_POINTS_MAX HULL_FLATNESS POSTS_MAX MESH_POINTS_MAX TRIANGLES_MAX
        PARTS_MAX PARTS_BYTES_MAX SHAPE_BYTES_PER_SCENE_MAX DENSITY_MIN DENSITY_MAX FRICTION_MAX DAMPING_MAX
        GRAVITY_SCALE_MAX SLEEP_SPEED_MAX SLEEP_SECONDS_MAX SUBSTEPS_MAX RATE_MAX STEP_SECONDS_MAX
        PUBLISH_SECONDS_MAX LOOKAHEAD_TICKS_MAX COUNT_MAX HISTORY_PACKETS LOST_NUMBERS_MAX
        REFRESH_PARTS_MAX FEC_SPAN FEC_ROWS REPAIR_SYMBOLS_KEPT WAITING_DATAGRAMS_MAX
        SILENCE_MS_MAX TICK_JUMP_MAX
    }
}

/// The limits of PROTOCOL 7 by name.
fn limits_in_the_document() -> BTreeMap<String, f64> {
    let text = Document::Protocol.text();
    let begin = text.find("\n## 7 ").expect("an existing clause");
    let rows = text[begin..].lines().filter_map(|line| {
        let mut words = line.strip_prefix("    ")?.split_whitespace();
        let (name, value) = (words.next()?, words.next()?.parse().ok()?);
        let is_name = name.bytes().all(|c| c.is_ascii_uppercase() || c == b'_');
        is_name.then(|| (name.to_owned(), value))
    });
    rows.collect()
}

#[test]
fn limits_are_the_same_in_code_document_and_table() {
    let grammar = Grammar::load();
    // Compared in the type that code uses: most are f32, whose decimals the document has.
    let single = |value: f64| value as f32;
    let code: BTreeMap<_, _> = limits_in_code()
        .into_iter()
        .map(|(name, value)| (name.to_owned(), single(value)))
        .collect();
    let named = |(name, value): (&str, f64)| (name.to_owned(), single(value));
    let table: BTreeMap<_, _> = grammar.limits().into_iter().map(named).collect();
    assert_eq!(code, table);
    let document: BTreeMap<_, _> = limits_in_the_document()
        .into_iter()
        .map(|(name, value)| (name, single(value)))
        .collect();
    assert_eq!(code, document);
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../protocol/src/limits.rs");
    let source = std::fs::read_to_string(source).expect("the limits are in the repository");
    let constants = source.lines().filter_map(|line| {
        let (name, _) = line.strip_prefix("pub const ")?.split_once(':')?;
        Some(name.to_owned())
    });
    let all: BTreeSet<_> = constants.collect();
    assert_eq!(all, code.into_keys().collect());
}

#[test]
fn codes_are_the_same_in_code_and_table() {
    let grammar = Grammar::load();
    let table = grammar.table();
    assert_eq!(table["version"], VERSIONS[0]);
    let magic = &table["types"]["client message"]["codes"][0]["fields"][0];
    assert_eq!(magic["least"], u32::from_le_bytes(MAGIC));
    for (name, code) in [
        ("DONE", CloseCode::DONE),
        ("MALFORMED", CloseCode::MALFORMED),
        ("VIOLATION", CloseCode::VIOLATION),
        ("VERSION", CloseCode::VERSION),
        ("LIMIT", CloseCode::LIMIT),
        ("EXTENSION", CloseCode::EXTENSION),
        ("SCENE_QUARANTINED", CloseCode::SCENE_QUARANTINED),
        ("BUSY", CloseCode::BUSY),
        ("HELLO_LATE", CloseCode::HELLO_LATE),
        ("SCENE_RESTORING", CloseCode::SCENE_RESTORING),
        ("SCENE_LOST", CloseCode::SCENE_LOST),
        ("SCENE_ELSEWHERE", CloseCode::SCENE_ELSEWHERE),
        ("TOKEN_MISSING", CloseCode::TOKEN_MISSING),
        ("TOKEN_INVALID", CloseCode::TOKEN_INVALID),
        ("TOKEN_EXPIRED", CloseCode::TOKEN_EXPIRED),
        ("TOKEN_SCENE", CloseCode::TOKEN_SCENE),
    ] {
        let codes = table["close codes"].as_array().expect("codes are listed");
        let row = codes.iter().find(|row| row["name"] == name);
        assert_eq!(row.map(|row| &row["code"]), Some(&Value::from(code.0)));
    }
    let quantities = table["quantities"].as_array().expect("a list").len();
    for code in 0..=u8::MAX {
        let known = usize::from(code) < quantities;
        assert_eq!(Quantity::from_code(code).is_some(), known, "{code}");
    }
    let kinds = table["datagrams"].as_array().expect("a list");
    for first in 0..=u8::MAX {
        // The low half is the kind; the other half is the stream id, whose rest follows if all its bits are ones.
        let known = Head::decode(&mut Reader::new(&[first, 0])).is_ok();
        let listed = kinds.iter().any(|row| row["kind"] == first & 0xf);
        assert_eq!(known, listed, "{first:#x}");
    }
    for version in table["grease"]["versions"].as_array().expect("a list") {
        let version = version.as_u64().expect("a number") as u16;
        assert!(is_no_version(version));
    }
}

/// Each message type with a body of zeros, and each code after those types: known to both or to neither.
#[test]
fn the_codec_and_the_table_have_the_same_types() {
    let grammar = Grammar::load();
    for side in [Sender::Client, Sender::Server] {
        let codes = &grammar.table()["types"][side.type_name()]["codes"];
        let codes = codes.as_array().expect("codes are listed");
        for kind in 0..=u8::MAX {
            let row = codes.iter().find(|row| row["code"] == kind);
            let unknown = |body: &[u8]| match side.outcome(kind, body) {
                Decoded::Skipped => kind >= OPTIONAL,
                Decoded::Refused(why) => format!("{why:?}") == "UnknownCode",
                _ => false,
            };
            let is_coded = row.is_some_and(|row| {
                let first = &row["fields"][0]["type"];
                first
                    .as_str()
                    .is_some_and(|name| grammar.table()["types"][name]["codes"].is_array())
            });
            if !is_coded {
                assert_eq!(unknown(&[]), row.is_none(), "{side:?} {kind}");
            }
        }
    }
}

/// The examples of a clause: the meaning and the bytes of each.
fn examples(clause: &str) -> Vec<(String, Vec<u8>)> {
    let text = Document::Protocol.text();
    let begin = text
        .find(&format!("### {clause} "))
        .expect("an existing clause");
    let section = &text[begin..];
    let section = section[4..]
        .find("\n#")
        .map_or(section, |end| &section[..end + 4]);
    let lines = section.lines().filter_map(|line| {
        let line = line.strip_prefix("    ")?;
        let digits = line
            .char_indices()
            .find(|(place, _)| begins_a_word(line, *place) && is_bytes(&line[*place..]));
        let (place, _) = digits?;
        Some((line[..place].trim().to_owned(), unhex(&line[place..])))
    });
    lines.collect()
}

fn begins_a_word(line: &str, place: usize) -> bool {
    line[..place].chars().next_back().is_none_or(|c| c == ' ')
}

/// True if a text is groups of pairs of digits with one or two spaces between.
fn is_bytes(text: &str) -> bool {
    let groups: Vec<_> = text.split(' ').filter(|group| !group.is_empty()).collect();
    let is_group = |group: &&str| {
        group.len().is_multiple_of(2) && group.bytes().all(|c| b"0123456789abcdef".contains(&c))
    };
    groups.len() > 1 && !text.starts_with(' ') && groups.iter().all(is_group)
}

#[test]
fn the_documents_example_of_a_message_decodes_as_described() {
    let grammar = Grammar::load();
    let found = examples("4.13");
    let [(name, bytes)] = &found[..] else {
        panic!("{found:?}")
    };
    let (length, typed) = bytes.split_first().expect("an example has bytes");
    assert_eq!(usize::from(*length), typed.len(), "{name}");
    let (means, _) = grammar.read(Sender::Client.type_name(), typed).expect(name);
    assert_eq!(
        Sender::Client.outcome(typed[0], &typed[1..]),
        Decoded::Accepted(None)
    );
    assert_eq!(
        (&means["is"], &means["scene"]),
        (&"Hello".into(), &"pit".into())
    );
}

#[test]
fn the_documents_examples_of_datagrams_are_of_stream_five() {
    let (_, empty) = &examples("5.18")[0];
    let written = UpdateWriter::new(StreamId(5), 70_000, 300, 12).finish(true);
    assert_eq!(empty, &written, "a tick without updates");
    let kinds: Vec<_> = examples("5.18")
        .into_iter()
        .map(|(_, bytes)| {
            let head = Head::decode(&mut Reader::new(&bytes)).expect("a datagram");
            assert_eq!(head.stream.0, 5);
            head.kind
        })
        .collect();
    assert_eq!(
        kinds,
        [
            PacketKind::UpdatesEnd,
            PacketKind::Watermark,
            PacketKind::LossReport
        ]
    );
}
