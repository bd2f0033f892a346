//! The figures of a scene's ticks, for operators and the flight recorder.

use rhumb_protocol::message::RemovalCause;

use super::SceneRunner;
use crate::flight::FlightCause;
use crate::metrics::TickFigures;
use crate::times::Marks;

impl SceneRunner {
    /// Adds the times of a tick to the scene's figures.
    pub(super) fn note_times(&mut self, marks: Marks) {
        self.times.add(marks);
        let figures = TickFigures {
            tick: self.scene.tick().value(),
            members: self.members.len(),
            bodies: self.scene.body_count(),
            awake: self.scene.awake_count(),
            waiting: self.streams.waiting(),
            load: self.provision.load.reserved(),
            step: marks.stepped.since(marks.begun),
            publish: marks.published.since(marks.stepped),
        };
        self.provision.meter.note_tick(&figures);
        let flight = &self.provision.flight;
        flight.packets(self.streams.all_packets());
        flight.stepped(&figures, self.scene.digest());
        self.provision.tap.record(&self.scene);
    }

    /// A body whose state was not finite is a fault of the engine, which the flight recorder explains.
    pub(super) fn note_removal(&self, cause: RemovalCause) {
        if cause == RemovalCause::NotFinite {
            self.provision.flight.write(FlightCause::Quarantine);
        }
    }
}
