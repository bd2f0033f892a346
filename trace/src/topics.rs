//! Topics of a scene, and what they are written to.

use foxglove::messages::{PosesInFrame, SceneUpdate};
use foxglove::{Encode, Schema as MessageSchema};
use prost::Message;

use super::body::DrawnBody;
use super::drawing::{DrawnScene, Painted, draw_poses, draw_statics};
use super::messages::{DESCRIPTORS, States};

/// The message type of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Schema {
    /// `foxglove.SceneUpdate`.
    Scene,
    /// `foxglove.PosesInFrame`.
    Poses,
    /// A message of `proto/rhumb.proto`, by its full name.
    Own(&'static str),
    /// The same, on a topic that carries captured packets.
    Wire(&'static str),
}

impl Schema {
    /// The schema as a file or a viewer gets it.
    pub(crate) fn message_schema(self) -> MessageSchema {
        let of_foxglove = match self {
            Self::Scene => SceneUpdate::get_schema(),
            Self::Poses => PosesInFrame::get_schema(),
            Self::Own(name) | Self::Wire(name) => {
                return MessageSchema::new(name, "protobuf", DESCRIPTORS);
            }
        };
        of_foxglove.expect("Foxglove's types have schemas")
    }
}

/// A topic and its write position.
#[derive(Debug)]
pub struct Topic {
    pub(crate) name: String,
    pub(crate) schema: Schema,
    pub(crate) channel: Option<u16>,
    pub(crate) sequence: u32,
}

impl Topic {
    /// A topic that nothing was written to.
    #[must_use]
    pub const fn new(name: String, schema: Schema) -> Self {
        Self {
            name,
            schema,
            channel: None,
            sequence: 0,
        }
    }
}

/// A file, or the viewers that watch.
pub trait TraceSink {
    /// Reason why a message cannot be written.
    type Error;

    /// Writes a message; `at_ns`: nanoseconds since the start of the scene, simulated time.
    ///
    /// # Errors
    ///
    /// The sink's.
    fn put(
        &mut self,
        topic: &mut Topic,
        at_ns: u64,
        message: &impl Message,
    ) -> Result<(), Self::Error>;
}

/// The two topics of a drawn set of bodies.
#[derive(Debug)]
pub struct DrawnTopics {
    moving: Topic,
    resting: Topic,
    drawn: DrawnScene,
}

impl DrawnTopics {
    /// Topics `{prefix}/moving` and `{prefix}/resting`; a body moves to `resting` after `rest_delay_ticks` of
    /// stillness.
    #[must_use]
    pub fn new(prefix: &str, rest_delay_ticks: u64) -> Self {
        Self {
            moving: Topic::new(format!("{prefix}/moving"), Schema::Scene),
            resting: Topic::new(format!("{prefix}/resting"), Schema::Scene),
            drawn: DrawnScene::new(rest_delay_ticks),
        }
    }

    /// Writes the topics whose content changed.
    ///
    /// # Errors
    ///
    /// The sink's.
    pub fn draw<S: TraceSink>(
        &mut self,
        sink: &mut S,
        at: (u64, u64),
        bodies: &[Painted<'_>],
    ) -> Result<(), S::Error> {
        self.draw_changes(sink, at, bodies)?;
        Ok(())
    }

    /// The same; true if a topic was written.
    fn draw_changes<S: TraceSink>(
        &mut self,
        sink: &mut S,
        (tick, at_ns): (u64, u64),
        bodies: &[Painted<'_>],
    ) -> Result<bool, S::Error> {
        let drawing = self.drawn.draw((tick, at_ns), bodies);
        let is_changed = drawing.resting.is_some() || drawing.moving.is_some();
        if let Some(resting) = drawing.resting {
            sink.put(&mut self.resting, at_ns, &resting)?;
        }
        if let Some(moving) = drawing.moving {
            sink.put(&mut self.moving, at_ns, &moving)?;
        }
        Ok(is_changed)
    }

    /// Writes both topics at the next drawing, for viewers that have neither.
    pub fn redraw(&mut self) {
        self.drawn.redraw();
    }
}

/// The names of the topics in which an engine's bodies are drawn, below a scene's prefix.
pub(crate) fn drawn_topics(prefix: &str) -> [String; 3] {
    ["static", "moving", "resting"].map(|of| format!("{prefix}/truth/{of}"))
}

/// The topics of an engine's bodies.
#[derive(Debug)]
pub struct SceneTopics {
    state: Topic,
    statics: Topic,
    poses: Topic,
    drawn: DrawnTopics,
}

impl SceneTopics {
    /// Topics below `{prefix}/truth`.
    #[must_use]
    pub fn new(prefix: &str, rest_delay_ticks: u64) -> Self {
        let prefix = format!("{prefix}/truth");
        Self {
            state: Topic::new(format!("{prefix}/state"), Schema::Own("rhumb.States")),
            statics: Topic::new(format!("{prefix}/static"), Schema::Scene),
            poses: Topic::new(format!("{prefix}/poses"), Schema::Poses),
            drawn: DrawnTopics::new(&prefix, rest_delay_ticks),
        }
    }

    /// Writes the states of a tick.
    ///
    /// # Errors
    ///
    /// The sink's.
    pub fn put_states<S: TraceSink>(
        &mut self,
        sink: &mut S,
        at_ns: u64,
        states: &States,
    ) -> Result<(), S::Error> {
        sink.put(&mut self.state, at_ns, states)
    }

    /// Draws the static bodies.
    ///
    /// # Errors
    ///
    /// The sink's.
    pub fn draw_statics<'a, S: TraceSink>(
        &mut self,
        sink: &mut S,
        at_ns: u64,
        bodies: impl Iterator<Item = DrawnBody<'a>>,
    ) -> Result<(), S::Error> {
        sink.put(&mut self.statics, at_ns, &draw_statics(at_ns, bodies))
    }

    /// Draws the other bodies, and writes their poses for viewers that draw no scenes.
    ///
    /// # Errors
    ///
    /// The sink's.
    pub fn draw<S: TraceSink>(
        &mut self,
        sink: &mut S,
        at: (u64, u64),
        bodies: &[Painted<'_>],
    ) -> Result<(), S::Error> {
        if self.drawn.draw_changes(sink, at, bodies)? {
            let (_, at_ns) = at;
            sink.put(&mut self.poses, at_ns, &draw_poses(at_ns, bodies))?;
        }
        Ok(())
    }

    /// Writes the drawings in full the next time.
    pub fn redraw(&mut self) {
        self.drawn.redraw();
    }
}
