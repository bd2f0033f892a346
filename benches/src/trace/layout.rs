//! The viewer layout that Foxglove or Lichtblick opens for a trace.
//!
//! Viewers hide scene topics by default, so the layout enables them: the engine's world on the left, a client's copy
//! on the right, and plots of bytes, errors and frame time below.

use serde_json::{Value, json};

use super::names::{load_names, run_names};
use crate::record::{Experiment, Load, Mode};

/// The text of `layout.json`: the smallest load, with its truth and its first copy that states a tolerance.
#[must_use]
pub fn layout(experiment: &Experiment) -> String {
    let bodies = |load: &Load| load.runs.first().map_or(u32::MAX, |run| run.config.bodies);
    let loads = load_names(experiment);
    let smallest = experiment
        .loads
        .iter()
        .zip(&loads)
        .min_by_key(|(load, _)| bodies(load));
    let mut text = match smallest {
        Some((load, prefix)) => format!("{:#}", window(load, prefix)),
        None => format!("{:#}", json!({})),
    };
    text.push('\n');
    text
}

fn window(load: &Load, prefix: &str) -> Value {
    let runs: Vec<_> = load.runs.iter().zip(run_names(load)).collect();
    let remote = || {
        runs.iter()
            .filter(|(run, _)| run.config.mode != Mode::Integrated)
    };
    let reckoned = remote().find(|(run, _)| run.config.tolerance_m.is_some());
    let copy = reckoned
        .or_else(|| remote().next())
        .map_or("truth", |(_, name)| name);
    let all = || runs.iter().map(|(_, name)| name.as_str()).collect();
    let copies = || remote().map(|(_, name)| name.as_str()).collect();
    let of_copy = "Client's copy: blue is exact, red is at the tolerance, violet is beyond";
    let of = |title, field, names: Vec<_>| plot(title, field, prefix, &names);
    let bytes = of(
        "Bytes down per frame, UDP payload",
        "wire_bytes_down",
        copies(),
    );
    let error = of("Largest surface error, metres", "error_m_max", copies());
    let panels = [
        ("3D!truth", drawn("Truth", prefix, "truth")),
        ("3D!copy", drawn(of_copy, prefix, copy)),
        ("Plot!bytes", bytes),
        ("Plot!error", error),
        (
            "Plot!frame",
            of("Frame time, nanoseconds", "frame_ns", all()),
        ),
    ];
    let panels = panels.map(|(name, panel)| (name.to_owned(), panel));
    let shares = json!({
        "direction": "column", "splitPercentage": 65,
        "first": { "direction": "row", "first": "3D!truth", "second": "3D!copy" },
        "second": {
            "direction": "row", "splitPercentage": 34, "first": "Plot!bytes",
            "second": { "direction": "row", "first": "Plot!error", "second": "Plot!frame" }
        }
    });
    rhumb_trace::whole_layout(&panels.into_iter().collect(), &shares)
}

/// A 3D panel that shows the topics of one copy or of the truth.
fn drawn(title: &str, prefix: &str, name: &str) -> Value {
    let of_copy = ["moving", "resting"].map(|of| format!("/{prefix}/{name}/{of}"));
    let statics = format!("/{prefix}/truth/static");
    rhumb_trace::drawing_panel(title, of_copy.into_iter().chain([statics]))
}

/// A panel with a line for each run.
fn plot(title: &str, field: &str, prefix: &str, names: &[&str]) -> Value {
    let path = |name: &&str| {
        json!({
            "value": format!("/{prefix}/{name}/stats.{field}"), "label": name, "enabled": true,
            "timestampMethod": "receiveTime", "showLine": true
        })
    };
    json!({
        "foxglovePanelTitle": title, "paths": names.iter().map(path).collect::<Vec<_>>(), "xAxisVal": "timestamp",
        "isSynced": true, "showLegend": true, "legendDisplay": "floating", "showXAxisLabels": true,
        "showYAxisLabels": true, "showPlotValuesInLegend": false, "sidebarDimension": 240
    })
}
