//! Track: the last published motion of a body, the base of all predictions.
//!
//! Publisher and subscriber share this one type. It holds integers or the engine's exact bits: two tracks are equal
//! exactly when all their predictions are (RECKONING 3.1). Tables hold tracks densely: nothing is rounded, and unpacking
//! gives the track that was packed.
//!
//! A pose at rest is sent to the engine's own bits, as a correction of a prediction. Lossless: any pose can be coded, and
//! poses near the prediction are short. A step leads to the neighbouring f32: it is as fine as the number at hand
//! (RECKONING 4.7).

use glam::{DQuat, DVec3};

use crate::exact::{normalised, sqrt};
use crate::free_motion::{RotationCursor, TRACK_AGE_MAX};
use crate::motion::{BodyId, InvalidMotion, Motion, Pose, Twist};
use crate::predictor::{Conditions, ConstantAcceleration, Predictor};
use crate::quantiser::{Grid, OTHERS, PackedRotation, QuantisedState};
use crate::units::{Tick, Ticks};

/// A published motion, its tick, and the predictor that continues it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Track {
    /// Tick of the motion. It grows with each update of a body: it also names the track's revision.
    pub origin: Tick,
    /// Continues the motion.
    pub predictor: Predictor,
    /// The motion.
    pub anchor: Anchor,
    /// The body in whose frame the motion is, and which moves this one; none for the world.
    pub parent: Option<BodyId>,
}

/// A published motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Anchor {
    /// On the stream's grid.
    Quantised(QuantisedState),
    /// The engine's f32 state to the last bit.
    Exact(BodyState),
}

impl Anchor {
    /// The quantised state; `None` for an exact one.
    #[must_use]
    pub const fn quantised(&self) -> Option<QuantisedState> {
        match self {
            Self::Quantised(quantised) => Some(*quantised),
            Self::Exact(_) => None,
        }
    }
}

/// A motion in the engine's own precision, kept as bits so that it can be compared and hashed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BodyState {
    bits: [u32; 13],
}

impl BodyState {
    /// Position, quaternion (x, y, z, w), linear and angular velocity.
    ///
    /// # Errors
    ///
    /// [`InvalidMotion`], as from [`Motion::new`].
    pub fn new(
        position: [f32; 3],
        rotation: [f32; 4],
        linear: [f32; 3],
        angular: [f32; 3],
    ) -> Result<Self, InvalidMotion> {
        let mut bits = [0; 13];
        let parts = position
            .iter()
            .chain(&rotation)
            .chain(&linear)
            .chain(&angular);
        for (slot, part) in bits.iter_mut().zip(parts) {
            *slot = part.to_bits();
        }
        let body_state = Self { bits };
        let (pose, twist) = body_state.raw();
        Motion::new(pose, twist)?;
        Ok(body_state)
    }

    /// The thirteen numbers in the order of [`Self::new`].
    #[must_use]
    #[inline]
    pub fn parts(&self) -> [f32; 13] {
        let mut parts = [0.0; 13];
        for (part, bits) in parts.iter_mut().zip(self.bits) {
            *part = f32::from_bits(bits);
        }
        parts
    }

    /// All bits, in the order of [`Self::new`].
    #[inline]
    const fn bits(&self) -> [u32; 13] {
        self.bits
    }

    /// The state of bits that a checked state gave.
    #[inline]
    const fn from_bits(bits: [u32; 13]) -> Self {
        Self { bits }
    }

    /// Position in the engine's precision, metres.
    #[must_use]
    pub fn position(&self) -> [f32; 3] {
        let p = self.parts();
        [p[0], p[1], p[2]]
    }

    /// The position, and one number more: four, to be read at once.
    #[inline]
    pub(crate) const fn first_parts(&self) -> [f32; 4] {
        let [x, y, z, a, ..] = self.bits;
        [
            f32::from_bits(x),
            f32::from_bits(y),
            f32::from_bits(z),
            f32::from_bits(a),
        ]
    }

