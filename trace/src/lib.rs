//! Scenes as messages that Foxglove's viewers and other programs read.
//!
//! It knows bodies and their poses, and neither engines nor runs: `rhumb-bench` writes traces by it, and `rhumb-server`
//! records scenes and shows them live. All of them have the topics, schemas and drawings of this crate.
//!
//! | topic below a scene's prefix | message | holds |
//! |---|---|---|
//! | `truth/state` | `rhumb.States` | states of the engine at each tick |
//! | `truth/static`, `truth/moving`, `truth/resting` | `foxglove.SceneUpdate` | the same, drawn; each message is complete |
//! | `truth/poses` | `foxglove.PosesInFrame` | the poses of a drawing, for viewers that draw no scenes |
#![forbid(unsafe_code)]

mod drawing;
mod file;
#[cfg(feature = "live")]
mod live;
mod messages;
mod topics;

pub use drawing::{
    ASLEEP, AWAKE, Drawing, DrawnBody, DrawnScene, FRAME, Painted, Placed, draw_statics,
};
pub use file::{ContentsError, FileContents, FileEnd, StoredChannel, StoredMessage};
pub use file::{SceneFacts, StatesReader, TickStates, TraceFile, log_time_ns, read_states};
pub use foxglove::messages::{Color, SceneUpdate};
#[cfg(feature = "live")]
pub use live::{LiveError, LiveScenes};
pub use mcap::McapError;
pub use mcap::write::NoSeek;
pub use messages::{
    BreachMessage, DESCRIPTORS, GridHistory, GridPose, Packet, Placement, PoseBase, Poses, STEPS,
    StateForm, States, TickStats,
};
pub use topics::{
    DrawnTopics, SceneTopics, Schema, Topic, TraceSink, drawing_panel, scene_layout, whole_layout,
};
