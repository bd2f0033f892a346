//! `rhumb-paper gap`: finds where the published client loses time.
//!
//! The paper's protocol runs over one pit with a client without defects, with clients of one defect each, and with one
//! of all defects. Further rows: the engine in the caller's thread, packed states, and awake bodies only. The cost of
//! each defect is measured here; that the paper's own client lost the same is inferred.

use std::num::NonZeroU32;
use std::path::PathBuf;

use clap::Args;
use rhumb_bench::drive::player::{self, FrameCost, PlayerSetup};
use rhumb_bench::drive::{Defect, Defects, ServerCpu};
use rhumb_bench::numbers::number;
use rhumb_bench::record::Mode;
use rhumb_bench::{machine, output};
use rhumb_server::run_on_cores;
use rhumb_transport::Clock;
use serde::{Deserialize, Serialize};

use crate::analysis;
use crate::page::{Provenance, Table};
use crate::processor::CoreAssignment;
use crate::settings::{ModeOutcome, PaperError, tolerance};
use crate::trial::{Pit, bodies_placed, outcome};

/// Arguments of the gap task.
#[derive(Clone, Debug, Args)]
pub(crate) struct GapArguments {
    /// Number of balls. Default: 0,1000,5000,10000, or 200 with --fast.
    #[arg(long, value_delimiter = ',', value_parser = clap::value_parser!(u32).range(0..=100_000))]
    loads: Vec<u32>,
    /// Frames of each row; the never-emptied list grows with them. Default: 60, or 10 with --fast.
    #[arg(long)]
    frames: Option<NonZeroU32>,
    /// Seed of the scene.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Use a small load and few frames.
    #[arg(long)]
    fast: bool,
    /// Folder for the results; created if missing.
    #[arg(long, default_value = "results/gap")]
    out: PathBuf,
    /// Let the system choose the cores instead of separating servers from their caller.
    #[arg(long)]
    no_pin: bool,
}

/// Results: `gap.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct GapResults {
    /// Circumstances of the measurement.
    #[serde(flatten)]
    pub(crate) provenance: Provenance,
    /// Rows, load by load.
    pub(crate) rows: Vec<GapRow>,
}

/// One client at one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct GapRow {
    /// Number of balls.
    pub(crate) load: u32,
    /// Defects of the client, or the other kind of row, as `cases` names it.
    client: String,
    /// Time from the first command until the server has applied all of them, seconds.
    pub(crate) placing_s: f64,
    pub(crate) outcome: ModeOutcome,
}

/// A client and its name.
struct GapCase {
    name: &'static str,
    mode: Mode,
    defects: Defects,
    /// Largest number of frames.
    most: u32,
}

const fn app(name: &'static str, mode: Mode, defects: Defects) -> GapCase {
    GapCase {
        name,
        mode,
        defects,
        most: u32::MAX,
    }
}

const INTEGRATED: &str = "integrated";
const SOUND: &str = "sound";
const AS_PUBLISHED: &str = "as published";
const AS_LONG: &str = "as published, its list as long";
/// Frames of a client with such a long list: each may take seconds.
const LONG_FRAMES: u32 = 12;

/// All rows of a load, in order.
fn cases(load: u32) -> Vec<GapCase> {
    let only = |name, loss: Defect| app(name, Mode::AppAll, Defects::only(&[loss]));
    vec![
        app(INTEGRATED, Mode::Integrated, Defects::SOUND),
        app(SOUND, Mode::AppAll, Defects::SOUND),
        app("sound, packed", Mode::AppPacked, Defects::SOUND),
        app("sound, awake only", Mode::AppActive, Defects::SOUND),
        only("poll", Defect::Poll),
        only("cap", Defect::Cap),
        only("list", Defect::List),
        only("buffer", Defect::Buffer),
        app(AS_PUBLISHED, Mode::AppAll, Defects::AS_PUBLISHED),
        GapCase {
            most: LONG_FRAMES,
            ..app(
                AS_LONG,
                Mode::AppAll,
                Defects::AS_PUBLISHED.with_listed(analysis::published_list(load)),
            )
        },
        app("rhumb", Mode::Rhumb, Defects::SOUND),
    ]
}

/// Tolerance of the rhumb row, metres.
const TOLERANCE_M: f64 = 0.05;

