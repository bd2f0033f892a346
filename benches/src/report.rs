//! Writes `report.html`: one self-contained page on an experiment.
//!
//! One figure comes first, then the table (a row per run, grouped by load) and the other figures. Each figure has one
//! sentence above it. Colours follow the reader's system, light or dark. All figures come from the summary; only
//! curves are read from the record.

mod figures;
mod plot;
mod words;

use std::fmt::Write as _;

use figures::{Figure, frontier};

use crate::record::{Experiment, Load};
use crate::summary::columns;
use crate::summary::{Column, RunFigures, Summary, ratios as ratios_of};

pub use figures::color;
pub use plot::{Axis, Chart, Mark, SIZE};
pub use words::escape;

/// Style sheet of the pages.
pub const STYLE: &str = include_str!("report/style.css");

/// The text of `report.html`.
#[must_use]
pub fn html(experiment: &Experiment, summary: &Summary) -> String {
    let mut page = String::new();
    let _ = write!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
    );
    page.push_str("<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n");
    page.push_str("<title>Rhumb: what a remote copy costs</title>\n<style>\n");
    page.push_str(STYLE);
    page.push_str("</style>\n</head>\n<body>\n");
    page.push_str(&opening(experiment, summary));
    let mut figures = all_figures(experiment, summary).into_iter();
    page.extend(figures.next());
    page.push_str(&provenance(summary));
    page.push_str(&table_html(summary));
    page.push_str(&ratios(summary));
    page.push_str(&modes(experiment));
    page.push_str("<h2>Limitations of Rhumb and of these figures</h2>\n<ul>\n");
    for sentence in words::limits(summary) {
        let _ = writeln!(page, "<li>{sentence}</li>");
    }
    page.push_str("</ul>\n");
    if figures.len() > 0 {
        page.push_str("<h2>Further figures</h2>\n");
    }
    page.extend(figures);
    page.push_str(DEFINITIONS);
    page.push_str("</body>\n</html>\n");
    page
}

/// The text of `report.md`: the table alone.
#[must_use]
pub fn markdown(summary: &Summary) -> String {
    format!(
        "`{}`, seed {}, on {}\n\n{}",
        summary.command,
        summary.seed,
        summary.machine,
        summary.table().to_markdown()
    )
}

fn opening(experiment: &Experiment, summary: &Summary) -> String {
    let mut text = String::from("<h1>What a remote copy of a physics scene costs</h1>\n");
    let _ = writeln!(text, "<p>{}</p>", words::what_was_run(experiment));
    for load in &experiment.loads {
        let differs = load
            .runs
            .iter()
            .find(|run| run.truth_checksum != load.truth.digest);
        if let Some(run) = differs {
            let _ = writeln!(
                text,
                "<p class=\"warn\">The runs with {} bodies are void: the engine of {} diverged from the others.</p>",
                run.config.bodies, run.config.mode
            );
        }
    }
    for replay in &summary.unfinished {
        let _ = writeln!(
            text,
            "<p class=\"warn\">Failed: {}</p>",
            escape(&replay.to_string())
        );
    }
    text
}

/// The command and the machine.
fn provenance(summary: &Summary) -> String {
    format!(
        "<pre>{}</pre>\n<p class=\"soft\">on {}</p>\n",
        escape(&summary.command),
        escape(&summary.machine)
    )
}

fn modes(experiment: &Experiment) -> String {
    let mut text = String::from("<h2>The modes</h2>\n<dl>\n");
    for mode in figures::modes_of(&experiment.loads) {
        let _ = writeln!(text, "<dt>{mode}</dt><dd>{}</dd>", words::mode(mode));
    }
    text.push_str("</dl>\n");
    text
}

/// Figures of replays: curves of a single one, or the frontier of several with different tolerances.
fn replay_figures(experiment: &Experiment, summary: &Summary) -> Vec<String> {
    if let ([load], [run]) = (&experiment.loads[..], &summary.runs[..]) {
        let curves = [
            figures::bandwidth(load, &[run]),
            figures::errors(load, &[run]),
        ];
        return curves.iter().map(|of| figure(of, "")).collect();
    }
    let frontier = frontier(summary);
    frontier
        .iter()
        .map(|frontier| figure(frontier, ""))
        .collect()
}

