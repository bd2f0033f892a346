//! Table of other engines, measured by `compare_engines.py`.

use serde::Deserialize;

use super::table::Table;
use rhumb_bench::summary::number;

/// Output of the script's `--out`.
#[derive(Debug, Deserialize)]
pub(crate) struct Engines {
    /// Command line of the script.
    pub(crate) command: String,
    /// Processor, cores, operating system.
    pub(crate) machine: String,
    /// Name of the scene.
    pub(crate) scene: String,
    /// Number of its non-static bodies.
    pub(crate) bodies: u32,
    rows: Vec<EngineRow>,
}

/// Times of one engine, milliseconds.
#[derive(Debug, Deserialize)]
struct EngineRow {
    /// Engine and where it steps: `bullet, tcp:localhost:6667`.
    engine: String,
    frame_ms_mean: f64,
    frame_ms_p50: f64,
    frame_ms_p99: f64,
    /// Both directions, headers included; `None` for an engine in process.
    bytes_per_frame: Option<f64>,
}

impl EngineRow {
    fn family(&self) -> &str {
        self.engine.split(',').next().unwrap_or_default()
    }
}

/// A row for each engine, relative to the same engine in process.
pub(crate) fn engines_table(engines: &Engines) -> Table {
    let columns = [
        "engine",
        "frame, ms",
        "p50, ms",
        "p99, ms",
        "mean, relative to its first row",
        "bytes per frame",
    ];
    let mut table = Table::new("Other engines on the same scene", columns);
    for row in &engines.rows {
        let first = engines
            .rows
            .iter()
            .find(|other| other.family() == row.family());
        let values = [
            Some(row.frame_ms_mean),
            Some(row.frame_ms_p50),
            Some(row.frame_ms_p99),
            first.map(|first| row.frame_ms_mean / first.frame_ms_mean),
            row.bytes_per_frame,
        ];
        let mut cells = vec![row.engine.clone()];
        cells.extend(values.map(number));
        table.rows.push(cells);
    }
    table.note = "Piles differ between engines, so times measure similar work, not the same work."
        .to_owned();
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_remote_engine_is_compared_to_itself_in_process() {
        let text = r#"{"command": "c", "machine": "m", "scene": "ball-pit", "bodies": 500, "rows": [
            {"engine": "bullet, direct", "frame_ms_mean": 2.0, "frame_ms_p50": 2.0, "frame_ms_p99": 3.0, "bytes_per_frame": null},
            {"engine": "ours, a", "frame_ms_mean": 1.0, "frame_ms_p50": 1.0, "frame_ms_p99": 1.5, "bytes_per_frame": null},
            {"engine": "bullet, tcp:h:1", "frame_ms_mean": 6.0, "frame_ms_p50": 5.0, "frame_ms_p99": 9.0, "bytes_per_frame": 1234.0}]}"#;
        let engines: Engines = serde_json::from_str(text).unwrap();
        let rows = table(&engines).rows;
        assert_eq!(rows[1], ["ours, a", "1.00", "1.00", "1.50", "1.00", "–"]);
        assert_eq!(
            rows[2],
            ["bullet, tcp:h:1", "6.00", "5.00", "9.00", "3.00", "1,234"]
        );
    }
}
