//! The way that each body of a recording went, frame by frame.
//!
//! A frame is a tick that is published: each, or every so many. A body is followed from where it was placed until it
//! goes or the recording ends.

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

/// What one body did.
#[derive(Clone, Debug)]
pub(super) struct Path {
    pub(super) radius: Metres,
    pub(super) tolerance_scale: ToleranceScale,
    pub(super) damping: Damping,
    /// What pulls at it, m/s².
    pub(super) gravity: DVec3,
    /// How it resists being turned, if it is_torque_free.
    pub(super) inertia: Option<Inertia>,
    /// What both ends know of it before anything is said.
    pub(super) known: Track,
    /// Its first frame.
    pub(super) first: usize,
    /// What it did at its first frame and those that follow.
    pub(super) motions: Vec<Motion>,
    /// Whether it is then where it was a frame before.
    pub(super) same: Vec<bool>,
}

impl Path {
    /// The frame after its last.
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

/// The paths of a recording, made one by one: all at once would fill the memory.
#[derive(Debug)]
pub(super) struct Paths<'a> {
    recording: &'a Recording,
    publish_interval: NonZeroU32,
    removed: BTreeMap<BodyId, Tick>,
    rows: BTreeMap<BodyId, Vec<(u64, BodyState)>>,
    /// Bodies that can move, in order of placing.
    placed: Vec<&'a Placed>,
}

impl<'a> Paths<'a> {
    pub(super) fn new(recording: &'a Recording, publish_interval: NonZeroU32) -> Self {
        let truth = &recording.truth;
        let mut rows: BTreeMap<BodyId, Vec<_>> = BTreeMap::new();
        for (row, tick) in truth.ticks.iter().zip(1..) {
            for seen in row {
                let of_body = rows.entry(seen.id).or_default();
                of_body.push((tick, seen.motion));
            }
        }
        let can_move = |placed: &&Placed| placed.desc.kind != BodyKind::Static;
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

    /// How many bodies can move.
    pub(super) const fn len(&self) -> usize {
        self.placed.len()
    }

    /// The bounding radius of a body, metres.
    pub(super) fn radius(&self, place: usize) -> f64 {
        self.placed[place].shape.bounding_radius().metres()
    }

    /// The path of a body; none if it was never there at a frame.
    pub(super) fn get(&self, place: usize) -> Option<Path> {
        let placed = self.placed[place];
        let id = placed.desc.id;
        let last = u64::from(self.recording.ticks());
        let end = self.removed.get(&id).map_or(last, |tick| tick.value());
        let seen = self.rows.get(&id).map_or(&[][..], Vec::as_slice);
        let path = path(self.recording, placed, seen, end, self.publish_interval);
        (!path.motions.is_empty()).then_some(path)
    }
}

/// What one body did from where it was placed until a tick.
fn path(
    recording: &Recording,
    placed: &Placed,
    seen: &[(u64, BodyState)],
    end: u64,
    publish_interval: NonZeroU32,
) -> Path {
    let parameters = recording.parameters(placed);
    let publish_interval = u64::from(publish_interval.get());
    let first = placed.tick.value().div_ceil(publish_interval);
    let mut motion = placed.observation.motion.motion();
    let (mut motions, mut same) = (Vec::new(), Vec::new());
    let mut seen = seen.iter().peekable();
    for frame in first..=end / publish_interval {
        let before = motion;
        while let Some((tick, newer)) = seen.peek()
            && *tick <= frame * publish_interval
        {
            motion = newer.motion();
            seen.next();
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
