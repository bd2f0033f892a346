//! The figures of a scene's ticks.

use super::SceneRunner;
use crate::metrics::TickFigures;
use crate::times::Marks;

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
