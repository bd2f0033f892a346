//! No taps, in a server that was built without recordings: nothing is copied.

use rhumb_protocol::message::SceneEvent;
use rhumb_protocol::scene::SceneName;
use rhumb_scene::Scene;

/// Taps without readers.
#[derive(Clone, Default)]
pub(crate) struct SceneTaps;

/// The tap of one scene; it does nothing.
pub(crate) struct SceneTap;

impl SceneTaps {
    pub(crate) fn begin(&self, _: &SceneName) -> SceneTap {
        SceneTap
    }
}

impl SceneTap {
    pub(crate) fn note(&mut self, _: &SceneEvent) {}

    pub(crate) fn record(&mut self, _: &Scene) {}
}
