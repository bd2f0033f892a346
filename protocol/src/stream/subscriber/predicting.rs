//! What is predicted_motion of many bodies at one tick, several side by side.

use rhumb_reckoning::{BodyId, Motion, PredictionX4, Tick};

use super::Subscriber;

impl Subscriber {
    /// Hands out what is predicted_motion of bodies at a tick, each under the key that it is asked by: the bits of
    /// [`Self::predicted_motion`], in no order that means anything. A body that is not there is passed over.
    pub fn predict_each(
        &self,
        asked: &[(u32, BodyId)],
        tick: Tick,
        mut out: impl FnMut(u32, Motion),
    ) {
        let mut batch = PredictionX4::default();
        for (key, id) in asked {
            let Some(slot) = self.tracks.slot(id.index()) else {
                continue;
            };
            let of_now = slot.id(id.index()) == *id && slot.origin() <= tick;
            // What is attached_motion, or older than its track, is looked up by itself.
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
