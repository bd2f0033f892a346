//! The viewer layout that Foxglove or Lichtblick opens for a trace.
//!
//! Viewers hide scene topics by default, so the layout enables them: the engine's world on the left, a client's copy
//! on the right, and plots of bytes, errors and frame time below.

use serde_json::{Value, json};

use super::names;
use crate::record::{Experiment, Load, Mode};

/// The text of `layout.json`: the smallest load, with its truth and its first copy that states a tolerance.
#[must_use]
pub fn layout(experiment: &Experiment) -> String {
    let bodies = |load: &Load| load.runs.first().map_or(u32::MAX, |run| run.config.bodies);
    let loads = names::loads(experiment);
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
    let runs: Vec<_> = load.runs.iter().zip(names::runs(load)).collect();
    let remote = || {
        runs.iter()
            .filter(|(run, _)| run.config.mode != Mode::Integrated)
    };
    let reckoned = remote().find(|(run, _)| run.config.tolerance_m.is_some());
    let copy = reckoned
        .or_else(|| remote().next())
        .map_or("truth", |(_, name)| name);
    let plot = |title: &str, field: &str, names: &mut dyn Iterator<Item = &str>| {
        let path = |name: &str| {
            json!({
                "value": format!("/{prefix}/{name}/stats.{field}"), "label": name, "enabled": true,
                "timestampMethod": "receiveTime", "showLine": true
            })
        };
        json!({
            "foxglovePanelTitle": title, "paths": names.map(path).collect::<Vec<_>>(), "xAxisVal": "timestamp",
            "isSynced": true, "showLegend": true, "legendDisplay": "floating", "showXAxisLabels": true,
            "showYAxisLabels": true, "showPlotValuesInLegend": false, "sidebarDimension": 240
        })
    };
    let all = || runs.iter().map(|(_, name)| name.as_str());
    let copies = || remote().map(|(_, name)| name.as_str());
    json!({
        "configById": {
            "3D!truth": view(prefix, "truth", "Truth"),
            "3D!copy": view(prefix, copy, "Client's copy: blue is exact, red is at the tolerance, violet is beyond"),
            "Plot!bytes": plot("Bytes down per frame, UDP payload", "wire_bytes_down", &mut copies()),
            "Plot!error": plot("Largest surface error, metres", "error_m_max", &mut copies()),
            "Plot!frame": plot("Frame time, nanoseconds", "frame_ns", &mut all()),
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": { "speed": 1 },
        "layout": {
            "direction": "column", "splitPercentage": 65,
            "first": { "direction": "row", "first": "3D!truth", "second": "3D!copy" },
            "second": {
                "direction": "row", "splitPercentage": 34, "first": "Plot!bytes",
                "second": { "direction": "row", "first": "Plot!error", "second": "Plot!frame" }
            }
        }
    })
}

/// A 3D panel that shows one copy's topics.
fn view(prefix: &str, name: &str, title: &str) -> Value {
    json!({
        "foxglovePanelTitle": title,
        "followTf": rhumb_trace::FRAME,
        "followMode": "follow-none",
        "cameraState": {
            "perspective": true, "distance": 60, "phi": 60, "thetaOffset": 45, "targetOffset": [0, 0, 0],
            "target": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.1, "far": 5000
        },
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid", "instanceId": "grid", "frameId": rhumb_trace::FRAME,
                "visible": true, "size": 100, "divisions": 20, "lineWidth": 1, "color": "#248eff40",
                "position": [0, 0, 0], "rotation": [0, 0, 0]
            }
        },
        "scene": {}, "transforms": {}, "publish": {}, "imageMode": {},
        "topics": {
            format!("/{prefix}/truth/static"): { "visible": true },
            format!("/{prefix}/{name}/moving"): { "visible": true },
            format!("/{prefix}/{name}/resting"): { "visible": true },
        }
    })
}
