//! Body poses at each tick, in the engine and in a client's copy.
//!
//! Replays the record forward, one tick or frame at a time.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3};
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, Divergence, Pose, Tick};
use rhumb_trace::DrawnBody;

use crate::record::{Frame, Placed, Truth};

/// A body at one tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body<'a> {
    /// Its placement.
    pub(super) placed: &'a Placed,
    /// Centre of mass, world frame, metres.
    pub(super) position: [f32; 3],
    /// Quaternion x, y, z, w.
    pub(super) rotation: [f32; 4],
    /// True if the body is at rest.
    pub(super) still: bool,
}

impl<'a> Body<'a> {
    fn begin(placed: &'a Placed) -> Self {
        Self {
            placed,
            position: placed.observation.motion.position(),
            rotation: placed.observation.motion.rotation(),
            still: placed.observation.activity == Activity::Asleep,
        }
    }

    /// The body as it is drawn.
    pub(super) const fn drawn(&self) -> DrawnBody<'a> {
        DrawnBody {
            id: self.id(),
            shape: &self.placed.shape,
            position: self.position,
            rotation: self.rotation,
            still: self.still,
        }
    }

    pub(super) const fn id(&self) -> BodyId {
        self.placed.desc.id
    }

    pub(super) fn is_static(&self) -> bool {
        self.placed.desc.kind == BodyKind::Fixed
    }

    /// Upper bound of the distance between any surface point and the same point of `other`, metres.
    pub(super) fn surface_error_m(&self, other: &Self) -> f64 {
        let divergence = Divergence::between(&self.pose(), &other.pose());
        divergence
            .surface_error(self.placed.shape.bounding_radius())
            .metres()
    }

    fn pose(&self) -> Pose {
        Pose {
            position: DVec3::from_array(self.position.map(f64::from)),
            rotation: DQuat::from_array(self.rotation.map(f64::from)).normalize(),
        }
    }
}

/// Bodies by index.
#[derive(Clone, Debug, Default)]
pub(super) struct Bodies<'a> {
    slots: Vec<Option<Body<'a>>>,
}

impl<'a> Bodies<'a> {
    pub(super) fn iter(&self) -> impl Iterator<Item = &Body<'a>> {
        self.slots.iter().flatten()
    }

    pub(super) fn find(&self, id: BodyId) -> Option<&Body<'a>> {
        let body = self.slots.get(id.index() as usize)?.as_ref()?;
        (body.id() == id).then_some(body)
    }

    fn find_mut(&mut self, id: BodyId) -> Option<&mut Body<'a>> {
        let body = self.slots.get_mut(id.index() as usize)?.as_mut()?;
        (body.id() == id).then_some(body)
    }

    fn place(&mut self, placed: &'a Placed) {
        let index = placed.desc.id.index() as usize;
        if index >= self.slots.len() {
            self.slots.resize(index + 1, None);
        }
        self.slots[index] = Some(Body::begin(placed));
    }

    fn remove(&mut self, id: BodyId) {
        if self.find(id).is_some() {
            self.slots[id.index() as usize] = None;
        }
    }
}

/// The engine's bodies.
#[derive(Debug)]
pub(super) struct TruthBodies<'a> {
    truth: &'a Truth,
    pub(super) bodies: Bodies<'a>,
    placed: usize,
    removed: usize,
    /// Placements and removals that follow the current tick.
    after: TickChanges<'a>,
}

/// Changes of the engine's bodies in one tick.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct TickChanges<'a> {
    /// Observations made by the tick's step.
    pub(super) observed: &'a [Observation],
    /// Placed after the step: present from the next tick on.
    pub(super) placed: &'a [Placed],
    /// Removed after the step: absent from the next tick on.
    pub(super) removed: &'a [(Tick, BodyId)],
    /// True if a static body was placed or removed since the tick before.
    pub(super) statics_changed: bool,
}

impl<'a> TruthBodies<'a> {
    pub(super) fn new(truth: &'a Truth) -> Self {
        Self {
            truth,
            bodies: Bodies::default(),
            placed: 0,
            removed: 0,
            after: TickChanges::default(),
        }
    }

    /// Advances to `tick`, which must be the next one.
    pub(super) fn step(&mut self, tick: Tick) -> TickChanges<'a> {
        let truth = self.truth;
        let mut statics_changed = self.apply_changes();
        let row = tick
            .value()
            .checked_sub(1)
            .and_then(|row| truth.ticks.get(row as usize));
        let observed = row.map_or(&[][..], Vec::as_slice);
        for observation in observed {
            if let Some(body) = self.bodies.find_mut(observation.id) {
                body.position = observation.motion.position();
                body.rotation = observation.motion.rotation();
                body.still = observation.activity == Activity::Asleep;
            }
        }
        let removed = &truth.removed[self.removed..];
        let removed = &removed[..removed.partition_point(|(when, _)| *when <= tick)];
        let placed = &truth.placed[self.placed..];
        let placed = &placed[..placed.partition_point(|placed| placed.tick <= tick)];
        self.removed += removed.len();
        self.placed += placed.len();
        self.after = TickChanges {
            observed,
            placed,
            removed,
            statics_changed: false,
        };
        let changes = self.after;
        if tick == Tick::ZERO {
            // Bodies placed before the first step are present at tick 0.
            statics_changed |= self.apply_changes();
        }
        TickChanges {
            statics_changed,
            ..changes
        }
    }

    /// Applies pending placements and removals; returns whether one of them was static.
    fn apply_changes(&mut self) -> bool {
        let after = std::mem::take(&mut self.after);
        let mut statics = false;
        for (_, id) in after.removed {
            statics |= self.bodies.find(*id).is_some_and(Body::is_static);
            self.bodies.remove(*id);
        }
        for placed in after.placed {
            statics |= placed.desc.kind == BodyKind::Fixed;
            self.bodies.place(placed);
        }
        statics
    }
}

/// A client's copy of the bodies.
#[derive(Debug)]
pub(super) struct CopiedBodies<'a> {
    truth: &'a Truth,
    placed_by_id: BTreeMap<BodyId, &'a Placed>,
    pub(super) bodies: Bodies<'a>,
    placed: usize,
}

impl<'a> CopiedBodies<'a> {
    pub(super) fn new(truth: &'a Truth) -> Self {
        Self {
            truth,
            placed_by_id: truth
                .placed
                .iter()
                .map(|placed| (placed.desc.id, placed))
                .collect(),
            bodies: Bodies::default(),
            placed: 0,
        }
    }

    /// Applies a frame. A body that was placed at tick 0 or before the frame's tick, and that no frame mentions,
    /// stands at its placement.
    pub(super) fn show(&mut self, frame: &Frame) {
        let truth = self.truth;
        let placed = &truth.placed[self.placed..];
        let placed = &placed[..placed
            .partition_point(|placed| placed.tick == Tick::ZERO || placed.tick < frame.tick)];
        self.placed += placed.len();
        for placed in placed {
            self.bodies.place(placed);
        }
        for id in &frame.removed {
            self.bodies.remove(*id);
        }
        for pose in &frame.changed {
            if self.bodies.find(pose.id).is_none()
                && let Some(placed) = self.placed_by_id.get(&pose.id)
            {
                self.bodies.place(placed);
            }
            if let Some(body) = self.bodies.find_mut(pose.id) {
                body.position = pose.position;
                body.rotation = pose.rotation;
                body.still = pose.resting;
            }
        }
    }
}
