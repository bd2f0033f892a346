//! One body's place in the table of tracks: as few bytes as say it
//!
//! What a tumbling body's cursor knows is kept beside the table: most scenes have no such body.

use core::fmt;

use rhumb_reckoning::{BodyId, DenseTrack, Predictor, Tick, Track};

/// One body's place in the table.
#[derive(Clone)]
pub(crate) struct Slot {
    track: DenseTrack,
    tumbles: bool,
    generation: u16,
    /// Its kind, of those of the table.
    pub(super) nature: u32,
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
    pub(super) fn new(id: BodyId, track: &Track, nature: u32, tumbles: bool) -> Self {
        Self {
            track: DenseTrack::new(track),
            tumbles,
            generation: id.generation(),
            nature,
        }
    }

    pub(super) fn set_track(&mut self, track: &Track) {
        self.track = DenseTrack::new(track);
    }

    pub(crate) const fn id(&self, index: u32) -> BodyId {
        BodyId::new(index, self.generation)
    }

    /// Whether it turns otherwise than at a constant spin when it is free.
    pub(crate) const fn tumbles(&self) -> bool {
        self.tumbles
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
    pub(crate) const fn carrier(&self) -> Option<BodyId> {
        self.track.carrier()
    }

    /// See [`Track::is_verbatim_rest`].
    pub(crate) const fn is_verbatim_rest(&self) -> bool {
        self.track.is_verbatim_rest()
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
