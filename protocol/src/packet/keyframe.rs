//! A keyframe: a whole track in bits that depend on no other track.
//!
//! Scene events, snapshots and refreshes carry tracks in this form, and updates carry what no correction can express
//! (PROTOCOL 5.5). An update encodes a constant acceleration once, with the mode that it belongs to: a correction that
//! keeps the mode does not repeat it (PROTOCOL 5.6).

use rhumb_reckoning::{
    ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT, Anchor, BodyId, BodyState, ConstantAcceleration,
    PackedRotation, Predictor, QuantisedState, Tick, Track,
};

use super::model::Model;
use super::tables::contexts;
use crate::limits::INDICES_MAX;
use crate::wire::Malformed;
use crate::wire::bits::{PutBits, TakeBits, golomb_len};
use crate::wire::range::{RangeReader, RangeWriter};

/// Orders of the Golomb codes for numbers in the range of the world.
const POSITION_ORDER: u32 = 14;
const VELOCITY_ORDER: u32 = 6;

const ACCELERATION_ORDER: u32 = 6;
const ACCELERATION_EXPONENT_BITS: u32 = 4;

/// Bits of a body's index.
pub(super) const INDEX_BITS: u32 = INDICES_MAX.ilog2();
const GENERATION_BITS: u32 = 16;

/// A track without its origin tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Keyframe {
    /// The predictor of the track.
    pub predictor: Predictor,
    /// The motion at the origin.
    pub anchor: Anchor,
    /// The body whose frame the motion is in; None for the world frame.
    pub parent: Option<BodyId>,
}

impl Keyframe {
    /// Upper bound of the bits that a keyframe takes.
    pub(crate) const BITS_MAX: usize = 5 + 36 + 13 * 32 + 3 * 63;

    /// The keyframe of a track.
    #[must_use]
    pub const fn of(track: &Track) -> Self {
        Self {
            predictor: track.predictor,
            anchor: track.anchor,
            parent: track.parent,
        }
    }

    /// The track with this keyframe and origin.
    #[must_use]
    pub const fn track(&self, origin: Tick) -> Track {
        Track {
            origin,
            predictor: self.predictor,
            anchor: self.anchor,
            parent: self.parent,
        }
    }

    /// The number of bits that [`Self::encode`] appends.
    #[must_use]
    pub(crate) fn bit_len(&self) -> usize {
        let moving = self.predictor != Predictor::Rest;
        let mut bits = PREDICTOR_BITS + 2;
        if self.parent.is_some() {
            bits += INDEX_BITS + GENERATION_BITS;
        }
        if let Some(push) = self.predictor.acceleration() {
            bits += ACCELERATION_EXPONENT_BITS
                + signed3_len(push.steps().map(i32::from), ACCELERATION_ORDER);
        }
        bits += match &self.anchor {
            Anchor::Exact(_) if moving => 13 * 32,
            Anchor::Exact(_) => 7 * 32,
            Anchor::Quantised(quantised) => {
                let velocities = signed3_len(quantised.linear, VELOCITY_ORDER)
                    + signed3_len(quantised.angular, VELOCITY_ORDER);
                signed3_len(quantised.position, POSITION_ORDER)
                    + 2
                    + 3 * COMPONENT_BITS
                    + if moving { velocities } else { 0 }
            }
        };
        bits as usize
    }

    /// Appends the predictor, the parent or the acceleration, and the motion.
    pub fn encode(&self, to: &mut impl PutBits) {
        to.bits(predictor_code(self.predictor), PREDICTOR_BITS);
        to.flag(self.parent.is_some());
        if let Some(parent) = self.parent {
            to.bits(parent.index(), INDEX_BITS);
            to.bits(u32::from(parent.generation()), GENERATION_BITS);
        }
        if let Some(push) = self.predictor.acceleration() {
            to.bits(u32::from(push.exponent()), ACCELERATION_EXPONENT_BITS);
            encode3(push.steps().map(i32::from), ACCELERATION_ORDER, to);
        }
        to.flag(matches!(self.anchor, Anchor::Exact(_)));
        let moving = self.predictor != Predictor::Rest;
        match &self.anchor {
            Anchor::Exact(body_state) => {
                let parts = body_state.parts();
                let written = if moving { &parts[..] } else { &parts[..7] };
                for part in written {
                    to.bits(part.to_bits(), 32);
                }
            }
            Anchor::Quantised(quantised) => {
                encode3(quantised.position, POSITION_ORDER, to);
                encode_rotation(quantised.rotation, to);
                if moving {
                    encode3(quantised.linear, VELOCITY_ORDER, to);
                    encode3(quantised.angular, VELOCITY_ORDER, to);
                }
            }
        }
    }

