//! Figures of SimFPS and PhysFT by load, with the paper's own curves.
//!
//! The paper's own figures are as printed. Source: its Table 1; frame times come from its text, because its printed Table 2
//! repeats Table 1. Its machines and engine differ from ours, so only the shapes of curves compare.

use std::fmt::Write as _;

use plotters::style::RGBColor;
use rhumb_bench::drive::player;
use rhumb_bench::record::Mode;
use rhumb_bench::report::{Axis, Chart, Mark, SIZE, color, escape};

use crate::analysis::{ModeAnalysis, PaperResults};
use crate::statistics::Sample;

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
