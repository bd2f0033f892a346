//! `rhumb-paper page`: fills a page with measurements.
//!
//! `<!-- paper: BLOCK FILE -->` opens a block, `<!-- /paper -->` closes it. FILE, or a folder of runs, lies beside the
//! page. The text between the markers is replaced, everything else stays. Blocks are fully generated, so a check can
//! find stale ones. Other engines are measured by `compare_engines.py`, two builds side by side by `compare_builds.py`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use rhumb_bench::ablate::Ablation;
use rhumb_bench::cost::Costs;
use rhumb_bench::load::{EdgesLoad, Filling, Load, Neighbour, ServiceCosts};
use rhumb_bench::numbers::{markdown, number};
use rhumb_bench::output;
use rhumb_bench::summary::{Summary, later, ratios};
use serde::Deserialize;

use crate::analysis::{self, Analysis, PaperFigure, PaperResults};
use crate::experiment::sentences;
use crate::gap::{self, GapResults};
use crate::hardware::{self, HardwareResults};
use crate::page::Table;
use crate::remote::{self, RemoteResults};
use crate::settings::{ExperimentTrial, PaperError, Settings, parse};
use crate::tables;

/// Arguments of the page task.
#[derive(Clone, Debug, Args)]
pub(crate) struct PageArguments {
    /// The page in Markdown.
    #[arg(default_value = "docs/results/paper.md")]
    page: PathBuf,
    /// Change nothing; fail if the page is stale.
    #[arg(long)]
    check: bool,
}

const OPENS: &str = "<!-- paper: ";
const OPENED: &str = " -->";
const CLOSES: &str = "<!-- /paper -->";

/// Fills or checks a page.
pub(crate) fn run(arguments: &PageArguments) -> Result<(), PaperError> {
    let path = &arguments.page;
    let text = read(path)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let filled = fill(path, &text, &mut |block, file| {
        make_block(path, folder, block, file)
    })?;
    let mut stale = filled.changed;
    for (name, svg) in &filled.figures {
        let beside = folder.join(name);
        if fs::read_to_string(&beside).ok().as_ref() != Some(svg) {
            stale.push(name.clone());
        }
    }
    if arguments.check {
        if stale.is_empty() {
            return Ok(output::print_text(&format!(
                "{} is current\n",
                path.display()
            ))?);
        }
        let (path, blocks) = (path.clone(), stale);
        return Err(PaperError::Stale { path, blocks });
    }
    for (name, svg) in &filled.figures {
        output::write_file(&folder.join(name), svg.as_bytes())?;
    }
    output::write_file(path, filled.text.as_bytes())?;
    let what = if stale.is_empty() {
        "unchanged".to_owned()
    } else {
        stale.join(", ")
    };
    Ok(output::print_text(&format!(
        "{}: {what}\n",
        path.display()
    ))?)
}

/// Text of a block, and the picture it shows.
#[derive(Debug, Default)]
struct Block {
    text: String,
    /// File name beside the page, and content.
    figure: Option<(String, String)>,
}

/// A page with filled blocks.
#[derive(Debug, Default)]
struct Filled {
    text: String,
    /// Blocks whose text changed.
    changed: Vec<String>,
    figures: BTreeMap<String, String>,
}

/// Replaces the text between the markers of a page.
fn fill(
    path: &Path,
    text: &str,
    make: &mut dyn FnMut(&str, &str) -> Result<Block, PaperError>,
) -> Result<Filled, PaperError> {
    let wrong = |why: String| PaperError::Page {
        path: path.to_owned(),
        why,
    };
    let mut filled = Filled::default();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once(OPENS) {
        let ends = || wrong("a marker does not end on its line".to_owned());
        let (marker, after) = after.split_once(OPENED).ok_or_else(ends)?;
        let (block, file) = marker
            .split_once(' ')
            .filter(|_| !marker.contains('\n'))
            .ok_or_else(|| wrong(format!("the marker {marker:?} lacks a block or file name")))?;
        let unclosed = || wrong(format!("the block {block} is not closed"));
        let (inside, after) = after.split_once(CLOSES).ok_or_else(unclosed)?;
        if inside.contains(OPENS) {
            return Err(unclosed());
        }
        let made = make(block, file)?;
        let new = format!("\n{}\n", made.text.trim_end());
        if new != inside {
            filled.changed.push(block.to_owned());
        }
        filled
            .text
            .push_str(&format!("{before}{OPENS}{marker}{OPENED}{new}{CLOSES}"));
        filled.figures.extend(made.figure);
        rest = after;
    }
    if filled.text.is_empty() {
        return Err(wrong(format!("no marker {OPENS:?} opens a block")));
    }
    filled.text.push_str(rest);
    Ok(filled)
}

