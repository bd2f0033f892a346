//! Vectors of messages in pieces, in a short form.
//!
//! They have the greatest lengths and counts, and one more.

use rhumb_conformance::grammar::{Grammar, hex};
use rhumb_conformance::vectors::{Decoded, Sender, error_json, in_pieces};
use rhumb_protocol::limits::{LONG_MESSAGE_BYTES_MAX, PARTS_BYTES_MAX};
use rhumb_protocol::message::Frames;
use serde_json::{Value, json};

use super::pieces::{TURNED, f, mesh, v, word};

/// Bytes, so many times.
type Run = (Vec<u8>, usize);

/// A message whose body is made of runs.
struct Long {
    rule: &'static str,
    name: String,
    kind: u8,
    parts: Vec<Run>,
}

impl Long {
    fn body(&self) -> Vec<u8> {
        let runs = self.parts.iter();
        runs.flat_map(|(bytes, times)| bytes.repeat(*times))
            .collect()
    }
}

/// One line of each message that a side may send or must not send.
pub(super) fn lines(grammar: &Grammar, side: Sender) -> Vec<String> {
    let (kind, head, of) = match side {
        Sender::Client => (7, [0, 1], "AddShape"),
        Sender::Server => (11, [0, 1], "ShapeAdded"),
    };
    let mut cases = lengths();
    for (rule, name, mut parts) in [heights(), meshes(), compounds()].concat() {
        parts.insert(0, (head.to_vec(), 1));
        let name = format!("{of}, {name}");
        cases.push(Long {
            rule,
            name,
            kind,
            parts,
        });
    }
    cases.iter().map(|long| line(grammar, side, long)).collect()
}

fn line(grammar: &Grammar, side: Sender, long: &Long) -> String {
    let (name, kind, body) = (&long.name, long.kind, long.body());
    let parts: Vec<_> = long
        .parts
        .iter()
        .map(|(bytes, times)| json!([hex(bytes), times]))
        .collect();
    let mut line = json!({"name": name, "rule": long.rule, "type": kind, "parts": parts});
    match received(side, kind, &body) {
        Decoded::Refused(why) => line["refusal"] = Value::String(word(why)),
        Decoded::Skipped => line["skipped"] = Value::Bool(true),
        Decoded::Accepted(invalid) => {
            if let Some(invalid) = invalid {
                line["error"] = error_json(invalid);
            }
            let typed = [&[kind], &body[..]].concat();
            let read = grammar.read(side.type_name(), &typed);
            assert!(read.is_ok(), "{name}: the table does not have it");
        }
        other => panic!("{name}: {other:?}"),
    }
    line.to_string()
}

/// The result of receiving a message in pieces.
fn received(side: Sender, kind: u8, body: &[u8]) -> Decoded {
    let mut frames = Frames::new();
    frames.push(&in_pieces(kind, body));
    match frames.next_frame() {
        Ok(framed) => {
            let framed = framed.expect("a whole message");
            assert_eq!((framed.kind, &framed.body[..]), (kind, body));
            side.outcome(kind, body)
        }
        Err(why) => Decoded::Refused(why),
    }
}

/// Unknown optional messages of about the greatest length.
fn lengths() -> Vec<Long> {
    const MOST: usize = LONG_MESSAGE_BYTES_MAX;
    [MOST - 1, MOST, MOST + 1]
        .into_iter()
        .map(|length| Long {
            rule: "4.1-7",
            name: format!("an optional message of {length} bytes"),
            kind: 0xee,
            parts: vec![(vec![7], length)],
        })
        .collect()
}

/// The requirement, the name, and the shape.
type LongShape = (&'static str, String, Vec<Run>);

/// Heights of about the most posts.
fn heights() -> Vec<LongShape> {
    let counts = [
        [512, 512],
        [2, 131_072],
        [512, 513],
        [131_073, 2],
        [65_537, 4],
    ];
    let of = |[rows, columns]: [usize; 2]| {
        let name = format!("{rows} rows of {columns} heights");
        ("2.6-7", name, field(rows, columns).to_vec())
    };
    counts.into_iter().map(of).collect()
}

/// A height field at 0.
fn field(rows: usize, columns: usize) -> [Run; 2] {
    let counts = [rows, columns].map(|count| v(count as u64)).concat();
    let head = [vec![5], counts, f(&[0.0625; 2]), vec![0]].concat();
    [(head, 1), (f(&[0.0]), rows * columns)]
}

/// Meshes of about the most points and triangles.
fn meshes() -> Vec<LongShape> {
    const MOST: usize = 65_536;
    let of = |[points, triangles]: [usize; 2]| {
        let counts = [points, triangles].map(|count| v(count as u64)).concat();
        let head = [vec![6], counts, vec![0]].concat();
        let parts = vec![
            (head, 1),
            (f(&[0.25, 0.5, 1.0]), points),
            (vec![0, 1, 2], triangles),
        ];
        let name = format!("a mesh of {points} points and {triangles} triangles");
        ("2.6-8", name, parts)
    };
    let counts = [[MOST, MOST], [MOST + 1, 1], [3, MOST + 1]];
    counts.into_iter().map(of).collect()
}

/// Compounds of about the greatest size: of a hull, a mesh, a ball and two height fields.
fn compounds() -> Vec<LongShape> {
    let placed = [f(&[1.0, -0.5, 0.0]), f(&TURNED)].concat();
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let hull = [vec![4, 4], f(&corners)].concat();
    let small = [
        hull,
        mesh(&corners[..9], &[0, 1, 2]),
        [vec![0], f(&[0.5])].concat(),
    ];
    let of = |[twos, threes]: [usize; 2]| {
        let mut parts = vec![(vec![7, 5], 1)];
        for shape in &small {
            parts.push(([&placed[..], shape].concat(), 1));
        }
        for [head, posts] in [field(2, twos), field(3, threes)] {
            parts.push((placed.clone(), 1));
            parts.extend([head, posts]);
        }
        let size = 48 + 4 * 12 + 48 + 3 * 12 + 12 + 48 + 2 * 48 + 4 * (2 * twos + 3 * threes);
        let name = format!("a compound of parts of {size} bytes, of {PARTS_BYTES_MAX}");
        ("2.6-10", name, parts)
    };
    [[106_501, 70_966], [106_500, 70_967]]
        .into_iter()
        .map(of)
        .collect()
}
