//! States of scenes for files and viewers, tick by tick.
//!
//! A scene copies the states of a tick into a bounded queue, and never waits: a queue that is full costs ticks of the
//! recording, which continues with a whole scene. Threads of their own write. Without readers a scene copies nothing.

#[cfg(feature = "foxglove")]
mod live;
#[cfg(feature = "record")]
mod recorder;
#[cfg(feature = "record")]
mod tap;

#[cfg(feature = "foxglove")]
pub use self::live::ViewersError;
#[cfg(feature = "foxglove")]
pub(crate) use self::live::{BoundViewers, LiveViewers};
#[cfg(not(feature = "record"))]
pub(crate) use self::no_tap::{SceneTap, SceneTaps};
#[cfg(feature = "record")]
pub(crate) use self::recorder::{Recorder, RecordingLimits};
#[cfg(feature = "record")]
pub(crate) use self::tap::{SceneTap, SceneTaps};

/// No taps, in a server that was built without recordings: nothing is copied.
#[cfg(not(feature = "record"))]
mod no_tap {
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
}
