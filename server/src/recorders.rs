//! Recorders of a server's scenes, beside the command log.

use crate::flight::FlightRecorders;
use crate::recording::SceneTaps;

/// The recorders of all scenes; all clones are one. The default records nothing.
#[derive(Clone, Default)]
pub(crate) struct SceneRecorders {
    /// The last moments, written after a fault.
    pub(crate) flights: FlightRecorders,
    /// States of every tick, for files and viewers.
    pub(crate) taps: SceneTaps,
}
