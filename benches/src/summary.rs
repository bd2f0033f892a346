//! The figures of an experiment, as `summary.json` and as a table.
//!
//! Computed from the record alone. A figure without meaning for a mode is `null`: a scene stepped in the caller's
//! thread sends no bytes. A percentile is the least measured value that the given share does not exceed.
//!
//! As an aligned table, for a terminal or for Markdown, it computes nothing but ratios between figures. One list of columns
//! serves terminal, Markdown and page. The columns depend on the runs: replays and stepped scenes differ, and a column with
//! equal cells in all rows is left out. Replays that ended early are listed below it.

mod run_figures;

use std::fmt;

use rhumb_netsim::LinkConfig;
use serde::{Deserialize, Serialize};

use crate::numbers::{aligned, dash, markdown, number, pretty_json};
use crate::record::{Experiment, Replayed, Unfinished};
use run_figures::{compare_with_naive, figures_of_run};

pub(crate) use run_figures::second_by_second;
pub use run_figures::{
    DATAGRAM_HEADER_BYTES, ErrorQuantiles, FirstSeconds, FrameTimes, Join, LessThanNaive, Moving,
    OfLimit, OverTolerance, Recovery, RunFigures, SIM_FPS_MAX, StepTimes,
};

/// Figures of one experiment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The command line; its paths have no folders.
    pub command: String,
    /// Seed of the scripts.
    pub seed: u64,
    /// Processor, cores, operating system.
    pub machine: String,
    /// Every mode's run of every load, in the order of the record.
    pub runs: Vec<RunFigures>,
    /// Failed replays, which have no figures; omitted if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unfinished: Vec<UnfinishedReplay>,
}

impl Summary {
    /// Computes the figures of an experiment.
    #[must_use]
    pub fn of(experiment: &Experiment) -> Self {
        let runs = experiment.loads.iter().flat_map(|load| {
            let figures = |run| figures_of_run(run, load.truth.digest);
            load.runs.iter().map(figures)
        });
        let mut runs: Vec<_> = runs.collect();
        compare_with_naive(&mut runs);
        let unfinished = experiment.loads.iter().flat_map(|load| &load.unfinished);
        Self {
            command: experiment.command.clone(),
            seed: experiment.seed,
            machine: experiment.machine.clone(),
            runs,
            unfinished: unfinished.map(UnfinishedReplay::of).collect(),
        }
    }

    /// The text of `summary.json`.
    #[must_use]
    pub fn to_json(&self) -> String {
        pretty_json(self).expect("numbers, texts and maps keyed by texts are always JSON")
    }

    /// True if all runs are replays of recordings.
    #[must_use]
    pub fn is_of_replays(&self) -> bool {
        !self.runs.is_empty() && self.runs.iter().all(|run| run.replayed.is_some())
    }

    /// Reduction of each run against naive, as lines for a terminal; empty without a naive run.
    #[must_use]
    pub fn ratios(&self) -> String {
        let rows = ratios(&self.runs);
        if rows.len() < 2 {
            return String::new();
        }
        format!("\nless than naive, times\n{}", aligned(&rows))
    }

    /// The runs as a table for a terminal.
    #[must_use]
    pub fn table(&self) -> SummaryTable<'_> {
        SummaryTable::new(&self.runs, &self.unfinished)
    }
}

/// Shown by `Display`: a line of titles, one line per run, then one per failed replay.
#[derive(Clone, Copy, Debug)]
pub struct SummaryTable<'a> {
    runs: &'a [RunFigures],
    unfinished: &'a [UnfinishedReplay],
}

impl<'a> SummaryTable<'a> {
    pub(crate) const fn new(runs: &'a [RunFigures], unfinished: &'a [UnfinishedReplay]) -> Self {
        Self { runs, unfinished }
    }

    /// The same cells as a Markdown table.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let columns = columns(self.runs);
        let mut rows = vec![titles(&columns)];
        rows.extend(self.rows(&columns));
        let mut text = markdown(&rows);
        let mut before = "\n";
        for replay in self.unfinished {
            text.push_str(&format!("{before}- Failed: {replay}\n"));
            before = "";
        }
        text
    }

    fn rows(&self, columns: &[Column]) -> Vec<Vec<String>> {
        let runs = self.runs;
        let cells = |run| {
            columns
                .iter()
                .map(|column| (column.cell)(run, runs))
                .collect()
        };
        runs.iter().map(cells).collect()
    }
}

