//! Topics of a scene, their sinks, and the layouts that show them.
//!
//! Viewers hide scene topics by default, so a layout enables them.

use foxglove::messages::{PosesInFrame, SceneUpdate};
use foxglove::{Encode, Schema as MessageSchema};
use prost::Message;
use serde_json::{Map, Value, json};

use crate::drawing::{DrawnBody, DrawnScene, FRAME, Painted, draw_poses, draw_statics};
use crate::messages::{DESCRIPTORS, States};

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
fn drawn_topics(prefix: &str) -> [String; 3] {
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

/// The text of a layout file that shows the truth of these scenes, each in a panel beside the others.
#[must_use]
pub fn scene_layout(scenes: &[&str]) -> String {
    let panel = |scene: &&str| {
        let topics = drawn_topics(&format!("/{scene}"));
        (format!("3D!{scene}"), drawing_panel(scene, topics))
    };
    let panels: Map<String, Value> = scenes.iter().map(panel).collect();
    let is_new = |(place, scene): &(usize, &&str)| !scenes[..*place].contains(scene);
    let scenes: Vec<_> = scenes
        .iter()
        .enumerate()
        .filter(is_new)
        .map(|(_, scene)| scene)
        .collect();
    // Each divider leaves all scenes an equal share of the window.
    let places = scenes.into_iter().rev().enumerate();
    let layout = places.fold(Value::Null, |right, (count, scene)| {
        let name = json!(format!("3D!{scene}"));
        match right {
            Value::Null => name,
            right => json!({
                "direction": "row", "splitPercentage": 100 / (count + 1), "first": name, "second": right
            }),
        }
    });
    let mut text = format!("{:#}", whole_layout(&panels, &layout));
    text.push('\n');
    text
}

/// A layout of panels, by their names, and how they share the window.
#[must_use]
pub fn whole_layout(panels: &Map<String, Value>, layout: &Value) -> Value {
    json!({
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": { "speed": 1 },
        "layout": layout,
    })
}

/// A panel that draws these topics in three dimensions.
#[must_use]
pub fn drawing_panel(title: &str, topics: impl IntoIterator<Item = String>) -> Value {
    let shown = |topic| (topic, json!({ "visible": true }));
    let topics: Map<String, Value> = topics.into_iter().map(shown).collect();
    json!({
        "foxglovePanelTitle": title,
        "followTf": FRAME,
        "followMode": "follow-none",
        "cameraState": {
            "perspective": true, "distance": 60, "phi": 60, "thetaOffset": 45, "targetOffset": [0, 0, 0],
            "target": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.1, "far": 5000
        },
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid", "instanceId": "grid", "frameId": FRAME,
                "visible": true, "size": 100, "divisions": 20, "lineWidth": 1, "color": "#248eff40",
                "position": [0, 0, 0], "rotation": [0, 0, 0]
            }
        },
        "scene": {}, "transforms": {}, "publish": {}, "imageMode": {},
        "topics": topics,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layout(scenes: &[&str]) -> Value {
        serde_json::from_str(&scene_layout(scenes)).unwrap()
    }

    #[test]
    fn each_scene_has_a_panel_with_all_that_is_drawn_of_it() {
        let layout = layout(&["pit", "team/7", "last"]);
        let panels = layout["configById"].as_object().unwrap();
        assert_eq!(panels.len(), 3);
        for scene in ["pit", "team/7", "last"] {
            let topics = panels[&format!("3D!{scene}")]["topics"]
                .as_object()
                .unwrap();
            let expected = ["moving", "resting", "static"].map(|of| format!("/{scene}/truth/{of}"));
            assert_eq!(topics.keys().cloned().collect::<Vec<_>>(), expected);
        }
        let window = &layout["layout"];
        assert_eq!(window["first"], "3D!pit");
        assert_eq!(window["splitPercentage"], 33);
        assert_eq!(window["second"]["first"], "3D!team/7");
        assert_eq!(window["second"]["splitPercentage"], 50);
        assert_eq!(window["second"]["second"], "3D!last");
    }

    #[test]
    fn one_scene_has_the_window_and_none_leaves_it_empty() {
        assert_eq!(layout(&["pit"])["layout"], "3D!pit");
        assert_eq!(layout(&["pit", "pit"])["layout"], "3D!pit");
        assert_eq!(layout(&[])["layout"], Value::Null);
    }
}
