//! Figures of SimFPS and PhysFT by load, and their analysis over all trials.
//!
//! A void outcome enters no figure and is listed by name. The results are `paper.json`.
//!
//! The paper's own figures are as printed. Source: its Table 1; frame times come from its text, because its printed Table 2
//! repeats Table 1. Its machines and engine differ from ours, so only the shapes of curves compare.
//!
//! The statistics of repeated trials of two modes, and the tests of their difference, work on plain numbers. Distributions
//! come from `statrs`; resampling is seeded.

use std::fmt::Write as _;

use plotters::style::RGBColor;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use rhumb_bench::drive::player;
use rhumb_bench::record::Mode;
use rhumb_bench::report::{Axis, Chart, Mark, SIZE, color, escape};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use crate::settings::{ExperimentTrial, ModeOutcome, Settings};

/// Frame rate below which a load counts as degraded (MDL: the minimum degradation load).
pub(crate) const DEGRADED_FPS: f64 = 9.0;
/// Level of significance of all tests.
pub(crate) const ALPHA: f64 = 0.05;

/// All results computed from the trials.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Analysis {
    /// Loads in ascending order.
    pub(crate) loads: Vec<LoadAnalysis>,
    /// Degradation of each mode, in the order of the settings.
    pub(crate) degradation: Vec<Degradation>,
    /// Outcomes excluded from all figures.
    pub(crate) void: Vec<Void>,
}

/// Analysis of one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct LoadAnalysis {
    /// Number of balls.
    pub(crate) load: u32,
    /// Modes in the order of the settings, without those whose outcomes are all void.
    pub(crate) modes: Vec<ModeAnalysis>,
}

/// One mode at one load, over all trials.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ModeAnalysis {
    /// Name of the mode.
    pub(crate) mode: String,
    /// Frames per second.
    pub(crate) sim_fps: Sample,
    /// Frames per second limited by the server too.
    pub(crate) sustained_fps: Sample,
    /// Frame time, milliseconds.
    pub(crate) phys_ft_ms: Sample,
    /// Processor time of the caller in a frame, milliseconds; `None` where the system does not report it.
    pub(crate) work_ms: Option<Sample>,
    /// Time of the engine's steps in a frame, milliseconds.
    pub(crate) step_ms: Sample,
    /// Server time per frame besides stepping, milliseconds.
    pub(crate) beside_ms: Sample,
    /// Bytes to the caller per frame, headers included.
    pub(crate) bytes_down: Sample,
    /// Bodies awake at the end.
    pub(crate) awake: Sample,
    /// Comparison with integrated at this load; `None` for integrated itself.
    pub(crate) against_integrated: Option<Against>,
}

/// Comparison of a mode with integrated; differences are mode minus integrated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Against {
    /// Difference in frames per second.
    pub(crate) sim_fps: Comparison,
    /// Difference in milliseconds per frame.
    pub(crate) phys_ft_ms: Comparison,
    /// Difference in milliseconds per frame, paired by trial: in each trial both step the same scene in turn.
    pub(crate) paired: Option<Paired>,
    /// Engine times, paired by trial: the engines take the same steps on different cores.
    pub(crate) engine: Option<Paired>,
}

/// Smallest load at which a mode's mean falls below nine frames per second.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Degradation {
    /// Name of the mode.
    pub(crate) mode: String,
    /// The load by SimFPS; `None` if no load degrades the mode.
    pub(crate) mdl: Option<u32>,
    /// The load by the sustained rate.
    pub(crate) sustained_mdl: Option<u32>,
}

/// An outcome whose engine diverged from the integrated one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Void {
    /// Number of the trial.
    pub(crate) trial: u32,
    /// Its seed.
    pub(crate) seed: u64,
    /// Load of the outcome.
    pub(crate) load: u32,
    /// Name of the mode.
    pub(crate) mode: String,
}

