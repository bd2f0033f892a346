//! A server's provision for one scene: limits, a part of its time, and a place in its figures.

use super::SceneRunner;
use crate::limits::Limits;
use crate::load::SceneLoad;
use crate::metrics::{SceneMeter, TickFigures};
use crate::times::Marks;

/// The provision of one scene, given back when the scene ends.
pub(crate) struct Provision {
    pub(crate) limits: Limits,
    pub(crate) load: SceneLoad,
    pub(crate) meter: SceneMeter,
}

#[cfg(test)]
impl Provision {
    /// The provision of a scene that shares nothing with others.
    pub(crate) fn unbounded(name: &rhumb_protocol::scene::SceneName) -> Self {
        Self {
            limits: Limits::default(),
            load: crate::load::ServerLoad::default().of_scene(0, u64::MAX, u64::MAX),
            meter: crate::metrics::Metrics::default().begin_scene(name),
        }
    }
}

impl SceneRunner {
    /// Adds the times of a tick to the scene's figures.
    pub(super) fn note_times(&mut self, marks: Marks) {
        self.times.add(marks);
        self.provision.meter.note_tick(&TickFigures {
            tick: self.scene.tick().value(),
            members: self.members.len(),
            bodies: self.scene.body_count(),
            awake: self.scene.awake_count(),
            step: marks.stepped.since(marks.begun),
            publish: marks.published.since(marks.stepped),
        });
    }
}