/// Reduction of each run against naive: titles, then a row per run.
pub fn ratios(runs: &[RunFigures]) -> Vec<Vec<String>> {
    let titles = [
        "mode",
        "bodies",
        "payload",
        "with headers",
        "payload, first 5 s",
        "with headers, first 5 s",
    ];
    let mut rows = vec![titles.map(str::to_owned).to_vec()];
    for run in runs {
        if let Some(less) = run.less_than_naive {
            let ratios = [
                less.payload,
                less.with_headers,
                less.payload_first,
                less.with_headers_first,
            ];
            let mut row = vec![run.mode.clone(), run.bodies.to_string()];
            row.extend(ratios.map(|ratio| number(Some(ratio))));
            rows.push(row);
        }
    }
    rows
}

/// Rates down after the first seconds, as a scene comes to rest: titles, then a row per run.
pub fn later(runs: &[RunFigures]) -> Vec<Vec<String>> {
    let titles = ["mode", "bodies", "payload, B/s", "with headers, B/s"];
    let mut rows = vec![titles.map(str::to_owned).to_vec()];
    for run in runs {
        let (Some(first), Some(payload_kbps)) = (run.first_seconds, run.payload_kbps_down) else {
            continue;
        };
        let (Some(payload), Some(bytes)) = (run.payload_bytes_down, run.bytes_down) else {
            continue;
        };
        // Both rates cover the whole run.
        let all_s = payload as f64 * 8.0 / (payload_kbps * 1e3);
        let left_s = all_s - first.seconds;
        let each = |all: u64, first: u64| (left_s > 0.0).then(|| (all - first) as f64 / left_s);
        rows.push(vec![
            run.mode.clone(),
            run.bodies.to_string(),
            number(each(payload, first.payload_bytes_down)),
            number(each(bytes, first.bytes_down)),
        ]);
    }
    rows
}

fn titles(columns: &[Column]) -> Vec<String> {
    columns
        .iter()
        .map(|column| column.short.to_owned())
        .collect()
}

impl fmt::Display for SummaryTable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let columns = columns(self.runs);
        let mut rows = vec![titles(&columns)];
        rows.extend(self.rows(&columns));
        f.write_str(&aligned(&rows))?;
        let mut unfinished = self.unfinished.iter();
        unfinished.try_for_each(|replay| writeln!(f, "failed: {replay}"))
    }
}

/// A column.
#[derive(Clone, Copy)]
pub(crate) struct Column {
    /// Title in a terminal, unit included.
    pub(crate) short: &'static str,
    /// Title on a page.
    pub(crate) long: &'static str,
    /// Unit, in small print below the title on a page.
    pub(crate) small: &'static str,
    /// Text of a run's cell, given all runs.
    pub(crate) cell: fn(&RunFigures, &[RunFigures]) -> String,
}

const fn column(
    short: &'static str,
    long: &'static str,
    small: &'static str,
    cell: fn(&RunFigures, &[RunFigures]) -> String,
) -> Column {
    Column {
        short,
        long,
        small,
        cell,
    }
}

/// The columns that fit these runs; the first names the run.
pub(crate) fn columns(runs: &[RunFigures]) -> Vec<Column> {
    let any = |has: fn(&RunFigures) -> bool| runs.iter().any(has);
    let first = runs.first().map(|run| &run.scene);
    let differ = runs.iter().any(|run| Some(&run.scene) != first);
    if any(|run| run.replayed.is_none()) || runs.is_empty() {
        let mut columns = EVALUATED.to_vec();
        if differ {
            columns.insert(0, SCENE);
        }
        if any(|run| run.of_limit.is_some()) {
            columns.extend(OF_LIMIT);
        }
        return columns;
    }
    let mut columns = vec![SETTING];
    if differ {
        columns.insert(0, SCENE);
    }
    if any(|run| run.link.is_some()) {
        columns.extend(LINK);
    }
    let seed = |run: &RunFigures| run.replayed.as_ref().map(|of| of.link_seed);
    if runs.iter().any(|run| seed(run) != seed(&runs[0])) {
        columns.push(SEED);
    }
    columns.extend(RATES);
    columns.extend(UPDATES);
    if any(|run| run.of_limit.is_some()) {
        columns.extend(OF_LIMIT);
    }
    columns.extend(ERRORS);
    if any(|run| run.recovery.is_some()) {
        columns.extend(RECOVERY);
    }
    columns
}