impl Analysis {
    /// Analyses trials.
    #[must_use]
    pub(crate) fn of(settings: &Settings, trials: &[ExperimentTrial]) -> Self {
        let loads: Vec<_> = settings
            .loads
            .iter()
            .map(|load| of_load(settings, *load, trials))
            .collect();
        let degradation = settings
            .modes
            .iter()
            .map(|mode| degradation(mode, &loads))
            .collect();
        Self {
            loads,
            degradation,
            void: void(trials),
        }
    }

    /// The analysis of one mode at one load.
    #[must_use]
    pub(crate) fn mode(&self, load: u32, mode: &str) -> Option<&ModeAnalysis> {
        let load = self.loads.iter().find(|found| found.load == load)?;
        load.modes.iter().find(|found| found.mode == mode)
    }
}

fn of_load(settings: &Settings, load: u32, trials: &[ExperimentTrial]) -> LoadAnalysis {
    let integrated = sound(trials, load, Mode::Integrated.name());
    let modes = settings.modes.iter();
    LoadAnalysis {
        load,
        modes: modes
            .filter_map(|mode| of_mode(settings, mode, &sound(trials, load, mode), &integrated))
            .collect(),
    }
}

/// The valid outcomes of a mode at a load, with their trial numbers.
fn sound<'t>(trials: &'t [ExperimentTrial], load: u32, mode: &str) -> Vec<(u32, &'t ModeOutcome)> {
    let all = trials.iter().flat_map(|trial| {
        let loads = trial.loads.iter().filter(|found| found.load == load);
        let modes = loads.flat_map(|found| &found.modes);
        modes.map(|found| (trial.number, found))
    });
    all.filter(|(_, found)| found.mode == mode && !found.void)
        .collect()
}

/// Values of two modes, paired by trial.
fn paired(
    of: fn(&ModeOutcome) -> f64,
    outcomes: &[(u32, &ModeOutcome)],
    integrated: &[(u32, &ModeOutcome)],
) -> Option<Paired> {
    let pair = |(number, own): &(u32, &ModeOutcome)| {
        let (_, beside) = integrated.iter().find(|(other, _)| other == number)?;
        Some((of(own), of(beside)))
    };
    let pairs: Vec<(f64, f64)> = outcomes.iter().filter_map(pair).collect();
    Paired::of(&pairs)
}

fn of_mode(
    settings: &Settings,
    mode: &str,
    outcomes: &[(u32, &ModeOutcome)],
    integrated: &[(u32, &ModeOutcome)],
) -> Option<ModeAnalysis> {
    let values = |of: fn(&ModeOutcome) -> f64, all: &[(u32, &ModeOutcome)]| -> Vec<f64> {
        all.iter().map(|(_, outcome)| of(outcome)).collect()
    };
    let sample = |of: fn(&ModeOutcome) -> f64| Sample::of(&values(of, outcomes));
    let compare = |of: fn(&ModeOutcome) -> f64| {
        Comparison::of(
            &values(of, outcomes),
            &values(of, integrated),
            settings.seed,
        )
    };
    let fps = |outcome: &ModeOutcome| outcome.sim_fps;
    let frame = |outcome: &ModeOutcome| outcome.phys_ft_ms;
    let is_other = mode != Mode::Integrated.name();
    let against = || compare(fps).zip(compare(frame));
    let step = |outcome: &ModeOutcome| outcome.step_ms;
    let work: Option<Vec<f64>> = outcomes.iter().map(|(_, found)| found.work_ms).collect();
    Some(ModeAnalysis {
        mode: mode.to_owned(),
        sim_fps: sample(fps)?,
        sustained_fps: sample(|outcome| outcome.sustained_fps)?,
        phys_ft_ms: sample(frame)?,
        work_ms: work.and_then(|work| Sample::of(&work)),
        step_ms: sample(step)?,
        beside_ms: sample(|outcome| outcome.observe_ms + outcome.publish_ms)?,
        bytes_down: sample(|outcome| outcome.bytes_down as f64 / f64::from(outcome.frames.max(1)))?,
        awake: sample(|outcome| f64::from(outcome.awake))?,
        against_integrated: is_other
            .then(against)
            .flatten()
            .map(|(sim_fps, phys_ft_ms)| Against {
                sim_fps,
                phys_ft_ms,
                paired: paired(frame, outcomes, integrated),
                engine: paired(step, outcomes, integrated),
            }),
    })
}

