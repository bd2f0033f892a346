//! States of scenes for files and viewers, tick by tick.
//!
//! A scene copies the states of a tick into a bounded queue, and never waits: a queue that is full costs ticks of the
//! recording, which continues with a whole scene. Threads of their own write. Without readers a scene copies nothing.

#[cfg(feature = "foxglove")]
mod live;
#[cfg(not(feature = "record"))]
mod no_tap;
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
