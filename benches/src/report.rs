//! Writes `report.html`: one self-contained page on an experiment.
//!
//! One figure comes first, then the table (a row per run, grouped by load) and the other figures. Each figure has one
//! sentence above it. Colours follow the reader's system, light or dark. All figures come from the summary; only
//! curves are read from the record. Every number of a sentence comes from the summary too; a limitation that an experiment
//! does not show is left out.

mod figures;
mod plot;

use std::fmt::Write as _;

use crate::numbers::number;
use crate::record::{Experiment, Load, Mode, RunConfig};
use crate::summary::{Column, RunFigures, Summary, columns, ratios as ratios_of};
use figures::{Figure, frontier};
use plot::plain;

pub use figures::color;
pub use plot::{Axis, Chart, Mark, SIZE};

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
    for sentence in limits(summary) {
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
    let _ = writeln!(text, "<p>{}</p>", what_was_run(experiment));
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
        let _ = writeln!(text, "<dt>{mode}</dt><dd>{}</dd>", meaning(mode));
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

/// Escapes text for HTML.
pub fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            other => safe.push(other),
        }
    }
    safe
}

/// A paragraph about what was run.
fn what_was_run(experiment: &Experiment) -> String {
    let config: Vec<_> = experiment
        .loads
        .iter()
        .flat_map(|load| &load.runs)
        .map(|run| &run.config)
        .collect();
    let Some(first) = config.first() else {
        return "Nothing was run.".to_owned();
    };
    let mut loads: Vec<_> = config
        .iter()
        .map(|config| config.bodies.to_string())
        .collect();
    loads.dedup();
    let link = config
        .iter()
        .find(|config| config.mode != Mode::Integrated)
        .map(|config| &config.link);
    if config.iter().all(|config| config.replayed.is_some()) {
        return escape(&what_was_replayed(first, config.len(), experiment.seed));
    }
    let tolerance = config.iter().find_map(|config| config.tolerance_m);
    let mut text = format!(
        "The physics scene {} was stepped {} times ({} simulated seconds, {} steps per second), with {} bodies. A \
         simulator in another process keeps a copy of all of them. This page shows the cost of the copy and its \
         errors.",
        first.scene,
        first.ticks,
        plain(f64::from(first.ticks) * first.step_s),
        plain(1.0 / first.step_s),
        enumeration(&loads),
    );
    if let Some(tolerance_m) = tolerance {
        let millimetres = plain(tolerance_m * 1e3);
        let _ = write!(
            text,
            " Rhumb's tolerance for any point of any body was {millimetres} mm."
        );
    }
    if let Some(link) = link.filter(|link| !link.is_empty()) {
        let _ = write!(text, " The link between the programs: {link}.");
    }
    if experiment.loads.iter().any(|load| load.runs.len() > 1) {
        text.push_str(
            " The same script with the same seed ran in every mode, in turn, tick by tick, so machine noise \
             affected all modes alike.",
        );
    }
    let _ = write!(text, " The seed was {}.", experiment.seed);
    escape(&text)
}

/// The recording and the number of its replays.
fn what_was_replayed(first: &RunConfig, runs: usize, seed: u64) -> String {
    let times = match runs {
        1 => "once".to_owned(),
        _ => format!("{runs} times, once for each row"),
    };
    format!(
        "The recording {} of {} bodies and {} simulated seconds ({} steps per second) was replayed {times}, over a \
         link in simulated time. This page shows the cost of each copy and its errors. One seed gives one result, \
         bit exact; the seed was {seed}.",
        first.scene,
        first.bodies,
        plain(f64::from(first.ticks) * first.step_s),
        plain((1.0 / first.step_s * 1e3).round() / 1e3),
    )
}

/// Joins items: `a`, `a and b`, `a, b and c`.
fn enumeration(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// Description of a mode.
const fn meaning(mode: Mode) -> &'static str {
    match mode {
        Mode::Integrated => {
            "the engine runs in the simulator's own process. No network: the baseline of frame times."
        }
        Mode::Naive => {
            "the engine runs in another process and sends every body's full state each tick, 56 bytes per body."
        }
        Mode::Rhumb => {
            "the engine runs in another process and sends only updates that the copy cannot predict; the simulator \
             waits for each tick."
        }
        Mode::RhumbPipelined => {
            "like rhumb, but the simulator continues while the engine steps, and receives each tick one tick later."
        }
        Mode::NaiveFree => "the free-running server sends every body's full state each tick.",
        Mode::RhumbFree => {
            "like rhumb, but the engine runs by its own clock in real time; the simulator never waits."
        }
        Mode::AppAll => {
            "the engine runs in another process and uses the paper's protocol: every body's state each tick, one datagram each."
        }
        Mode::AppActive => {
            "the paper's protocol for awake bodies only: their states each tick, one datagram each."
        }
        Mode::AppPacked => {
            "the paper's protocol with as many states per datagram as fit: the effect of packing alone."
        }
        Mode::Replay => {
            "a recorded scene is replayed over a simulated link in simulated time; each tick is compared when the \
             stream's watermark reaches it, and bytes are counted as they are sent."
        }
    }
}

