//! The table that opens the page: a row for each run, loads apart.

use std::fmt::Write as _;

use super::words::escape;
use crate::summary::{RunFigures, Summary, number};

/// Titles, and what stands below them in small print.
const COLUMNS: [(&str, &str); 11] = [
    ("mode", ""),
    ("kbit/s down", "mean"),
    ("less than naive", "times"),
    ("worst second", "kbit/s"),
    ("updates", "a second"),
    ("update", "bits"),
    ("error p99", "mm"),
    ("error max", "mm"),
    ("over tolerance", "body-ticks"),
    ("frame", "ms, median"),
    ("of integrated", "times"),
];

/// The `table` element.
pub(super) fn html(summary: &Summary) -> String {
    let mut text = String::from("<div class=\"wide\"><table>\n<thead><tr>");
    for (title, small) in COLUMNS {
        let _ = write!(text, "<th>{title}<small>{small}</small></th>");
    }
    text.push_str("</tr></thead>\n<tbody>\n");
    let mut load = None;
    for run in &summary.runs {
        if load != Some((&run.scene, run.bodies)) {
            load = Some((&run.scene, run.bodies));
            let _ = writeln!(
                text,
                "<tr class=\"load\"><td colspan=\"{}\">{} bodies, {}</td></tr>",
                COLUMNS.len(),
                run.bodies,
                escape(&run.scene)
            );
        }
        text.push_str(&row(run, summary));
    }
    text.push_str("</tbody></table></div>\n");
    text
}

fn row(run: &RunFigures, summary: &Summary) -> String {
    let naive = run
        .beside(&summary.runs, "naive")
        .and_then(|run| run.mean_kbps_down);
    let integrated = run
        .beside(&summary.runs, "integrated")
        .and_then(|run| run.frame_ms);
    let frame = run.frame_ms.map(|ms| ms.p50);
    let errors = run.surface_error_m;
    let over = run.over_tolerance.as_ref().map(|over| {
        let why: Vec<_> = over
            .by_cause
            .iter()
            .filter(|(_, count)| **count > 0)
            .map(|(cause, count)| format!("{count} {cause}"))
            .collect();
        if why.is_empty() {
            "0".to_owned()
        } else {
            why.join(", ")
        }
    });
    let cells = [
        number(run.mean_kbps_down),
        number(
            naive
                .zip(run.mean_kbps_down)
                .map(|(naive, own)| naive / own),
        ),
        number(run.worst_second_kbps_down),
        number(run.updates_per_second()),
        number(run.bits_per_update),
        number(errors.map(|errors| 1e3 * errors.p99)),
        number(errors.map(|errors| 1e3 * errors.max)),
        over.unwrap_or_else(|| number(None)),
        number(frame),
        number(frame.zip(integrated).map(|(own, base)| own / base.p50)),
    ];
    let mut text = format!(
        "<tr><td><span class=\"key\" style=\"--own: var(--{0})\">{0}</span></td>",
        escape(&run.mode)
    );
    for cell in cells {
        let _ = write!(text, "<td>{cell}</td>");
    }
    text.push_str("</tr>\n");
    text
}
