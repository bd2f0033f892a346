//! Replays a recorded session to the Rust client, and compares each state.
//!
//! The recording has the form of spec/vectors/streams.json, as another client wrote it. The exit code is 1 after a
//! difference.

use std::fs;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use rhumb_conformance::vectors::{agrees, replayed};
use serde_json::Value;

/// Replays a recorded session to the Rust client.
#[derive(Debug, Parser)]
struct Arguments {
    /// The recording.
    file: PathBuf,
}

fn main() -> io::Result<ExitCode> {
    let arguments = Arguments::parse();
    let recording: Value = serde_json::from_str(&fs::read_to_string(arguments.file)?)?;
    let mut out = io::stdout().lock();
    let (mut states, mut wrong) = (0, 0);
    for stream in recording["streams"].as_array().into_iter().flatten() {
        let events = stream["events"].as_array().cloned().unwrap_or_default();
        for (place, recorded, own) in replayed(&events) {
            states += 1;
            if !agrees(&recorded, &own) {
                wrong += 1;
                writeln!(
                    out,
                    "event {place}: the recording has {recorded}, the Rust client {own}"
                )?;
            }
        }
    }
    writeln!(out, "{states} states, {wrong} of them differ")?;
    let passed = states > 0 && wrong == 0;
    Ok(if passed {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}
