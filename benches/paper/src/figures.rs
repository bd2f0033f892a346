//! Figures of SimFPS and PhysFT by load, with the paper's own curves.

use std::fmt::Write as _;

use plotters::style::RGBColor;
use rhumb_bench::drive::player;
use rhumb_bench::record::Mode;
use rhumb_bench::report::{Axis, Chart, Mark, SIZE, color, escape};

use crate::analysis::{ModeAnalysis, PaperResults};
use crate::published;
use crate::statistics::Sample;

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
    let theirs = |row: &published::Published| Some((row.integrated_fps, row.distributed_fps));
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
        theirs: fn(&published::Published) -> Option<(f64, f64)>,
    ) -> Self {
        let mut drawn = Self {
            marks: Vec::new(),
            keys: Vec::new(),
            points: Vec::new(),
        };
        let most = results.settings.loads.last().copied().unwrap_or_default();
        let rows = published::TABLE.iter().filter(|row| row.load <= most);
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
