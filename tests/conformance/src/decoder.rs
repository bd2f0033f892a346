//! L0.81 to L4.82: the golden vectors, given to a decoder.
//!
//! One case covers all vectors of one kind; its decoder process is started once.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde_json::{Value, json};

use super::case::Case;
use super::outcome::{CaseResult, Stop, ensure};
use super::peer::Decoder;
use super::trial::Trial;
use crate::vectors::{agrees, golden, in_pieces};

/// All cases of this module.
pub(super) fn cases() -> Vec<Case> {
    let (control, packets) = (golden("control.json"), golden("packets.json"));
    let (streams, scripted) = (golden("streams.json"), golden("scripted.json"));
    let mut cases = Vec::new();
    for side in ["client", "server"] {
        cases.extend(messages(side, &control));
    }
    for side in ["client", "server"] {
        cases.push(family(
            "L0.87",
            &format!("long messages, as a {side} sends them in pieces, are accepted or refused"),
            "PROTOCOL 2.6-7, 2.6-8, 2.6-10, 4.1-5, 4.1-7",
            lines_of(&control[&format!("long {side} messages")]),
            move |decoder, line| long(decoder, side, line),
        ));
    }
    cases.push(family(
        "L0.83",
        "messages are framed",
        "PROTOCOL 4.1-1, 4.1-5, 4.1-6, 4.1-8",
        lines_of(&control["frames"]),
        framed,
    ));
    cases.extend(datagrams(&packets));
    cases.extend(one_fault(&scripted));
    cases.push(family(
        "L0.86",
        "repair symbols are computed",
        "PROTOCOL 5.16-2, 5.16-3, 5.16-4",
        lines_of(&packets["repair_symbols"]),
        repair_symbol,
    ));
    cases.extend(lines_of(&streams["streams"]).into_iter().map(received));
    cases.extend(lines_of(&scripted["streams"]).into_iter().map(received));
    let upstreams = lines_of(&scripted["upstreams"]);
    cases.extend(upstreams.into_iter().map(received_upstream));
    cases
}

/// Messages that a side may send, and bytes that it must not send.
fn messages(side: &'static str, control: &Value) -> Vec<Case> {
    let sent = grouped(&control[&format!("{side} messages")], |line| {
        word(&line["means"]["is"])
    });
    let sent = sent.into_iter().map(|(kind, lines)| {
        let name = format!("{kind}, as a {side} sends it, is decoded correctly");
        let cites = "PROTOCOL 2.5-1, 2.5-2, 4.1-4";
        family("L0.81", &name, cites, lines, move |decoder, line| {
            message(decoder, side, line)
        })
    });
    let refused = grouped(&control[&format!("refused {side} messages")], |line| {
        word(&line["refusal"])
    });
    let refused = refused.into_iter().map(|(why, lines)| {
        let name = format!("bytes that a {side} must not send are refused: {why}");
        let cites = "PROTOCOL 2.5-1";
        family("L0.82", &name, cites, lines, move |decoder, line| {
            let answer = decoder.ask(&json!({"message": side, "bytes": line["bytes"]}))?;
            must(answer.get("refused").is_some(), line, &answer)
        })
    });
    sent.chain(refused).collect()
}

/// Datagrams, valid and malformed.
fn datagrams(packets: &Value) -> Vec<Case> {
    let sent = grouped(&packets["accepted"], |line| word(&line["means"]["kind"]));
    let sent = sent.into_iter().map(|(kind, lines)| {
        let name = format!("datagrams of kind {kind} are decoded correctly");
        let cites = "PROTOCOL 2.5-2, 5.6-3, 5.8-1";
        family("L0.84", &name, cites, lines, packet)
    });
    let refused = grouped(&packets["refused"], |line| word(&line["refusal"]));
    let refused = refused.into_iter().map(|(why, lines)| {
        let name = format!("malformed datagrams are refused: {why}");
        let cites = "PROTOCOL 2.5-1, 2.5-4, 5.8-2";
        family("L0.85", &name, cites, lines, |decoder, line| {
            let answer = decoder.ask(&json!({"packet": line["bytes"]}))?;
            must(answer.get("refused").is_some(), line, &answer)
        })
    });
    sent.chain(refused).collect()
}

