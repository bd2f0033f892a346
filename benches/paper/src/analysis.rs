//! Figures of SimFPS and PhysFT by load, and their analysis over all trials.
//!
//! A void outcome enters no figure and is listed by name. The results are `paper.json`.
//!
//! The paper's own figures are as printed. Source: its Table 1; frame times come from its text, because its printed Table 2
//! repeats Table 1. Its machines and engine differ from ours, so only the shapes of curves compare.

use std::fmt::Write as _;

use plotters::style::RGBColor;
use rhumb_bench::drive::player;
use rhumb_bench::record::Mode;
use rhumb_bench::report::{Axis, Chart, Mark, SIZE, color, escape};
use serde::{Deserialize, Serialize};

use crate::settings::{ExperimentTrial, ModeOutcome, Settings};
use crate::statistics::{Comparison, Paired, Sample};

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
    /// The command line, as typed.
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::settings::LoadOutcome;
    use crate::settings::tests::settings;

    /// A trial with these frame rates of integrated and naive at 500 and 1,000 balls.
    pub(crate) fn trial(number: u32, fps: [[f64; 2]; 2]) -> ExperimentTrial {
        let outcome = |mode: &str, fps: f64| ModeOutcome {
            mode: mode.to_owned(),
            frames: 10,
            sim_fps: fps,
            sustained_fps: fps / 2.0,
            phys_ft_ms: 1e3 / fps,
            bytes_down: 1_000,
            ..ModeOutcome::default()
        };
        let load = |load, fps: [f64; 2]| LoadOutcome {
            load,
            modes: vec![outcome("integrated", fps[0]), outcome("naive", fps[1])],
        };
        ExperimentTrial {
            number,
            seed: u64::from(number),
            wall_s: 1.0,
            loads: vec![load(500, fps[0]), load(1_000, fps[1])],
        }
    }

    #[test]
    fn degradation_begins_at_the_smallest_load_with_a_mean_below_nine() {
        let trials = [
            trial(1, [[11.0, 9.5], [9.2, 8.0]]),
            trial(2, [[11.0, 8.5], [8.8, 7.0]]),
        ];
        let analysis = Analysis::of(&settings(), &trials);
        let mdl = |mode: &str| {
            let found = analysis.degradation.iter().find(|found| found.mode == mode);
            found.map(|found| (found.mdl, found.sustained_mdl)).unwrap()
        };
        // Integrated: means 11 and exactly 9, which is not below. Naive: exactly 9 at 500, 7.5 at 1,000.
        assert_eq!(mdl("integrated"), (None, Some(500)));
        assert_eq!(mdl("naive"), (Some(1_000), Some(500)));
        assert_eq!(mdl("rhumb"), (None, None));
        let naive = analysis.mode(1_000, "naive").unwrap();
        assert_eq!((naive.sim_fps.count, naive.sim_fps.mean), (2, 7.5));
        let against = naive.against_integrated.unwrap();
        assert!((against.sim_fps.difference + 1.5).abs() < 1e-12);
        // Frames of 1/8 and 1/7 s beside 1/9.2 and 1/8.8 s: √(9.2/8 · 8.8/7).
        let paired = against.paired.unwrap();
        assert_eq!(paired.pairs, 2);
        assert!((paired.ratio - (1.15_f64 * 8.8 / 7.0).sqrt()).abs() < 1e-12);
        assert_eq!(
            analysis.mode(500, "integrated").unwrap().against_integrated,
            None
        );
        assert_eq!(naive.bytes_down.mean, 100.0);
    }

    #[test]
    fn a_void_outcome_is_excluded_and_listed() {
        let mut trials = [
            trial(1, [[11.0, 10.0], [10.0, 10.0]]),
            trial(2, [[11.0, 1.0], [10.0, 10.0]]),
        ];
        trials[1].loads[0].modes[1].void = true;
        let analysis = Analysis::of(&settings(), &trials);
        let naive = analysis.mode(500, "naive").unwrap();
        assert_eq!((naive.sim_fps.count, naive.sim_fps.mean), (1, 10.0));
        let named = Void {
            trial: 2,
            seed: 2,
            load: 500,
            mode: "naive".to_owned(),
        };
        assert_eq!(analysis.void, [named]);
        trials[0].loads[0].modes[1].void = true;
        assert_eq!(Analysis::of(&settings(), &trials).mode(500, "naive"), None);
    }
}
