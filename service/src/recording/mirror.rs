//! The bodies of a scene as its records leave them.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, Tick};
use rhumb_trace::{DrawnBody, Placed};

use super::tap::{RecordedBody, TickRecord};

/// All bodies of a scene.
#[derive(Debug, Default)]
pub(super) struct SceneMirror {
    bodies: BTreeMap<BodyId, RecordedBody>,
    tick: Tick,
}

/// The changes by a record.
#[derive(Debug, Default)]
pub(super) struct MirrorChanges {
    pub(super) placed: Vec<BodyId>,
    pub(super) removed: Vec<BodyId>,
    /// True if a fixed body is among them.
    pub(super) statics: bool,
}

impl SceneMirror {
    /// The newest tick.
    pub(super) const fn tick(&self) -> Tick {
        self.tick
    }

    /// Applies a record.
    pub(super) fn apply(&mut self, record: &TickRecord) -> MirrorChanges {
        let mut changes = MirrorChanges::default();
        if record.is_whole {
            let gone = std::mem::take(&mut self.bodies);
            changes.statics = true;
            let placed: BTreeSet<_> = record.placed.iter().map(|body| body.desc.id).collect();
            changes.removed = gone.into_keys().filter(|id| !placed.contains(id)).collect();
        }
        for id in &record.removed {
            if let Some(body) = self.bodies.remove(id) {
                changes.statics |= body.desc.kind == BodyKind::Fixed;
                changes.removed.push(*id);
            }
        }
        for body in &record.placed {
            changes.statics |= body.desc.kind == BodyKind::Fixed;
            changes.placed.push(body.desc.id);
            self.bodies.insert(body.desc.id, body.clone());
        }
        for observation in &record.observed {
            if let Some(body) = self.bodies.get_mut(&observation.id) {
                body.observation = *observation;
            }
        }
        self.tick = record.tick;
        changes
    }

    /// A body as it is now.
    pub(super) fn placed(&self, id: BodyId) -> Option<Placed> {
        self.bodies.get(&id).map(|body| self.placement(body))
    }

    /// All bodies as they are now.
    pub(super) fn all_placed(&self) -> Vec<Placed> {
        let bodies = self.bodies.values();
        bodies.map(|body| self.placement(body)).collect()
    }

    fn placement(&self, body: &RecordedBody) -> Placed {
        Placed {
            tick: self.tick,
            desc: body.desc,
            shape: body.shape.clone(),
            observation: body.observation,
            inertia: body.inertia,
        }
    }

    /// All bodies as they are drawn: the fixed ones, or the others.
    pub(super) fn drawn(&self, statics: bool) -> impl Iterator<Item = DrawnBody<'_>> {
        let bodies = self.bodies.values();
        let wanted = bodies.filter(move |body| (body.desc.kind == BodyKind::Fixed) == statics);
        wanted.map(|body| {
            let Observation {
                id,
                motion,
                activity,
            } = body.observation;
            DrawnBody {
                id,
                shape: &body.shape,
                position: motion.position(),
                rotation: motion.rotation(),
                still: activity == Activity::Asleep,
            }
        })
    }
}