/// Rule of the paper: the smallest load with a mean below nine.
fn degradation(mode: &str, loads: &[LoadAnalysis]) -> Degradation {
    let least = |of: fn(&ModeAnalysis) -> f64| {
        let below = loads.iter().filter(|load| {
            let own = load.modes.iter().find(|found| found.mode == mode);
            own.is_some_and(|own| of(own) < DEGRADED_FPS)
        });
        below.map(|load| load.load).min()
    };
    Degradation {
        mode: mode.to_owned(),
        mdl: least(|own| own.sim_fps.mean),
        sustained_mdl: least(|own| own.sustained_fps.mean),
    }
}

fn void(trials: &[ExperimentTrial]) -> Vec<Void> {
    let mut void = Vec::new();
    for trial in trials {
        for load in &trial.loads {
            for outcome in load.modes.iter().filter(|outcome| outcome.void) {
                void.push(Void {
                    trial: trial.number,
                    seed: trial.seed,
                    load: load.load,
                    mode: outcome.mode.clone(),
                });
            }
        }
    }
    void
}

/// Results of an experiment: `paper.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PaperResults {
    /// The command line; its paths have no folders.
    pub(crate) command: String,
    /// Settings of the experiment.
    pub(crate) settings: Settings,
    /// Every finished trial.
    pub(crate) trials: Vec<ExperimentTrial>,
    /// Analysis over all trials.
    pub(crate) analysis: Analysis,
}

/// A load of the paper's table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Published {
    /// Number of balls.
    pub(crate) load: u32,
    /// Simulated frames per second with the engine in the simulator.
    pub(crate) integrated_fps: f64,
    /// The same with the engine in another process.
    pub(crate) distributed_fps: f64,
    /// Frame times in milliseconds, integrated and distributed, where the text states them.
    pub(crate) frame_ms: Option<(f64, f64)>,
}

/// Load from which the paper's integrated frame rate is below nine.
pub(crate) const MDL_INTEGRATED: u32 = 4_500;
/// The same for distributed.
pub(crate) const MDL_DISTRIBUTED: u32 = 500;

const fn row(load: u32, integrated_fps: f64, distributed_fps: f64) -> Published {
    Published {
        load,
        integrated_fps,
        distributed_fps,
        frame_ms: None,
    }
}

const fn timed(row: Published, integrated_ms: f64, distributed_ms: f64) -> Published {
    Published {
        frame_ms: Some((integrated_ms, distributed_ms)),
        ..row
    }
}

/// Balls added per stage, and frames of a stage.
const STAGE: u32 = 500;
const STAGE_FRAMES: u64 = 340;
/// Percentage of states that the published client processed, measured with its plug-in: a thousand bodies, 450 frames,
/// 40 s. The share falls with more bodies.
const TAKEN_IN_PERCENT: u64 = 34;

/// Length of the published client's list in the middle of a load's stage, if it processed the same share of all states
/// as measured with few bodies.
pub(crate) fn published_list(load: u32) -> u32 {
    let stages = u64::from(load / STAGE);
    let before = stages * stages.saturating_sub(1) / 2 * u64::from(STAGE);
    let states = STAGE_FRAMES * before + STAGE_FRAMES / 2 * u64::from(load);
    u32::try_from(states * TAKEN_IN_PERCENT / 100).unwrap_or(u32::MAX)
}

/// Time until a load is placed, spread over the frames of a stage: milliseconds per frame.
pub(crate) fn spread_ms(placing_s: f64, load: u32) -> f64 {
    placing_s * 1e3 * f64::from(STAGE) / f64::from(load) / STAGE_FRAMES as f64
}