    /// Reads the predictor, the parent or the acceleration, and the motion.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if the motion is not within the limits.
    pub fn decode(from: &mut impl TakeBits) -> Result<Self, Malformed> {
        let predictor = from.bits(PREDICTOR_BITS)?;
        let parent = if from.flag()? {
            let index = from.bits(INDEX_BITS)?;
            Some(BodyId::new(index, from.bits(GENERATION_BITS)? as u16))
        } else {
            None
        };
        let predictor = match predictor {
            ACCELERATED => Predictor::Accelerated(decode_acceleration(from)?),
            _ => predictor_of(predictor)?,
        };
        let moving = predictor != Predictor::Rest;
        let anchor = if from.flag()? {
            Anchor::Exact(decode_body_state(moving, from)?)
        } else {
            Anchor::Quantised(decode_quantised(moving, from)?)
        };
        let held_still = !moving && matches!(anchor, Anchor::Quantised(_));
        let exactly_accelerated =
            predictor.acceleration().is_some() && matches!(anchor, Anchor::Exact(_));
        if exactly_accelerated || parent.is_some() && !held_still {
            return Err(Malformed::OutOfRange);
        }
        Ok(Self {
            predictor,
            anchor,
            parent,
        })
    }
}

/// Bits of a predictor's code.
const PREDICTOR_BITS: u32 = 3;

/// The code of a predictor on the wire.
pub(crate) const fn predictor_code(predictor: Predictor) -> u32 {
    match predictor {
        Predictor::Rest => 0,
        Predictor::Uniform => 1,
        Predictor::Ballistic => 2,
        Predictor::TorqueFree => 3,
        Predictor::BallisticTorqueFree => 4,
        Predictor::Accelerated(_) => ACCELERATED,
    }
}

/// The code of the predictor with constant acceleration; the acceleration follows.
pub(crate) const ACCELERATED: u32 = 5;

/// The predictor of a code, except [`ACCELERATED`], whose predictor also needs the acceleration.
pub(crate) const fn predictor_of(code: u32) -> Result<Predictor, Malformed> {
    match code {
        0 => Ok(Predictor::Rest),
        1 => Ok(Predictor::Uniform),
        2 => Ok(Predictor::Ballistic),
        3 => Ok(Predictor::TorqueFree),
        4 => Ok(Predictor::BallisticTorqueFree),
        _ => Err(Malformed::UnknownCode),
    }
}

fn decode_quantised(moving: bool, from: &mut impl TakeBits) -> Result<QuantisedState, Malformed> {
    let mut quantised = QuantisedState {
        position: decode3(POSITION_ORDER, from)?,
        rotation: decode_rotation(from)?,
        linear: [0; 3],
        angular: [0; 3],
    };
    if moving {
        quantised.linear = decode3(VELOCITY_ORDER, from)?;
        quantised.angular = decode3(VELOCITY_ORDER, from)?;
    }
    if !quantised.is_within_limits() {
        return Err(Malformed::OutOfRange);
    }
    Ok(quantised)
}

fn decode_acceleration(from: &mut impl TakeBits) -> Result<ConstantAcceleration, Malformed> {
    let exponent = from.bits(ACCELERATION_EXPONENT_BITS)? as u8;
    let mut steps = [0; 3];
    for (steps, value) in steps.iter_mut().zip(decode3(ACCELERATION_ORDER, from)?) {
        *steps = i16::try_from(value).map_err(|_| Malformed::OutOfRange)?;
    }
    ConstantAcceleration::new(steps, exponent).ok_or(Malformed::OutOfRange)
}

fn decode_body_state(moving: bool, from: &mut impl TakeBits) -> Result<BodyState, Malformed> {
    let mut parts = [0.0_f32; 13];
    let count = if moving { 13 } else { 7 };
    for part in &mut parts[..count] {
        *part = f32::from_bits(from.bits(32)?);
    }
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = parts;
    BodyState::new([px, py, pz], [x, y, z, w], [vx, vy, vz], [wx, wy, wz])
        .map_err(|_| Malformed::NotFinite)
}

