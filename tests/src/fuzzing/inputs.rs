//! The kept inputs of each fuzzer, and those from the golden vectors.
//!
//! `tests/fuzz/corpus/NAME.hex` has one input per line, in hexadecimal digits; a line that begins with `#` describes the
//! next one. Seeds are generated from `spec/vectors` on demand, so that they follow the wire format.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::target::Target;
use rhumb_conformance::grammar::{hex, unhex};
use rhumb_conformance::vectors::golden;

/// The bytes of each of these cases.
///
/// # Panics
///
/// If they are no list.
#[must_use]
pub fn with_bytes(cases: &Value) -> Vec<Vec<u8>> {
    let cases = cases
        .as_array()
        .expect("the vectors have this section")
        .iter();
    let bytes = cases.filter_map(|case| case["bytes"].as_str());
    bytes.map(unhex).collect()
}

/// A file of this crate.
fn file(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn path(target: &Target) -> PathBuf {
    file(&format!("fuzz/corpus/{}.hex", target.name))
}

/// The kept inputs of a target.
///
/// # Panics
///
/// When the file is missing.
#[must_use]
pub fn kept(target: &Target) -> Vec<Vec<u8>> {
    let text =
        std::fs::read_to_string(path(target)).expect("each fuzzer has a file of kept inputs");
    let inputs = text.lines().filter(|line| !line.starts_with('#'));
    inputs.map(unhex).collect()
}

/// The inputs from the golden vectors whose bytes a target can decode.
#[must_use]
pub fn seeds(target: &Target) -> Vec<Vec<u8>> {
    let control = |sections: [&str; 2]| {
        let control = golden("control.json");
        let cases = sections
            .into_iter()
            .flat_map(|name| with_bytes(&control[name]));
        behind(&[255], cases)
    };
    match target.name {
        "client_messages" => control(["client messages", "refused client messages"]),
        "server_messages" => control(["server messages", "refused server messages"]),
        "state_packets" => behind(&[0], datagrams()),
        "side_packets" => behind(&[1], datagrams()),
        "recordings" => behind(&[3], std::iter::once(trace())),
        _ => Vec::new(),
    }
}

/// A trace of `rhumb-bench evaluate --scene free-fall --bodies 1 --seconds 0.1 --modes integrated`.
fn trace() -> Vec<u8> {
    let path = file("data/traces/free_fall.mcap");
    std::fs::read(path).expect("a trace in the repository")
}

fn datagrams() -> impl Iterator<Item = Vec<u8>> {
    let packets = golden("packets.json");
    let sections = ["accepted", "refused"];
    let cases = sections
        .into_iter()
        .flat_map(move |name| with_bytes(&packets[name]));
    cases.collect::<Vec<_>>().into_iter()
}

fn behind(front: &[u8], cases: impl Iterator<Item = Vec<u8>>) -> Vec<Vec<u8>> {
    cases.map(|bytes| [front, &bytes].concat()).collect()
}

/// Writes the kept inputs and the seeds of a target into a folder, one file each, as a fuzzer expects them.
///
/// # Errors
///
/// When a file cannot be written.
pub fn unpack(target: &Target, folder: &Path) -> std::io::Result<usize> {
    std::fs::create_dir_all(folder)?;
    let mut inputs = kept(target);
    inputs.extend(seeds(target));
    for (number, input) in inputs.iter().enumerate() {
        std::fs::write(folder.join(format!("{number:05}")), input)?;
    }
    Ok(inputs.len())
}

/// Replaces the kept inputs by those of a folder: the shortest, up to a total number of bytes. Findings and their
/// descriptions stay.
///
/// # Errors
///
/// When a file cannot be read or written.
pub fn pack(target: &Target, folder: &Path, bytes_max: usize) -> std::io::Result<usize> {
    let known = std::fs::read_to_string(path(target)).unwrap_or_default();
    let mut lines = findings(&known);
    let mut inputs = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        inputs.push(std::fs::read(entry?.path())?);
    }
    inputs.sort_by(|a, b| (a.len(), a).cmp(&(b.len(), b)));
    let seeds = seeds(target);
    let mut bytes = 0;
    for input in inputs {
        bytes += input.len();
        let line = hex(&input);
        if bytes > bytes_max {
            break;
        }
        if !input.is_empty() && !seeds.contains(&input) && !lines.contains(&line) {
            lines.push(line);
        }
    }
    let count = lines.iter().filter(|line| !line.starts_with('#')).count();
    std::fs::write(path(target), lines.join("\n") + "\n")?;
    Ok(count)
}

/// The lines about findings, each with its input.
fn findings(text: &str) -> Vec<String> {
    let mut kept = Vec::new();
    let mut sent = false;
    for line in text.lines() {
        let says = line.starts_with('#');
        if says || sent {
            kept.push(line.to_owned());
        }
        sent = says;
    }
    kept
}
