//! The experiment's tables, next to the paper's own figures, and its CSV.
//!
//! The CSV has a line per outcome or comparison.

mod aims;

use rhumb_bench::numbers::number;
use rhumb_bench::output::OutputError;
use rhumb_bench::record::Mode;
use serde::Serialize;

use crate::analysis;
use crate::analysis::{ALPHA, DEGRADED_FPS, Degradation, ModeAnalysis, PaperResults};
use crate::page::Table;
use crate::settings::PaperError;
use crate::statistics::{Comparison, Sample, Test};
use aims::{Digits, NONE, interval, probability};

pub(crate) use aims::{aims, aims_of_bytes};

fn test(test: Option<Test>) -> [String; 2] {
    match test {
        None => [NONE.to_owned(), NONE.to_owned()],
        Some(Test { statistic, p }) => {
            let statistic =
                statistic.map_or_else(|| NONE.to_owned(), |value| format!("{value:.2}"));
            [statistic, probability(p)]
        }
    }
}

/// One column per mode and two of the paper, one row per load.
fn by_mode(
    results: &PaperResults,
    title: &str,
    own: fn(&ModeAnalysis) -> &Sample,
    theirs: fn(&analysis::Published) -> Option<(f64, f64)>,
    digits: Digits,
) -> Table {
    let modes = results.settings.modes.iter().map(String::as_str);
    let columns = ["balls"].into_iter().chain(modes);
    let mut table = Table::new(
        title,
        columns.chain(["paper: integrated", "paper: distributed"]),
    );
    for load in &results.analysis.loads {
        let mut row = vec![load.load.to_string()];
        for mode in &results.settings.modes {
            let found = load.modes.iter().find(|found| found.mode == *mode);
            row.push(found.map_or_else(|| NONE.to_owned(), |found| digits.spread(own(found))));
        }
        let published = analysis::published(load.load).and_then(theirs);
        row.push(digits.show(published.map(|pair| pair.0)));
        row.push(digits.show(published.map(|pair| pair.1)));
        table.rows.push(row);
    }
    table
}

/// Frames per second.
pub(crate) fn sim_fps(results: &PaperResults) -> Table {
    let mut table = by_mode(
        results,
        "SimFPS: simulated frames per second, at most 11.33 (mean ± standard deviation over trials)",
        |mode| &mode.sim_fps,
        |row| Some((row.integrated_fps, row.distributed_fps)),
        Digits::TwoPlaces,
    );
    table.note = "The paper's figures come from another engine on other machines: compare only the ratio of each \
                  remote column to the integrated one beside it."
        .to_owned();
    table
}

/// Frames per second that each mode can sustain.
pub(crate) fn sustained(results: &PaperResults) -> Table {
    let mut table = by_mode(
        results,
        "Frames per second that server and caller both sustain",
        |mode| &mode.sustained_fps,
        |row| Some((row.integrated_fps, row.distributed_fps)),
        Digits::TwoPlaces,
    );
    table.note = "Differs from SimFPS only for pipelined callers: their frames are short, but they cannot outpace \
                  the server."
        .to_owned();
    table
}

/// Milliseconds of a physics frame.
pub(crate) fn phys_ft(results: &PaperResults) -> Table {
    by_mode(
        results,
        "PhysFT: milliseconds from calling advance to having every pose of the returned frame",
        |mode| &mode.phys_ft_ms,
        |row| row.frame_ms,
        Digits::Three,
    )
}