/// All rows, by load.
const TABLE: [Published; 10] = [
    timed(row(1_000, 11.33, 3.19), 0.81, 654.51),
    row(2_000, 11.30, 1.32),
    row(3_000, 10.97, 0.69),
    row(4_000, 9.65, 0.45),
    timed(row(5_000, 6.53, 0.30), 289.44, 6_141.13),
    row(6_000, 4.18, 0.44),
    row(7_000, 1.54, 0.33),
    row(8_000, 0.73, 0.36),
    row(9_000, 0.68, 0.38),
    timed(row(10_000, 1.72, 0.30), 1_081.37, 6_269.5),
];

/// The paper's figures at a load.
pub(crate) fn published(load: u32) -> Option<&'static Published> {
    TABLE.iter().find(|row| row.load == load)
}

/// A figure and its legend.
pub(crate) struct PaperFigure {
    /// Part of the file name.
    pub(crate) name: &'static str,
    pub(crate) title: &'static str,
    pub(crate) svg: String,
    /// Colours and labels, in the order of drawing.
    pub(crate) keys: Vec<(RGBColor, String)>,
}

impl PaperFigure {
    /// The figure as a file of its own: on white, with its legend below.
    pub(crate) fn standalone(&self) -> String {
        let (width, height) = SIZE;
        let rows = self.keys.chunks(KEYS_IN_ROW).count() as u32;
        let taller = height + rows * LEGEND_ROW;
        let mut legend = String::new();
        for (place, (color, label)) in (0..).zip(&self.keys) {
            let hue = format!("#{:02X}{:02X}{:02X}", color.0, color.1, color.2);
            let (column, row) = (place % KEYS_IN_ROW as u32, place / KEYS_IN_ROW as u32);
            let left = column * (width / KEYS_IN_ROW as u32) + 40;
            let top = height + row * LEGEND_ROW + LEGEND_ROW / 4;
            let _ = write!(
                legend,
                "<rect x=\"{left}\" y=\"{top}\" width=\"24\" height=\"24\" fill=\"{hue}\"/>\n\
                 <text x=\"{}\" y=\"{}\" font-family=\"sans-serif\" font-size=\"28\" fill=\"#374151\">{}</text>\n",
                left + 34,
                top + 22,
                escape(label)
            );
        }
        let old = format!("height=\"{height}\" viewBox=\"0 0 {width} {height}\"");
        let new = format!("height=\"{taller}\" viewBox=\"0 0 {width} {taller}\"");
        let svg = self.svg.replacen(&old, &new, 1);
        let white = format!("<rect width=\"{width}\" height=\"{taller}\" fill=\"#FFFFFF\"/>\n");
        let (head, body) = svg.split_once(">\n").unwrap_or((&svg, ""));
        let body = body.replacen("</svg>", &format!("{legend}</svg>"), 1);
        format!("{head}>\n{white}{body}")
    }
}

/// Legend entries per row.
const KEYS_IN_ROW: usize = 4;
/// Height of a legend row, in the figure's units.
const LEGEND_ROW: u32 = 56;
/// Colours of the paper's integrated and distributed engines.
const PUBLISHED: [RGBColor; 2] = [RGBColor(156, 163, 175), RGBColor(217, 119, 87)];

/// Frames per second by load.
pub(crate) fn sim_fps(results: &PaperResults) -> PaperFigure {
    let theirs = |row: &Published| Some((row.integrated_fps, row.distributed_fps));
    let drawn = Drawn::of(results, |mode| &mode.sim_fps, theirs);
    PaperFigure {
        name: "sim-fps",
        title: "SimFPS by load (higher is better)",
        svg: Chart {
            x: drawn.loads(),
            y: Axis::linear("frames per second", 0.0, [12.0].into_iter()),
            marks: drawn.marks,
        }
        .svg(),
        keys: drawn.keys,
    }
}

