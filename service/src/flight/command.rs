//! `rhumb-server flight`: prints the file of a flight recorder.

use std::error::Error;
use std::fs;
use std::io::Write;
use std::path::Path;

use rhumb_protocol::packet::Datagram;
use rhumb_protocol::scene::Command;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;

use super::file::decode;
use super::ring::{FlightEntry, entries};

/// Longest text of a printed command.
const COMMAND_TEXT_MAX: usize = 240;

/// Prints a file, oldest event first.
///
/// # Errors
///
/// For a file that cannot be read, with its path and the cause.
pub(crate) fn run(path: &Path, out: &mut dyn Write) -> Result<(), Box<dyn Error>> {
    let shown = path.display();
    let bytes = fs::read(path).map_err(|cause| format!("cannot read {shown}: {cause}"))?;
    let (head, rest) = decode(&bytes).map_err(|cause| format!("{shown} {cause}"))?;
    writeln!(out, "scene {}", head.scene)?;
    writeln!(out, "cause {}", head.cause)?;
    writeln!(
        out,
        "written {} seconds after 1970 by rhumb-server {}",
        head.written, head.server
    )?;
    writeln!(out, "{} older entries are not kept", head.dropped)?;
    for entry in entries(rest) {
        let entry = entry.ok_or_else(|| format!("{shown} has an entry of another version"))?;
        writeln!(out, "{}", text(&entry))?;
    }
    Ok(())
}

fn text(entry: &FlightEntry<'_>) -> String {
    let ms = |ns: u64| ns as f64 / 1e6;
    match entry {
        FlightEntry::Joined { peer, client } => {
            let client = client.unwrap_or("without a token");
            format!("client {peer} joins: {client}")
        }
        FlightEntry::Left { peer } => format!("client {peer} leaves"),
        FlightEntry::Command {
            peer,
            number,
            length,
            bytes,
        } => {
            let shown = command(bytes, *length as usize);
            format!("client {peer} command {number}: {shown}")
        }
        FlightEntry::Refused { error } => format!("  refused: {error}"),
        FlightEntry::StepBegan { at_ns, tick } => {
            format!("{:.6} s: step from tick {tick}", *at_ns as f64 / 1e9)
        }
        FlightEntry::Stepped {
            tick,
            step_ns,
            publish_ns,
            members,
            bodies,
            awake,
            digest,
        } => format!(
            "  tick {tick}: step {:.3} ms, publish {:.3} ms, {members} members, {bodies} bodies, {awake} awake, \
             digest {digest:016x}",
            ms(*step_ns),
            ms(*publish_ns),
        ),
        FlightEntry::Packet { length, head } => format!("  {}, {length} bytes", packet(head)),
    }
}

/// A command as far as it was kept.
fn command(bytes: &[u8], length: usize) -> String {
    if bytes.len() < length {
        return format!(
            "{length} bytes, of which {} were kept: {bytes:02x?}",
            bytes.len()
        );
    }
    let mut from = Reader::new(bytes);
    match Command::decode(&mut from) {
        Ok(command) => {
            let text = format!("{command:?}");
            text.chars().take(COMMAND_TEXT_MAX).collect()
        }
        Err(error) => format!("{error:?}: {bytes:02x?}"),
    }
}

fn packet(head: &[u8]) -> String {
    match Datagram::open(head) {
        Ok(datagram) => {
            let head = datagram.head();
            format!("{}: {:?}", head.stream, head.kind)
        }
        Err(error) => format!("packet {head:02x?}: {error:?}"),
    }
}
