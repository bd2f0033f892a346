//! The parked workers and the names of their scenes.

use std::collections::BTreeMap;

use rhumb_protocol::Instant;
use rhumb_protocol::scene::SceneName;

use super::message::WorkerId;

/// Parked threads from which on no new scene begins: each takes a core.
const PARKED_MAX: usize = 8;

/// The scenes of one worker. All scenes of an adapter's clients share one.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Scope {
    Adapter,
    Scene(SceneName),
}

/// The parked workers, and the next look.
#[derive(Default)]
pub(super) struct Parked {
    pub(super) parked: BTreeMap<WorkerId, Scope>,
    pub(super) next: Instant,
}

impl Parked {
    pub(super) fn is_parked(&self, id: WorkerId) -> bool {
        self.parked.contains_key(&id)
    }

    pub(super) fn is_full(&self) -> bool {
        self.parked.len() >= PARKED_MAX
    }
}
