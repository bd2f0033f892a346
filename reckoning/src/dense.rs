//! A track without a bit to spare: as tables hold it.
//!
//! Nothing is rounded: what is unpacked is what was packed. Invariant: the bytes were made of a track, so that what they
//! hold was checked.

use crate::body::BodyId;
use crate::lattice::Snapped;
use crate::packed::PackedRotation;
use crate::predictor::Predictor;
use crate::push::Push;
use crate::tick::Tick;
use crate::track::{Anchor, Track, Verbatim};

/// A [`Track`] in 61 bytes, where that takes 80.
///
/// It lies anywhere: nothing in it is read but by copy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, packed)]
pub struct DenseTrack {
    /// The thirteen numbers of a verbatim motion; or the eleven of one on its grid, and behind them its carrier's index and
    /// generation, or its push.
    words: [u32; 13],
    origin: Tick,
    /// The law, and the flags below.
    form: u8,
}

/// The bits of a law.
const LAW: u8 = 7;
/// The law of what rests.
const REST: u8 = 0;
/// It is said to the bit.
const VERBATIM: u8 = 8;
/// It has a carrier.
const CARRIED: u8 = 16;

impl DenseTrack {
    /// Packs a track.
    ///
    /// # Panics
    ///
    /// When it is held or pushed and said to the bit, or both held and pushed: what is held rests on its grid, what is pushed
    /// moves on its own (PROTOCOL 5.5), and so do all that are decoded.
    #[must_use]
    pub fn new(track: &Track) -> Self {
        let law = law(track.predictor);
        let (words, form) = match (&track.anchor, track.carrier, track.predictor.push()) {
            (Anchor::Verbatim(verbatim), carrier, push) => {
                assert!(carrier.is_none(), "what is held lies on its grid");
                assert!(push.is_none(), "what is pushed lies on its grid");
                (verbatim.bits(), law | VERBATIM)
            }
            (Anchor::Snapped(snapped), None, push) => {
                (on_grid(snapped, push.map_or([0; 2], Push::words)), law)
            }
            (Anchor::Snapped(snapped), Some(carrier), push) => {
                assert!(push.is_none(), "what is held rests");
                let carrier = [carrier.index(), u32::from(carrier.generation())];
                (on_grid(snapped, carrier), law | CARRIED)
            }
        };
        Self {
            words,
            origin: track.origin,
            form,
        }
    }

    /// The track.
    #[must_use]
    #[inline]
    pub fn track(&self) -> Track {
        Track {
            origin: self.origin(),
            predictor: self.predictor(),
            anchor: self.anchor(),
            carrier: self.carrier(),
        }
    }

    /// See [`Track::origin`].
    #[must_use]
    #[inline]
    pub const fn origin(&self) -> Tick {
        self.origin
    }

    /// See [`Track::predictor`].
    #[must_use]
    #[inline]
    pub const fn predictor(&self) -> Predictor {
        match self.form & LAW {
            REST => Predictor::Rest,
            1 => Predictor::Uniform,
            2 => Predictor::Ballistic,
            3 => Predictor::Tumbling,
            4 => Predictor::Thrown,
            _ => Predictor::Pushed(Push::from_words([self.words[11], self.words[12]])),
        }
    }

    /// See [`Track::anchor`].
    #[must_use]
    #[inline(always)]
    pub fn anchor(&self) -> Anchor {
        if self.form & VERBATIM != 0 {
            return Anchor::Verbatim(Verbatim::from_bits(self.words));
        }
        let number = |place: usize| self.words[place] as i32;
        let numbers = |place: usize| [number(place), number(place + 1), number(place + 2)];
        Anchor::Snapped(Snapped {
            position: numbers(0),
            rotation: PackedRotation::from_words([self.words[3], self.words[4]]),
            linear: numbers(5),
            angular: numbers(8),
        })
    }

    /// See [`Track::carrier`].
    #[must_use]
    #[inline]
    pub const fn carrier(&self) -> Option<BodyId> {
        if self.form & CARRIED == 0 {
            return None;
        }
        Some(BodyId::new(self.words[11], self.words[12] as u16))
    }

    /// See [`Track::is_resting`].
    #[must_use]
    #[inline]
    pub const fn is_resting(&self) -> bool {
        self.form & !VERBATIM == REST
    }