const SCENE: Column = column("scene", "scene", "", |run, _| run.scene.clone());

const EVALUATED: [Column; 13] = [
    column("mode", "mode", "", |run, _| match run.void {
        true => format!("{} (void)", name(run)),
        false => name(run),
    }),
    column("bodies", "bodies", "", |run, _| run.bodies.to_string()),
    column("kbit/s", "kbit/s down", "mean", |run, _| {
        number(run.mean_kbps_down)
    }),
    column("payload", "payload", "kbit/s", |run, _| {
        number(run.payload_kbps_down)
    }),
    column("naive/", "less than naive", "times", |run, runs| {
        let naive = run.baseline(runs).and_then(|naive| naive.mean_kbps_down);
        number(ratio(naive, run.mean_kbps_down))
    }),
    column("worst s", "worst second", "kbit/s", |run, _| {
        number(run.worst_second_kbps_down)
    }),
    column("upd/s", "updates", "a second", |run, _| {
        number(run.updates_per_second())
    }),
    column("bits/upd", "update", "bits", |run, _| {
        number(run.bits_per_update)
    }),
    column("p99 mm", "error p99", "mm", |run, _| {
        number(run.surface_error_m.map(|errors| 1e3 * errors.p99))
    }),
    column("max mm", "error max", "mm", |run, _| {
        number(run.surface_error_m.map(|errors| 1e3 * errors.max))
    }),
    column("over", "over tolerance", "body-ticks", |run, _| over(run)),
    column("frame ms", "frame", "ms, median", |run, _| {
        number(run.frame_ms.map(|ms| ms.p50))
    }),
    column("/integr", "of integrated", "times", |run, runs| {
        let integrated = run.beside(runs, "integrated");
        let base = integrated.and_then(|run| run.frame_ms);
        number(ratio(run.frame_ms.map(|ms| ms.p50), base.map(|ms| ms.p50)))
    }),
];

const SETTING: Column = column("replay", "replay", "tolerance and means", |run, _| {
    let of = run.replayed.as_ref();
    let named = of.map(|of| setting(of, run.tolerance_m, run.budget_bytes_per_second));
    named.unwrap_or_else(|| run.mode.clone())
});

const LINK: [Column; 3] = [
    column("rtt ms", "round trip", "ms", |run, _| {
        link(run).map_or_else(dash, |link| {
            (2.0 * link.delay.as_nanos() as f64 / 1e6).to_string()
        })
    }),
    column("loss", "loss", "of packets", |run, _| {
        link(run).map_or_else(dash, |link| link.loss.to_string())
    }),
    column("burst", "bursts of", "packets", |run, _| {
        link(run).map_or_else(dash, |link| link.burst.to_string())
    }),
];

const SEED: Column = column("seed", "seed", "of the link", |run, _| {
    let seed = run.replayed.as_ref().map(|of| of.link_seed);
    seed.map_or_else(dash, |seed| seed.to_string())
});

const RATES: [Column; 2] = [
    column("payload kbit/s", "payload", "kbit/s", |run, _| {
        number(run.payload_kbps_down)
    }),
    column("with headers", "with headers", "kbit/s", |run, _| {
        number(run.mean_kbps_down)
    }),
];

const UPDATES: [Column; 2] = [
    column("upd/s", "updates", "a second", |run, _| {
        number(run.updates_per_second())
    }),
    column("bits/upd", "update", "bits", |run, _| {
        number(run.bits_per_update)
    }),
];

const OF_LIMIT: [Column; 3] = [
    column("bits/limit", "bits of limit", "times", |run, _| {
        number(run.of_limit.map(|of| of.bits))
    }),
    column("upd/limit", "updates of limit", "times", |run, _| {
        number(run.of_limit.map(|of| of.updates))
    }),
    column("upd/on grid", "of limit on grid", "times", |run, _| {
        number(run.of_limit.map(|of| of.updates_on_grid))
    }),
];

const ERRORS: [Column; 5] = [
    column("p50 mm", "error p50", "mm, moving", |run, _| {
        number(run.moving.map(|moving| 1e3 * moving.surface_error_m.p50))
    }),
    column("p95 mm", "error p95", "mm, moving", |run, _| {
        number(run.moving.map(|moving| 1e3 * moving.surface_error_m.p95))
    }),
    column("p99 mm", "error p99", "mm, moving", |run, _| {
        number(run.moving.map(|moving| 1e3 * moving.surface_error_m.p99))
    }),
    column("max mm", "error max", "mm", |run, _| {
        number(run.surface_error_m.map(|errors| 1e3 * errors.max))
    }),
    column("over %", "over tolerance", "% of moving", |run, _| {
        number(run.moving.map(|moving| 1e2 * moving.over_tolerance_share))
    }),
];

