//! The paper's own figures, as printed, for comparison.
//!
//! Source: its Table 1; frame times come from its text, because its printed Table 2 repeats Table 1. Its machines and
//! engine differ from ours, so only the shapes of curves compare.

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
pub(crate) fn listed(load: u32) -> u32 {
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
pub(crate) const TABLE: [Published; 10] = [
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
pub(crate) fn at(load: u32) -> Option<&'static Published> {
    TABLE.iter().find(|row| row.load == load)
}
