//! The frame of every task: its end, its provenance, its output files.
//!
//! The files are summary, report, trace and viewer layout. Each is written whole or not at all.

use std::error::Error;
use std::ffi::OsStr;
use std::fmt;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde::{Deserialize, Serialize};

use crate::numbers::{aligned, pretty_json};
use crate::record::Experiment;
use crate::summary::Summary;
use crate::trace::{self, TraceError, TraceOptions};
use crate::{machine, report};

/// Any error that ends a task; its text is for the user.
pub type Failure = Box<dyn Error + Send + Sync>;

/// Exit code 0 on success; otherwise prints the failure to standard error and returns 1.
pub(crate) fn ended(result: Result<(), Failure>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // If standard error is closed, no other place is left to report to.
            let _ = writeln!(io::stderr(), "error: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// Source of figures.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// The command line; its paths have no folders.
    pub command: String,
    /// Processor, cores, operating system.
    pub machine: String,
    /// Commit and optimisation of the build.
    pub build: String,
}

impl Provenance {
    /// This process, on this machine.
    pub(crate) fn here() -> Self {
        Self {
            command: command_line(),
            machine: machine::describe(),
            build: machine::build(),
        }
    }

    /// The lines of a document.
    #[must_use]
    pub fn paragraph(&self) -> String {
        let Self {
            command,
            machine,
            build,
        } = self;
        format!("    {command}\n\nOn {machine} ({build}).")
    }
}

/// Writes the figures to a file of the folder, and prints tables with their titles, as far as they have rows.
pub(crate) fn write(
    folder: &Path,
    file: &str,
    figures: &impl Serialize,
    tables: &[(&str, Vec<Vec<String>>)],
) -> Result<(), OutputError> {
    write_json(&folder.join(file), figures)?;
    for (title, rows) in tables.iter().filter(|(_, rows)| rows.len() > 1) {
        let title = if title.is_empty() {
            String::new()
        } else {
            format!("\n{title}\n")
        };
        print_text(&format!("{title}{}", aligned(rows)))?;
    }
    print_text(&format!("\nwritten to {}\n", folder.display()))
}

/// The error of an output that was not written.
#[derive(Debug)]
pub enum OutputError {
    /// A file or folder cannot be written.
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// The trace cannot be written.
    Trace(TraceError),
}

impl fmt::Display for OutputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Write { path, cause } => write!(f, "cannot write {}: {cause}", path.display()),
            Self::Trace(cause) => cause.fmt(f),
        }
    }
}

impl Error for OutputError {}

/// Creates the folder and its parents if missing.
pub fn make_folder(out: &Path) -> Result<(), OutputError> {
    std::fs::create_dir_all(out).map_err(|cause| OutputError::Write {
        path: out.to_owned(),
        cause,
    })
}

/// The command line of this process. Folders of one machine are left out: those of the program and of all paths.
pub fn command_line() -> String {
    let mut words = std::env::args();
    let program = words.next().unwrap_or_default();
    let name = Path::new(&program).file_stem().unwrap_or_default();
    words.fold(name.to_string_lossy().into_owned(), |line, word| {
        line + " " + &without_folders(&word)
    })
}

/// An argument, of each path in it the last name.
fn without_folders(argument: &str) -> String {
    let parts = argument.split_inclusive(['=', ',']).map(|part| {
        let path = part.trim_end_matches(['=', ',']);
        let name = Path::new(path).file_name().and_then(OsStr::to_str);
        [name.unwrap_or(path), &part[path.len()..]].concat()
    });
    parts.collect()
}

/// Prints the table and writes all outputs. `drawn` is the largest body count drawn in the trace; `None` writes no
/// trace.
///
/// Outputs already written are kept when a later one fails.
pub fn write_all(
    out: &Path,
    experiment: &Experiment,
    drawn: Option<u32>,
) -> Result<(), OutputError> {
    let summary = write_figures(out, experiment)?;
    print_text(&summary.table().to_string())?;
    print_text(&summary.ratios())?;
    if let Some(scene_bodies_max) = drawn {
        let options = TraceOptions {
            scene_bodies_max,
            ..TraceOptions::default()
        };
        write_trace(out, experiment, &options)?;
    }
    print_text(&format!("\nwritten to {}\n", out.display()))
}

