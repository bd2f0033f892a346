//! The frontier figure: bytes and errors of several replays.

use plotters::style::RGBColor;

use super::figures::{Figure, LegendKey};
use super::plot::{Axis, Chart, INK, Mark, plain};
use crate::summary::{RunFigures, Summary, number};

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
