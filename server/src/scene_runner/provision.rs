//! A server's provision for one scene: limits, a share of time, an observer.

use crate::limits::Limits;
use crate::load::SceneLoad;
use crate::observer::SceneObserver;
use crate::heartbeat::Heartbeat;

/// The provision of one scene, given back when the scene ends.
pub(crate) struct Provision {
    pub(crate) limits: Limits,
    pub(crate) load: SceneLoad,
    /// Shows that a long work of the scene makes progress.
    pub(crate) heartbeat: Heartbeat,
    pub(crate) observer: Box<dyn SceneObserver>,
}

#[cfg(test)]
impl Provision {
    /// The provision of a scene that shares nothing with others.
    pub(crate) fn unbounded() -> Self {
        Self {
            limits: Limits::default(),
            load: crate::load::ServerLoad::default().of_scene((0, 1), u64::MAX, u64::MAX),
            heartbeat: Heartbeat::default(),
            observer: Box::new(crate::observer::Unobserved),
        }
    }
}
