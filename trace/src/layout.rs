//! Layouts of viewers: which panels there are, and the topics that they show.
//!
//! Viewers hide scene topics by default, so a layout enables them.

use serde_json::{Map, Value, json};

use super::primitives::FRAME;
use super::topics::drawn_topics;

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
