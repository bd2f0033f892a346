//! The previous tracks of bodies, which hold before the present ones.
//!
//! At most one for each body, and only while a view may show ticks before the present track. They are few, so they are
//! kept outside the table. Invariant: `places` points into `kept`, and each entry of `kept` back.

use alloc::vec::Vec;

use rhumb_reckoning::{DenseTrack, Tick, Track};

use crate::capacity::{grow_to, push};

/// By body: the track directly before the present one.
#[derive(Clone, Debug, Default)]
pub(crate) struct PreviousTracks {
    /// By index: one more than the position in `kept`; 0 for none.
    places: Vec<u32>,
    /// The tracks, each with the index of its body.
    kept: Vec<(u32, DenseTrack)>,
}

impl PreviousTracks {
    /// The previous track of a body, if it is kept.
    pub(crate) fn get(&self, index: u32) -> Option<Track> {
        Some(self.kept[self.place(index)?].1.track())
    }

    /// The origin of the previous track.
    pub(crate) fn origin(&self, index: u32) -> Option<Tick> {
        Some(self.kept[self.place(index)?].1.origin())
    }

    /// Keeps the previous track of a body in place of an older one.
    pub(crate) fn keep(&mut self, index: u32, track: DenseTrack) {
        if let Some(place) = self.place(index) {
            self.kept[place].1 = track;
            return;
        }
        grow_to(&mut self.places, index as usize + 1, || 0);
        push(&mut self.kept, (index, track));
        self.places[index as usize] = self.kept.len() as u32;
    }

    /// Drops the previous track of a body.
    pub(crate) fn forget(&mut self, index: u32) {
        if let Some(place) = self.place(index) {
            self.take_out(place);
        }
    }

    /// Keeps only the previous tracks of bodies that satisfy `of`.
    pub(crate) fn retain(&mut self, of: impl Fn(u32) -> bool) {
        // From the last entry on, so that an entry that fills a removed place was tested already.
        for place in (0..self.kept.len()).rev() {
            if !of(self.kept[place].0) {
                self.take_out(place);
            }
        }
    }

    fn place(&self, index: u32) -> Option<usize> {
        Some(self.places.get(index as usize)?.checked_sub(1)? as usize)
    }

    fn take_out(&mut self, place: usize) {
        let (index, _) = self.kept.swap_remove(place);
        self.places[index as usize] = 0;
        if let Some((moved, _)) = self.kept.get(place) {
            self.places[*moved as usize] = place as u32 + 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::collections::BTreeMap;
    use proptest::prelude::*;
    use rhumb_reckoning::{Anchor, BodyState, Predictor};

    #[derive(Clone, Copy, Debug)]
    enum Operation {
        Keep(u32, u64),
        Forget(u32),
        Retain(u64),
    }

    fn operation() -> impl Strategy<Value = Operation> {
        prop_oneof![
            (0_u32..40, 0_u64..9).prop_map(|(index, tick)| Operation::Keep(index, tick)),
            (0_u32..40).prop_map(Operation::Forget),
            (0_u64..9).prop_map(Operation::Retain),
        ]
    }

    fn track(tick: u64) -> Track {
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        Track {
            origin: Tick::new(tick),
            predictor: Predictor::Rest,
            anchor: Anchor::Exact(still.unwrap()),
            parent: None,
        }
    }

    proptest! {
        #[test]
        fn kept_tracks_are_found_by_body(operations in proptest::collection::vec(operation(), 0..120)) {
            let (mut before, mut expected) = (PreviousTracks::default(), BTreeMap::new());
            for operation in operations {
                match operation {
                    Operation::Keep(index, tick) => {
                        before.keep(index, DenseTrack::new(&track(tick)));
                        expected.insert(index, tick);
                    }
                    Operation::Forget(index) => {
                        before.forget(index);
                        expected.remove(&index);
                    }
                    Operation::Retain(least) => {
                        let ticks = expected.clone();
                        before.retain(|index| ticks[&index] >= least);
                        expected.retain(|_, tick| *tick >= least);
                    }
                }
                for index in 0..45 {
                    let tick = expected.get(&index).copied();
                    prop_assert_eq!(before.get(index), tick.map(track));
                    prop_assert_eq!(before.origin(index), tick.map(Tick::new));
                }
            }
        }
    }
}