/// Milliseconds of a frame by load.
pub(crate) fn phys_ft(results: &PaperResults) -> PaperFigure {
    let drawn = Drawn::of(results, |mode| &mode.phys_ft_ms, |row| row.frame_ms);
    let values: Vec<f64> = drawn.points.iter().map(|point| point.1).collect();
    PaperFigure {
        name: "phys-ft",
        title: "PhysFT by load (lower is better)",
        svg: Chart {
            x: drawn.loads(),
            y: Axis::log("milliseconds", values.into_iter()),
            marks: drawn.marks,
        }
        .svg(),
        keys: drawn.keys,
    }
}

/// Curves of all modes and of the paper.
struct Drawn {
    marks: Vec<Mark>,
    keys: Vec<(RGBColor, String)>,
    points: Vec<(f64, f64)>,
}

impl Drawn {
    fn of(
        results: &PaperResults,
        own: fn(&ModeAnalysis) -> &Sample,
        theirs: fn(&Published) -> Option<(f64, f64)>,
    ) -> Self {
        let mut drawn = Self {
            marks: Vec::new(),
            keys: Vec::new(),
            points: Vec::new(),
        };
        let most = results.settings.loads.last().copied().unwrap_or_default();
        let rows = TABLE.iter().filter(|row| row.load <= most);
        let pairs: Vec<(f64, (f64, f64))> = rows
            .filter_map(|row| Some((f64::from(row.load), theirs(row)?)))
            .collect();
        if !pairs.is_empty() {
            let integrated = pairs.iter().map(|(load, pair)| (*load, pair.0)).collect();
            let distributed = pairs.iter().map(|(load, pair)| (*load, pair.1)).collect();
            drawn.line(PUBLISHED[0], "paper: integrated", 3, integrated);
            drawn.line(PUBLISHED[1], "paper: distributed", 3, distributed);
        }
        for mode in &results.settings.modes {
            let found: Vec<(f64, Sample)> = results
                .analysis
                .loads
                .iter()
                .filter_map(|load| {
                    let own_mode = load.modes.iter().find(|found| found.mode == *mode)?;
                    Some((f64::from(load.load), *own(own_mode)))
                })
                .collect();
            let known = player::playable().find(|known| known.name() == mode);
            let color = known.map_or(PUBLISHED[0], color);
            for (load, sample) in &found {
                // One standard deviation up and down.
                let each_way = sample.deviation.unwrap_or(0.0);
                drawn.marks.push(Mark::Line {
                    color,
                    width: 2,
                    dash: None,
                    points: vec![
                        (*load, sample.mean - each_way),
                        (*load, sample.mean + each_way),
                    ],
                });
            }
            let points = found
                .iter()
                .map(|(load, sample)| (*load, sample.mean))
                .collect();
            let width = if *mode == Mode::Rhumb.name() { 8 } else { 5 };
            drawn.line(color, mode, width, points);
        }
        drawn
    }

    fn line(&mut self, color: RGBColor, label: &str, width: u32, points: Vec<(f64, f64)>) {
        if points.is_empty() {
            return;
        }
        self.points.extend(&points);
        // A dot, since a single point makes no line.
        for at in &points {
            self.marks.push(Mark::Dot {
                color,
                radius: width as i32 + 2,
                at: *at,
                label: String::new(),
            });
        }
        self.keys.push((color, label.to_owned()));
        self.marks.push(Mark::Line {
            color,
            width,
            dash: None,
            points,
        });
    }

    fn loads(&self) -> Axis {
        Axis::linear("balls", 0.0, self.points.iter().map(|point| point.0))
    }
}

/// Number of resamples for an interval.
const RESAMPLES: usize = 10_000;

/// Count, mean and spread of values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Sample {
    /// Number of values.
    pub(crate) count: usize,
    /// Arithmetic mean.
    pub(crate) mean: f64,
    /// Standard deviation with count − 1 in the denominator; `None` for a single value.
    pub(crate) deviation: Option<f64>,
}

