//! The points of `rhumb-paper remote`, and where the curves cross.

use serde::{Deserialize, Serialize};

use crate::crossover::{Crossover, Pair, crossovers};
use crate::provenance::Provenance;

/// Results: `remote.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct RemoteResults {
    /// Circumstances of the measurement.
    #[serde(flatten)]
    pub(crate) provenance: Provenance,
    /// Points, load by load.
    pub(crate) points: Vec<RemotePoint>,
}

/// One mode with a load and an amount of other work. Times are milliseconds per frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct RemotePoint {
    /// Number of bodies.
    pub(crate) load: u32,
    /// Percentage of bodies set in motion.
    pub(crate) awake_percent: u32,
    /// Bodies awake at the end, according to the engine.
    pub(crate) awake: u32,
    /// Requested other work.
    pub(crate) other_work_ms: u32,
    /// Pipeline depth; `None` for the integrated engine.
    pub(crate) depth: Option<u32>,
    /// Frame time, other work included.
    pub(crate) frame_ms: f64,
    /// Time of the physics call in it.
    pub(crate) call_ms: f64,
    /// Processor time of the caller's thread in that call.
    pub(crate) work_ms: Option<f64>,
    /// Time of the engine's steps.
    pub(crate) step_ms: f64,
    /// Time of observing.
    pub(crate) observe_ms: f64,
    /// Time of selecting, encoding and queueing.
    pub(crate) publish_ms: f64,
    /// Frames per second, at most 11.33.
    pub(crate) sim_fps: f64,
    /// The same without that limit.
    pub(crate) uncapped_fps: f64,
    /// True if its engine diverged from the integrated one.
    pub(crate) void: bool,
}

impl RemotePoint {
    /// Server time besides stepping, as a share of the stepping time.
    pub(super) fn beside(&self) -> f64 {
        (self.observe_ms + self.publish_ms) / self.step_ms
    }

    /// Frame time of the paired integrated engine if its steps took as long as this one's, milliseconds.
    pub(super) fn frame_of(&self, integrated: &Self) -> f64 {
        let beside_steps = integrated.frame_ms - integrated.step_ms;
        self.step_ms + beside_steps
    }
}

/// The range in which a depth beats the integrated engine in frames per second.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Crossing {
    /// Pipeline depth.
    pub(crate) depth: u32,
    /// Percentage of bodies set in motion.
    pub(crate) awake_percent: u32,
    /// Fixed load, if the search runs over other work.
    pub(crate) load: Option<u32>,
    /// Fixed other work, if the search runs over loads.
    pub(crate) other_work_ms: Option<u32>,
    /// With frames of at least 1/11.33 s.
    pub(crate) capped: Vec<Crossover>,
    /// With frames as fast as possible.
    pub(crate) uncapped: Vec<Crossover>,
    /// The same, if the engine's steps took as long in the caller's thread as at the server.
    pub(crate) engines_alike: Vec<Crossover>,
}

/// All crossovers: over other work at each load, and over loads at each amount of other work.
pub(super) fn crossings(points: &[RemotePoint]) -> Vec<Crossing> {
    let sound: Vec<&RemotePoint> = points.iter().filter(|point| !point.void).collect();
    let mut depths: Vec<u32> = sound.iter().filter_map(|point| point.depth).collect();
    let mut shares: Vec<u32> = sound.iter().map(|point| point.awake_percent).collect();
    let mut loads: Vec<u32> = sound.iter().map(|point| point.load).collect();
    let mut works: Vec<u32> = sound.iter().map(|point| point.other_work_ms).collect();
    for values in [&mut depths, &mut shares, &mut loads, &mut works] {
        values.sort_unstable();
        values.dedup();
    }
    let mut found = Vec::new();
    for awake_percent in shares {
        for depth in &depths {
            let along = |load: Option<u32>, other_work_ms: Option<u32>| {
                let there = |point: &&&RemotePoint| {
                    point.awake_percent == awake_percent
                        && load.is_none_or(|load| point.load == load)
                        && other_work_ms.is_none_or(|work| point.other_work_ms == work)
                };
                let sorted = |of: fn(&RemotePoint, &RemotePoint) -> (f64, f64)| {
                    let all: Vec<&RemotePoint> = sound.iter().filter(there).copied().collect();
                    crossovers(&pairs(&all, *depth, load.is_some(), of))
                };
                Crossing {
                    depth: *depth,
                    awake_percent,
                    load,
                    other_work_ms,
                    capped: sorted(|own, other| (own.sim_fps, other.sim_fps)),
                    uncapped: sorted(|own, other| (own.uncapped_fps, other.uncapped_fps)),
                    engines_alike: sorted(|own, other| {
                        (1e3 / other.frame_of(own), other.uncapped_fps)
                    }),
                }
            };
            found.extend(loads.iter().map(|load| along(Some(*load), None)));
            found.extend(works.iter().map(|work| along(None, Some(*work))));
        }
    }
    found
}

/// The pairs of the integrated engine and a depth, by other work or by load.
fn pairs(
    points: &[&RemotePoint],
    depth: u32,
    by_work: bool,
    of: fn(&RemotePoint, &RemotePoint) -> (f64, f64),
) -> Vec<Pair> {
    let place = |point: &RemotePoint| {
        if by_work {
            point.other_work_ms
        } else {
            point.load
        }
    };
    let mut pairs: Vec<Pair> = points
        .iter()
        .filter(|point| point.depth == Some(depth))
        .filter_map(|other| {
            let all = points.iter().copied();
            let (own, beats) = of(integrated(all, other)?, other);
            Some(Pair {
                at: f64::from(place(other)),
                own,
                other: beats,
            })
        })
        .collect();
    pairs.sort_by(|one, other| one.at.total_cmp(&other.at));
    pairs
}

/// The integrated point with the same load and other work.
pub(super) fn integrated<'a>(
    mut points: impl Iterator<Item = &'a RemotePoint>,
    beside: &RemotePoint,
) -> Option<&'a RemotePoint> {
    points.find(|point| {
        point.depth.is_none()
            && point.awake_percent == beside.awake_percent
            && point.load == beside.load
            && point.other_work_ms == beside.other_work_ms
    })
}