/// A packed component is at most 370,728 in size, so it fits 20 bits with its sign.
const COMPONENT_BITS: u32 = 20;

fn encode_rotation(rotation: PackedRotation, to: &mut impl PutBits) {
    let (largest, others) = rotation.parts();
    to.bits(u32::from(largest), 2);
    for other in others {
        to.bits((other + (1 << (COMPONENT_BITS - 1))) as u32, COMPONENT_BITS);
    }
}

fn decode_rotation(from: &mut impl TakeBits) -> Result<PackedRotation, Malformed> {
    let largest = from.bits(2)? as u8;
    let mut others = [0; 3];
    for other in &mut others {
        *other = from.bits(COMPONENT_BITS)? as i32 - (1 << (COMPONENT_BITS - 1));
    }
    PackedRotation::from_parts(largest, others).ok_or(Malformed::NotCanonical)
}

fn encode3(values: [i32; 3], order: u32, to: &mut impl PutBits) {
    for value in values {
        to.signed_golomb(value, order);
    }
}

fn decode3(order: u32, from: &mut impl TakeBits) -> Result<[i32; 3], Malformed> {
    Ok([
        from.signed_golomb(order)?,
        from.signed_golomb(order)?,
        from.signed_golomb(order)?,
    ])
}

fn signed3_len(values: [i32; 3], order: u32) -> u32 {
    values
        .iter()
        .map(|&value| golomb_len(((value << 1) ^ (value >> 31)) as u32, order))
        .sum()
}

const _: () = assert!(INDICES_MAX.is_power_of_two());

pub(super) fn write_acceleration(
    model: &mut Model,
    push: &ConstantAcceleration,
    to: &mut RangeWriter,
) {
    numbers_of_acceleration(push, |context, number| {
        model.write(context, number.unsigned_abs(), to);
        if number != 0 && context != contexts::ACCELERATION_EXPONENT {
            to.raw(u32::from(number < 0), 1);
        }
    });
}

pub(super) fn read_acceleration(
    model: &mut Model,
    from: &mut RangeReader<'_>,
) -> Result<ConstantAcceleration, Malformed> {
    let exponent = model.read(contexts::ACCELERATION_EXPONENT, from)?;
    let (mut steps, mut sum) = ([0; 3], 0_u64);
    for (part, steps) in steps.iter_mut().enumerate() {
        let size = model.read(contexts::acceleration().context(part, sum), from)?;
        if size > ACCELERATION_LIMIT as u32 {
            return Err(Malformed::OutOfRange);
        }
        let negative = size != 0 && from.bit()?;
        *steps = if negative {
            -(size as i16)
        } else {
            size as i16
        };
        sum += u64::from(size);
    }
    if exponent > u32::from(ACCELERATION_EXPONENT_MAX) {
        return Err(Malformed::OutOfRange);
    }
    ConstantAcceleration::new(steps, exponent as u8).ok_or(Malformed::OutOfRange)
}

/// Calls `emit` for each number in the order on the wire, with its context. The first number has no sign.
pub(super) fn numbers_of_acceleration(
    push: &ConstantAcceleration,
    mut emit: impl FnMut(usize, i32),
) {
    emit(contexts::ACCELERATION_EXPONENT, i32::from(push.exponent()));
    let mut sum = 0_u64;
    for (part, steps) in push.steps().into_iter().enumerate() {
        emit(
            contexts::acceleration().context(part, sum),
            i32::from(steps),
        );
        sum += u64::from(steps.unsigned_abs());
    }
}

/// The longest step of a rest correction, bits.
const STEP_BITS_MAX: u32 = 31;

/// The difference of a length from the expected one, mapped to an unsigned number.
pub(super) const fn zigzag(length: u32, expected: u32) -> u32 {
    if length >= expected {
        (length - expected) * 2
    } else {
        (expected - length) * 2 - 1
    }
}

