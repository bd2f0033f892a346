//! Makes vectors that differ from valid messages in one number.
//!
//! The table gives the positions and bounds of the numbers; each kind of change is made only once.

use std::collections::BTreeSet;

use serde_json::Value;

use super::message_case::MessageCase;
use super::pieces::{f, v};
use rhumb_conformance::grammar::{Grammar, Span};
use rhumb_conformance::vectors::Sender;

/// Every change of one number in the cases that the table decodes.
pub(super) fn cases(grammar: &Grammar, side: Sender, sent: &[MessageCase]) -> Vec<MessageCase> {
    let mut changed = Vec::new();
    let mut seen = BTreeSet::new();
    for MessageCase {
        name, kind, body, ..
    } in sent
    {
        let typed = [&[*kind], &body[..]].concat();
        let Ok((means, spans)) = grammar.read(side.type_name(), &typed) else {
            continue;
        };
        let of = kinds(&means);
        // The first span is the message type, which other cases change.
        for span in spans.iter().skip(1) {
            let place: String = span.path.chars().filter(|c| !c.is_ascii_digit()).collect();
            let now = &typed[span.start..span.end];
            for (word, bytes) in changes(span, now) {
                let key = if word.contains("the least") || word.contains("the most") || word == WIDE
                {
                    // Their bounds are those of the table: once for each name in a kind of message.
                    (kind_of(&means), place_of(&place), word.clone())
                } else {
                    (of.clone(), place.clone(), word.clone())
                };
                if !seen.insert(key) {
                    continue;
                }
                let body = [&typed[1..span.start], &bytes, &typed[span.end..]].concat();
                let path = if span.kind == "code" {
                    "code"
                } else {
                    &span.path
                };
                let name = format!("{name}: {path} {word}");
                let kind = *kind;
                changed.push(MessageCase {
                    name,
                    kind,
                    body,
                    rule: None,
                });
            }
        }
    }
    changed
}

/// The name of the change to the greatest number of 64 bits.
const WIDE: &str = "of 64 bits";

/// The name of a message, and of the command or scene event in it.
fn kind_of(means: &Value) -> String {
    let inner =
        [&means["command"], &means["event"]].map(|inner| inner["is"].as_str().unwrap_or_default());
    format!(
        "{}{}",
        means["is"].as_str().unwrap_or_default(),
        inner.concat()
    )
}

/// The last names of a path.
fn place_of(path: &str) -> String {
    let names: Vec<_> = path.split('.').filter(|name| !name.is_empty()).collect();
    names[names.len().saturating_sub(2)..].join(".")
}

/// The variants that a value consists of.
fn kinds(means: &Value) -> String {
    match means {
        Value::Object(fields) => {
            let is = fields.get("is").and_then(Value::as_str).unwrap_or_default();
            let rest = fields.values().map(kinds);
            format!("{is}{}", rest.collect::<String>())
        }
        _ => String::new(),
    }
}

fn changes(span: &Span, now: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut changes: Vec<(String, Vec<u8>)> = Vec::new();
    let mut change = |word: String, bytes: Vec<u8>| {
        if bytes != now {
            changes.push((word, bytes));
        }
    };
    match &span.kind[..] {
        "varint" | "varint32" | "count" | "length" => {
            let most = span.bounds.1.unwrap_or(u64::MAX);
            let least = span.bounds.0.unwrap_or(0);
            if span.kind != "length" && !span.path.ends_with("count") || span.path == "count" {
                change(format!("{least}, the least"), v(least));
                change(format!("{most}, the most"), v(most));
            }
            if least > 0 {
                change(format!("{}, too little", least - 1), v(least - 1));
            }
            if span.kind == "varint" && most < u64::MAX >> 1 {
                change(WIDE.to_owned(), v(u64::MAX));
            }
            match most.checked_add(1) {
                Some(more) => change(format!("{more}, too much"), v(more)),
                None => change("of 65 bits".to_owned(), [&[0xff; 9][..], &[2]].concat()),
            }
            let mut longer = now.to_vec();
            *longer.last_mut().expect("a number has bytes") |= 0x80;
            longer.push(0);
            change("in a longer form".to_owned(), longer);
        }
        "u8" => {
            let more = span
                .bounds
                .1
                .map_or(0xff, |most| (most as u8).saturating_add(1));
            change(format!("{more}"), vec![more]);
            change("with its high bit".to_owned(), vec![now[0] | 0x80]);
        }
        "i8" => {
            for number in [-128_i8, -4, -3, 0, 3, 4, 127] {
                change(format!("{number}"), vec![number.cast_unsigned()]);
            }
        }
        "code" => change("one that no table has".to_owned(), vec![0x7d]),
        "f32" | "vec3" | "quat" => {
            let size = now.len();
            for (word, number) in floats(span) {
                let bytes = [&now[..size - 4], &f(&[number])].concat();
                change(word.to_owned(), bytes);
            }
            if let Some(not) = &span.not {
                change("what is left out".to_owned(), not.clone());
            }
        }
        _ => {}
    }
    changes
}

/// Numbers for a float: at its bounds and beyond, and what no float may be.
fn floats(span: &Span) -> Vec<(&'static str, f32)> {
    let mut floats = vec![
        ("NaN", f32::NAN),
        ("infinite", f32::INFINITY),
        ("the greatest of all", f32::MAX),
        ("less than nothing", -1e-3),
    ];
    if let Some([least, most]) = span.within {
        floats.extend([
            ("the least", least),
            ("less than the least", least.next_down()),
            ("the most", most),
            ("more than the most", most.next_up()),
        ]);
    }
    floats
}