const RECOVERY: [Column; 3] = [
    column("lost", "lost", "ticks", |run, _| {
        run.recovery
            .map_or_else(dash, |recovery| recovery.losses.to_string())
    }),
    column("rec p50 ms", "recovery p50", "ms", |run, _| {
        number(run.recovery.map(|recovery| recovery.p50_ms))
    }),
    column("rec p99 ms", "recovery p99", "ms", |run, _| {
        number(run.recovery.map(|recovery| recovery.p99_ms))
    }),
];

fn ratio(part: Option<f64>, whole: Option<f64>) -> Option<f64> {
    Some(part? / whole?)
}

/// The run's link; `None` means a perfect one.
fn link(run: &RunFigures) -> Option<LinkConfig> {
    run.link.as_deref().unwrap_or_default().parse().ok()
}

/// Body-ticks over tolerance by cause.
fn over(run: &RunFigures) -> String {
    let Some(over) = &run.over_tolerance else {
        return dash();
    };
    let causes = over.by_cause.iter().filter(|(_, count)| **count > 0);
    let why: Vec<_> = causes
        .map(|(cause, count)| format!("{count} {cause}"))
        .collect();
    if why.is_empty() {
        "0".to_owned()
    } else {
        why.join(", ")
    }
}

/// The mode and, if not the default, its publish and subscribe settings.
fn name(run: &RunFigures) -> String {
    let mut text = run.mode.clone();
    if let Some(of) = run.subscription {
        publish_schedule(of.publish_interval, of.lookahead_ticks, &mut text);
        if of.delay_ticks > 0 {
            text.push_str(&format!(", shown with a delay of {}", of.delay_ticks));
        }
    }
    text
}

/// Appends publish interval and lookahead, if not the default.
fn publish_schedule(publish_interval: u32, lookahead_ticks: u32, text: &mut String) {
    if publish_interval > 1 {
        text.push_str(&format!(", each {publish_interval} ticks"));
    }
    if lookahead_ticks > 0 {
        text.push_str(&format!(", {lookahead_ticks} ticks later"));
    }
}

/// Settings of a replay besides its link.
fn setting(of: &Replayed, tolerance_m: Option<f64>, budget: Option<u32>) -> String {
    let metres = tolerance_m.or(of.position_m);
    let mut text = metres.map_or_else(dash, |metres| {
        format!("{} mm", (metres * 1e9).round() / 1e6)
    });
    if let Some(turn_rad) = of.turn_rad {
        text.push_str(&format!(", {}°", number(Some(turn_rad.to_degrees()))));
    }
    publish_schedule(of.publish_interval, of.lookahead_ticks, &mut text);
    if let Some(budget) = budget {
        text.push_str(&format!(", {budget} B/s"));
    }
    if !of.without.is_empty() {
        text.push_str(&format!(", without {}", of.without.join(", ")));
    }
    text
}

/// A failed replay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnfinishedReplay {
    /// Its settings, as tables name them.
    pub setting: String,
    /// The simulated link; `null` without one.
    pub link: Option<String>,
    /// Seed of that link.
    pub link_seed: u64,
    /// Cause of the failure.
    pub cause: String,
}

impl UnfinishedReplay {
    fn of(unfinished: &Unfinished) -> Self {
        let config = &unfinished.config;
        let replayed = config.replayed.as_ref();
        let setting =
            replayed.map(|of| setting(of, config.tolerance_m, config.budget_bytes_per_second));
        Self {
            setting: setting.unwrap_or_else(|| config.mode.name().to_owned()),
            link: (!config.link.is_empty()).then(|| config.link.clone()),
            link_seed: replayed.map_or(config.seed, |of| of.link_seed),
            cause: unfinished.cause.clone(),
        }
    }
}

impl fmt::Display for UnfinishedReplay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.setting)?;
        if let Some(link) = &self.link {
            write!(f, ", {link}, seed {}", self.link_seed)?;
        }
        write!(f, ": {}", self.cause)
    }
}