/// Load at which each mode degrades.
pub(crate) fn degradation(results: &PaperResults) -> Table {
    let title = format!("MDL: the smallest load with a mean SimFPS below {DEGRADED_FPS}");
    let mut table = Table::new(&title, ["mode", "MDL, balls", "MDL by sustained rate"]);
    let most = results.settings.loads.last().copied().unwrap_or_default();
    let cell =
        |mdl: Option<u32>| mdl.map_or_else(|| format!("above {most}"), |mdl| mdl.to_string());
    for Degradation {
        mode,
        mdl,
        sustained_mdl,
    } in &results.analysis.degradation
    {
        table
            .rows
            .push(vec![mode.clone(), cell(*mdl), cell(*sustained_mdl)]);
    }
    for (mode, mdl) in [
        ("paper: integrated", analysis::MDL_INTEGRATED),
        ("paper: distributed", analysis::MDL_DISTRIBUTED),
    ] {
        table
            .rows
            .push(vec![mode.to_owned(), mdl.to_string(), NONE.to_owned()]);
    }
    table
}

/// Tests of each mode against integrated at each load, by one measure.
fn tests_of(
    results: &PaperResults,
    title: &str,
    of: fn(&ModeAnalysis) -> Option<Comparison>,
) -> Table {
    let columns = [
        "balls",
        "mode",
        "of integrated",
        "difference",
        "95 % interval",
        "z",
        "p",
        "Welch t",
        "p",
        "Cohen's d",
        "differs by z",
    ];
    let mut table = Table::new(title, columns);
    for load in &results.analysis.loads {
        for mode in &load.modes {
            let Some(found) = of(mode) else { continue };
            let differs = match found.z {
                None => NONE,
                Some(test) if test.p < ALPHA => "yes",
                Some(_) => "no",
            };
            let mut row = vec![
                load.load.to_string(),
                mode.mode.clone(),
                number(Some(found.ratio)),
                number(Some(found.difference)),
                interval(found.interval),
            ];
            row.extend(test(found.z));
            row.extend(test(found.welch));
            row.push(number(found.effect));
            row.push(differs.to_owned());
            table.rows.push(row);
        }
    }
    table.note = format!(
        "Two-tailed Z-tests against integrated at each load, α = {ALPHA}; Welch's t and the interval (10,000 \
         resamples) are added because trials are few. A dash: no spread, or a single trial. Difference: the mode \
         minus integrated."
    );
    table
}

/// Tests of frames per second.
pub(crate) fn tests_fps(results: &PaperResults) -> Table {
    tests_of(results, "SimFPS against integrated", |mode| {
        Some(mode.against_integrated?.sim_fps)
    })
}

/// Tests of frame times.
pub(crate) fn tests_frame(results: &PaperResults) -> Table {
    tests_of(results, "PhysFT against integrated, ms", |mode| {
        Some(mode.against_integrated?.phys_ft_ms)
    })
}

/// Frame times of a mode against integrated, paired by trial.
pub(crate) fn paired(results: &PaperResults) -> Table {
    let columns = [
        "balls",
        "mode",
        "trials",
        "frame, of integrated",
        "95 % interval",
        "t",
        "p",
        "engine, of integrated",
        "frame, of own engine",
    ];
    let mut table = Table::new("PhysFT against integrated, trial by trial", columns);
    for load in &results.analysis.loads {
        for mode in &load.modes {
            let against = mode.against_integrated;
            let Some(found) = against.and_then(|against| against.paired) else {
                continue;
            };
            let engine = against.and_then(|against| against.engine);
            let mut row = vec![
                load.load.to_string(),
                mode.mode.clone(),
                found.pairs.to_string(),
                number(Some(found.ratio)),
                interval(found.interval),
            ];
            row.extend(test(found.test));
            row.push(number(engine.map(|engine| engine.ratio)));
            row.push(number(Some(mode.phys_ft_ms.mean / mode.step_ms.mean)));
            table.rows.push(row);
        }
    }
    table.note = "In a trial all modes step the same scene, frame by frame in turn, so seed and machine conditions \
                  affect all alike: geometric means of the trials' ratios, with Student's t of their logarithms. \
                  Engine: the same steps in the server and in the caller's process, which has other caches. Where it \
                  is not 1, the ratio of frames is biased by as much; the last column is free of this bias."
        .to_owned();
    table
}

