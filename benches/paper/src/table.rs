//! A table of text and numbers, for a terminal, Markdown and HTML.

use std::fmt::Write as _;

use rhumb_bench::report::escape;
use rhumb_bench::summary::aligned;

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