/// Figures of the largest load, those of the other loads folded, and those over all loads.
fn all_figures(experiment: &Experiment, summary: &Summary) -> Vec<String> {
    if summary.is_of_replays() {
        return replay_figures(experiment, summary);
    }
    let mut all = Vec::new();
    let mut runs = summary.runs.iter();
    let mut loads: Vec<(&Load, Vec<&RunFigures>)> = Vec::new();
    for load in &experiment.loads {
        loads.push((load, runs.by_ref().take(load.runs.len()).collect()));
    }
    let bodies = |runs: &[&RunFigures]| runs.first().map_or(0, |run| run.bodies);
    let what = |load: &Load, runs: &[&RunFigures]| {
        let is_free = load.runs.iter().any(|run| run.config.mode.is_free());
        let how = if is_free { ", free running" } else { "" };
        format!("{} bodies{how}", bodies(runs))
    };
    loads.sort_by_key(|(_, runs)| std::cmp::Reverse(bodies(runs)));
    let of_load = |(load, runs): &(&Load, Vec<&RunFigures>)| {
        let title = format!(", {}", what(load, runs));
        [
            figure(&figures::bandwidth(load, runs), &title),
            figure(&figures::errors(load, runs), &title),
        ]
    };
    if let Some((largest, others)) = loads.split_first() {
        all.extend(of_load(largest));
        for other in others {
            all.push(format!(
                "<details><summary>The same with {}</summary>\n{}</details>\n",
                what(other.0, &other.1),
                of_load(other).concat()
            ));
        }
        all.push(figure(
            &figures::frame_times(&experiment.loads, summary),
            "",
        ));
        all.push(figure(&figures::points(&experiment.loads, summary), ""));
    }
    all
}

fn figure(figure: &Figure, of: &str) -> String {
    let mut text = format!(
        "<h3>{}{of}</h3>\n<p>{}</p>\n<div class=\"legend\">",
        figure.title, figure.sentence
    );
    for key in &figure.keys {
        let _ = write!(
            text,
            "<span class=\"key\" style=\"--own: var({})\">{}</span>",
            key.color, key.label
        );
    }
    let svg = figure.svg.replacen("<svg ", "<svg role=\"img\" ", 1);
    let _ = writeln!(
        text,
        "</div>\n<figure aria-label=\"{}\">{svg}</figure>",
        figure.title
    );
    text
}

/// Definitions of the measured quantities.
const DEFINITIONS: &str = "<h2>How it is measured</h2>
<dl>
<dt>kbit/s down</dt><dd>all bytes from server to client after joining: UDP payload and 28 bytes of IPv4 and UDP headers
for each datagram, QUIC's encryption, acknowledgements and heartbeats included, over simulated time</dd>
<dt>payload</dt><dd>state datagrams and control stream alone, as passed to QUIC</dd>
<dt>update</dt><dd>one body's new motion; its bits are those of state datagrams as passed to QUIC, divided by the updates</dd>
<dt>error</dt><dd>an upper bound of the displacement of any point of the body: |Δp| + 2 r sin(Δθ/2), r its bounding radius;
measured at every frame for every body that can move, against the engine at the same tick</dd>
<dt>over tolerance</dt><dd>body-ticks with an error above the tolerance, by cause: a lost datagram, a tick past the stream's
watermark, an insufficient budget, or a fault, which must never occur</dd>
<dt>moving</dt><dd>replays only: bodies with a record in the recording at the tick; a body without one has not moved</dd>
<dt>recovery</dt><dd>replays only: time from sending a lost packet until all of its bodies are known again, at its tick or
later</dd>
<dt>p50, p99</dt><dd>nearest rank, never interpolated: the least measured value that the share does not exceed</dd>
<dt>frame</dt><dd>time from requesting a tick to having every pose of the returned tick, in the simulator's own thread</dd>
</dl>
<p class=\"soft\">Every number is in <code>summary.json</code>, and can be computed again from <code>trace.mcap</code>
without this program.</p>
";

/// The `table` element.
fn table_html(summary: &Summary) -> String {
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
fn ratios(summary: &Summary) -> String {
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
