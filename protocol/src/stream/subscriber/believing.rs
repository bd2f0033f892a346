//! What is believed of many bodies at one tick, several side by side.

use rhumb_reckoning::{BodyId, Motion, Quartet, Tick};

use super::Subscriber;

impl Subscriber {
    /// Hands out what is believed of bodies at a tick, each under the key that it is asked by: the bits of
    /// [`Self::believed`], in no order that means anything. A body that is not there is passed over.
    pub fn believe_each(
        &self,
        asked: &[(u32, BodyId)],
        tick: Tick,
        mut out: impl FnMut(u32, Motion),
    ) {
        let mut quartet = Quartet::default();
        for (key, id) in asked {
            let Some(slot) = self.tracks.slot(id.index()) else {
                continue;
            };
            let of_now = slot.id(id.index()) == *id && slot.origin() <= tick;
            // What is carried, or older than its track, is looked up by itself.
            let free = slot.carrier().is_none();
            if of_now && free && self.tracks.take(&mut quartet, *key, slot, tick) {
                if quartet.is_full() {
                    quartet.predict(&mut out);
                }
            } else if let Some(motion) = self.believed(*id, tick) {
                out(*key, motion);
            }
        }
        quartet.predict(&mut out);
    }
}