/// Breakdown of a frame's time.
pub(crate) fn stages(results: &PaperResults) -> Table {
    let columns = [
        "balls",
        "mode",
        "caller: work, ms",
        "caller: waiting, ms",
        "engine, ms",
        "rest of server, ms",
        "of engine",
        "awake",
    ];
    let mut table = Table::new("Where a frame's time goes", columns);
    for load in &results.analysis.loads {
        for mode in &load.modes {
            let waiting = mode
                .work_ms
                .map(|work| (mode.phys_ft_ms.mean - work.mean).max(0.0));
            table.rows.push(vec![
                load.load.to_string(),
                mode.mode.clone(),
                number(mode.work_ms.map(|work| work.mean)),
                number(waiting),
                number(Some(mode.step_ms.mean)),
                number(Some(mode.beside_ms.mean)),
                number(Some(mode.beside_ms.mean / mode.step_ms.mean)),
                number(Some(mode.awake.mean)),
            ]);
        }
    }
    table.note =
        "The integrated engine steps in the caller's own thread: its work is the engine's."
            .to_owned();
    table
}

/// Bytes to the caller over the whole experiment.
pub(crate) fn traffic(results: &PaperResults) -> Table {
    let columns = [
        "mode",
        "bytes down, per trial",
        "of these in the worst stage",
        "times rhumb",
    ];
    let mut table = Table::new(
        "Bandwidth over the whole experiment, headers counted",
        columns,
    );
    let total = |mode: &str| {
        let bytes = results.analysis.loads.iter().map(|load| {
            let own = load.modes.iter().find(|found| found.mode == mode)?;
            Some(own.bytes_down.mean * f64::from(results.settings.frames_per_load))
        });
        bytes.collect::<Option<Vec<f64>>>()
    };
    let sum = |mode: &str| total(mode).map(|stages| stages.iter().sum::<f64>());
    let rhumb = sum(Mode::Rhumb.name());
    for mode in results
        .settings
        .modes
        .iter()
        .filter(|mode| *mode != Mode::Integrated.name())
    {
        let worst = total(mode).and_then(|stages| stages.into_iter().reduce(f64::max));
        let ratio = sum(mode).zip(rhumb).map(|(own, rhumb)| own / rhumb);
        table.rows.push(vec![
            mode.clone(),
            number(sum(mode)),
            number(worst),
            number(ratio),
        ]);
    }
    table
}

/// A sentence for each void outcome.
pub(crate) fn void(results: &PaperResults) -> Vec<String> {
    let void = results.analysis.void.iter();
    void.map(|void| {
        format!(
            "void: trial {} (seed {}), {} balls, {}: its engine diverged from the integrated one; excluded",
            void.trial, void.seed, void.load, void.mode
        )
    })
    .collect()
}

/// One line of `trials.csv`: a mode at a load in a trial.
#[derive(Serialize)]
struct TrialLine<'r> {
    trial: u32,
    seed: u64,
    load: u32,
    mode: &'r str,
    frames: u32,
    phys_ft_ms: f64,
    phys_ft_p50_ms: f64,
    phys_ft_p99_ms: f64,
    phys_ft_max_ms: f64,
    work_ms: Option<f64>,
    sim_fps: f64,
    sustained_fps: f64,
    step_ms: f64,
    observe_ms: f64,
    publish_ms: f64,
    awake: u32,
    bytes_down: u64,
    bytes_up: u64,
    datagrams_down: u64,
    updates: u64,
    truth: &'r str,
    void: bool,
}

