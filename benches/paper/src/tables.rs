//! The experiment's tables next to the paper's figures, its targets, its CSV.
//!
//! The CSV has a line per outcome or comparison.

use rhumb_bench::numbers::number;
use rhumb_bench::output::OutputError;
use rhumb_bench::record::Mode;
use serde::Serialize;

use crate::analysis::{
    self, ALPHA, Comparison, DEGRADED_FPS, Degradation, Interval, LoadAnalysis, ModeAnalysis,
    PaperResults, Sample, Test,
};
use crate::page::Table;
use crate::settings::PaperError;

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

const COLUMNS: [&str; 5] = ["target", "found", "95 % interval", "where", "met"];

/// A ratio at a load, and its interval where known.
#[derive(Clone, Copy, Debug)]
struct Ratio {
    load: u32,
    ratio: f64,
    interval: Option<Interval>,
}

/// Frame times and degradation.
pub(crate) fn aims(results: &PaperResults) -> Table {
    let mut table = Table::new("Targets", COLUMNS);
    for (mode, from, most) in [
        (Mode::Rhumb, 1_000, 1.10),
        (Mode::RhumbPipelined, 2_000, 0.05),
    ] {
        let ratios = at_loads(results, mode, from, |own| {
            let paired = own.against_integrated?.paired?;
            Some((paired.ratio, paired.interval))
        });
        let name = mode.name();
        let aim = format!("{name} frame at most {most} × integrated from {from} balls on");
        table
            .rows
            .extend(ratios.and_then(|all| of_worst(aim, &all, most)));
    }
    // The stricter target if the integrated engine steps more slowly than the server's.
    let beside = at_loads(results, Mode::Rhumb, 1_000, |own| {
        Some((own.phys_ft_ms.mean / own.step_ms.mean, None))
    });
    let aim = "rhumb frame at most 1.1 × its own engine's steps from 1000 balls on".to_owned();
    table
        .rows
        .extend(beside.and_then(|all| of_worst(aim, &all, 1.10)));
    table
        .rows
        .extend(of_degradation(results, Mode::Rhumb, |found| found.mdl));
    table
        .rows
        .extend(of_degradation(results, Mode::RhumbPipelined, |found| {
            found.sustained_mdl
        }));
    table.note = "Met: at every load; decided by the interval where known, or by the ratio where the interval spans \
                  the target. Found: at the worst load."
        .to_owned();
    table
}

/// A mode's ratio at each load from `from` on; `None` if one is missing, or there is none.
fn at_loads(
    results: &PaperResults,
    mode: Mode,
    from: u32,
    of: impl Fn(&ModeAnalysis) -> Option<(f64, Option<Interval>)>,
) -> Option<Vec<Ratio>> {
    let loads = results.analysis.loads.iter();
    let loads = loads.filter(|load| load.load >= from);
    let own = |load: &LoadAnalysis| {
        let own = load.modes.iter().find(|found| found.mode == mode.name())?;
        let (ratio, interval) = of(own)?;
        Some(Ratio {
            load: load.load,
            ratio,
            interval,
        })
    };
    let all: Vec<Ratio> = loads.map(own).collect::<Option<_>>()?;
    (!all.is_empty()).then_some(all)
}

/// A row for the worst ratio; `None` without ratios.
fn of_worst(aim: String, ratios: &[Ratio], most: f64) -> Option<Vec<String>> {
    let worst = ratios
        .iter()
        .max_by(|one, other| one.ratio.total_cmp(&other.ratio))?;
    let surely = |is: fn(&Interval, f64) -> bool| {
        move |of: &Ratio| of.interval.is_some_and(|interval| is(&interval, most))
    };
    let within = ratios
        .iter()
        .all(surely(|interval, most| interval.to <= most));
    let beyond = ratios
        .iter()
        .any(surely(|interval, most| interval.from > most));
    let met = match (beyond, within, worst.ratio <= most) {
        (true, ..) => "no",
        (_, true, _) => "yes",
        (_, _, true) => "yes, not significantly",
        (_, _, false) => "no, not significantly",
    };
    Some(vec![
        aim,
        number(Some(worst.ratio)),
        interval(worst.interval),
        format!("worst, at {} balls", worst.load),
        met.to_owned(),
    ])
}

