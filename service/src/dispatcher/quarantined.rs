//! The quarantined workers and the names of their scenes.

use std::collections::BTreeMap;

use rhumb_protocol::Instant;
use rhumb_protocol::scene::SceneName;

use super::message::WorkerId;

/// The scenes of one worker. All scenes of an adapter's clients share one.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Scope {
    Adapter,
    Scene(SceneName),
}

impl Scope {
    /// The scene, if there is only one.
    pub(super) const fn scene(&self) -> Option<&SceneName> {
        match self {
            Self::Adapter => None,
            Self::Scene(scene) => Some(scene),
        }
    }
}

/// The quarantined workers, and the next look.
#[derive(Default)]
pub(super) struct Quarantined {
    pub(super) quarantined: BTreeMap<WorkerId, Scope>,
    pub(super) next: Instant,
}

impl Quarantined {
    pub(super) fn is_quarantined(&self, id: WorkerId) -> bool {
        self.quarantined.contains_key(&id)
    }
}
