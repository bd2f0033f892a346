//! The slot of one body in the table of tracks, in few bytes.
//!
//! Rotation cursors are kept beside the table, because most scenes have no torque-free body.

use core::fmt;

use rhumb_reckoning::{BodyId, DenseTrack, Predictor, Tick, Track};

/// The slot of one body in the table.
#[derive(Clone)]
pub(crate) struct Slot {
    track: DenseTrack,
    is_torque_free: bool,
    generation: u16,
    /// The number of its parameters in the table's interner.
    pub(super) interned: u32,
}

impl fmt::Debug for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Slot")
            .field("track", &self.track())
            .field("generation", &self.generation)
            .finish_non_exhaustive()
    }
}

impl Slot {
    pub(super) fn new(id: BodyId, track: &Track, interned: u32, is_torque_free: bool) -> Self {
        Self {
            track: DenseTrack::new(track),
            is_torque_free,
            generation: id.generation(),
            interned,
        }
    }

    pub(super) fn set_track(&mut self, track: &Track) {
        self.track = DenseTrack::new(track);
    }

    pub(crate) const fn id(&self, index: u32) -> BodyId {
        BodyId::new(index, self.generation)
    }

    /// True if the body rotates torque-free.
    pub(crate) const fn is_torque_free(&self) -> bool {
        self.is_torque_free
    }

    /// The body's track.
    #[inline]
    pub(crate) fn track(&self) -> Track {
        self.track.track()
    }

    /// The track in its compact form.
    pub(crate) const fn dense(&self) -> &DenseTrack {
        &self.track
    }

    /// The tick of the track's motion.
    pub(crate) const fn origin(&self) -> Tick {
        self.track.origin()
    }

    /// The predictor of the track.
    pub(crate) const fn predictor(&self) -> Predictor {
        self.track.predictor()
    }

    /// The parent of the body, if it is attached.
    pub(crate) const fn parent(&self) -> Option<BodyId> {
        self.track.parent()
    }

    /// See [`Track::is_exact_rest`].
    pub(crate) const fn is_exact_rest(&self) -> bool {
        self.track.is_exact_rest()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slot_stays_small() {
        assert!(size_of::<Option<Slot>>() <= 68, "{}", size_of::<Slot>());
    }
}
