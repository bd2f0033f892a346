//! Parts of a page: HTML, tables, and the circumstances of a measurement.
//!
//! A table is written for a terminal, as Markdown or as HTML. The circumstances stand at the head of a page.

use std::fmt::Write as _;
use std::path::Path;

use rhumb_bench::numbers::aligned;
use rhumb_bench::report::{STYLE, escape};
use rhumb_bench::{machine, output};
use serde::{Deserialize, Serialize};

use crate::analysis::PaperFigure;
use crate::processor::CoreAssignment;
use crate::settings::PaperError;

/// A self-contained page.
pub(crate) fn page(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{body}</body>\n</html>\n"
    )
}

/// A figure with its legend.
pub(crate) fn figure_html(figure: &PaperFigure) -> String {
    let mut text = format!("<h3>{}</h3>\n<div class=\"legend\">", escape(figure.title));
    for (color, label) in &figure.keys {
        let hue = format!("#{:02X}{:02X}{:02X}", color.0, color.1, color.2);
        let _ = write!(
            text,
            "<span class=\"key\" style=\"--own: {hue}\">{}</span>",
            escape(label)
        );
    }
    let svg = figure.svg.replacen("<svg ", "<svg role=\"img\" ", 1);
    let _ = writeln!(
        text,
        "</div>\n<figure aria-label=\"{}\">{svg}</figure>",
        escape(figure.title)
    );
    text
}

/// Title, columns, rows and a note.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Table {
    pub(crate) title: String,
    pub(crate) columns: Vec<String>,
    pub(crate) rows: Vec<Vec<String>>,
    /// Text below the table; may be empty.
    pub(crate) note: String,
}

impl Table {
    /// A table without rows.
    pub(crate) fn new(title: &str, columns: impl IntoIterator<Item = impl Into<String>>) -> Self {
        Self {
            title: title.to_owned(),
            columns: columns.into_iter().map(Into::into).collect(),
            ..Self::default()
        }
    }

    /// Aligned text under its title.
    pub(crate) fn to_text(&self) -> String {
        let mut rows = vec![self.columns.clone()];
        rows.extend(self.rows.iter().cloned());
        format!("\n{}\n{}", self.title, aligned(&rows))
    }

    /// Markdown, without the title.
    pub(crate) fn to_markdown(&self) -> String {
        let line = |cells: &[String]| {
            let cells: Vec<_> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        let mut text = line(&self.columns);
        text.push_str("|---");
        text.push_str(&"|---:".repeat(self.columns.len().saturating_sub(1)));
        text.push_str("|\n");
        for row in &self.rows {
            text.push_str(&line(row));
        }
        if !self.note.is_empty() {
            let _ = write!(text, "\n{}\n", self.note);
        }
        text
    }

    /// HTML, with the title.
    pub(crate) fn to_html(&self) -> String {
        let cells = |cells: &[String], kind: &str| -> String {
            let cell = |cell: &String| format!("<{kind}>{}</{kind}>", escape(cell));
            cells.iter().map(cell).collect()
        };
        let mut text = format!(
            "<h3>{}</h3>\n<div class=\"wide\"><table>\n<thead><tr>{}</tr></thead>\n<tbody>\n",
            escape(&self.title),
            cells(&self.columns, "th")
        );
        for row in &self.rows {
            let _ = writeln!(text, "<tr>{}</tr>", cells(row, "td"));
        }
        text.push_str("</tbody></table></div>\n");
        if !self.note.is_empty() {
            let _ = writeln!(text, "<p class=\"soft\">{}</p>", escape(&self.note));
        }
        text
    }
}

/// Circumstances of a task's measurement.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Provenance {
    /// The command line; its paths have no folders.
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
    /// The provenance of this process, on a machine as described before the process was bound to cores.
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

    /// The provenance in Markdown; `each` names the unit that the number of frames is of.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_three_forms_show_the_same_table() {
        let mut table = Table::new("Balls & frames", ["load", "a|b"]);
        table.rows.push(vec!["500".to_owned(), "<1".to_owned()]);
        table.note = "one < two".to_owned();
        assert_eq!(table.to_text(), "\nBalls & frames\nload  a|b\n500    <1\n");
        assert_eq!(
            table.to_markdown(),
            "| load | a\\|b |\n|---|---:|\n| 500 | <1 |\n\none < two\n"
        );
        let html = table.to_html();
        assert!(html.contains("<h3>Balls &amp; frames</h3>"));
        assert!(html.contains("<tr><td>500</td><td>&lt;1</td></tr>"));
        assert!(html.contains("one &lt; two"));
    }
}
