//! The figures of the report, with their sentences.
//!
//! The frontier shows bytes and errors of several replays.

use plotters::style::RGBColor;

use super::plot::{Axis, Chart, INK, Mark, decimate, plain};
use crate::numbers::number;
use crate::record::{Load, Mode, Run};
use crate::summary::{RunFigures, Summary, second_by_second};

/// A figure of the page.
pub(super) struct Figure {
    pub(super) title: String,
    pub(super) sentence: String,
    /// Legend of its colours.
    pub(super) keys: Vec<LegendKey>,
    pub(super) svg: String,
}

/// A colour and its meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LegendKey {
    /// The colour's name in `style.css`.
    pub(super) color: &'static str,
    pub(super) label: &'static str,
}

/// Legend entry of a mode.
const fn key(mode: Mode) -> LegendKey {
    let color = match mode {
        Mode::Integrated => "--integrated",
        Mode::Naive => "--naive",
        Mode::Rhumb => "--rhumb",
        Mode::RhumbPipelined => "--rhumb-pipelined",
        Mode::RhumbFree => "--rhumb-free",
        Mode::NaiveFree => "--naive-free",
        Mode::AppAll => "--app-all",
        Mode::AppActive => "--app-active",
        Mode::AppPacked => "--app-packed",
        Mode::Replay => "--replay",
    };
    LegendKey {
        color,
        label: mode.name(),
    }
}

fn keys(modes: impl IntoIterator<Item = Mode>) -> Vec<LegendKey> {
    modes.into_iter().map(key).collect()
}

/// Colour of a mode on a light page; `style.css` has the dark one.
pub const fn color(mode: Mode) -> RGBColor {
    match mode {
        Mode::Integrated => RGBColor(107, 114, 128),
        Mode::Naive => RGBColor(194, 65, 12),
        Mode::Rhumb => RGBColor(29, 78, 216),
        Mode::RhumbPipelined => RGBColor(16, 163, 127),
        Mode::RhumbFree => RGBColor(126, 34, 206),
        Mode::NaiveFree => RGBColor(161, 98, 7),
        Mode::AppAll => RGBColor(153, 27, 27),
        Mode::AppActive => RGBColor(220, 38, 38),
        Mode::AppPacked => RGBColor(87, 83, 78),
        Mode::Replay => RGBColor(190, 24, 93),
    }
}

fn remote(load: &Load) -> impl Iterator<Item = &Run> {
    load.runs
        .iter()
        .filter(|run| run.config.mode != Mode::Integrated)
}

/// Bandwidth over time of one load.
pub(super) fn bandwidth(load: &Load, figures: &[&RunFigures]) -> Figure {
    let curve = |run: &Run| {
        let end_s = f64::from(run.config.ticks) * run.config.step_s;
        let points = second_by_second(run)
            .map(|(tick, kbps)| (tick as f64 * run.config.step_s, kbps))
            // The rate averages the previous second, so it ramps up during the first one.
            .filter(|(time, _)| *time >= 1.0 || end_s < 2.0);
        (run.config.mode, decimate(points.collect()))
    };
    let curves: Vec<_> = remote(load).map(curve).collect();
    let every = || curves.iter().flat_map(|(_, points)| points);
    let rates = every().map(|point| point.1.max(RATE_LEAST_KBPS));
    let mean = |mode: Mode| {
        let run = figures.iter().find(|run| run.mode == mode.name());
        run.and_then(|run| run.mean_kbps_down)
    };
    let sentence = match (
        mean(Mode::Naive).or(mean(Mode::NaiveFree)),
        mean(Mode::Rhumb).or(mean(Mode::RhumbFree)),
    ) {
        (Some(naive), Some(rhumb)) if rhumb > 0.0 => format!(
            "Lower is better: naive takes {} kbit/s on average and rhumb {}, {} times less. Each point averages the \
             previous second; the scale is logarithmic.",
            number(Some(naive)),
            number(Some(rhumb)),
            number(Some(naive / rhumb)),
        ),
        _ => "Lower is better. Each point averages the previous second; the scale is logarithmic."
            .to_owned(),
    };
    Figure {
        title: "Bandwidth over time".to_owned(),
        sentence,
        keys: keys(curves.iter().map(|(mode, _)| *mode)),
        svg: Chart {
            x: Axis::linear("simulated time, s", 0.0, every().map(|point| point.0)),
            y: Axis::log("kbit/s down", rates),
            marks: lines(curves),
        }
        .svg(),
    }
}

/// Lower rates are drawn at this one: a packet a minute.
const RATE_LEAST_KBPS: f64 = 0.1;

