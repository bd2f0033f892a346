//! Predicts many bodies at one tick, several at a time.

use rhumb_reckoning::{BodyId, Motion, PredictionX4, Tick};

use super::Subscriber;
use crate::stream::tracks::Slot;

impl Subscriber {
    /// Passes the predicted motion of each body to the callback with its key, in no defined order. The bits are those
    /// of [`Self::predicted_motion`]. A body that does not exist is skipped.
    pub fn predict_each(
        &self,
        requested: &[(u32, BodyId)],
        tick: Tick,
        mut out: impl FnMut(u32, Motion),
    ) {
        let mut batch = PredictionX4::default();
        for (key, id) in requested {
            // An attached body, or a tick before the track's origin, is predicted alone.
            let is_simple = |slot: &&Slot| {
                let of_now = slot.id(id.index()) == *id && slot.origin() <= tick;
                of_now && slot.parent().is_none()
            };
            let slot = self.tracks.slot(id.index()).filter(is_simple);
            if slot.is_some_and(|slot| self.tracks.take(&mut batch, *key, slot, tick)) {
                if batch.is_full() {
                    batch.predict(&mut out);
                }
            } else if let Some(motion) = self.predicted_motion(*id, tick) {
                out(*key, motion);
            }
        }
        batch.predict(&mut out);
    }
}