    /// Quaternion x, y, z, w in the engine's precision.
    #[must_use]
    #[inline]
    pub const fn rotation(&self) -> [f32; 4] {
        let [_, _, _, x, y, z, w, ..] = self.bits;
        [
            f32::from_bits(x),
            f32::from_bits(y),
            f32::from_bits(z),
            f32::from_bits(w),
        ]
    }

    /// The same pose without movement.
    #[must_use]
    pub fn stilled(mut self) -> Self {
        self.bits[7..].fill(0);
        self
    }

    /// Widened to f64, the rotation not normalised.
    pub(crate) fn raw(&self) -> (Pose, Twist) {
        let p = |place: usize| f64::from(f32::from_bits(self.bits[place]));
        (
            Pose {
                position: DVec3::new(p(0), p(1), p(2)),
                rotation: DQuat::from_xyzw(p(3), p(4), p(5), p(6)),
            },
            Twist {
                linear: DVec3::new(p(7), p(8), p(9)),
                angular: DVec3::new(p(10), p(11), p(12)),
            },
        )
    }

    /// The motion, widened to f64 with its rotation normalised.
    #[must_use]
    pub fn motion(&self) -> Motion {
        let (pose, twist) = self.raw();
        // The constructor has checked it.
        let rotation = normalised(pose.rotation);
        Motion::from_checked(Pose { rotation, ..pose }, twist)
    }
}

impl Track {
    /// A body that rests in the engine's exact pose.
    #[must_use]
    pub fn resting(origin: Tick, body_state: BodyState) -> Self {
        Self {
            origin,
            predictor: Predictor::Rest,
            anchor: Anchor::Exact(body_state.stilled()),
            parent: None,
        }
    }

    /// The published motion.
    #[must_use]
    pub fn start(&self, grid: &Grid) -> Motion {
        match &self.anchor {
            Anchor::Quantised(quantised) => quantised.motion(grid),
            Anchor::Exact(body_state) => body_state.motion(),
        }
    }

    /// The predicted motion at a tick, in the frame of the anchor: the parent's frame if the body has a parent.
    ///
    /// Before the origin it is that of the origin, beyond the horizon that of the horizon.
    /// [`attached_motion`](crate::attached_motion) adds the motion of the parent.
    ///
    /// The gravity of `conditions` is the acceleration of this body from the track's origin on. Their flow is computed
    /// to [`TRACK_AGE_MAX`], or at least to `tick`.
    #[must_use]
    pub fn at(&self, tick: Tick, grid: &Grid, conditions: &Conditions<'_>) -> Motion {
        let start = self.start(grid);
        self.predictor
            .predict(&start, self.elapsed(tick), conditions)
    }

    /// The same bits as [`Self::at`]; results in the body's cursor are not computed again.
    #[must_use]
    pub fn at_with(
        &self,
        tick: Tick,
        grid: &Grid,
        conditions: &Conditions<'_>,
        cursor: &mut RotationCursor,
    ) -> Motion {
        let start = self.start(grid);
        self.predictor
            .predict_with(&start, self.elapsed(tick), conditions, cursor)
    }

    /// Ticks from the origin (RECKONING 3.2).
    #[inline]
    fn elapsed(&self, tick: Tick) -> Ticks {
        elapsed(self.origin, tick)
    }

    /// True if the track predicts rest in the world.
    #[must_use]
    pub fn is_resting(&self) -> bool {
        self.predictor == Predictor::Rest && self.parent.is_none()
    }

    /// True if the copy equals the engine's resting state to the bit.
    #[must_use]
    pub fn is_exact_rest(&self) -> bool {
        self.is_resting() && matches!(self.anchor, Anchor::Exact(_))
    }
}