/// Every outcome of every trial.
pub(crate) fn trials_csv(results: &PaperResults) -> Result<String, PaperError> {
    let mut lines = Vec::new();
    for trial in &results.trials {
        for load in &trial.loads {
            for found in &load.modes {
                lines.push(TrialLine {
                    trial: trial.number,
                    seed: trial.seed,
                    load: load.load,
                    mode: &found.mode,
                    frames: found.frames,
                    phys_ft_ms: found.phys_ft_ms,
                    phys_ft_p50_ms: found.phys_ft_p50_ms,
                    phys_ft_p99_ms: found.phys_ft_p99_ms,
                    phys_ft_max_ms: found.phys_ft_max_ms,
                    work_ms: found.work_ms,
                    sim_fps: found.sim_fps,
                    sustained_fps: found.sustained_fps,
                    step_ms: found.step_ms,
                    observe_ms: found.observe_ms,
                    publish_ms: found.publish_ms,
                    awake: found.awake,
                    bytes_down: found.bytes_down,
                    bytes_up: found.bytes_up,
                    datagrams_down: found.datagrams_down,
                    updates: found.updates,
                    truth: &found.truth,
                    void: found.void,
                });
            }
        }
    }
    csv(&lines)
}

/// One line of `analysis.csv`: a mode at a load over all trials, by one measure.
#[derive(Serialize)]
struct AnalysisLine<'r> {
    load: u32,
    mode: &'r str,
    measure: &'static str,
    trials: usize,
    mean: f64,
    deviation: Option<f64>,
    of_integrated: Option<f64>,
    difference: Option<f64>,
    interval_from: Option<f64>,
    interval_to: Option<f64>,
    z: Option<f64>,
    z_p: Option<f64>,
    welch_t: Option<f64>,
    welch_p: Option<f64>,
    cohens_d: Option<f64>,
    paired_ratio: Option<f64>,
    paired_t: Option<f64>,
    paired_p: Option<f64>,
}

/// Every comparison.
pub(crate) fn analysis_csv(results: &PaperResults) -> Result<String, PaperError> {
    let mut lines = Vec::new();
    for load in &results.analysis.loads {
        for mode in &load.modes {
            let against = mode.against_integrated;
            for (measure, sample, found, paired) in [
                (
                    "sim_fps",
                    mode.sim_fps,
                    against.map(|against| against.sim_fps),
                    None,
                ),
                (
                    "phys_ft_ms",
                    mode.phys_ft_ms,
                    against.map(|against| against.phys_ft_ms),
                    against.and_then(|against| against.paired),
                ),
            ] {
                let paired_test = paired.and_then(|paired| paired.test);
                let interval = found.and_then(|found| found.interval);
                let (z, welch) = (
                    found.and_then(|found| found.z),
                    found.and_then(|found| found.welch),
                );
                lines.push(AnalysisLine {
                    load: load.load,
                    mode: &mode.mode,
                    measure,
                    trials: sample.count,
                    mean: sample.mean,
                    deviation: sample.deviation,
                    of_integrated: found.map(|found| found.ratio),
                    difference: found.map(|found| found.difference),
                    interval_from: interval.map(|interval| interval.from),
                    interval_to: interval.map(|interval| interval.to),
                    z: z.and_then(|test| test.statistic),
                    z_p: z.map(|test| test.p),
                    welch_t: welch.and_then(|test| test.statistic),
                    welch_p: welch.map(|test| test.p),
                    cohens_d: found.and_then(|found| found.effect),
                    paired_ratio: paired.map(|paired| paired.ratio),
                    paired_t: paired_test.and_then(|test| test.statistic),
                    paired_p: paired_test.map(|test| test.p),
                });
            }
        }
    }
    csv(&lines)
}

fn csv(lines: &[impl Serialize]) -> Result<String, PaperError> {
    let failed = |cause: std::io::Error| {
        PaperError::Output(OutputError::Write {
            path: "the CSV table".into(),
            cause,
        })
    };
    let mut writer = csv::Writer::from_writer(Vec::new());
    for line in lines {
        writer
            .serialize(line)
            .map_err(|cause| failed(cause.into()))?;
    }
    let bytes = writer
        .into_inner()
        .map_err(|cause| failed(cause.into_error()))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}