/// Curves may overlap, so the wider ones are drawn first, others are dashed, and each has its name at a point of its own.
fn lines(mut curves: Vec<(Mode, Vec<(f64, f64)>)>) -> Vec<Mark> {
    curves.sort_by_key(|(mode, _)| !drawn_first(*mode));
    let count = curves.len();
    let numbered = curves.iter().enumerate();
    let named = numbered.filter_map(|(number, (mode, points))| {
        let place = points.len() * (2 * number + 1) / (2 * count.max(1));
        Some((*mode, *points.get(place)?, mode.name().to_owned()))
    });
    let names: Vec<_> = named.collect();
    let line = |(mode, points)| Mark::Line {
        color: color(mode),
        width: if mode == Mode::Rhumb { 10 } else { 4 },
        dash: dash(mode),
        points,
    };
    let mut marks: Vec<_> = curves.into_iter().map(line).collect();
    marks.extend(dots(names));
    marks
}

/// Dash and gap of a mode's curve: those that run over each other differ.
const fn dash(mode: Mode) -> Option<(u32, u32)> {
    match mode {
        Mode::RhumbPipelined => Some((30, 16)),
        Mode::NaiveFree => Some((10, 12)),
        Mode::AppActive => Some((20, 8)),
        Mode::AppPacked => Some((6, 8)),
        _ => None,
    }
}

/// Dots with labels.
fn dots(mut all: Vec<(Mode, (f64, f64), String)>) -> Vec<Mark> {
    all.sort_by_key(|(mode, ..)| !drawn_first(*mode));
    let dot = |(mode, at, label)| Mark::Dot {
        color: color(mode),
        radius: if drawn_first(mode) { 14 } else { 8 },
        at,
        label,
    };
    all.into_iter().map(dot).collect()
}

/// True if a mode is drawn below others.
const fn drawn_first(mode: Mode) -> bool {
    matches!(mode, Mode::Rhumb | Mode::Naive)
}

/// Distribution of errors against the tolerance.
pub(super) fn errors(load: &Load, figures: &[&RunFigures]) -> Figure {
    let curves: Vec<_> = remote(load)
        .map(|run| (run.config.mode, farther_off(run)))
        .filter(|(_, points)| !points.is_empty())
        .collect();
    let tolerance_m = load.runs.iter().find_map(|run| run.config.tolerance_m);
    let every = || curves.iter().flat_map(|(_, points)| points);
    let shares = every().map(|point| point.1).filter(|share| *share > 0.0);
    let lengths = every()
        .map(|point| point.0)
        .chain(tolerance_m.map(|m| m * 1e3));
    let x = Axis::log("error above, mm", lengths);
    let y = Axis::log("% of body-ticks", shares.chain([100.0]));
    let mut marks = lines(curves.clone());
    marks.extend(tolerance_m.map(|m| Mark::Vertical {
        at: m * 1e3,
        label: format!("tolerance {} mm", plain(m * 1e3)),
    }));
    let over: u64 = figures
        .iter()
        .filter_map(|run| run.over_tolerance.as_ref())
        .map(|over| over.count)
        .sum();
    let exact: Vec<_> = remote(load)
        .map(|run| run.config.mode)
        .filter(|mode| curves.iter().all(|(m, _)| m != mode))
        .collect();
    let mut sentence = match (tolerance_m, over) {
        (Some(_), 0) => {
            "Every curve ends before the vertical line: no error ever exceeded the tolerance."
                .to_owned()
        }
        (Some(_), over) => format!(
            "A curve beyond the vertical line exceeds the tolerance: {over} body-ticks did. The table lists the causes."
        ),
        (None, _) => "Curves farther to the left mean a more exact copy.".to_owned(),
    };
    if !exact.is_empty() {
        let names: Vec<_> = exact.iter().map(|mode| mode.name()).collect();
        sentence.push_str(&format!(
            " There is no curve for {}: errors never exceeded a micrometre.",
            names.join(" and ")
        ));
    }
    Figure {
        title: "Errors of the copy".to_owned(),
        sentence,
        keys: keys(curves.iter().map(|(mode, _)| *mode)),
        svg: Chart { x, y, marks }.svg(),
    }
}

