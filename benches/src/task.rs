//! The frame of every task: its end, its provenance, its file and tables.

use std::error::Error;
use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

use serde::{Deserialize, Serialize};

use crate::machine;
use crate::output::{self, OutputError, print_text};
use crate::summary::aligned;

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
    /// The command line, as typed.
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
            command: output::command_line(),
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
    output::write_json(&folder.join(file), figures)?;
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
