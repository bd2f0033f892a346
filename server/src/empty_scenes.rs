//! Scenes without members, and since when.

use std::collections::BTreeMap;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Instant, Span};

/// When each scene lost its last member.
#[derive(Debug, Default)]
pub(crate) struct EmptyScenes(BTreeMap<SceneName, Instant>);

impl EmptyScenes {
    /// Notes whether a scene is empty now.
    pub(crate) fn note(&mut self, name: &SceneName, is_empty: bool, now: Instant) {
        if is_empty {
            self.0.entry(name.clone()).or_insert(now);
        } else {
            self.0.remove(name);
        }
    }

    /// The scenes that have been empty for so long.
    pub(crate) fn over(&self, now: Instant, after: Span) -> Vec<SceneName> {
        let scenes = self.0.iter();
        let over = scenes.filter(|(_, since)| now.since(**since) >= after);
        over.map(|(name, _)| name.clone()).collect()
    }

    /// When the next scene will have been empty for so long.
    pub(crate) fn next(&self, after: Span) -> Option<Instant> {
        Some(*self.0.values().min()? + after)
    }
}