/// Ticks from an origin to a tick, at most those of the horizon.
#[inline]
pub(crate) fn elapsed(origin: Tick, tick: Tick) -> Ticks {
    match tick.since(origin) {
        Some(ticks) => ticks.min(TRACK_AGE_MAX),
        None if tick > origin => TRACK_AGE_MAX,
        None => Ticks::ZERO,
    }
}

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

    /// Packs a track on its grid in the world frame.
    #[must_use]
    #[inline]
    pub fn on_grid(origin: Tick, predictor: Predictor, quantised: &QuantisedState) -> Self {
        let acceleration = predictor.acceleration();
        let acceleration = acceleration.map_or([0; 2], ConstantAcceleration::words);
        Self {
            words: on_grid(quantised, acceleration),
            origin,
            form: predictor_form(predictor),
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

/// Difference between the f32 of a pose and those of its prediction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct RestCorrection {
    /// True if the quaternion is nearer to the negative of the predicted one.
    pub negated: bool,
    /// Steps of position.
    pub position: [i32; 3],
    /// Steps of the three parts of the quaternion that are not the greatest of the predicted one, in order.
    pub others: [i32; 3],
    /// Steps of that one.
    pub largest: i32,
}

/// A rest correction has fewer steps than this in each number.
const REACH: i64 = 1 << 31;

impl RestCorrection {
    /// The correction that leads from a predicted to a true pose; `None` where they are too far apart.
    #[must_use]
    pub fn of(truth: &BodyState, predicted: &Pose) -> Option<Self> {
        let (position, rotation) = (truth.position(), truth.rotation());
        let expected = predicted.rotation.to_array();
        let place = greatest(expected);
        let negated = (rotation[place] < 0.0) != (expected[place] < 0.0);
        let expected = expected.map(|part| if negated { -part } else { part });
        let parts = OTHERS[place].map(|i| rotation[i]);
        let guess = greatest_of(parts, expected[place]);
        let position_guess = predicted.position.to_array();
        let mut rest_correction = Self {
            negated,
            largest: steps(rotation[place], guess)?,
            ..Self::default()
        };
        for i in 0..3 {
            rest_correction.position[i] = steps(position[i], position_guess[i] as f32)?;
            rest_correction.others[i] = steps(parts[i], expected[OTHERS[place][i]] as f32)?;
        }
        Some(rest_correction)
    }

    /// The pose at rest that this correction makes of a predicted one.
    ///
    /// # Errors
    ///
    /// [`InvalidMotion`] if the result is not a pose.
    pub fn onto(&self, predicted: &Pose) -> Result<BodyState, InvalidMotion> {
        let expected = predicted.rotation.to_array();
        let place = greatest(expected);
        let expected = expected.map(|part| if self.negated { -part } else { part });
        let guess = predicted.position.to_array();
        let position = core::array::from_fn(|i| stepped(guess[i] as f32, self.position[i]));
        let places = OTHERS[place];
        let parts: [f32; 3] =
            core::array::from_fn(|i| stepped(expected[places[i]] as f32, self.others[i]));
        let mut rotation = [0.0; 4];
        for (place, part) in places.into_iter().zip(parts) {
            rotation[place] = part;
        }
        rotation[place] = stepped(greatest_of(parts, expected[place]), self.largest);
        BodyState::new(position, rotation, [0.0; 3], [0.0; 3])
    }
}

/// The place of the part that is greatest in size; the first among equals.
fn greatest(parts: [f64; 4]) -> usize {
    let mut place = 0;
    for i in 1..4 {
        if parts[i].abs() > parts[place].abs() {
            place = i;
        }
    }
    place
}

/// The fourth part of a unit quaternion, from the three others and with the sign of the expected value.
fn greatest_of(parts: [f32; 3], expected: f64) -> f32 {
    let [a, b, c] = parts.map(f64::from);
    let rest = 1.0 - ((a * a + b * b) + c * c);
    // Written so that NaN gives zero too.
    let size = if rest > 0.0 { sqrt(rest) } else { 0.0 };
    (if expected < 0.0 { -size } else { size }) as f32
}

/// The rank of an f32 among all: −0 is −1 and 0 is 0.
const fn rank(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    if bits < 0 { bits ^ i32::MAX } else { bits }
}

/// The number of f32 between two values.
fn steps(to: f32, from: f32) -> Option<i32> {
    let by = i64::from(rank(to)) - i64::from(rank(from));
    (by.abs() < REACH).then_some(by as i32)
}

/// The f32 that is `by` ranks further; it wraps around at the ends.
const fn stepped(from: f32, by: i32) -> f32 {
    let rank = rank(from).wrapping_add(by);
    let bits = if rank < 0 { rank ^ i32::MAX } else { rank };
    f32::from_bits(bits as u32)
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    use super::*;
    use crate::predictor::{ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT};
    use crate::quantiser::{POSITION_LIMIT, VELOCITY_LIMIT};

    #[test]
    fn a_body_state_motion_keeps_every_bit() {
        let body_state =
            BodyState::new([0.1, -0.0, 3e-40], [0.0, 0.0, 0.0, 1.0], [1.0; 3], [2.0; 3]).unwrap();
        assert_eq!(body_state.parts()[1].to_bits(), (-0.0_f32).to_bits());
        assert_eq!(body_state.motion().pose().position.x, f64::from(0.1_f32));
        assert_eq!(body_state.stilled().parts()[7..], [0.0; 6]);
    }

    #[test]
    fn non_finite_states_are_refused() {
        let identity = [0.0, 0.0, 0.0, 1.0];
        let wrong = BodyState::new([f32::NAN, 0.0, 0.0], identity, [0.0; 3], [0.0; 3]);
        assert_eq!(wrong, Err(InvalidMotion::Position));
        let wrong = BodyState::new([0.0; 3], [0.0; 4], [0.0; 3], [0.0; 3]);
        assert_eq!(wrong, Err(InvalidMotion::Rotation));
    }

    #[test]
    fn a_track_stays_small() {
        assert!(size_of::<Track>() <= 80, "{}", size_of::<Track>());
    }

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

    fn pose() -> impl Strategy<Value = Pose> {
        let place = proptest::array::uniform3(-1e5_f64..1e5).prop_map(DVec3::from_array);
        let rotation = proptest::array::uniform4(-1.0_f64..1.0).prop_filter_map("too short", |q| {
            let q = DQuat::from_array(q);
            (q.length() > 0.1).then(|| q.normalize())
        });
        (place, rotation).prop_map(|(position, rotation)| Pose { position, rotation })
    }

    fn resting(pose: &Pose) -> BodyState {
        BodyState::new(
            pose.position.as_vec3().to_array(),
            pose.rotation.to_array().map(|part| part as f32),
            [0.0; 3],
            [0.0; 3],
        )
        .unwrap()
    }

    proptest! {
        #[test]
        fn rest_correction_round_trips(truth in pose(), predicted in pose()) {
            let truth = resting(&truth);
            if let Some(rest_correction) = RestCorrection::of(&truth, &predicted) {
                prop_assert_eq!(rest_correction.onto(&predicted), Ok(truth));
            }
        }

        #[test]
        fn good_predictions_need_small_steps(predicted in pose(), negated in any::<bool>()) {
            let sign = if negated { -1.0 } else { 1.0 };
            let truth = resting(&Pose { rotation: predicted.rotation * sign, ..predicted });
            let rest_correction = RestCorrection::of(&truth, &predicted).unwrap();
            let steps = (rest_correction.negated, rest_correction.position, rest_correction.others);
            prop_assert_eq!(steps, (negated, [0; 3], [0; 3]));
            prop_assert!(rest_correction.largest.abs() <= 1, "{}", rest_correction.largest);
        }
    }

    #[test]
    fn the_sign_of_a_zero_is_a_step() {
        assert_eq!((rank(0.0), rank(-0.0), rank(f32::from_bits(1))), (0, -1, 1));
        assert_eq!(stepped(0.0, -1).to_bits(), (-0.0_f32).to_bits());
    }

    #[test]
    fn invalid_poses_are_refused() {
        let far = RestCorrection {
            position: [rank(f32::INFINITY), 0, 0],
            ..RestCorrection::default()
        };
        let origin = Pose::IDENTITY;
        assert_eq!(far.onto(&origin), Err(InvalidMotion::Position));
        let long = RestCorrection {
            largest: rank(2.0) - rank(1.0),
            ..RestCorrection::default()
        };
        assert_eq!(long.onto(&origin), Err(InvalidMotion::Rotation));
    }
}
