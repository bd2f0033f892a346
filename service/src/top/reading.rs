//! One reading of a server's figures.

use std::collections::BTreeMap;
use std::fmt;

use rhumb_protocol::Instant;

use super::samples::{Samples, UnreadableFigures};

/// A server's figures at a moment.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Reading {
    pub(super) at: Instant,
    /// True if `/health` answered so.
    pub(super) is_healthy: bool,
    samples: Samples,
    pub(super) scenes: BTreeMap<String, SceneReading>,
}

/// Figures of one scene, by the names that `/metrics` has for them without `rhumb_scene_`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct SceneReading {
    values: BTreeMap<String, f64>,
    /// Steps that took at most so many seconds, for rising durations.
    pub(super) steps_within: Vec<(f64, f64)>,
}

/// Reason why an answer is not a server's figures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NoFigures {
    Unreadable(UnreadableFigures),
    /// Another program answers there.
    NotAServer,
}

impl fmt::Display for NoFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unreadable(cause) => cause.fmt(f),
            Self::NotAServer => f.write_str("the answer has no figures of a rhumb-server"),
        }
    }
}

/// The beginning of the names of a scene's figures.
const OF_SCENE: &str = "rhumb_scene_";
/// The histogram of the durations of steps.
const STEP_BUCKETS: &str = "step_seconds_bucket";

impl Reading {
    /// Reads the answer of `/metrics`.
    pub(super) fn parse(at: Instant, is_healthy: bool, text: &str) -> Result<Self, NoFigures> {
        let samples = Samples::parse(text).map_err(NoFigures::Unreadable)?;
        if samples.plain("rhumb_scenes").is_none() {
            return Err(NoFigures::NotAServer);
        }
        let mut scenes: BTreeMap<String, SceneReading> = BTreeMap::new();
        for (name, sample) in samples.iter() {
            let (Some(name), Some(scene)) = (name.strip_prefix(OF_SCENE), sample.label("scene"))
            else {
                continue;
            };
            let scene = scenes.entry(scene.to_owned()).or_default();
            if name == STEP_BUCKETS {
                let end = sample.label("le").and_then(|end| end.parse().ok());
                (scene.steps_within).extend(end.map(|end: f64| (end, sample.value)));
            } else {
                scene.values.insert(name.to_owned(), sample.value);
            }
        }
        for scene in scenes.values_mut() {
            scene.steps_within.sort_by(|a, b| a.0.total_cmp(&b.0));
        }
        Ok(Self {
            at,
            is_healthy,
            samples,
            scenes,
        })
    }

    /// A figure of the server.
    pub(super) fn value(&self, name: &str) -> Option<f64> {
        self.samples.plain(name)
    }

    /// Connections that the server closed, by code.
    pub(super) fn closed(&self) -> impl Iterator<Item = (&str, f64)> {
        let closed = self.samples.of("rhumb_closed_total").iter();
        closed.filter_map(|sample| Some((sample.label("code")?, sample.value)))
    }
}

impl SceneReading {
    /// A figure; `None` for one that this server does not have.
    pub(super) fn value(&self, name: &str) -> Option<f64> {
        self.values.get(name).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_read_with_their_histograms() {
        let text = "rhumb_scenes 1\nrhumb_scene_tick{scene=\"pit\"} 9\n\
            rhumb_scene_step_seconds_bucket{scene=\"pit\",le=\"+Inf\"} 9\n\
            rhumb_scene_step_seconds_bucket{scene=\"pit\",le=\"0.001\"} 8\n\
            rhumb_closed_total{code=\"18\"} 2\n";
        let reading = Reading::parse(Instant::ZERO, true, text).unwrap();
        let pit = &reading.scenes["pit"];
        assert_eq!(pit.value("tick"), Some(9.0));
        assert_eq!(pit.value("wind"), None);
        assert_eq!(pit.steps_within, [(0.001, 8.0), (f64::INFINITY, 9.0)]);
        assert_eq!(reading.closed().collect::<Vec<_>>(), [("18", 2.0)]);
    }

    #[test]
    fn figures_of_another_program_are_refused() {
        let refused = Reading::parse(Instant::ZERO, true, "process_cpu_seconds_total 3\n");
        assert_eq!(refused, Err(NoFigures::NotAServer));
        let page = Reading::parse(Instant::ZERO, true, "<!doctype html>\n<p>Hello</p>");
        assert!(matches!(page, Err(NoFigures::Unreadable(_))), "{page:?}");
    }
}