/// Distances in mm and the percentage of body-ticks with a larger error; empty if all errors are negligible.
fn farther_off(run: &Run) -> Vec<(f64, f64)> {
    let mut errors: Vec<f32> = run
        .frames
        .iter()
        .flat_map(|frame| &frame.errors_m)
        .copied()
        .collect();
    let exact: u64 = run.frames.iter().map(|frame| u64::from(frame.exact)).sum();
    errors.sort_unstable_by(f32::total_cmp);
    let Some(worst) = errors
        .last()
        .copied()
        .map(f64::from)
        .filter(|worst| *worst > EXACT_M)
    else {
        return Vec::new();
    };
    let all = errors.len() as f64 + exact as f64;
    let least = (worst * 1e-4).max(EXACT_M);
    let columns = COLUMNS as f64;
    let mut points: Vec<_> = (0..COLUMNS)
        .map(|column| {
            let length = least * (worst / least).powf(f64::from(column) / columns);
            let within = errors.partition_point(|error| f64::from(*error) <= length);
            (length * 1e3, (errors.len() - within) as f64 / all * 100.0)
        })
        .collect();
    // The curve ends at a single body-tick, the worst one.
    points.push((worst * 1e3, 100.0 / all));
    points
}

/// f32 resolution at a hundred metres; smaller errors are drawn as exact.
const EXACT_M: f64 = 1e-6;

/// Points of an error curve.
const COLUMNS: u32 = 400;

/// Frame time against number of bodies, over all loads.
pub(super) fn frame_times(loads: &[Load], summary: &Summary) -> Figure {
    let modes = modes_of(loads);
    let of_mode = |mode: Mode| {
        let runs = summary
            .runs
            .iter()
            .filter(move |run| run.mode == mode.name());
        runs.filter_map(|run| Some((f64::from(run.bodies), run.frame_ms?)))
    };
    let medians = |mode: &Mode| {
        let mut medians: Vec<_> = of_mode(*mode)
            .map(|(bodies, ms)| (bodies, ms.p50))
            .collect();
        medians.sort_by(|a, b| a.0.total_cmp(&b.0));
        (*mode, medians)
    };
    let curves: Vec<_> = modes.iter().map(medians).collect();
    let single = |(mode, medians): &(Mode, Vec<(f64, f64)>)| {
        let mode = *mode;
        let dots = medians.iter().map(move |at| (mode, *at, String::new()));
        dots.collect::<Vec<_>>()
    };
    let medians = dots(curves.iter().flat_map(single).collect());
    let mut marks = lines(curves);
    marks.extend(medians);
    let every = || modes.iter().flat_map(|mode| of_mode(*mode));
    let most = every().map(|point| point.0).fold(1.0, f64::max);
    Figure {
        title: "Frame time against bodies".to_owned(),
        sentence: frame_sentence(summary),
        svg: Chart {
            x: Axis::linear("bodies", 0.0, [most * 1.1].into_iter()),
            y: Axis::log("median frame, ms", every().map(|(_, ms)| ms.p50)),
            marks,
        }
        .svg(),
        keys: keys(modes),
    }
}

fn frame_sentence(summary: &Summary) -> String {
    let largest = summary.runs.iter().map(|run| run.bodies).max().unwrap_or(0);
    let median = |mode: Mode| {
        let run = summary
            .runs
            .iter()
            .find(|run| run.bodies == largest && run.mode == mode.name())?;
        Some(run.frame_ms?.p50)
    };
    let mut sentence = "Time of a frame in the simulator's own thread; lower is better.".to_owned();
    if let Some(integrated) = median(Mode::Integrated) {
        for (mode, waits) in [
            (Mode::Rhumb, "waiting for each tick"),
            (Mode::RhumbPipelined, "working meanwhile"),
        ] {
            if let Some(own) = median(mode) {
                let ratio = number(Some(own / integrated));
                sentence.push_str(&format!(
                    " At {largest} bodies {mode}, {waits}, takes {ratio} times the time of stepping in process."
                ));
            }
        }
    }
    sentence
}

/// Bandwidth and error of each run.
pub(super) fn points(loads: &[Load], summary: &Summary) -> Figure {
    let shown: Vec<_> = summary
        .runs
        .iter()
        .filter_map(|run| Some((run, run.mean_kbps_down?, run.surface_error_m?.p99 * 1e3)))
        .collect();
    let errors = shown.iter().map(|(.., error)| error.max(EXACT_M * 1e3));
    let rates = shown.iter().map(|(_, kbps, _)| *kbps);
    let of_mode = |mode: Mode| {
        let runs = shown
            .iter()
            .filter(move |(run, ..)| run.mode == mode.name());
        runs.map(move |(run, kbps, error)| {
            (mode, (*kbps, *error), number(Some(f64::from(run.bodies))))
        })
    };
    let marks = dots(modes_of(loads).into_iter().flat_map(of_mode).collect());
    Figure {
        title: "What exactness costs".to_owned(),
        sentence: "Nearer to the lower left corner is better: fewer bytes, smaller errors. Each point is a run, its \
                   number the bodies; points on the lower edge are off by a micrometre at most."
            .to_owned(),
        keys: keys(modes_of(loads).into_iter().filter(|mode| *mode != Mode::Integrated)),
        svg: Chart {
            x: Axis::log("kbit/s down", rates),
            y: Axis::log("99th percentile of error, mm", errors),
            marks,
        }
        .svg(),
    }
}