/// Writes the summary and the report of the measurements so far.
pub fn write_figures(out: &Path, experiment: &Experiment) -> Result<Summary, OutputError> {
    let summary = Summary::of(experiment);
    write_file(&out.join("summary.json"), summary.to_json().as_bytes())?;
    let page = report::html(experiment, &summary);
    write_file(&out.join("report.html"), page.as_bytes())?;
    Ok(summary)
}

/// A progress bar on standard error. Where that is no terminal, a line says what begins.
pub fn progress_bar(length: u64, what: String) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::stderr());
    if bar.is_hidden() && !what.is_empty() {
        // If standard error is closed, no other place is left to report to.
        let _ = writeln!(io::stderr(), "{what} ...");
    }
    let style = ProgressStyle::with_template("{msg:28} {bar:32} {pos}/{len} {elapsed} left {eta}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar.with_message(what)
}

/// Reports a part of the result as soon as it is there, on standard error.
pub fn note(bar: &ProgressBar, text: &str) {
    if bar.is_hidden() {
        // If standard error is closed, no other place is left to report to.
        let _ = writeln!(io::stderr(), "{text}");
    } else {
        bar.println(text);
    }
}

/// Style of a progress bar that shows a percentage instead of a step count.
pub fn share_style() -> ProgressStyle {
    let style = ProgressStyle::with_template("{msg:34} {bar:32} {percent} % {elapsed} left {eta}");
    style.unwrap_or_else(|_| ProgressStyle::default_bar())
}

/// Path of a task's trace.
pub fn trace_of(out: &Path) -> PathBuf {
    out.join("trace.mcap")
}

fn write_trace(
    out: &Path,
    experiment: &Experiment,
    options: &TraceOptions,
) -> Result<(), OutputError> {
    let bar = progress_bar(0, "trace".to_owned());
    let path = trace_of(out);
    let written = trace::write(&path, experiment, options, &mut |progress| {
        bar.set_length(progress.of);
        bar.set_position(progress.done);
    });
    bar.finish_and_clear();
    written.map_err(OutputError::Trace)?;
    write_file(
        &out.join("layout.json"),
        trace::layout(experiment).as_bytes(),
    )
}

/// Writes a value as indented JSON.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<(), OutputError> {
    let text = pretty_json(value).map_err(|cause| OutputError::Write {
        path: path.to_owned(),
        cause: cause.into(),
    })?;
    write_file(path, text.as_bytes())
}

/// Writes to a temporary path, then renames: a reader never finds a half-written file under the final name.
pub fn write_file(path: &Path, bytes: &[u8]) -> Result<(), OutputError> {
    let partial = path.with_extension("partial");
    let written = std::fs::write(&partial, bytes).and_then(|()| std::fs::rename(&partial, path));
    written.map_err(|cause| {
        // The file may not exist; the original error is reported either way.
        let _ = std::fs::remove_file(&partial);
        OutputError::Write {
            path: path.to_owned(),
            cause,
        }
    })
}

/// Writes text to standard output, at once.
pub fn print_text(text: &str) -> Result<(), OutputError> {
    let mut out = io::stdout().lock();
    let printed = out.write_all(text.as_bytes()).and_then(|()| out.flush());
    printed.map_err(|cause| OutputError::Write {
        path: "standard output".into(),
        cause,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_recorded_without_its_folder() {
        let recorded = |argument: &str, expected: &str| {
            assert_eq!(without_folders(argument), expected, "{argument}");
        };
        recorded("/home/me/results/pit", "pit");
        recorded("target/release/rhumb-server", "rhumb-server");
        recorded("--out=/tmp/pit/", "--out=pit");
        recorded(
            "cubes=/data/a.zst,pit,b=../b.mcap",
            "cubes=a.zst,pit,b=b.mcap",
        );
        for unchanged in [
            "--no-trace",
            "rtt=100ms,loss=5%",
            "500..2000",
            "..",
            ",=",
            "",
        ] {
            recorded(unchanged, unchanged);
        }
    }
}
