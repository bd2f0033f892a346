//! The experiment's results as CSV: a line per outcome or comparison.

use rhumb_bench::output::OutputError;
use serde::Serialize;

use crate::analysis::PaperResults;
use crate::settings::PaperError;

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
