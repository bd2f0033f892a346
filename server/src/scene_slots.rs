//! Bound on the scenes of one process, shared by all its threads.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts the scenes of a process; all clones are one count.
#[derive(Clone, Debug, Default)]
pub(crate) struct SceneSlots(Arc<AtomicUsize>);

/// The place of one scene; dropping it frees the place.
#[derive(Debug)]
pub(crate) struct SceneSlot(Arc<AtomicUsize>);

impl SceneSlots {
    /// A place for another scene; `None` if the process has `most` already.
    pub(crate) fn take(&self, most: usize) -> Option<SceneSlot> {
        let another = |count| (count < most).then_some(count + 1);
        let taken = (self.0).fetch_update(Ordering::Relaxed, Ordering::Relaxed, another);
        taken.ok().map(|_| SceneSlot(Arc::clone(&self.0)))
    }
}

impl Drop for SceneSlot {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
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
    }
}
