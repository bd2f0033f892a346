//! The recorders of scenes: metrics, flight recorders and recordings.
//!
//! Each observes a scene and changes nothing in it.

use bytes::Bytes;
use rhumb_protocol::message::SceneEvent;
use rhumb_protocol::scene::{Command, CommandError, SceneName};
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::Tick;
use rhumb_scene::{Incident, ObserveScenes, Scene, SceneObserver, TickMetrics, Traffic};

use crate::flight::{FlightCause, FlightRecorder, FlightRecorders};
use crate::metrics::{Metrics, SceneMeter};
use crate::recording::{SceneTap, SceneTaps};

/// The recorders of all scenes; all clones are one. The default counts, and records nothing.
#[derive(Clone, Default)]
pub(crate) struct SceneRecorders {
    /// Metrics for operators.
    pub(crate) metrics: Metrics,
    /// The last moments, written after a fault.
    pub(crate) flights: FlightRecorders,
    /// States of every tick, for files and viewers.
    pub(crate) taps: SceneTaps,
}

/// The recorders of one scene.
struct SceneRecorder {
    meter: SceneMeter,
    flight: FlightRecorder,
    tap: SceneTap,
}

impl ObserveScenes for SceneRecorders {
    fn begin(&self, scene: &SceneName, period: Span) -> Box<dyn SceneObserver> {
        let meter = self.metrics.begin_scene(scene);
        meter.note_step_period(period);
        Box::new(SceneRecorder {
            meter,
            flight: self.flights.begin(scene),
            tap: self.taps.begin(scene),
        })
    }
}

impl SceneObserver for SceneRecorder {
    fn joined(&mut self, peer: Peer, client: Option<&str>) {
        self.flight.joined(peer, client);
    }

    fn left(&mut self, peer: Peer) {
        self.flight.left(peer);
    }

    fn command(&mut self, peer: Peer, number: u64, command: &Command) {
        self.flight.command(peer, number, command);
    }

    fn commanded(&mut self, refused: Option<&CommandError>) {
        self.meter.count_command(refused.is_some());
        if let Some(error) = refused {
            self.flight.refused(error);
        }
    }

    fn scene_event(&mut self, event: &SceneEvent) {
        self.tap.note(event);
    }

    fn step_began(&mut self, at: Instant, tick: Tick) {
        self.flight.step_began(at, tick);
    }

    fn stepped(
        &mut self,
        metrics: &TickMetrics,
        scene: &Scene,
        packets: &mut dyn Iterator<Item = &Bytes>,
    ) {
        self.meter.note_tick(metrics);
        self.flight.packets(packets);
        self.flight.stepped(metrics, scene.digest());
        self.tap.record(scene);
    }

    fn incident(&mut self, incident: Incident) {
        match incident {
            Incident::Late => self.meter.count_late(),
            Incident::Slowed => self.meter.count_slowed(),
            Incident::Restored => self.meter.count_restored(),
            Incident::Faulted => self.meter.note_faulted(),
            Incident::EnginePanicked => self.flight.write(FlightCause::EnginePanicked),
            Incident::NotFinite => self.flight.write(FlightCause::NotFinite),
            Incident::ChecksumMismatch => self.flight.write(FlightCause::ChecksumMismatch),
        }
    }

    fn traffic(&self) -> Traffic {
        self.meter.traffic()
    }
}
