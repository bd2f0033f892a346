//! `rhumb-bench import`: a recording of another program as an `.rhtrace`.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;

use crate::output::{OutputError, print_text};
use crate::recording::{Recording, RecordingSource, write_rhtrace};
use crate::task::{Failure, ended};

/// Arguments: the recording, the file to write.
#[derive(Clone, Debug, Args)]
pub struct Import {
    #[command(flatten)]
    source: RecordingSource,
    /// File to write; packed by zstd unless it ends with .rhtrace.
    #[arg(long, value_name = "FILE", default_value = "recording.rhtrace.zst")]
    out: PathBuf,
}

/// Level of zstd: recordings are read more often than written.
const LEVEL: i32 = 9;

/// Reads the recording and writes it. Exit code 0 on success, 1 otherwise.
pub fn import(arguments: &Import) -> ExitCode {
    ended(import_one(arguments))
}

fn import_one(arguments: &Import) -> Result<(), Failure> {
    let recording = arguments.source.read()?;
    let bytes = write(&recording, &arguments.out)?;
    let seconds = f64::from(recording.ticks()) * recording.integrator.rate.step().seconds();
    let known = recording
        .truth
        .placed
        .iter()
        .filter(|placed| placed.inertia.is_some());
    print_text(&format!(
        "{}: {} bodies, {} with unequal moments of inertia, {} frames, {seconds:.3} s, {bytes} bytes\n",
        arguments.out.display(),
        recording.truth.placed.len(),
        known.count() + recording.inertias.len(),
        recording.ticks() + 1,
    ))?;
    Ok(())
}

/// Writes a recording, and returns its bytes.
fn write(recording: &Recording, path: &Path) -> Result<usize, OutputError> {
    let plain = write_rhtrace(recording);
    let failed = |cause: io::Error| OutputError::Write {
        path: path.to_owned(),
        cause,
    };
    let bytes = if path.extension().is_some_and(|end| end == "rhtrace") {
        plain
    } else {
        zstd::encode_all(plain.as_slice(), LEVEL).map_err(failed)?
    };
    let mut file = std::fs::File::create(path).map_err(failed)?;
    file.write_all(&bytes).map_err(failed)?;
    Ok(bytes.len())
}