/// Limitations of Rhumb and of the figures: sentences, ready for HTML.
fn limits(summary: &Summary) -> Vec<String> {
    let runs = &summary.runs;
    let largest = runs.iter().map(|run| run.bodies).max().unwrap_or(0);
    let find = |mode: Mode| {
        runs.iter()
            .find(|run| run.bodies == largest && run.mode == mode.name())
    };
    let mut sentences = Vec::new();
    let integrated = find(Mode::Integrated).and_then(|run| run.frame_ms);
    if let Some((base, own)) = integrated.zip(find(Mode::Rhumb).and_then(|run| run.frame_ms)) {
        sentences.push(format!(
            "In lockstep the simulator waits for the engine and the round trip: at {largest} bodies a frame took {} ms, \
             in process {} ms, {} times as long. A real link adds its round trip to every frame.",
            number(Some(own.p50)),
            number(Some(base.p50)),
            number(Some(own.p50 / base.p50)),
        ));
    }
    if find(Mode::RhumbPipelined).is_some() {
        sentences.push(
            "A pipelined frame is short because the simulator has other work while the server steps: here, stepping \
             the other modes. A simulator without other work waits for the engine as well, and its commands take \
             effect a tick later."
                .to_owned(),
        );
    }
    sentences.extend(
        find(Mode::Rhumb)
            .or(find(Mode::RhumbFree))
            .map(of_bandwidth),
    );
    let faults: u64 = runs
        .iter()
        .filter_map(|run| run.over_tolerance.as_ref()?.by_cause.get("fault"))
        .sum();
    if faults > 0 {
        sentences.push(format!(
            "<span class=\"warn\">{faults} body-ticks were over tolerance without an explanation: a defect.</span>"
        ));
    }
    if summary.is_of_replays() {
        sentences.extend(limits_of_replays(runs));
        return sentences;
    }
    sentences.extend(of_limit(runs));
    sentences.push(
        "Times come from one run on one shared machine: compare them with each other, not with those of another \
         machine. Bytes, updates and errors of the modes that wait are repeatable; times are not."
            .to_owned(),
    );
    sentences.push(
        "Errors are measured at whole ticks against the engine at the same tick. They exclude smoothing between \
         ticks, as a display does it."
            .to_owned(),
    );
    sentences
}

/// Limitations of replays.
fn limits_of_replays(runs: &[RunFigures]) -> Vec<String> {
    let mut sentences = Vec::new();
    let counts_plain_codes = |run: &RunFigures| {
        let replayed = run.replayed.as_ref();
        replayed.is_some_and(|of| of.without.iter().any(|name| name == "coder"))
    };
    if runs.iter().any(counts_plain_codes) {
        sentences.push(
            "The coder is part of the wire format; without it, plain codes are counted instead (forms in five bits, \
             numbers in Exp-Golomb codes)."
                .to_owned(),
        );
    }
    sentences.extend(of_limit(runs));
    sentences.push(
        "Bytes are counted as the publisher sends them, with 22 of QUIC and 28 of headers for each datagram. They \
         exclude acknowledgements, heartbeats and the initial state."
            .to_owned(),
    );
    sentences
}

/// Definition of the limit, if runs are compared to one.
fn of_limit(runs: &[RunFigures]) -> Option<String> {
    let beside = runs.iter().any(|run| run.of_limit.is_some());
    beside.then(|| {
        "The limit assumes a known future: each body's path is cut into the longest verified segments by any \
         predictor, coded by an ideal adaptive coder. Better fits may exist, so the true minimum is lower. A real \
         publisher has more to do: it sends packets and exact rest poses, and does not know the future. On the grid \
         means that motions are rounded to the protocol's grid and verified as rounded."
            .to_owned()
    })
}

/// A run's worst second, headers and joining, which its mean bandwidth hides.
fn of_bandwidth(run: &RunFigures) -> String {
    let mut text = format!(
        "The mean hides bursts: the worst second of {} with {} bodies took {} kbit/s, the mean was {}.",
        run.mode,
        run.bodies,
        number(run.worst_second_kbps_down),
        number(run.mean_kbps_down),
    );
    if let Some((payload, wire)) = run
        .payload_bytes_down
        .zip(run.bytes_down)
        .filter(|(_, wire)| *wire > 0)
    {
        let share = 100.0 * (1.0 - payload as f64 / wire as f64);
        let _ = write!(
            text,
            " {} % of the counted bytes belong to QUIC, UDP and IP.",
            number(Some(share))
        );
    }
    if let Some(join) = run.join {
        let kilobytes = number(Some(join.bytes_down as f64 / 1e3));
        let _ = write!(
            text,
            " Joining took {kilobytes} kB once, which is not included."
        );
    }
    text
}
