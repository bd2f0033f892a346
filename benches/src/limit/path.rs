//! The path of each body of a recording, frame by frame.
//!
//! A frame is a published tick: every tick, or every n-th. A path starts at the body's placement and ends at its
//! removal or the end of the recording.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use glam::DVec3;
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{
    BodyId, BodyState, Damping, Inertia, Metres, Motion, Tick, ToleranceScale, Track,
};

use crate::record::Placed;
use crate::recording::Recording;
use crate::replay::first_track;

/// Path of one body.
#[derive(Clone, Debug)]
pub(super) struct Path {
    pub(super) radius: Metres,
    pub(super) tolerance_scale: ToleranceScale,
    pub(super) damping: Damping,
    /// Gravity acting on it, m/s².
    pub(super) gravity: DVec3,
    /// Its inertia, if it rotates freely.
    pub(super) inertia: Option<Inertia>,
    /// The track that both ends know before the first update.
    pub(super) known: Track,
    /// Its first frame.
    pub(super) first: usize,
    /// Motion at its first frame and each one after.
    pub(super) motions: Vec<Motion>,
    /// True at each frame whose pose equals that of the frame before.
    pub(super) same: Vec<bool>,
}

impl Path {
    /// End of its frames.
    pub(super) const fn end(&self) -> usize {
        self.first + self.motions.len()
    }

    pub(super) fn at(&self, frame: usize) -> &Motion {
        &self.motions[frame - self.first]
    }

    pub(super) fn is_same(&self, frame: usize) -> bool {
        self.same[frame - self.first]
    }
}

/// The paths of a recording, built one at a time to bound memory.
#[derive(Debug)]
pub(super) struct Paths<'a> {
    recording: &'a Recording,
    publish_interval: NonZeroU32,
    removed: BTreeMap<BodyId, Tick>,
    rows: BTreeMap<BodyId, Vec<(u64, BodyState)>>,
    /// Non-static bodies, in order of placing.
    placed: Vec<&'a Placed>,
}

impl<'a> Paths<'a> {
    pub(super) fn new(recording: &'a Recording, publish_interval: NonZeroU32) -> Self {
        let truth = &recording.truth;
        let mut rows: BTreeMap<BodyId, Vec<_>> = BTreeMap::new();
        for (row, tick) in truth.ticks.iter().zip(1..) {
            for observation in row {
                let of_body = rows.entry(observation.id).or_default();
                of_body.push((tick, observation.motion));
            }
        }
        let can_move = |placed: &&Placed| placed.desc.kind != BodyKind::Fixed;
        Self {
            recording,
            publish_interval,
            removed: truth
                .removed
                .iter()
                .map(|(tick, id)| (*id, *tick))
                .collect(),
            rows,
            placed: truth.placed.iter().filter(can_move).collect(),
        }
    }

    /// Number of non-static bodies.
    pub(super) const fn len(&self) -> usize {
        self.placed.len()
    }

    /// Bounding radius of a body, metres.
    pub(super) fn radius(&self, place: usize) -> f64 {
        self.placed[place].shape.bounding_radius().metres()
    }

    /// Path of a body; `None` if it is present at no frame.
    pub(super) fn get(&self, place: usize) -> Option<Path> {
        let placed = self.placed[place];
        let id = placed.desc.id;
        let last = u64::from(self.recording.ticks());
        let end = self.removed.get(&id).map_or(last, |tick| tick.value());
        let observed = self.rows.get(&id).map_or(&[][..], Vec::as_slice);
        let path = path(self.recording, placed, observed, end, self.publish_interval);
        (!path.motions.is_empty()).then_some(path)
    }
}

/// Path of one body from its placement to `end`.
fn path(
    recording: &Recording,
    placed: &Placed,
    observed: &[(u64, BodyState)],
    end: u64,
    publish_interval: NonZeroU32,
) -> Path {
    let parameters = recording.parameters(placed);
    let publish_interval = u64::from(publish_interval.get());
    let first = placed.tick.value().div_ceil(publish_interval);
    let mut motion = placed.observation.motion.motion();
    let (mut motions, mut same) = (Vec::new(), Vec::new());
    let mut observed = observed.iter().peekable();
    for frame in first..=end / publish_interval {
        let before = motion;
        while let Some((tick, newer)) = observed.peek()
            && *tick <= frame * publish_interval
        {
            motion = newer.motion();
            observed.next();
        }
        same.push(frame > first && before.pose() == motion.pose());
        motions.push(motion);
    }
    Path {
        radius: parameters.radius,
        tolerance_scale: parameters.tolerance_scale,
        damping: parameters.damping,
        gravity: recording.gravity.as_dvec3() * f64::from(parameters.gravity_scale),
        known: first_track(placed, &parameters),
        inertia: parameters.inertia,
        first: first as usize,
        motions,
        same,
    }
}