/// Runs every client at every load; writes the results after each load.
pub(crate) fn run(arguments: &GapArguments) -> Result<(), PaperError> {
    let machine = machine::describe();
    let places = if arguments.no_pin {
        CoreAssignment::default()
    } else {
        CoreAssignment::apart()
    };
    output::make_folder(&arguments.out)?;
    if !places.caller.is_empty() {
        run_on_cores(&places.caller).map_err(PaperError::Cores)?;
    }
    let (loads, frames): (&[u32], u32) = if arguments.fast {
        (&[200], 10)
    } else {
        (&[0, 1_000, 5_000, 10_000], 60)
    };
    let loads = if arguments.loads.is_empty() {
        loads
    } else {
        &arguments.loads
    };
    let frames = arguments.frames.map_or(frames, NonZeroU32::get);
    let mut results = GapResults {
        provenance: Provenance::new(machine, &places, arguments.seed, frames),
        rows: Vec::new(),
    };
    let bar = output::progress_bar((loads.len() * cases(0).len()) as u64, String::new());
    for load in loads {
        let mut truth = None;
        for case in cases(*load) {
            bar.set_message(format!("{load} balls, {}", case.name));
            let mut row = of_case(&case, *load, frames, arguments.seed, &places)?;
            // A run of fewer frames ends in another state, so its truth differs.
            if case.most >= frames {
                row.outcome.void =
                    *truth.get_or_insert(row.outcome.truth.clone()) != row.outcome.truth;
            }
            results.rows.push(row);
            bar.inc(1);
        }
        write(arguments, &results)?;
    }
    bar.finish_and_clear();
    output::print_text(&table(&results).to_text())?;
    output::print_text(&shares_table(&results).to_text())?;
    output::print_text(&published_table(&results).to_text())?;
    let out = arguments.out.display();
    Ok(output::print_text(&format!("\nwritten to {out}\n"))?)
}

/// Runs one client; nothing else runs meanwhile.
fn of_case(
    case: &GapCase,
    load: u32,
    frames: u32,
    seed: u64,
    places: &CoreAssignment,
) -> Result<GapRow, PaperError> {
    let mut pit = Pit::new(load, 1, frames, seed);
    let mut commands = Vec::new();
    pit.commands(0, &mut commands);
    let player_setup = PlayerSetup {
        config: pit.config(),
        bodies: bodies_placed(&commands),
        tolerance: tolerance(TOLERANCE_M)?,
        defects: case.defects,
        cpu: ServerCpu {
            cores: places.servers.clone(),
            threads: None,
        },
        seed,
    };
    let mode = case.mode;
    let mut player =
        player::start(mode, &player_setup).ok_or(PaperError::NotPlayable { mode })??;
    let clock = Clock::start();
    player.prepare(&commands)?;
    // The first frame waits for messages that the cap holds back; that time belongs to the placing.
    player.frame(&[])?;
    let placing_s = clock.now().as_nanos() as f64 / 1e9;
    let before = player.totals()?;
    let frame_cost = (0..frames.min(case.most))
        .map(|_| player.frame(&[]))
        .collect::<Result<Vec<FrameCost>, _>>()?;
    let after = player.totals()?;
    Ok(GapRow {
        load,
        client: case.name.to_owned(),
        placing_s,
        outcome: outcome(mode, &frame_cost, &before, &after),
    })
}

fn write(arguments: &GapArguments, results: &GapResults) -> Result<(), PaperError> {
    let out = &arguments.out;
    output::write_json(&out.join("gap.json"), results)?;
    let tables = [
        table(results),
        shares_table(results),
        published_table(results),
    ];
    results.provenance.write(out, "gap", TITLE, &tables)
}

const TITLE: &str = "Where the published client loses its time";

/// The rows, as measured.
pub(crate) fn table(results: &GapResults) -> Table {
    let columns = [
        "balls",
        "client",
        "placing, s",
        "PhysFT, ms",
        "p50, ms",
        "p99, ms",
        "of integrated",
        "engine, ms",
        "beyond the engine, ms",
        "states per frame",
        "ends lost",
    ];
    let mut table = Table::new("Frames by client", columns);
    for row in &results.rows {
        let found = &row.outcome;
        let integrated = sound_row(results, row.load, INTEGRATED);
        let mut cells = vec![
            row.load.to_string(),
            if found.void {
                format!("{}, void", row.client)
            } else {
                row.client.clone()
            },
        ];
        let states = (row.client != INTEGRATED)
            .then_some(found.updates as f64 / f64::from(found.frames.max(1)));
        let values = [
            Some(row.placing_s),
            Some(found.phys_ft_ms),
            Some(found.phys_ft_p50_ms),
            Some(found.phys_ft_p99_ms),
            integrated.map(|base| found.phys_ft_ms / base.phys_ft_ms),
            Some(found.step_ms),
            Some(beyond_ms(found)),
            states,
        ];
        cells.extend(values.map(number));
        cells.push(found.ends_lost.to_string());
        table.rows.push(cells);
    }
    table.note = "All clients except the integrated engine's and those of the last rows use the paper's protocol; \
                  poll, cap, list and buffer have that one defect each. Each row ran separately with its own engine \
                  run: compare the time beyond the engine. Ends lost: frames whose end message overflowed the \
                  buffer, so they lasted 1/11.33 s longer. Void: the engine diverged from the integrated one."
        .to_owned();
    table
}