/// True if a mode degrades no sooner than integrated, by SimFPS or by the sustained rate.
fn of_degradation(
    results: &PaperResults,
    mode: Mode,
    by: fn(&Degradation) -> Option<u32>,
) -> Option<Vec<String>> {
    let of = |mode: Mode| {
        let mut all = results.analysis.degradation.iter();
        let found = all.find(|found| found.mode == mode.name())?;
        Some(by(found))
    };
    let (own, integrated) = (of(mode)?, of(Mode::Integrated)?);
    let text = |mdl: Option<u32>| mdl.map_or_else(|| "nowhere".to_owned(), |mdl| mdl.to_string());
    let later = own.is_none_or(|own| integrated.is_some_and(|integrated| own >= integrated));
    let measure = if mode.is_ahead() {
        ", by sustained rate"
    } else {
        ""
    };
    Some(vec![
        format!(
            "{} degrades at no fewer balls than integrated{measure}",
            mode.name()
        ),
        text(own),
        NONE.to_owned(),
        format!("integrated: {}", text(integrated)),
        yes(later),
    ])
}

fn yes(met: bool) -> String {
    if met { "yes" } else { "no" }.to_owned()
}

/// Bytes. The target is meant for stages of 30 s; shorter stages need more updates per second.
pub(crate) fn aims_of_bytes(results: &PaperResults) -> Table {
    /// Times the bytes of rhumb.
    const LEAST: f64 = 600.0;
    let mut table = Table::new("Targets", COLUMNS);
    let total = |mode: Mode| {
        let bytes = results.analysis.loads.iter().map(|load| {
            let own = load.modes.iter().find(|found| found.mode == mode.name())?;
            Some(own.bytes_down.mean)
        });
        bytes.sum::<Option<f64>>()
    };
    if let Some((theirs, own)) = total(Mode::AppAll).zip(total(Mode::Rhumb)) {
        table.rows.push(vec![
            format!("app-all takes at least {LEAST} × the bytes of rhumb"),
            number(Some(theirs / own)),
            NONE.to_owned(),
            "whole experiment".to_owned(),
            yes(theirs / own >= LEAST),
        ]);
    }
    table
}

/// Cell of a missing value.
pub(super) const NONE: &str = "–";

/// Precision of a displayed figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Digits {
    /// Three significant digits.
    Three,
    /// Two decimals, as the paper prints frames per second.
    TwoPlaces,
}

impl Digits {
    pub(super) fn show(self, value: Option<f64>) -> String {
        match (self, value) {
            (Self::TwoPlaces, Some(value)) => format!("{value:.2}"),
            (_, value) => number(value),
        }
    }

    /// A mean and its standard deviation.
    pub(super) fn spread(self, sample: &Sample) -> String {
        let mean = self.show(Some(sample.mean));
        match sample.deviation {
            Some(deviation) => format!("{mean} ± {}", self.show(Some(deviation))),
            None => mean,
        }
    }
}

pub(super) fn probability(p: f64) -> String {
    if p < 0.0001 {
        "< 0.0001".to_owned()
    } else {
        format!("{p:.4}")
    }
}