impl Sample {
    /// `None` without values.
    #[must_use]
    pub(crate) fn of(values: &[f64]) -> Option<Self> {
        let count = values.len();
        if count == 0 {
            return None;
        }
        let mean = values.iter().sum::<f64>() / count as f64;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        Some(Self {
            count,
            mean,
            deviation: (count > 1).then(|| (squares / (count - 1) as f64).sqrt()),
        })
    }

    /// Square of the mean's standard error.
    fn error_squared(&self) -> Option<f64> {
        Some(self.deviation?.powi(2) / self.count as f64)
    }
}

/// A test of the hypothesis that two means are equal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Test {
    /// Difference of the means in standard errors, first minus second; `None` without any spread.
    pub(crate) statistic: Option<f64>,
    /// Two-tailed probability of such a difference or a greater one if the means are equal.
    pub(crate) p: f64,
}

/// An interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Interval {
    /// Lower end.
    pub(crate) from: f64,
    /// Upper end.
    pub(crate) to: f64,
}

/// Comparison of two samples; differences are first minus second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Comparison {
    /// Mean of the first minus mean of the second.
    pub(crate) difference: f64,
    /// Mean of the first over mean of the second.
    pub(crate) ratio: f64,
    /// The paper's test, with the samples' deviations in place of the populations'. `None` with a single trial.
    pub(crate) z: Option<Test>,
    /// Welch's test: Student's distribution, unequal variances. `None` with a single trial.
    pub(crate) welch: Option<Test>,
    /// Cohen's d: the difference in pooled standard deviations. `None` with a single trial or without any spread.
    pub(crate) effect: Option<f64>,
    /// Central 95 % of the differences of resampled means. `None` with a single trial.
    pub(crate) interval: Option<Interval>,
}

/// Ratio of paired values, such as two modes of one trial with the same seed and machine conditions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Paired {
    /// Number of pairs.
    pub(crate) pairs: usize,
    /// Geometric mean of first over second.
    pub(crate) ratio: f64,
    /// 95 % interval of the ratio, by Student's distribution of the mean logarithm. `None` for a single pair.
    pub(crate) interval: Option<Interval>,
    /// Student's test of the hypothesis that the mean logarithm is zero. `None` for a single pair.
    pub(crate) test: Option<Test>,
}

impl Paired {
    /// `None` without pairs, or if a value is not above zero.
    #[must_use]
    pub(crate) fn of(pairs: &[(f64, f64)]) -> Option<Self> {
        let logs = pairs.iter().map(|(first, second)| {
            let sound = *first > 0.0 && *second > 0.0;
            sound.then(|| (first / second).ln())
        });
        let logs: Vec<f64> = logs.collect::<Option<_>>()?;
        let sample = Sample::of(&logs)?;
        let error = sample.error_squared().map(f64::sqrt);
        let student = StudentsT::new(0.0, 1.0, (sample.count - 1) as f64);
        let student = error.zip(student.ok());
        Some(Self {
            pairs: sample.count,
            ratio: sample.mean.exp(),
            interval: student.map(|(error, student)| {
                let half = error * student.inverse_cdf(0.975);
                Interval {
                    from: (sample.mean - half).exp(),
                    to: (sample.mean + half).exp(),
                }
            }),
            test: student.map(|(error, student)| {
                let statistic = (error > 0.0).then(|| sample.mean / error);
                Test {
                    statistic,
                    p: statistic.map_or_else(
                        || p_without_spread(sample.mean),
                        |t| 2.0 * student.cdf(-t.abs()),
                    ),
                }
            }),
        })
    }
}

/// Hypotheses rejected at a family-wise level (Holm's step-down method).
#[must_use]
pub(crate) fn rejected(p: &[f64], level: f64) -> Vec<bool> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|one, other| p[*one].total_cmp(&p[*other]));
    let mut rejected = vec![false; p.len()];
    for (before, place) in order.into_iter().enumerate() {
        let left = (p.len() - before) as f64;
        // In this form NaN rejects nothing.
        let small = p[place] * left < level;
        if !small {
            break;
        }
        rejected[place] = true;
    }
    rejected
}