fn read(path: &Path) -> Result<String, PaperError> {
    fs::read_to_string(path).map_err(|cause| PaperError::Read {
        path: path.to_owned(),
        cause,
    })
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, PaperError> {
    parse(path, read(path)?.as_bytes())
}

/// Results of an experiment, recomputed from its trials: the file may come from a version with other statistics.
fn read_experiment(path: &Path) -> Result<PaperResults, PaperError> {
    let StoredExperiment {
        command,
        settings,
        trials,
    } = read_json(path)?;
    Ok(PaperResults {
        command,
        analysis: Analysis::of(&settings, &trials),
        settings,
        trials,
    })
}

/// The measured part of `paper.json`.
#[derive(Debug, Deserialize)]
struct StoredExperiment {
    command: String,
    settings: Settings,
    trials: Vec<ExperimentTrial>,
}

/// Builds a block by its name.
fn make_block(page: &Path, folder: &Path, block: &str, file: &str) -> Result<Block, PaperError> {
    let path = folder.join(file);
    let text = match block.split_once('-') {
        Some(("ablation", what)) => read_json::<Ablation>(&path)?.block(what),
        Some(("cost", what)) => read_json::<Costs>(&path)?.block(what),
        Some(("builds", what)) => read_json::<Builds>(&path)?.block(what),
        Some(("service", what)) => read_json::<ServiceCosts>(&path)?.block(what),
        Some(("load", what)) => read_json::<Load>(&path)?.block(what),
        Some(("edges", what)) => read_json::<EdgesLoad>(&path)?.block(what),
        Some(("neighbour", what)) => read_json::<Neighbour>(&path)?.block(what),
        Some(("filling", what)) => read_json::<Filling>(&path)?.block(what),
        Some(("runs", what)) => of_runs(&read_runs(&path)?, what),
        Some(("remote", what)) => of_remote(&read_json(&path)?, what),
        Some(("engines", what)) => of_engines(&read_json(&path)?, what),
        Some(("gap", what)) => of_gap(&read_json(&path)?, what),
        Some(("hardware", what)) => of_hardware(&read_json(&path)?, what),
        _ => {
            let results = read_experiment(&path)?;
            match block.strip_prefix("figure-") {
                Some(name) => return of_figure(page, block, figure(&results, name)),
                None => of_paper(&results, block),
            }
        }
    };
    let text = text.ok_or_else(|| no_such(page, block))?;
    Ok(Block { text, figure: None })
}

fn no_such(page: &Path, block: &str) -> PaperError {
    PaperError::Page {
        path: page.to_owned(),
        why: format!("the block {block:?} does not exist"),
    }
}

fn of_paper(results: &PaperResults, block: &str) -> Option<String> {
    let table = match block {
        "command" => return Some(format!("    {}", results.command)),
        "findings" => {
            let sentences = sentences(results);
            let lines: Vec<String> = sentences
                .iter()
                .map(|sentence| format!("- {sentence}"))
                .collect();
            return Some(lines.join("\n"));
        }
        "sim-fps" => tables::sim_fps(results),
        "phys-ft" => tables::phys_ft(results),
        "sustained" => tables::sustained(results),
        "degradation" => tables::degradation(results),
        "tests-sim-fps" => tables::tests_fps(results),
        "tests-phys-ft" => tables::tests_frame(results),
        "paired" => tables::paired(results),
        "aims" => tables::aims(results),
        "aims-of-bytes" => tables::aims_of_bytes(results),
        "stages" => tables::stages(results),
        "traffic" => tables::traffic(results),
        _ => return None,
    };
    Some(table.to_markdown())
}

/// The runs of a `summary.json`, or of all such files in a folder, ordered by name.
fn read_runs(path: &Path) -> Result<Summary, PaperError> {
    if !path.is_dir() {
        return read_json(path);
    }
    let failed = |cause| PaperError::Read {
        path: path.to_owned(),
        cause,
    };
    let mut files = Vec::new();
    for entry in fs::read_dir(path).map_err(failed)? {
        files.push(entry.map_err(failed)?.path());
    }
    files.sort();
    let mut all: Option<Summary> = None;
    for file in &files {
        let mut one: Summary = read_json(file)?;
        match &mut all {
            Some(all) => {
                all.runs.append(&mut one.runs);
                all.unfinished.append(&mut one.unfinished);
            }
            None => all = Some(one),
        }
    }
    all.ok_or_else(|| failed(std::io::ErrorKind::NotFound.into()))
}

/// Blocks of the `summary.json` of any other task.
fn of_runs(summary: &Summary, what: &str) -> Option<String> {
    match what {
        "command" => Some(format!("    {}", summary.command)),
        "table" => Some(summary.table().to_markdown()),
        "ratios" => Some(markdown(&ratios(&summary.runs))),
        "later" => Some(markdown(&later(&summary.runs))),
        _ => None,
    }
}

fn of_remote(results: &RemoteResults, what: &str) -> Option<String> {
    match what {
        "command" => Some(results.provenance.markdown("a point")),
        "crossings" => Some(remote::crossings_table(results).to_markdown()),
        "aims" => Some(remote::aims_table(results).to_markdown()),
        "points" => Some(remote::points_table(results).to_markdown()),
        _ => None,
    }
}

fn of_engines(engines: &Engines, what: &str) -> Option<String> {
    match what {
        "command" => Some(format!(
            "    {}\n\nOn {}; {} with {} bodies.",
            engines.command, engines.machine, engines.scene, engines.bodies
        )),
        "table" => Some(engines_table(engines).to_markdown()),
        _ => None,
    }
}

fn of_gap(results: &GapResults, what: &str) -> Option<String> {
    match what {
        "command" => Some(results.provenance.markdown("each")),
        "table" => Some(gap::table(results).to_markdown()),
        "shares" => Some(gap::shares_table(results).to_markdown()),
        "published" => Some(gap::published_table(results).to_markdown()),
        _ => None,
    }
}

fn of_hardware(results: &HardwareResults, what: &str) -> Option<String> {
    match what {
        "command" => {
            let line = |machine: &hardware::MachineResults| {
                format!(
                    "    {}\n\nOn {} ({} build).\n",
                    machine.command, machine.machine, machine.build
                )
            };
            Some(
                results
                    .machines
                    .iter()
                    .map(line)
                    .collect::<Vec<_>>()
                    .join("\n"),
            )
        }
        "table" => Some(hardware::table(results).to_markdown()),
        _ => None,
    }
}

fn figure(results: &PaperResults, name: &str) -> Option<PaperFigure> {
    [analysis::sim_fps(results), analysis::phys_ft(results)]
        .into_iter()
        .find(|figure| figure.name == name)
}

fn of_figure(page: &Path, block: &str, figure: Option<PaperFigure>) -> Result<Block, PaperError> {
    let figure = figure.ok_or_else(|| no_such(page, block))?;
    let name = format!("{}.svg", figure.name);
    Ok(Block {
        text: format!("![{}]({name})", figure.title),
        figure: Some((name, figure.standalone())),
    })
}

/// Output of the script's `--out`.
#[derive(Debug, Deserialize)]
struct Engines {
    /// Command line of the script.
    pub(crate) command: String,
    /// Processor, cores, operating system.
    pub(crate) machine: String,
    /// Name of the scene.
    pub(crate) scene: String,
    /// Number of its non-static bodies.
    pub(crate) bodies: u32,
    rows: Vec<EngineRow>,
}

/// Times of one engine, milliseconds.
#[derive(Debug, Deserialize)]
struct EngineRow {
    /// Engine and where it steps: `bullet, tcp:localhost:6667`.
    engine: String,
    frame_ms_mean: f64,
    frame_ms_p50: f64,
    frame_ms_p99: f64,
    /// Both directions, headers included; `None` for an engine in process.
    bytes_per_frame: Option<f64>,
}

impl EngineRow {
    fn family(&self) -> &str {
        self.engine.split(',').next().unwrap_or_default()
    }
}

/// A row for each engine, relative to the same engine in process.
fn engines_table(engines: &Engines) -> Table {
    let columns = [
        "engine",
        "frame, ms",
        "p50, ms",
        "p99, ms",
        "mean, relative to its first row",
        "bytes per frame",
    ];
    let mut table = Table::new("Other engines on the same scene", columns);
    for row in &engines.rows {
        let first = engines
            .rows
            .iter()
            .find(|other| other.family() == row.family());
        let values = [
            Some(row.frame_ms_mean),
            Some(row.frame_ms_p50),
            Some(row.frame_ms_p99),
            first.map(|first| row.frame_ms_mean / first.frame_ms_mean),
            row.bytes_per_frame,
        ];
        let mut cells = vec![row.engine.clone()];
        cells.extend(values.map(number));
        table.rows.push(cells);
    }
    table.note = "Piles differ between engines, so times measure similar work, not the same work."
        .to_owned();
    table
}

/// Content of `builds.json`.
#[derive(Debug, Deserialize)]
pub(crate) struct Builds {
    machine: String,
    /// Commits.
    old: String,
    new: String,
    #[serde(default)]
    rows: Vec<BuildRow>,
    #[serde(default)]
    bytes: Vec<LoadRow>,
    #[serde(default)]
    stages: Vec<StageRow>,
}

/// A figure of both builds.
#[derive(Debug, Deserialize)]
struct BuildRow {
    what: String,
    unit: String,
    /// `None` where only the new build can do it.
    old: Option<f64>,
    new: f64,
    ratio: Option<f64>,
    /// The least and the greatest ratio of the pairs.
    least: Option<f64>,
    most: Option<f64>,
    /// `None` where the aim is another row's.
    aim: Option<String>,
    met: Option<bool>,
    /// A floor of the same run, in words.
    beside: Option<String>,
    /// How it was measured, in words.
    by: String,
    /// The command: a task of `rhumb-bench`, or a Criterion bench.
    command: String,
}

/// Bytes of a load.
#[derive(Debug, Deserialize)]
struct LoadRow {
    load: String,
    /// Payload, kbit/s.
    old: f64,
    new: f64,
    ratio: f64,
    /// Moving body-ticks that are off, percent.
    old_off: Option<f64>,
    new_off: Option<f64>,
    /// True if the engine took the same path.
    same_truth: bool,
    /// Body-ticks of both builds that are off without a cause.
    faults: u64,
    command: String,
}

/// A Criterion bench, mean processor time.
#[derive(Debug, Deserialize)]
struct StageRow {
    stage: String,
    old_ns: f64,
    new_ns: f64,
}

impl Builds {
    /// Text of a block of the documents; `None` if the block does not exist.
    pub(crate) fn block(&self, what: &str) -> Option<String> {
        match what {
            "machine" => Some(format!(
                "Builds of {} and {}, on {}.",
                self.old, self.new, self.machine
            )),
            "table" => Some(markdown(&self.table())),
            "bytes" => Some(markdown(&self.loads())),
            "stages" => Some(markdown(&self.stages())),
            _ => None,
        }
    }

    fn titles(&self, before: &[&str], behind: &[&str]) -> Vec<String> {
        let before = before.iter().map(|title| (*title).to_owned());
        let builds = [self.old.clone(), self.new.clone(), "ratio".to_owned()];
        let behind = behind.iter().map(|title| (*title).to_owned());
        before.chain(builds).chain(behind).collect()
    }

    fn table(&self) -> Vec<Vec<String>> {
        let behind = ["aim", "met", "floor", "by", "command"];
        let mut table = vec![self.titles(&["what", "unit"], &behind)];
        for row in &self.rows {
            let mut cells = vec![row.what.clone(), row.unit.clone()];
            cells.extend([row.old, Some(row.new)].map(number));
            let ratio = number(row.ratio);
            cells.push(match row.least.zip(row.most) {
                Some((least, most)) => {
                    format!(
                        "{ratio} ({} to {})",
                        number(Some(least)),
                        number(Some(most))
                    )
                }
                None => ratio,
            });
            cells.push(row.aim.clone().unwrap_or_else(|| number(None)));
            cells.push(match row.met {
                Some(true) => "yes".to_owned(),
                Some(false) => "**no**".to_owned(),
                None => number(None),
            });
            cells.push(row.beside.clone().unwrap_or_else(|| number(None)));
            cells.extend([row.by.clone(), format!("`{}`", row.command)]);
            table.push(cells);
        }
        table
    }

    fn loads(&self) -> Vec<Vec<String>> {
        let behind = ["off, %", "off, %", "same truth", "faults", "command"];
        let mut table = vec![self.titles(&["load"], &behind)];
        for row in &self.bytes {
            let mut cells = vec![row.load.clone()];
            cells.extend([row.old, row.new, row.ratio].map(|value| number(Some(value))));
            cells.extend([row.old_off, row.new_off].map(number));
            let same = if row.same_truth { "yes" } else { "no" };
            cells.extend([same.to_owned(), row.faults.to_string()]);
            cells.push(format!("`{}`", row.command));
            table.push(cells);
        }
        table
    }

    fn stages(&self) -> Vec<Vec<String>> {
        let mut table = vec![self.titles(&["stage, us"], &[])];
        for row in &self.stages {
            let microseconds = [row.old_ns, row.new_ns].map(|ns| Some(ns * 1e-3));
            let mut cells = vec![row.stage.clone()];
            cells.extend(microseconds.map(number));
            cells.push(number(Some(row.new_ns / row.old_ns)));
            table.push(cells);
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PAGE: &str = "# A page\n\n<!-- paper: one a.json -->\nold\n<!-- /paper -->\n\ntail\n";

    fn filled(text: &str) -> Result<Filled, PaperError> {
        fill(Path::new("page.md"), text, &mut |block, file| {
            Ok(Block {
                text: format!("{block} of {file}"),
                figure: None,
            })
        })
    }

    #[test]
    fn filling_replaces_blocks_and_nothing_else() {
        let once = filled(PAGE).unwrap();
        let expected =
            "# A page\n\n<!-- paper: one a.json -->\none of a.json\n<!-- /paper -->\n\ntail\n";
        assert_eq!(once.text, expected);
        assert_eq!(once.changed, ["one"]);
        let again = filled(&once.text).unwrap();
        assert_eq!((again.text.as_str(), again.changed.len()), (expected, 0));
    }

    #[test]
    fn an_error_names_the_wrong_marker() {
        for (text, why) in [
            (
                "<!-- paper: one a.json -->\nold\n",
                "the block one is not closed",
            ),
            (
                "<!-- paper: one -->\n<!-- /paper -->",
                "lacks a block or file name",
            ),
            ("<!-- paper: one a.json\n", "does not end on its line"),
            ("# A page\n\nand no block\n", "opens a block"),
            (
                "<!-- paper: one a.json -->\n<!-- paper: two a.json -->\n<!-- /paper -->",
                "the block one is not closed",
            ),
        ] {
            let message = filled(text).unwrap_err().to_string();
            assert!(message.contains(why), "{message}");
        }
    }

    #[test]
    fn a_remote_engine_is_compared_to_itself_in_process() {
        let text = r#"{"command": "c", "machine": "m", "scene": "ball-pit", "bodies": 500, "rows": [
            {"engine": "bullet, direct", "frame_ms_mean": 2.0, "frame_ms_p50": 2.0, "frame_ms_p99": 3.0, "bytes_per_frame": null},
            {"engine": "ours, a", "frame_ms_mean": 1.0, "frame_ms_p50": 1.0, "frame_ms_p99": 1.5, "bytes_per_frame": null},
            {"engine": "bullet, tcp:h:1", "frame_ms_mean": 6.0, "frame_ms_p50": 5.0, "frame_ms_p99": 9.0, "bytes_per_frame": 1234.0}]}"#;
        let engines: Engines = serde_json::from_str(text).unwrap();
        let rows = engines_table(&engines).rows;
        assert_eq!(rows[1], ["ours, a", "1.00", "1.00", "1.50", "1.00", "–"]);
        assert_eq!(
            rows[2],
            ["bullet, tcp:h:1", "6.00", "5.00", "9.00", "3.00", "1,234"]
        );
    }

    #[test]
    fn a_row_says_whether_its_aim_is_met() {
        let text = r#"{"machine": "m", "old": "a", "new": "b", "rows": [
            {"what": "w", "unit": "us", "old": 4.0, "new": 2.0, "ratio": 0.5, "least": 0.4, "most": 0.75,
             "aim": "≤ 0.45 ×", "met": false, "by": "5 pairs", "command": "cost"}]}"#;
        let builds: Builds = serde_json::from_str(text).unwrap();
        let expected = "| what | unit | a | b | ratio | aim | met | floor | by | command |";
        let table = builds.block("table").unwrap();
        assert!(table.starts_with(expected), "{table}");
        let row = "| w | us | 4.00 | 2.00 | 0.500 (0.400 to 0.750) | ≤ 0.45 × | **no** | – | 5 pairs | `cost` |";
        assert!(table.contains(row), "{table}");
    }
}
