//! The figures of a scene's ticks, for its observer.

use rhumb_protocol::message::RemovalCause;

use super::SceneRunner;
use crate::observer::{Incident, TickFigures};
use crate::times::Timestamps;

impl SceneRunner {
    /// Adds the times of a tick to the scene's figures.
    pub(super) fn note_times(&mut self, timestamps: Timestamps) {
        self.times.add(timestamps);
        let figures = TickFigures {
            tick: self.scene.tick(),
            members: self.members.len(),
            bodies: self.scene.body_count(),
            awake: self.scene.awake_count(),
            waiting: self.streams.waiting(),
            load: self.load.reserved(),
            step: timestamps.stepped.since(timestamps.begun),
            publish: timestamps.published.since(timestamps.stepped),
        };
        let mut packets = self.streams.all_packets();
        let observer = &mut self.observer;
        observer.stepped(&figures, &self.scene, &mut packets);
    }

    /// A body whose state was not finite is a fault of the engine.
    pub(super) fn note_removal(&mut self, cause: RemovalCause) {
        if cause == RemovalCause::NotFinite {
            self.observer.incident(Incident::NotFinite);
        }
    }
}
