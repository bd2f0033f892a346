//! The stays of a recorded body: from a pose to its removal, or to a gap.
//!
//! Short gaps are filled. A removal takes away what was there before it; what comes in its frame is there again. Nothing here
//! knows a file.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use glam::{DQuat, DVec3};

/// Missing frames that are filled.
pub(super) const FILLED_MAX: u64 = 3;

/// A body's poses by frame.
pub(super) type Path = BTreeMap<u64, FramedPose>;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FramedPose {
    pub(super) position: DVec3,
    pub(super) rotation: DQuat,
    pub(super) velocity: Option<[DVec3; 2]>,
}

/// Bodies are removed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Removal {
    /// Nanoseconds, from the origin of the poses.
    pub(super) at_ns: i64,
    pub(super) of: Removed,
    pub(super) cause: RemovalCause,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Removed {
    /// All that are there.
    All,
    /// Those of a group.
    Group(usize),
    /// The body of this number.
    Body(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum RemovalCause {
    /// A message says so. A pose in its frame is of another stay.
    Deleted,
    /// The time of a pose has passed. A pose in its frame continues it.
    Expired,
}

/// The frames of removals, in order.
#[derive(Clone, Debug, Default)]
pub(super) struct Removals {
    all: Vec<u64>,
    groups: BTreeMap<usize, Vec<u64>>,
    bodies: BTreeMap<usize, Vec<u64>>,
}

impl Removals {
    /// Takes removals with their frames.
    pub(super) fn new<'a>(removals: impl Iterator<Item = (&'a Removal, u64)>) -> Self {
        let mut sorted = Self::default();
        for (removal, frame) in removals {
            let frames = match removal.of {
                Removed::All => &mut sorted.all,
                Removed::Group(group) => sorted.groups.entry(group).or_default(),
                Removed::Body(body) => sorted.bodies.entry(body).or_default(),
            };
            frames.push(frame + u64::from(removal.cause == RemovalCause::Expired));
        }
        let some = sorted.groups.values_mut().chain(sorted.bodies.values_mut());
        for frames in some.chain([&mut sorted.all]) {
            frames.sort_unstable();
            frames.dedup();
        }
        sorted
    }

    /// Those of a body, which may be of a group.
    pub(super) fn of(&self, body: usize, group: Option<usize>) -> RemovalsOfBody<'_> {
        let of_group = group.and_then(|group| self.groups.get(&group));
        let own = self.bodies.get(&body);
        let [of_group, own] = [of_group, own].map(|some| some.map_or(&[][..], Vec::as_slice));
        RemovalsOfBody([&self.all, of_group, own])
    }
}

/// The frames of the removals of one body.
#[derive(Clone, Copy, Debug)]
pub(super) struct RemovalsOfBody<'a>([&'a [u64]; 3]);

impl RemovalsOfBody<'_> {
    /// The first one within these frames.
    fn within(self, frames: RangeInclusive<u64>) -> Option<u64> {
        let first = |of: &[u64]| {
            of.get(of.partition_point(|at| at < frames.start()))
                .copied()
        };
        let first = self.0.into_iter().filter_map(first).min();
        first.filter(|at| frames.contains(at))
    }
}

/// One stay of a body: its poses, and the frame after which it is gone.
pub(super) struct Stay {
    pub(super) path: Path,
    pub(super) gone: Option<u64>,
    pub(super) is_static: bool,
}

/// The stays of a body between its gaps; `persists`: gaps end none. `frames`: the last of the recording.
pub(super) fn stays(
    path: Path,
    frames: u64,
    persists: bool,
    removals: RemovalsOfBody<'_>,
) -> Vec<Stay> {
    let first = path.keys().next().copied().unwrap_or_default();
    let is_static = path.len() == 1 && removals.within(first + 1..=u64::MAX).is_none();
    let mut stays: Vec<Stay> = Vec::new();
    let mut last: Option<(u64, FramedPose)> = None;
    for (frame, mut pose) in path {
        // The sign of a quaternion says nothing; neighbours have like signs.
        if let Some((_, before)) = last
            && before.rotation.dot(pose.rotation) < 0.0
        {
            pose.rotation = -pose.rotation;
        }
        let goes_on = last.is_some_and(|(before, _)| {
            let is_removed = removals.within(before + 1..=frame).is_some();
            !is_removed && (persists || frame - before <= FILLED_MAX + 1)
        });
        if let (true, Some(stay), Some((before, from))) = (goes_on, stays.last_mut(), last) {
            if !persists {
                stay.path.extend(filled((before, from), (frame, pose)));
            }
            stay.path.insert(frame, pose);
        } else {
            stays.push(Stay {
                path: Path::from([(frame, pose)]),
                gone: None,
                is_static,
            });
        }
        last = Some((frame, pose));
    }
    let mut next = None;
    for stay in stays.iter_mut().rev() {
        let end = stay.path.keys().next_back().copied().unwrap_or_default();
        let removed = removals.within(end + 1..=next.unwrap_or(u64::MAX));
        let gone = match (removed, next) {
            (Some(at), _) => Some(at - 1),
            (None, Some(_)) => Some(end),
            (None, None) => (!persists && !is_static && end < frames).then_some(end),
        };
        stay.gone = gone.filter(|gone| *gone < frames);
        next = stay.path.keys().next().copied();
    }
    stays
}

/// The poses between two frames: on a line, and on the shortest arc.
fn filled(
    (from, a): (u64, FramedPose),
    (to, b): (u64, FramedPose),
) -> impl Iterator<Item = (u64, FramedPose)> {
    (from + 1..to).map(move |frame| {
        let share = (frame - from) as f64 / (to - from) as f64;
        let velocity = a
            .velocity
            .zip(b.velocity)
            .map(|([v, w], [x, y])| [v.lerp(x, share), w.lerp(y, share)]);
        let pose = FramedPose {
            position: a.position.lerp(b.position, share),
            rotation: a.rotation.slerp(b.rotation, share),
            velocity,
        };
        (frame, pose)
    })
}