/// Shares of the published client's frame that the defects explain.
pub(crate) fn shares_table(results: &GapResults) -> Table {
    let columns = [
        "balls",
        "published client, beyond the engine, ms",
        "the paper's, beyond integrated, ms",
        "share of it, %",
        "protocol alone, %",
        "poll, %",
        "cap, %",
        "list, %",
        "buffer, %",
        "only together, %",
    ];
    let mut table = Table::new(
        "What of the published client's frame explains what",
        columns,
    );
    let mut loads: Vec<u32> = results.rows.iter().map(|row| row.load).collect();
    loads.dedup();
    for load in loads {
        let Some(parts) = GapShares::of(results, load) else {
            continue;
        };
        let GapShares { all, each } = parts;
        let share = |part: f64| Some(100.0 * part / all);
        let together = all - each.iter().sum::<f64>();
        let papers = analysis::published(load).and_then(|row| row.frame_ms);
        let papers = papers.map(|(integrated, distributed)| distributed - integrated);
        let mut cells = vec![
            load.to_string(),
            number(Some(all)),
            number(papers),
            number(papers.map(|theirs| 100.0 * all / theirs)),
        ];
        cells.extend(each.map(|part| number(share(part))));
        cells.push(number(share(together)));
        table.rows.push(cells);
    }
    table.note = "Shares of the published client's frame beyond its engine's steps. Share of it: relative to the \
                  paper's own gap. Protocol alone: the client without defects. Each defect: its addition to that \
                  client, alone. Only together: the rest; negative where defects mask each other, since a client \
                  that receives fewer states scans a shorter list. The list grows with each received state."
        .to_owned();
    table
}

/// Shares of the paper's own gap that the measurements explain.
pub(crate) fn published_table(results: &GapResults) -> Table {
    let columns = [
        "balls",
        "the paper's, times integrated",
        "the paper's gap, ms",
        "protocol alone, % of it",
        "poll, %",
        "buffer, %",
        "published client here, ms",
        "of the gap, %",
        "entries of its list",
        "with as many, ms",
        "of the gap, %",
        "its median, ms",
        "placing, spread over a stage, ms",
        "of the gap, %",
        "not explained, %",
    ];
    let mut table = Table::new("Beside the paper's own gap", columns);
    let mut loads: Vec<u32> = results.rows.iter().map(|row| row.load).collect();
    loads.dedup();
    for load in loads {
        let row = |client| row_of(results, load, client);
        let papers = analysis::published(load).and_then(|row| row.frame_ms);
        let Some((integrated, distributed)) = papers else {
            continue;
        };
        let gap = distributed - integrated;
        let beyond = |client| Some(beyond_ms(&row(client)?.outcome));
        let placing = |client| Some(analysis::spread_ms(row(client)?.placing_s, load));
        let capped = placing("cap")
            .zip(placing(SOUND))
            .map(|(cap, sound)| cap - sound);
        let of_gap = |found: Option<f64>| found.map(|found| 100.0 * found / gap);
        let parts = GapShares::of(results, load).map(|parts| parts.each);
        let part = |place: usize| number(of_gap(parts.map(|each| each[place])));
        let long = beyond(AS_LONG);
        let median = row(AS_LONG).map(|row| row.outcome.phys_ft_p50_ms - row.outcome.step_ms);
        let explained = of_gap(long.zip(capped).map(|(long, placing)| long + placing));
        table.rows.push(vec![
            load.to_string(),
            number(Some(distributed / integrated)),
            number(Some(gap)),
            part(GapShares::PROTOCOL),
            part(GapShares::POLL),
            part(GapShares::BUFFER),
            number(beyond(AS_PUBLISHED)),
            number(of_gap(beyond(AS_PUBLISHED))),
            analysis::published_list(load).to_string(),
            number(long),
            number(of_gap(long)),
            number(median),
            number(capped),
            number(of_gap(capped)),
            number(explained.map(|explained| 100.0 - explained)),
        ]);
    }
    table.note = "Gap: the paper's distributed frame beyond its integrated one. Protocol alone, poll and buffer: \
                  time beyond the engine's steps here without defects, and the addition of each defect alone; \
                  measured. Entries: inferred from the experiment's stages and the third of all states that the \
                  published plug-in processed in a measurement with 1,000 bodies. With as many entries: measured, \
                  the first few frames after placing, all defects together; the paper's figures are means. Placing: \
                  the addition of the cap of fifty messages per 30 ms to placing 500 balls of three messages each, \
                  if a caller waits for it, spread over the stage's frames; inferred from the time until all are \
                  placed. A region of the published simulator sends five times as many messages per ball. Not \
                  explained: by the long list and placing."
        .to_owned();
    table
}

