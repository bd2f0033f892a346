//! Bound on the scenes of one server, shared by all threads of a process.
//!
//! The number of scenes of the server's other processes is as old as their last report.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts the scenes of a server; all clones are one count.
#[derive(Clone, Debug, Default)]
pub struct SceneSlots(Arc<SlotCounts>);

#[derive(Debug, Default)]
struct SlotCounts {
    /// Scenes of this process.
    here: AtomicUsize,
    /// Scenes of the server's other processes.
    elsewhere: AtomicUsize,
}

/// The place of one scene; dropping it frees the place.
#[derive(Debug)]
pub(crate) struct SceneSlot(Arc<SlotCounts>);

impl SceneSlots {
    /// Scenes of this process.
    #[must_use]
    pub fn here(&self) -> usize {
        self.0.here.load(Ordering::Relaxed)
    }

    /// Sets the number of scenes of the server's other processes.
    pub fn set_elsewhere(&self, scenes: usize) {
        self.0.elsewhere.store(scenes, Ordering::Relaxed);
    }

    /// A place for another scene; `None` if the server has `most` already.
    pub(crate) fn take(&self, most: usize) -> Option<SceneSlot> {
        let most = most.saturating_sub(self.0.elsewhere.load(Ordering::Relaxed));
        let another = |count| (count < most).then_some(count + 1);
        let taken = (self.0.here).fetch_update(Ordering::Relaxed, Ordering::Relaxed, another);
        taken.ok().map(|_| SceneSlot(Arc::clone(&self.0)))
    }
}

impl Drop for SceneSlot {
    fn drop(&mut self) {
        self.0.here.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_free_again_when_its_scene_ends() {
        let slots = SceneSlots::default();
        let mut taken: Vec<_> = std::iter::from_fn(|| slots.clone().take(4)).collect();
        assert_eq!(taken.len(), 4);
        taken.pop();
        assert!(slots.take(4).is_some());
        slots.set_elsewhere(2);
        assert!(slots.take(5).is_none(), "three here, two elsewhere");
        assert_eq!(slots.here(), 3);
    }
}
