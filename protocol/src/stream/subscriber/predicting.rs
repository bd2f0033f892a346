//! Predicts many bodies at one tick, several at a time.

use rhumb_reckoning::{BodyId, Motion, PredictionX4, Tick};

use super::Subscriber;

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
            let Some(slot) = self.tracks.slot(id.index()) else {
                continue;
            };
            let of_now = slot.id(id.index()) == *id && slot.origin() <= tick;
            // An attached body, or a tick before the track's origin, is predicted alone.
            let free = slot.parent().is_none();
            if of_now && free && self.tracks.take(&mut batch, *key, slot, tick) {
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