pub(super) fn interval(interval: Option<Interval>) -> String {
    interval.map_or_else(
        || NONE.to_owned(),
        |Interval { from, to }| format!("{} to {}", number(Some(from)), number(Some(to))),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::Analysis;
    use crate::settings::tests::settings;
    use crate::settings::{ExperimentTrial, LoadOutcome, ModeOutcome};

    /// Trials with these frame times of integrated, rhumb and rhumb-pipelined at 500 and 1,000 balls, milliseconds;
    /// engine steps take half the integrated frame.
    fn results(trials: &[[[f64; 3]; 2]]) -> PaperResults {
        let mut settings = settings();
        settings.modes = ["integrated", "rhumb", "rhumb-pipelined"]
            .map(str::to_owned)
            .into();
        let load = |load, frames_ms: [f64; 3]| LoadOutcome {
            load,
            modes: settings
                .modes
                .iter()
                .zip(frames_ms)
                .map(|(mode, phys_ft_ms)| ModeOutcome {
                    mode: mode.clone(),
                    frames: 10,
                    phys_ft_ms,
                    step_ms: frames_ms[0] / 2.0,
                    sim_fps: 1e3 / phys_ft_ms,
                    sustained_fps: 1e3 / frames_ms[0].max(phys_ft_ms),
                    ..ModeOutcome::default()
                })
                .collect(),
        };
        let trials: Vec<ExperimentTrial> = (1..)
            .zip(trials)
            .map(|(number, [few, many])| ExperimentTrial {
                number,
                seed: u64::from(number),
                wall_s: 1.0,
                loads: vec![load(500, *few), load(1_000, *many)],
            })
            .collect();
        PaperResults {
            command: String::new(),
            analysis: Analysis::of(&settings, &trials),
            settings,
            trials,
        }
    }

    fn decisions(results: &PaperResults) -> Vec<(String, String)> {
        let rows = aims(results).rows.into_iter();
        rows.map(|row| (row[1].clone(), row[4].clone())).collect()
    }

    fn expected(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
        let owned = |(one, other): &(&str, &str)| ((*one).to_owned(), (*other).to_owned());
        pairs.iter().map(owned).collect()
    }

    #[test]
    fn only_loads_from_a_thousand_on_count_and_an_interval_decides() {
        // 1.05 and 1.07 of integrated: within 1.1 by their mean, but two trials spread farther.
        let near = results(&[
            [[10.0, 20.0, 1.0], [100.0, 105.0, 1.0]],
            [[10.0, 20.0, 1.0], [100.0, 107.0, 1.0]],
        ]);
        assert_eq!(
            decisions(&near),
            expected(&[
                ("1.06", "yes, not significantly"),
                ("2.12", "no, not significantly"),
                ("nowhere", "yes"),
                ("nowhere", "yes"),
            ])
        );
        let alike = [[10.0, 20.0, 1.0], [100.0, 105.0, 1.0]];
        assert_eq!(
            decisions(&results(&[alike, alike]))[0],
            ("1.05".into(), "yes".into())
        );
        let slow = [[10.0, 10.0, 1.0], [100.0, 125.0, 1.0]];
        let slow = decisions(&results(&[slow, slow]));
        assert_eq!(slow[0], ("1.25".into(), "no".into()));
        // 1/0.125 s is below nine frames a second, 1/0.1 s is not; a caller ahead keeps up what its server does.
        assert_eq!(slow[2..], expected(&[("1000", "no"), ("nowhere", "yes")]));
    }

    #[test]
    fn a_void_load_leaves_the_target_undecided() {
        let mut results = results(&[[[10.0, 10.0, 1.0], [100.0, 105.0, 1.0]]]);
        results.trials[0].loads[1].modes[1].void = true;
        results.analysis = Analysis::of(&results.settings, &results.trials);
        let rows = aims(&results).rows;
        assert!(
            rows.iter().all(|row| !row[0].contains("rhumb frame")),
            "{rows:?}"
        );
    }

    #[test]
    fn bytes_cover_the_whole_experiment() {
        let mut results = results(&[[[10.0, 10.0, 1.0], [100.0, 105.0, 1.0]]]);
        results.settings.modes[0] = "app-all".to_owned();
        for load in &mut results.trials[0].loads {
            load.modes[0].mode = "app-all".to_owned();
            load.modes[0].bytes_down = 6_010_000;
            load.modes[1].bytes_down = 10_000;
        }
        results.analysis = Analysis::of(&results.settings, &results.trials);
        assert_eq!(aims_of_bytes(&results).rows[0][1], "601");
        assert_eq!(aims_of_bytes(&results).rows[0][4], "yes");
    }
}