/// Datagrams that break one requirement each, and keep all others.
fn one_fault(scripted: &Value) -> impl Iterator<Item = Case> {
    let refused = grouped(&scripted["refused"], |line| word(&line["breaks"]));
    refused.into_iter().map(|(requirement, lines)| {
        let name = format!("datagrams that break only PROTOCOL {requirement} are refused");
        let cites = "PROTOCOL 2.5-1, 2.5-4";
        family("L0.85", &name, cites, lines, |decoder, line| {
            let answer = decoder.ask(&json!({"packet": line["bytes"]}))?;
            must(answer.get("refused").is_some(), line, &answer)
        })
    })
}

/// A stream, as one of its subscribers received it.
fn received(stream: Value) -> Case {
    let name = format!(
        "a decoder of {} reaches the subscriber's state",
        word(&stream["name"])
    );
    let cites =
        "PROTOCOL 5.6-18, 6.1-2, 6.2-1, 6.2-2, 6.2-3, 6.6-14, 6.8-2, 6.13-6, 6.13-7, 6.13-11";
    family("L4.81", &name, cites, vec![stream], known)
}

/// An upstream, as the server received it.
fn received_upstream(upstream: Value) -> Case {
    let name = format!(
        "a decoder of {} moves the bodies as the server does",
        word(&upstream["name"])
    );
    let cites = "PROTOCOL 6.14-1, 6.14-3, 6.14-5, 6.14-6, 6.14-8, 6.14-9, 6.14-12, 6.14-13, 6.14-14, 6.14-19";
    family("L4.82", &name, cites, vec![upstream], moved)
}

/// One case that contains all these vectors.
fn family(
    group: &str,
    name: &str,
    cites: &str,
    lines: Vec<Value>,
    play: impl Fn(&mut Decoder, &Value) -> CaseResult + Send + Sync + 'static,
) -> Case {
    let lines = Arc::new(lines);
    Case::decoder(group, name)
        .keyed(name.as_bytes())
        .cites(cites)
        .play(move |trial: &mut Trial<'_>| {
            let mut decoder = trial.decoder()?;
            for line in lines.iter() {
                trial.note(format!("{} {}", word(&line["name"]), word(&line["bytes"])));
                play(&mut decoder, line)?;
            }
            Ok(())
        })
}

fn message(decoder: &mut Decoder, side: &str, line: &Value) -> CaseResult {
    let answer = decoder.ask(&json!({"message": side, "bytes": line["bytes"]}))?;
    if line.get("skipped").is_some() {
        return must(answer.get("skipped").is_some(), line, &answer);
    }
    if let Some(error) = line.get("error") {
        let reported = answer.get("error");
        // A decoder that only knows that a number is wrong may answer null.
        return must(
            reported.is_some_and(|reported| reported.is_null() || reported == error),
            line,
            &answer,
        );
    }
    must(answer["means"] == line["means"], line, &answer)
}

/// A message whose body is so many times each of its parts.
fn long(decoder: &mut Decoder, side: &str, line: &Value) -> CaseResult {
    let parts = lines_of(&line["parts"]).into_iter().flat_map(|part| {
        let times = part[1].as_u64().unwrap_or_default() as usize;
        crate::grammar::unhex(&word(&part[0])).repeat(times)
    });
    let body: Vec<u8> = parts.collect();
    let kind = line["type"].as_u64().unwrap_or_default() as u8;
    let bytes = crate::grammar::hex(&in_pieces(kind, &body));
    let answer = decoder.ask(&json!({"message": side, "bytes": bytes}))?;
    let word_of_the_answer = ["refused", "skipped", "error", "means"]
        .into_iter()
        .find(|word| answer.get(word).is_some());
    let expected = [
        ("refusal", "refused"),
        ("skipped", "skipped"),
        ("error", "error"),
    ]
    .into_iter()
    .find(|(field, _)| line.get(field).is_some())
    .map_or("means", |(_, word)| word);
    let same_error = answer["error"].is_null() || answer["error"] == line["error"];
    let name = word(&line["name"]);
    ensure(
        word_of_the_answer == Some(expected) && same_error,
        format!("{name}: the answer is {word_of_the_answer:?}; expected is {expected}"),
    )
}

