//! Circumstances of a task's measurement, at the head of its page.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::cores::CoreAssignment;
use super::error::PaperError;
use super::page::page;
use super::table::Table;
use rhumb_bench::machine;
use rhumb_bench::output;
use rhumb_bench::report::escape;

/// Circumstances of a task's measurement.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Provenance {
    /// The command line, as typed.
    pub(crate) command: String,
    /// Processor, cores, operating system.
    machine: String,
    /// Build profile, version and commit.
    build: String,
    /// Cores of the caller and the servers.
    cores: String,
    /// Seed of the scene.
    seed: u64,
    /// Frames of each row or point.
    frames: u32,
}

impl Provenance {
    /// That of this process, on a machine as described before the process was bound to cores.
    pub(crate) fn new(machine: String, places: &CoreAssignment, seed: u64, frames: u32) -> Self {
        Self {
            command: output::command_line(),
            machine,
            build: machine::build(),
            cores: places.describe(),
            seed,
            frames,
        }
    }

    /// In Markdown; `each`: what the number of frames is of.
    pub(crate) fn markdown(&self, each: &str) -> String {
        format!(
            "    {}\n\nOn {} ({}; {} build), seed {}, {} frames {each}.",
            self.command, self.machine, self.cores, self.build, self.seed, self.frames
        )
    }

    /// Writes the tables of a task as NAME.md and NAME.html.
    pub(crate) fn write(
        &self,
        out: &Path,
        name: &str,
        title: &str,
        tables: &[Table],
    ) -> Result<(), PaperError> {
        let mut text = format!("# {title}\n\n`{}`\n", self.command);
        let mut body = format!("<pre>{}</pre>\n", escape(&self.command));
        for table in tables {
            text.push_str(&format!("\n## {}\n\n{}", table.title, table.to_markdown()));
            body.push_str(&table.to_html());
        }
        output::write_file(&out.join(format!("{name}.md")), text.as_bytes())?;
        let html = page(title, &body);
        output::write_file(&out.join(format!("{name}.html")), html.as_bytes())?;
        Ok(())
    }
}
