//! Unpacks the kept inputs of a fuzzer into files, or packs those of a folder.

use std::path::PathBuf;

use clap::{Parser, Subcommand};
use rhumb_tests::fuzzing::inputs::{pack, unpack};
use rhumb_tests::fuzzing::{Target, target};

#[derive(Parser)]
struct Options {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    /// Writes the kept inputs and those from the golden vectors into a folder.
    Unpack { target: String, folder: PathBuf },
    /// Keeps the shortest inputs of a folder up to a number of bytes, and the findings.
    Pack {
        target: String,
        folder: PathBuf,
        bytes: usize,
    },
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let find = |name: &str| -> Result<&'static Target, String> {
        target(name).ok_or_else(|| format!("there is no target {name}"))
    };
    let count = match Options::parse().action {
        Action::Unpack { target, folder } => unpack(find(&target)?, &folder)?,
        Action::Pack {
            target,
            folder,
            bytes,
        } => pack(find(&target)?, &folder, bytes)?,
    };
    eprintln!("{count} inputs");
    Ok(())
}
