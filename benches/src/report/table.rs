//! The table at the top of the page: a row per run, grouped by load.

use std::fmt::Write as _;

use super::words::escape;
use crate::summary::{Column, RunFigures, Summary, columns, ratios as ratios_of};

/// The `table` element.
pub(super) fn table_html(summary: &Summary) -> String {
    let columns = columns(&summary.runs);
    let mut text = String::from("<div class=\"wide\"><table>\n<thead><tr>");
    for column in &columns {
        let _ = write!(
            text,
            "<th>{}<small>{}</small></th>",
            column.long, column.small
        );
    }
    text.push_str("</tr></thead>\n<tbody>\n");
    let mut load = None;
    for run in &summary.runs {
        if load != Some((&run.scene, run.bodies)) {
            load = Some((&run.scene, run.bodies));
            let _ = writeln!(
                text,
                "<tr class=\"load\"><td colspan=\"{}\">{} bodies, {}</td></tr>",
                columns.len(),
                run.bodies,
                escape(&run.scene)
            );
        }
        text.push_str(&row(run, &columns, summary));
    }
    text.push_str("</tbody></table></div>\n");
    text
}

/// Table of factors against naive replication; empty without a naive run.
pub(super) fn ratios(summary: &Summary) -> String {
    let rows = ratios_of(&summary.runs);
    let Some((titles, rows)) = rows.split_first().filter(|(_, rows)| !rows.is_empty()) else {
        return String::new();
    };
    let mut text =
        String::from("<h2>Less than naive, times</h2>\n<div class=\"wide\"><table>\n<thead><tr>");
    for title in titles {
        let _ = write!(text, "<th>{title}</th>");
    }
    text.push_str("</tr></thead>\n<tbody>\n");
    for row in rows {
        let cells: String = row
            .iter()
            .map(|cell| format!("<td>{}</td>", escape(cell)))
            .collect();
        let _ = writeln!(text, "<tr>{cells}</tr>");
    }
    text.push_str("</tbody></table></div>\n");
    text
}

fn row(run: &RunFigures, columns: &[Column], summary: &Summary) -> String {
    let mut text = String::from("<tr>");
    for (place, column) in columns.iter().enumerate() {
        let cell = escape(&(column.cell)(run, &summary.runs));
        let _ = match place {
            0 => write!(
                text,
                "<td><span class=\"key\" style=\"--own: var(--{})\">{cell}</span></td>",
                escape(&run.mode)
            ),
            _ => write!(text, "<td>{cell}</td>"),
        };
    }
    text.push_str("</tr>\n");
    text
}