fn framed(decoder: &mut Decoder, line: &Value) -> CaseResult {
    let answer = decoder.ask(&json!({"frames": line["bytes"]}))?;
    let refused = line.get("refusal").is_some();
    must(
        answer["refused"] == refused && answer["messages"] == line["messages"],
        line,
        &answer,
    )
}

fn packet(decoder: &mut Decoder, line: &Value) -> CaseResult {
    let answer = decoder.ask(&json!({"packet": line["bytes"]}))?;
    let right = if decoder.tells() {
        answer["means"] == line["means"]
    } else {
        answer["accepted"] == true
    };
    must(right, line, &answer)
}

fn repair_symbol(decoder: &mut Decoder, line: &Value) -> CaseResult {
    let bytes = crate::grammar::unhex(&word(&line["repair_symbol"]));
    let mut reader = rhumb_protocol::wire::bytes::Reader::new(&bytes);
    let read = |_| Stop::Inconclusive("a vector is not a repair symbol".into());
    let head: rhumb_protocol::packet::Head =
        rhumb_protocol::wire::Wire::decode(&mut reader).map_err(read)?;
    let sent = rhumb_protocol::packet::RepairSymbol::decode(reader).map_err(read)?;
    let question = json!({"packets": line["packets"], "row": sent.row, "stream": head.stream.0});
    let answer = decoder.ask(&question)?;
    must(answer["bytes"] == line["repair_symbol"], line, &answer)
}

fn known(decoder: &mut Decoder, line: &Value) -> CaseResult {
    let answer = decoder.ask(&json!({"stream": line["events"]}))?;
    let reported = answer["known"].as_array().cloned().unwrap_or_default();
    let events = line["events"].as_array().into_iter().flatten();
    let wanted: Vec<_> = events
        .filter(|event| event[0] == "known")
        .map(|event| event[1].clone())
        .collect();
    if reported.len() != wanted.len() {
        return Stop::fail(format!(
            "it reports its state {} times, not {}",
            reported.len(),
            wanted.len()
        ));
    }
    for (place, (reported, wanted)) in reported.into_iter().zip(wanted).enumerate() {
        if !agrees(&wanted, &reported) {
            return Stop::fail(format!(
                "report {place} is {reported}, but {wanted} is expected"
            ));
        }
    }
    Ok(())
}

fn moved(decoder: &mut Decoder, line: &Value) -> CaseResult {
    let events = lines_of(&line["events"]);
    let (mut asked, mut wanted) = (Vec::new(), Vec::new());
    for event in events {
        if event[0] == "step" {
            asked.push(json!([event[0], event[1]]));
            wanted.push(event[2].clone());
        } else {
            asked.push(event);
        }
    }
    let answer = decoder.ask(&json!({"upstream": asked}))?;
    ensure(
        answer["known"] == json!(wanted),
        format!(
            "its steps are {}, but {} are expected",
            answer["known"],
            json!(wanted)
        ),
    )
}

fn must(right: bool, line: &Value, answer: &Value) -> CaseResult {
    if right {
        return Ok(());
    }
    let (name, bytes) = (word(&line["name"]), word(&line["bytes"]));
    let wanted: String = line["means"].to_string().chars().take(200).collect();
    Stop::fail(format!(
        "{name}, {bytes}: the answer is {answer}; expected is {wanted}"
    ))
}

fn grouped(lines: &Value, key: impl Fn(&Value) -> String) -> BTreeMap<String, Vec<Value>> {
    let mut groups: BTreeMap<_, Vec<_>> = BTreeMap::new();
    for line in lines_of(lines) {
        groups.entry(key(&line)).or_default().push(line);
    }
    groups
}

fn lines_of(lines: &Value) -> Vec<Value> {
    lines
        .as_array()
        .cloned()
        .expect("the vectors have this section")
}

/// A string without quotes, any other value as JSON.
fn word(value: &Value) -> String {
    value
        .as_str()
        .map_or_else(|| value.to_string(), str::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_excerpt_of_a_vector_is_cut_between_characters() {
        let line = json!({"name": "long", "bytes": "", "means": "ä".repeat(300)});
        let Err(Stop::Fail(why)) = must(false, &line, &json!({})) else {
            panic!("the case must fail");
        };
        assert_eq!(
            why.matches('ä').count(),
            199,
            "one character is the quotation mark"
        );
    }
}
