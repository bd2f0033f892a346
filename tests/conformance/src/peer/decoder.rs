//! The decoder under test: a process that answers lines, or the built-in one.
//!
//! A question and its answer are one JSON object per line; `docs/book/src/implementing.md` describes them.

use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

use rhumb_protocol::message::Frames;
use rhumb_protocol::packet::RepairSymbol;
use serde_json::{Value, json};

use super::datagram;
use super::stderr_tail::StderrTail;
use crate::grammar::{Grammar, hex, unhex};
use crate::log::Log;
use crate::outcome::Stop;
use crate::vectors::{Decoded, Sender, error_json, replayed, upstream_states};

/// The decoder under test.
pub enum Decoder {
    /// A process.
    Process {
        /// The process, which is killed on drop.
        child: Child,
        /// Its standard input, for questions.
        questions: ChildStdin,
        /// The lines of its standard output.
        answers: Receiver<String>,
        /// Time limit of one answer.
        time_limit: Duration,
        /// The tail of its standard error.
        stderr_tail: Option<StderrTail>,
        /// The log that receives this tail on drop.
        log: Log,
    },
    /// The project's own decoder.
    House(Box<Grammar>),
}

impl Decoder {
    pub(crate) fn start(exec: Option<&str>, time_limit: Duration, log: Log) -> Result<Self, Stop> {
        let Some(exec) = exec else {
            return Ok(Self::House(Box::new(Grammar::load())));
        };
        let cannot = |what: &str| Stop::Inconclusive(format!("the decoder cannot be run: {what}"));
        let mut child = Command::new("sh")
            .args(["-c", &format!("exec {exec}")])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|error| cannot(&error.to_string()))?;
        let questions = child.stdin.take().ok_or_else(|| cannot("no input"))?;
        let out = child.stdout.take().ok_or_else(|| cannot("no output"))?;
        let stderr_tail = child.stderr.take().map(StderrTail::of);
        let (written, answers) = mpsc::channel();
        thread::spawn(move || {
            for line in BufReader::new(out).lines().map_while(Result::ok) {
                if written.send(line).is_err() {
                    return;
                }
            }
        });
        Ok(Self::Process {
            child,
            questions,
            answers,
            time_limit,
            stderr_tail,
            log,
        })
    }

    /// Asks a question and returns the answer.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when no JSON object comes in time; [`Stop::Unsupported`] when the decoder declares so.
    pub fn ask(&mut self, question: &Value) -> Result<Value, Stop> {
        let answer = match self {
            Self::House(grammar) => answer(grammar, question),
            Self::Process {
                questions,
                answers,
                time_limit,
                ..
            } => {
                let lost = |why: String| Stop::Fail(format!("no answer to {question}: {why}"));
                writeln!(questions, "{question}").map_err(|error| lost(error.to_string()))?;
                let line = answers
                    .recv_timeout(*time_limit)
                    .map_err(|error| lost(error.to_string()))?;
                serde_json::from_str(&line).map_err(|error| lost(error.to_string()))?
            }
        };
        if answer.get("unsupported").is_some() {
            return Err(Stop::Unsupported("declared by the decoder".into()));
        }
        Ok(answer)
    }

    /// True if its answers contain the full meaning of packets.
    #[must_use]
    pub const fn tells(&self) -> bool {
        matches!(self, Self::Process { .. })
    }
}

impl Drop for Decoder {
    fn drop(&mut self) {
        if let Self::Process {
            child,
            stderr_tail,
            log,
            ..
        } = self
        {
            // Killing a process that has already ended does nothing.
            let _ = child.kill();
            let _ = child.wait();
            let stderr_tail = stderr_tail.iter().flat_map(StderrTail::last);
            stderr_tail.for_each(|line| log.note(line));
        }
    }
}

/// The answer of the project's own decoder. It only classifies packets; their meaning is tested by their own vectors.
fn answer(grammar: &Grammar, question: &Value) -> Value {
    if let Some(side) = question["message"].as_str() {
        let side = if side == "client" {
            Sender::Client
        } else {
            Sender::Server
        };
        return message(grammar, side, &bytes_of(&question["bytes"]));
    }
    if question.get("frames").is_some() {
        return frames(&bytes_of(&question["frames"]));
    }
    if question.get("packet").is_some() {
        return match datagram::read(&bytes_of(&question["packet"])) {
            Ok(()) => json!({"accepted": true}),
            Err(why) => json!({"refused": format!("{why:?}")}),
        };
    }
    if let Some(packets) = question["packets"].as_array() {
        let packets: Vec<_> = packets
            .iter()
            .map(|row| (row[0].as_u64().unwrap_or_default(), bytes_of(&row[1])))
            .collect();
        let packets: Vec<_> = packets.iter().map(|(n, bytes)| (*n, &bytes[..])).collect();
        let row = question["row"].as_u64().unwrap_or_default() as u8;
        let stream = rhumb_protocol::packet::StreamId(
            question["stream"].as_u64().unwrap_or_default() as u32,
        );
        let repair_symbol =
            RepairSymbol::of(row, &packets).map(|repair_symbol| hex(&repair_symbol.encode(stream)));
        return json!({"bytes": repair_symbol});
    }
    if let Some(events) = question["upstream"].as_array() {
        return json!({"known": upstream_states(events)});
    }
    let events = question["stream"].as_array().cloned().unwrap_or_default();
    let known = replayed(&events).into_iter();
    json!({"known": known.map(|(_, _, known)| known).collect::<Vec<_>>()})
}

fn bytes_of(value: &Value) -> Vec<u8> {
    value.as_str().map(unhex).unwrap_or_default()
}

fn message(grammar: &Grammar, side: Sender, bytes: &[u8]) -> Value {
    let mut frames = Frames::new();
    frames.push(bytes);
    let Ok(Some(framed)) = frames.next_frame() else {
        return json!({"refused": "not a message"});
    };
    let mut sent = match side.outcome(framed.kind, &framed.body) {
        Decoded::Skipped => return json!({"skipped": true}),
        Decoded::Refused(why) => return json!({"refused": format!("{why:?}")}),
        Decoded::UnknownCommand => return json!({"error": {"is": "UnknownCommand"}}),
        Decoded::NoMotion(quantity) => {
            let error = rhumb_protocol::scene::Invalid::not_finite(quantity);
            return json!({"error": error_json(error)});
        }
        Decoded::Accepted(None) => json!({}),
        Decoded::Accepted(Some(invalid)) => json!({"error": error_json(invalid)}),
    };
    let typed = [&[framed.kind], &framed.body[..]].concat();
    if let Ok((means, _)) = grammar.read(side.type_name(), &typed) {
        sent["means"] = means;
    }
    sent
}

fn frames(bytes: &[u8]) -> Value {
    let mut frames = Frames::new();
    frames.push(bytes);
    let mut messages = Vec::new();
    loop {
        match frames.next_frame() {
            Ok(Some(framed)) => {
                messages.push(json!({"type": framed.kind, "body": hex(&framed.body)}));
            }
            Ok(None) => return json!({"messages": messages, "refused": false}),
            Err(_) => return json!({"messages": messages, "refused": true}),
        }
    }
}

impl std::fmt::Debug for Decoder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.tells() {
            "a process"
        } else {
            "built-in"
        })
    }
}
