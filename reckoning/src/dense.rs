//! Dense storage of a track, as tables hold it.
//!
//! Nothing is rounded: unpacking gives the track that was packed. Invariant: the bytes come from a track, so that
//! their parts are checked.

use crate::acceleration::ConstantAcceleration;
use crate::body::BodyId;
use crate::packed::PackedRotation;
use crate::predictor::Predictor;
use crate::quantiser::QuantisedState;
use crate::tick::Tick;
use crate::track::{Anchor, BodyState, Track};

/// A [`Track`] in 61 bytes instead of 80.
///
/// It needs no alignment: its parts are read by copy only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, packed)]
pub struct DenseTrack {
    /// Exact anchor: its thirteen numbers. Quantised anchor: its eleven numbers, then either the parent's index and
    /// generation or the acceleration.
    words: [u32; 13],
    origin: Tick,
    /// The predictor, and the flags below.
    form: u8,
}

/// Bits of `form` that hold the predictor.
const PREDICTOR: u8 = 7;
/// Predictor of a resting body.
const REST: u8 = 0;
/// Flag: the anchor is exact.
const EXACT: u8 = 8;
/// Flag: the body has a parent.
const ATTACHED: u8 = 16;

impl DenseTrack {
    /// Packs a track.
    ///
    /// # Panics
    ///
    /// If the track is exact and also attached or accelerated, or both attached and accelerated: an attached body
    /// rests on its grid and an accelerated one has no parent (PROTOCOL 5.5). Decoded tracks obey both.
    #[must_use]
    pub fn new(track: &Track) -> Self {
        let predictor = predictor_form(track.predictor);
        let (words, form) = match (&track.anchor, track.parent, track.predictor.acceleration()) {
            (Anchor::Exact(body_state), parent, acceleration) => {
                assert!(parent.is_none(), "an attached body lies on its grid");
                assert!(
                    acceleration.is_none(),
                    "an accelerated body lies on its grid"
                );
                (body_state.bits(), predictor | EXACT)
            }
            (Anchor::Quantised(quantised), None, acceleration) => (
                on_grid(
                    quantised,
                    acceleration.map_or([0; 2], ConstantAcceleration::words),
                ),
                predictor,
            ),
            (Anchor::Quantised(quantised), Some(parent), acceleration) => {
                assert!(acceleration.is_none(), "an attached body rests");
                let parent = [parent.index(), u32::from(parent.generation())];
                (on_grid(quantised, parent), predictor | ATTACHED)
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
            parent: self.parent(),
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
        match self.form & PREDICTOR {
            REST => Predictor::Rest,
            1 => Predictor::Uniform,
            2 => Predictor::Ballistic,
            3 => Predictor::TorqueFree,
            4 => Predictor::BallisticTorqueFree,
            _ => Predictor::Accelerated(ConstantAcceleration::from_words([
                self.words[11],
                self.words[12],
            ])),
        }
    }

    /// See [`Track::anchor`].
    #[must_use]
    #[inline(always)]
    pub fn anchor(&self) -> Anchor {
        if self.form & EXACT != 0 {
            return Anchor::Exact(BodyState::from_bits(self.words));
        }
        let number = |place: usize| self.words[place] as i32;
        let numbers = |place: usize| [number(place), number(place + 1), number(place + 2)];
        Anchor::Quantised(QuantisedState {
            position: numbers(0),
            rotation: PackedRotation::from_words([self.words[3], self.words[4]]),
            linear: numbers(5),
            angular: numbers(8),
        })
    }

    /// See [`Track::parent`].
    #[must_use]
    #[inline]
    pub const fn parent(&self) -> Option<BodyId> {
        if self.form & ATTACHED == 0 {
            return None;
        }
        Some(BodyId::new(self.words[11], self.words[12] as u16))
    }

    /// See [`Track::is_resting`].
    #[must_use]
    #[inline]
    pub const fn is_resting(&self) -> bool {
        self.form & !EXACT == REST
    }

    /// See [`Track::is_exact_rest`].
    #[must_use]
    #[inline]
    pub const fn is_exact_rest(&self) -> bool {
        self.form == EXACT | REST
    }
}

const fn predictor_form(predictor: Predictor) -> u8 {
    match predictor {
        Predictor::Rest => REST,
        Predictor::Uniform => 1,
        Predictor::Ballistic => 2,
        Predictor::TorqueFree => 3,
        Predictor::BallisticTorqueFree => 4,
        Predictor::Accelerated(_) => 5,
    }
}

/// The words of a quantised motion and of its parent or acceleration.
fn on_grid(quantised: &QuantisedState, [index, generation]: [u32; 2]) -> [u32; 13] {
    let [x, y, z] = quantised.position;
    let [low, high] = quantised.rotation.words();
    let ([u, v, w], [p, q, r]) = (quantised.linear, quantised.angular);
    [
        x as u32, y as u32, z as u32, low, high, u as u32, v as u32, w as u32, p as u32, q as u32,
        r as u32, index, generation,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::acceleration::{ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT};
    use crate::quantiser::{POSITION_LIMIT, VELOCITY_LIMIT};
    use glam::DQuat;
    use proptest::prelude::*;

    fn steps(limit: i32) -> impl Strategy<Value = [i32; 3]> {
        proptest::array::uniform3(-limit..=limit)
    }

    fn quantised() -> impl Strategy<Value = QuantisedState> {
        let turn = proptest::array::uniform3(-3.0_f64..3.0);
        let velocity = || steps(VELOCITY_LIMIT);
        (steps(POSITION_LIMIT), turn, velocity(), velocity()).prop_map(
            |(position, turn, linear, angular)| QuantisedState {
                position,
                rotation: PackedRotation::of(DQuat::from_scaled_axis(turn.into())),
                linear,
                angular,
            },
        )
    }

    fn body_state() -> impl Strategy<Value = BodyState> {
        let parts = || proptest::array::uniform3(-1e6_f32..1e6);
        (parts(), 0_usize..4, any::<bool>(), parts(), parts()).prop_map(
            |(position, place, negative, linear, angular)| {
                let mut rotation = [0.0; 4];
                rotation[place] = if negative { -1.0 } else { 1.0 };
                BodyState::new(position, rotation, linear, angular).unwrap()
            },
        )
    }

    /// A predictor that fits its anchor and parent.
    fn track() -> impl Strategy<Value = Track> {
        let parent = (any::<u32>(), any::<u16>()).prop_map(|(i, g)| BodyId::new(i, g));
        let free = || prop::sample::select(&Predictor::ALL[..]);
        let parts = proptest::array::uniform3(-ACCELERATION_LIMIT..=ACCELERATION_LIMIT);
        let accelerated = (parts, 0..=ACCELERATION_EXPONENT_MAX).prop_map(|(steps, exponent)| {
            Predictor::Accelerated(ConstantAcceleration::new(steps, exponent).unwrap())
        });
        let unaccelerated = free().prop_filter("the anchor is exact", |predictor| {
            predictor.acceleration().is_none()
        });
        let framed = || quantised().prop_map(Anchor::Quantised);
        let parts = prop_oneof![
            (prop_oneof![free(), accelerated], framed(), Just(None)),
            (Just(Predictor::Rest), framed(), parent.prop_map(Some)),
            (
                unaccelerated,
                body_state().prop_map(Anchor::Exact),
                Just(None)
            ),
        ];
        (any::<u64>(), parts).prop_map(|(origin, (predictor, anchor, parent))| Track {
            origin: Tick::new(origin),
            predictor,
            anchor,
            parent,
        })
    }

    proptest! {
        #[test]
        fn a_track_is_unpacked_as_it_was_packed(track in track()) {
            let dense = DenseTrack::new(&track);
            prop_assert_eq!(dense.track(), track);
            prop_assert_eq!(dense.is_resting(), track.is_resting());
            prop_assert_eq!(dense.is_exact_rest(), track.is_exact_rest());
        }
    }

    #[test]
    fn a_packed_track_is_small_and_needs_no_alignment() {
        assert_eq!((size_of::<DenseTrack>(), align_of::<DenseTrack>()), (61, 1));
    }
}