/// Time of the published client's frame beyond the engine's steps, milliseconds, and its parts.
struct GapShares {
    all: f64,
    /// The protocol alone, then each defect by itself.
    each: [f64; 5],
}

impl GapShares {
    /// Index of the protocol in `each`.
    const PROTOCOL: usize = 0;
    /// Index of polling in `each`.
    const POLL: usize = 1;
    /// Index of the socket buffer in `each`.
    const BUFFER: usize = 4;

    /// `None` if a row is missing or void.
    fn of(results: &GapResults, load: u32) -> Option<Self> {
        let beyond = |client| sound_row(results, load, client).map(beyond_ms);
        let (base, sound) = (beyond(INTEGRATED)?, beyond(SOUND)?);
        let more = |client| Some(beyond(client)? - sound);
        Some(Self {
            all: beyond(AS_PUBLISHED)? - base,
            each: [
                sound - base,
                more("poll")?,
                more("cap")?,
                more("list")?,
                more("buffer")?,
            ],
        })
    }
}

/// A client's row at a load, unless it is void.
fn row_of<'r>(results: &'r GapResults, load: u32, client: &str) -> Option<&'r GapRow> {
    let sound = |row: &&GapRow| row.load == load && row.client == client && !row.outcome.void;
    results.rows.iter().find(sound)
}

/// A client's outcome at a load, unless it is void.
fn sound_row<'r>(results: &'r GapResults, load: u32, client: &str) -> Option<&'r ModeOutcome> {
    row_of(results, load, client).map(|row| &row.outcome)
}

/// Time of a frame beyond its engine steps, milliseconds.
fn beyond_ms(outcome: &ModeOutcome) -> f64 {
    outcome.phys_ft_ms - outcome.step_ms
}

#[cfg(test)]
mod tests {
    use super::*;

    fn results(frames_ms: &[(&str, f64)]) -> GapResults {
        let row = |(client, phys_ft_ms): &(&str, f64)| GapRow {
            load: 1_000,
            client: (*client).to_owned(),
            placing_s: 1.0,
            outcome: ModeOutcome {
                frames: 10,
                phys_ft_ms: *phys_ft_ms,
                step_ms: 10.0,
                ..ModeOutcome::default()
            },
        };
        GapResults {
            provenance: Provenance::default(),
            rows: frames_ms.iter().map(row).collect(),
        }
    }

    #[test]
    fn shares_are_relative_to_the_published_clients_extra_time() {
        let mut results = results(&[
            (INTEGRATED, 10.0),
            (SOUND, 20.0),
            ("poll", 50.0),
            ("cap", 20.0),
            ("list", 30.0),
            ("buffer", 15.0),
            (AS_PUBLISHED, 110.0),
        ]);
        let table = shares_table(&results);
        // By the paper: 654.51 ms less 0.81.
        let expected = [
            "1000", "100", "654", "15.3", "10.0", "30.0", "0", "10.0", "-5.00", "55.0",
        ];
        assert_eq!(table.rows, [expected.map(str::to_owned)]);
        let mut long = results.rows[6].clone();
        (long.client, long.outcome.phys_ft_ms) = (AS_LONG.to_owned(), 337.0);
        long.outcome.phys_ft_p50_ms = 210.0;
        results.rows[3].placing_s = 3.0;
        results.rows.push(long);
        // 170 frames of 500 balls before, 170 of 1,000 so far, 34 % of them; 2 s more for 1,000 balls, spread over 340
        // frames.
        let expected = [
            "1000", "808", "654", "1.53", "4.59", "-0.765", "100", "15.3", "115600", "327", "50.0",
            "200", "2.94", "0.450", "49.5",
        ];
        assert_eq!(
            published_table(&results).rows,
            [expected.map(str::to_owned)]
        );
        results.rows[2].outcome.void = true;
        assert!(shares_table(&results).rows.is_empty());
        assert_eq!(super::table(&results).rows[2][1], "poll, void");
    }
}
