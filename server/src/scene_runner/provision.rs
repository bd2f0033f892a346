//! A server's provision for one scene: limits, a share of time, and figures.

use crate::flight::FlightRecorder;
use crate::limits::Limits;
use crate::load::SceneLoad;
use crate::metrics::SceneMeter;
use crate::pulse::Pulse;
use crate::recording::SceneTap;

/// The provision of one scene, given back when the scene ends.
pub(crate) struct Provision {
    pub(crate) limits: Limits,
    pub(crate) load: SceneLoad,
    pub(crate) meter: SceneMeter,
    /// Shows that a long work of the scene makes progress.
    pub(crate) pulse: Pulse,
    pub(crate) flight: FlightRecorder,
    pub(crate) tap: SceneTap,
}

#[cfg(test)]
impl Provision {
    /// The provision of a scene that shares nothing with others.
    pub(crate) fn unbounded(name: &rhumb_protocol::scene::SceneName) -> Self {
        Self {
            limits: Limits::default(),
            load: crate::load::ServerLoad::default().of_scene((0, 1), u64::MAX, u64::MAX),
            meter: crate::metrics::Metrics::default().begin_scene(name),
            pulse: Pulse::default(),
            flight: crate::flight::FlightRecorders::default().begin(name),
            tap: crate::recording::SceneTaps::default().begin(name),
        }
    }
}