/// All modes of the loads, each once, in the order of the record.
pub(super) fn modes_of(loads: &[Load]) -> Vec<Mode> {
    let mut modes = Vec::new();
    for run in loads.iter().flat_map(|load| &load.runs) {
        if !modes.contains(&run.config.mode) {
            modes.push(run.config.mode);
        }
    }
    modes
}

/// One curve of the figure.
struct Series {
    key: LegendKey,
    color: RGBColor,
    /// Length that the curve shows, millimetres.
    length_mm: fn(&RunFigures) -> Option<f64>,
}

const SERIES: [Series; 3] = [
    Series {
        key: LegendKey {
            color: "--soft",
            label: "tolerance",
        },
        color: INK,
        length_mm: promised_mm,
    },
    Series {
        key: LegendKey {
            color: "--rhumb",
            label: "99th percentile of error",
        },
        color: RGBColor(29, 78, 216),
        length_mm: |run| run.moving.map(|moving| 1e3 * moving.surface_error_m.p99),
    },
    Series {
        key: LegendKey {
            color: "--rhumb-pipelined",
            label: "median of error",
        },
        color: RGBColor(16, 163, 127),
        length_mm: |run| run.moving.map(|moving| 1e3 * moving.surface_error_m.p50),
    },
];

/// The figure; `None` unless the runs are replays with different tolerances.
pub(super) fn frontier(summary: &Summary) -> Option<Figure> {
    let mut runs: Vec<&RunFigures> = summary.runs.iter().collect();
    runs.sort_by(|a, b| {
        promised_mm(a)
            .unwrap_or(0.0)
            .total_cmp(&promised_mm(b).unwrap_or(0.0))
    });
    let differ = runs
        .windows(2)
        .filter(|pair| promised_mm(pair[0]) != promised_mm(pair[1]))
        .count();
    if differ == 0 || runs.iter().any(|run| run.replayed.is_none()) {
        return None;
    }
    let points = |series: &Series| -> Vec<_> {
        let at = |run: &&RunFigures| {
            let label = promised_mm(run).map(|mm| format!("{} mm", plain(mm)));
            Some(((run.payload_kbps_down?, (series.length_mm)(run)?), label?))
        };
        runs.iter().filter_map(at).collect()
    };
    let mut marks = Vec::new();
    let mut all = Vec::new();
    for series in &SERIES {
        let points = points(series);
        let color = series.color;
        let promised = series.key.label == "tolerance";
        all.extend(points.iter().map(|(at, _)| *at));
        marks.push(Mark::Line {
            color,
            width: if promised { 10 } else { 4 },
            dash: None,
            points: points.iter().map(|(at, _)| *at).collect(),
        });
        marks.extend(points.into_iter().map(|(at, label)| Mark::Dot {
            color,
            radius: 8,
            at,
            label: if promised { label } else { String::new() },
        }));
    }
    Some(Figure {
        title: "What exactness costs".to_owned(),
        sentence: format!("{} {}", sentence(&runs), READING),
        keys: SERIES.iter().map(|series| series.key).collect(),
        svg: Chart {
            x: Axis::log("payload, kbit/s down", all.iter().map(|at| at.0)),
            y: Axis::log("tolerance and error, mm", all.iter().map(|at| at.1)),
            marks,
        }
        .svg(),
    })
}

const READING: &str = "Nearer to the lower left corner is better. Errors cover the bodies that the recording lists at \
                       the tick; both scales are logarithmic.";

/// Compares the smallest with the largest tolerance.
fn sentence(runs: &[&RunFigures]) -> String {
    let ends = runs.first().zip(runs.last());
    let text = ends.and_then(|(least, most)| {
        Some(format!(
            "{} mm cost {} kbit/s, {} mm cost {}.",
            plain(promised_mm(least)?),
            number(Some(least.payload_kbps_down?)),
            plain(promised_mm(most)?),
            number(Some(most.payload_kbps_down?)),
        ))
    });
    text.unwrap_or_default()
}

/// Tolerance of any surface point, or of the position, millimetres.
fn promised_mm(run: &RunFigures) -> Option<f64> {
    let of_parts = run.replayed.as_ref().and_then(|of| of.position_m);
    run.tolerance_m.or(of_parts).map(|metres| 1e3 * metres)
}