    /// See [`Track::is_verbatim_rest`].
    #[must_use]
    #[inline]
    pub const fn is_verbatim_rest(&self) -> bool {
        self.form == VERBATIM | REST
    }
}

const fn law(predictor: Predictor) -> u8 {
    match predictor {
        Predictor::Rest => REST,
        Predictor::Uniform => 1,
        Predictor::Ballistic => 2,
        Predictor::Tumbling => 3,
        Predictor::Thrown => 4,
        Predictor::Pushed(_) => 5,
    }
}

/// The words of a motion on its grid, and of what stands behind it.
fn on_grid(snapped: &Snapped, [index, generation]: [u32; 2]) -> [u32; 13] {
    let [x, y, z] = snapped.position;
    let [low, high] = snapped.rotation.words();
    let ([u, v, w], [p, q, r]) = (snapped.linear, snapped.angular);
    [
        x as u32, y as u32, z as u32, low, high, u as u32, v as u32, w as u32, p as u32, q as u32,
        r as u32, index, generation,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::{POSITION_LIMIT, VELOCITY_LIMIT};
    use crate::push::{DOUBLINGS_LIMIT, PUSH_LIMIT};
    use glam::DQuat;
    use proptest::prelude::*;

    fn steps(limit: i32) -> impl Strategy<Value = [i32; 3]> {
        proptest::array::uniform3(-limit..=limit)
    }

    fn snapped() -> impl Strategy<Value = Snapped> {
        let turn = proptest::array::uniform3(-3.0_f64..3.0);
        let velocity = || steps(VELOCITY_LIMIT);
        (steps(POSITION_LIMIT), turn, velocity(), velocity()).prop_map(
            |(position, turn, linear, angular)| Snapped {
                position,
                rotation: PackedRotation::of(DQuat::from_scaled_axis(turn.into())),
                linear,
                angular,
            },
        )
    }

    fn verbatim() -> impl Strategy<Value = Verbatim> {
        let parts = || proptest::array::uniform3(-1e6_f32..1e6);
        (parts(), 0_usize..4, any::<bool>(), parts(), parts()).prop_map(
            |(position, place, negative, linear, angular)| {
                let mut rotation = [0.0; 4];
                rotation[place] = if negative { -1.0 } else { 1.0 };
                Verbatim::new(position, rotation, linear, angular).unwrap()
            },
        )
    }

    /// A law that goes with its anchor and carrier.
    fn track() -> impl Strategy<Value = Track> {
        let carrier = (any::<u32>(), any::<u16>()).prop_map(|(i, g)| BodyId::new(i, g));
        let free = || prop::sample::select(&Predictor::ALL[..]);
        let parts = proptest::array::uniform3(-PUSH_LIMIT..=PUSH_LIMIT);
        let push = (parts, 0..=DOUBLINGS_LIMIT)
            .prop_map(|(steps, doublings)| Predictor::Pushed(Push::new(steps, doublings).unwrap()));
        let unpushed = free().prop_filter("it is said to the bit", |law| law.push().is_none());
        let framed = || snapped().prop_map(Anchor::Snapped);
        let parts = prop_oneof![
            (prop_oneof![free(), push], framed(), Just(None)),
            (Just(Predictor::Rest), framed(), carrier.prop_map(Some)),
            (unpushed, verbatim().prop_map(Anchor::Verbatim), Just(None)),
        ];
        (any::<u64>(), parts).prop_map(|(origin, (predictor, anchor, carrier))| Track {
            origin: Tick::new(origin),
            predictor,
            anchor,
            carrier,
        })
    }

    proptest! {
        #[test]
        fn a_track_is_unpacked_as_it_was_packed(track in track()) {
            let dense = DenseTrack::new(&track);
            prop_assert_eq!(dense.track(), track);
            prop_assert_eq!(dense.is_resting(), track.is_resting());
            prop_assert_eq!(dense.is_verbatim_rest(), track.is_verbatim_rest());
        }
    }

    #[test]
    fn a_packed_track_is_small_and_lies_anywhere() {
        assert_eq!((size_of::<DenseTrack>(), align_of::<DenseTrack>()), (61, 1));
    }
}
