//! One body's place in the table of tracks: as few bytes as say it
//!
//! What a torque_free body's cursor knows is kept beside the table: most scenes have no such body.

use core::fmt;

use rhumb_reckoning::{BodyId, DenseTrack, Predictor, Tick, Track};

/// One body's place in the table.
#[derive(Clone)]
pub(crate) struct Slot {
    track: DenseTrack,
    is_torque_free: bool,
    generation: u16,
    /// Its kind, of those of the table.
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

    /// Whether it turns otherwise than at a constant spin when it is free.
    pub(crate) const fn is_torque_free(&self) -> bool {
        self.is_torque_free
    }

    /// The body's track.
    #[inline]
    pub(crate) fn track(&self) -> Track {
        self.track.track()
    }

    /// The same as it lies here.
    pub(crate) const fn dense(&self) -> &DenseTrack {
        &self.track
    }

    /// When the track's motion held.
    pub(crate) const fn origin(&self) -> Tick {
        self.track.origin()
    }

    /// How the body goes on.
    pub(crate) const fn predictor(&self) -> Predictor {
        self.track.predictor()
    }

    /// Who holds the body.
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
    fn a_place_in_the_table_stays_small() {
        assert!(size_of::<Option<Slot>>() <= 68, "{}", size_of::<Slot>());
    }
}