/// The length that [`zigzag`] encoded as `number`.
pub(super) fn unzigzag(number: u32, expected: u32) -> Result<u32, Malformed> {
    let by = number / 2;
    let length = if number.is_multiple_of(2) {
        expected.checked_add(by)
    } else {
        expected.checked_sub(by + 1)
    };
    length
        .filter(|length| *length <= STEP_BITS_MAX)
        .ok_or(Malformed::OutOfRange)
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;
    use rhumb_reckoning::{POSITION_LIMIT, VELOCITY_LIMIT};

    use super::*;
    use crate::wire::bits::{BitReader, BitWriter};

    pub(crate) fn steps(limit: i32) -> impl Strategy<Value = [i32; 3]> {
        prop_oneof![
            proptest::array::uniform3(-limit..=limit),
            proptest::array::uniform3(-9_i32..=9)
        ]
    }

    fn quantised() -> impl Strategy<Value = QuantisedState> {
        let rotation = proptest::array::uniform4(-1.0_f64..1.0).prop_filter_map("too short", |q| {
            let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
            (length > 0.1).then(|| glam::DQuat::from_array(q.map(|c| c / length)))
        });
        let velocity = || steps(VELOCITY_LIMIT);
        (steps(POSITION_LIMIT), rotation, velocity(), velocity()).prop_map(
            |(position, rotation, linear, angular)| QuantisedState {
                position,
                rotation: PackedRotation::of(rotation),
                linear,
                angular,
            },
        )
    }

    fn body_state() -> impl Strategy<Value = BodyState> {
        (steps(POSITION_LIMIT), quantised()).prop_map(|(position, other)| {
            let float = |values: [i32; 3]| values.map(|v| v as f32 / 1024.0);
            let quaternion = other.rotation.value().to_array().map(|c| c as f32);
            BodyState::new(
                float(position),
                quaternion,
                float(other.linear),
                float(other.angular),
            )
            .unwrap()
        })
    }

    fn parent() -> impl Strategy<Value = BodyId> {
        (0..INDICES_MAX, any::<u16>())
            .prop_map(|(index, generation)| BodyId::new(index, generation))
    }

    pub(crate) fn keyframe() -> impl Strategy<Value = Keyframe> {
        let predictor = prop::sample::select(&Predictor::ALL[..]);
        let predictor_only = predictor
            .clone()
            .prop_filter("an accelerated motion lies on its grid", |predictor| {
                predictor.acceleration().is_none()
            });
        prop_oneof![
            (predictor, quantised()).prop_map(|(predictor, quantised)| Keyframe {
                predictor,
                anchor: Anchor::Quantised(if predictor == Predictor::Rest {
                    quantised.stilled()
                } else {
                    quantised
                }),
                parent: None,
            }),
            (predictor_only, body_state()).prop_map(|(predictor, body_state)| Keyframe {
                predictor,
                anchor: Anchor::Exact(if predictor == Predictor::Rest {
                    body_state.stilled()
                } else {
                    body_state
                }),
                parent: None,
            }),
            (parent(), quantised()).prop_map(|(parent, quantised)| Keyframe {
                predictor: Predictor::Rest,
                anchor: Anchor::Quantised(quantised.stilled()),
                parent: Some(parent),
            }),
        ]
    }

    proptest! {
        #[test]
        fn a_keyframe_round_trips_in_the_announced_bit_length(keyframe in keyframe()) {
            let mut writer = BitWriter::default();
            keyframe.encode(&mut writer);
            prop_assert_eq!(writer.bit_len(), keyframe.bit_len());
            prop_assert!(keyframe.bit_len() <= Keyframe::BITS_MAX);
            let bytes = writer.into_bytes();
            let mut reader = BitReader::new(&bytes);
            prop_assert_eq!(Keyframe::decode(&mut reader), Ok(keyframe));
            prop_assert_eq!(reader.finish(), Ok(()));
        }

        #[test]
        fn decode_then_encode_gives_the_same_bits(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let mut reader = BitReader::new(&bytes);
            if let Ok(keyframe) = Keyframe::decode(&mut reader) {
                let mut writer = BitWriter::default();
                keyframe.encode(&mut writer);
                prop_assert_eq!(writer.bit_len(), reader.position());
                let again = writer.into_bytes();
                let mut reread = BitReader::new(&again);
                prop_assert_eq!(Keyframe::decode(&mut reread), Ok(keyframe));
            }
        }
    }
}
