//! The paper's own figures, as printed, to stand beside ours.
//!
//! Source: its Table 1, and of frame times what its text says, since its printed Table 2 repeats Table 1. Its machines and
//! its engine were others: only shapes compare.

/// A load of the paper's table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Published {
    /// Balls.
    pub(super) load: u32,
    /// Simulated frames per second, engine in the simulator.
    pub(super) integrated_fps: f64,
    /// The same, engine in another process.
    pub(super) distributed_fps: f64,
    /// Milliseconds of a physics frame, integrated and distributed, where the text has them.
    pub(super) frame_ms: Option<(f64, f64)>,
}

/// Balls at which the paper saw fewer than nine frames a second: integrated.
pub(super) const MDL_INTEGRATED: u32 = 4_500;
/// The same, distributed.
pub(super) const MDL_DISTRIBUTED: u32 = 500;

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

/// Balls that are added in each stage, and frames of a stage.
const STAGE: u32 = 500;
const STAGE_FRAMES: u64 = 340;
/// Of the states that were said to it the published client took in so many of a hundred: a thousand bodies, 450 frames, 40 s,
/// measured with its plug-in. With more bodies it takes in fewer.
const TAKEN_IN_PERCENT: u64 = 34;

/// How long the published client's list was in the midst of a load's stage, if it took in as large a part of all states as
/// was measured with few.
pub(super) fn listed(load: u32) -> u32 {
    let stages = u64::from(load / STAGE);
    let before = stages * stages.saturating_sub(1) / 2 * u64::from(STAGE);
    let states = STAGE_FRAMES * before + STAGE_FRAMES / 2 * u64::from(load);
    u32::try_from(states * TAKEN_IN_PERCENT / 100).unwrap_or(u32::MAX)
}

/// What of a frame it is, spread over a stage, that a time passes until a load is placed: milliseconds.
pub(super) fn spread_ms(placing_s: f64, load: u32) -> f64 {
    placing_s * 1e3 * f64::from(STAGE) / f64::from(load) / STAGE_FRAMES as f64
}

/// All of them, by load.
pub(super) const TABLE: [Published; 10] = [
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
pub(super) fn at(load: u32) -> Option<&'static Published> {
    TABLE.iter().find(|row| row.load == load)
}
