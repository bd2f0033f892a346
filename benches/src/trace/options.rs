//! Options of a trace's drawings.

use crate::record::Load;

/// The parts of a trace that are drawn for viewers; the data topics are always complete.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TraceOptions {
    /// Scenes drawn per simulated second.
    pub scene_hz: f64,
    /// Seconds that a body lies still before it is drawn on the `resting` topic.
    pub resting_after_s: f64,
    /// Loads with more bodies are not drawn: a drawn body takes about 20 bytes each time.
    pub scene_bodies_max: u32,
}

impl Default for TraceOptions {
    fn default() -> Self {
        Self {
            scene_hz: 30.0,
            resting_after_s: 0.5,
            scene_bodies_max: 1_000,
        }
    }
}

impl TraceOptions {
    pub(super) fn draws(&self, load: &Load) -> bool {
        load.runs
            .first()
            .is_some_and(|run| run.config.bodies <= self.scene_bodies_max)
    }
}