impl Comparison {
    /// Compares two samples; `None` if one is empty.
    #[must_use]
    pub(crate) fn of(first: &[f64], second: &[f64], seed: u64) -> Option<Self> {
        let (one, other) = (Sample::of(first)?, Sample::of(second)?);
        let several = first.len() > 1 && second.len() > 1;
        Some(Self {
            difference: one.mean - other.mean,
            ratio: one.mean / other.mean,
            z: z_test(&one, &other),
            welch: welch_test(&one, &other),
            effect: cohens_d(&one, &other),
            interval: several.then(|| bootstrap(first, second, seed)),
        })
    }
}

/// The difference in standard errors, and the error's square; the statistic is `None` without any spread.
fn standardised(one: &Sample, other: &Sample) -> Option<(Option<f64>, f64)> {
    let squared = one.error_squared()? + other.error_squared()?;
    let difference = one.mean - other.mean;
    let statistic = (squared > 0.0).then(|| difference / squared.sqrt());
    Some((statistic, difference))
}

/// Without any spread, equal means have p = 1 and other means p = 0.
fn p_without_spread(difference: f64) -> f64 {
    if difference == 0.0 { 1.0 } else { 0.0 }
}

/// Two-tailed two-sample Z-test.
fn z_test(one: &Sample, other: &Sample) -> Option<Test> {
    let (statistic, difference) = standardised(one, other)?;
    let p = match statistic {
        Some(z) => 2.0 * Normal::standard().cdf(-z.abs()),
        None => p_without_spread(difference),
    };
    Some(Test { statistic, p })
}

/// Welch's two-tailed t-test, with the degrees of freedom of Welch and Satterthwaite.
fn welch_test(one: &Sample, other: &Sample) -> Option<Test> {
    let (statistic, difference) = standardised(one, other)?;
    let p = match statistic {
        Some(t) => {
            let (a, b) = (one.error_squared()?, other.error_squared()?);
            let parts = a.powi(2) / (one.count - 1) as f64 + b.powi(2) / (other.count - 1) as f64;
            let student = StudentsT::new(0.0, 1.0, (a + b).powi(2) / parts).ok()?;
            2.0 * student.cdf(-t.abs())
        }
        None => p_without_spread(difference),
    };
    Some(Test { statistic, p })
}

/// The difference of the means in pooled standard deviations.
fn cohens_d(one: &Sample, other: &Sample) -> Option<f64> {
    let sum = |sample: &Sample| Some(sample.deviation?.powi(2) * (sample.count - 1) as f64);
    let pooled = (sum(one)? + sum(other)?) / (one.count + other.count - 2) as f64;
    (pooled > 0.0).then(|| (one.mean - other.mean) / pooled.sqrt())
}

/// Central 95 % of differences of means, each side resampled separately (percentile bootstrap).
fn bootstrap(first: &[f64], second: &[f64], seed: u64) -> Interval {
    /// The generator's stream number: PCG's own example.
    const STREAM: u64 = 0x0a02_bdbf_7bb3_c0a7;
    let mut draws = Pcg32::new(seed, STREAM);
    let mut mean_again = |values: &[f64]| {
        let pick = |_| values[((u64::from(draws.next_u32()) * values.len() as u64) >> 32) as usize];
        (0..values.len()).map(pick).sum::<f64>() / values.len() as f64
    };
    let mut differences: Vec<f64> = (0..RESAMPLES)
        .map(|_| mean_again(first) - mean_again(second))
        .collect();
    let mut at = |share: f64| {
        let place = ((RESAMPLES - 1) as f64 * share).round() as usize;
        *differences.select_nth_unstable_by(place, f64::total_cmp).1
    };
    Interval {
        from: at(0.025),
        to: at(0.975),
    }
}

#[cfg(test)]
pub(crate) mod tests;
