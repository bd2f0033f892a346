//! What is said of one body: a law, and a motion in one of three forms.
//!
//! Codes are exponential Golomb codes of fixed orders, so that a packet can be read without knowing any track, and a
//! lost one derails nothing (PROTOCOL 5.4).

use rhumb_reckoning::{
    Anchor, HORIZON, POSITION_LIMIT, PackedRotation, Predictor, Residual, Snapped, Tick, Ticks,
    Track, VELOCITY_LIMIT, Verbatim,
};

use crate::wire::Malformed;
use crate::wire::bits::{BitReader, BitWriter, golomb_len};

/// Orders of the Golomb codes, by what they hold. Measured on the ball pit.
mod order {
    pub(super) const AGE: u32 = 3;
    pub(super) const POSITION: u32 = 0;
    pub(super) const TURN: u32 = 0;
    pub(super) const LINEAR: u32 = 2;
    pub(super) const ANGULAR: u32 = 2;
    /// For motions said alone, whose numbers are as large as the world.
    pub(super) const ALONE_POSITION: u32 = 10;
    pub(super) const ALONE_VELOCITY: u32 = 6;
}

/// What an update says of a body, at the tick of its packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Saying {
    /// A correction of what the last track predicts; readable only by who has that track.
    Residual {
        /// The new law.
        predictor: Predictor,
        /// Ticks since the origin of the track that this builds on: names its revision.
        age: Ticks,
        /// The correction.
        residual: Residual,
    },
    /// A whole motion, readable by all.
    Whole(TrackSaying),
}

/// A law and a whole motion, without its tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrackSaying {
    /// How the body goes on.
    pub predictor: Predictor,
    /// From which motion.
    pub anchor: Anchor,
}

impl TrackSaying {
    /// What says this track again.
    #[must_use]
    pub const fn of(track: &Track) -> Self {
        Self {
            predictor: track.predictor,
            anchor: track.anchor,
        }
    }

    /// The track that this says.
    #[must_use]
    pub const fn track(&self, origin: Tick) -> Track {
        Track {
            origin,
            predictor: self.predictor,
            anchor: self.anchor,
        }
    }

    /// Appends the law, the form and the motion.
    pub fn encode(&self, to: &mut BitWriter) {
        encode_predictor(self.predictor, to);
        to.flag(matches!(self.anchor, Anchor::Verbatim(_)));
        encode_anchor(&self.anchor, self.predictor, to);
    }

    /// Takes the law, the form and the motion.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for what is no motion within the limits.
    pub fn decode(from: &mut BitReader<'_>) -> Result<Self, Malformed> {
        let predictor = decode_predictor(from)?;
        let verbatim = from.flag()?;
        decode_anchor(predictor, verbatim, from)
    }
}

impl Saying {
    /// Most bits that a saying takes: a residual whose every number is at its limit.
    pub const MAX_BITS: usize = 3 + 18 + 3 * 63 + 3 * 23 + 6 * 49;

    /// How many bits [`Self::encode`] appends.
    #[must_use]
    pub fn bit_len(&self) -> usize {
        match self {
            Self::Residual {
                predictor,
                age,
                residual,
            } => {
                let mut bits = 3 + golomb_len(age.count(), order::AGE);
                bits += signed3_len(residual.position, order::POSITION);
                bits += signed3_len(residual.turn, order::TURN);
                if *predictor != Predictor::Rest {
                    bits += signed3_len(residual.linear, order::LINEAR);
                    bits += signed3_len(residual.angular, order::ANGULAR);
                }
                bits as usize
            }
            Self::Whole(whole) => {
                let moving = whole.predictor != Predictor::Rest;
                match &whole.anchor {
                    Anchor::Verbatim(_) => 4 + 7 * 32 + if moving { 6 * 32 } else { 0 },
                    Anchor::Snapped(snapped) => {
                        let mut bits =
                            4 + 62 + signed3_len(snapped.position, order::ALONE_POSITION);
                        if moving {
                            bits += signed3_len(snapped.linear, order::ALONE_VELOCITY);
                            bits += signed3_len(snapped.angular, order::ALONE_VELOCITY);
                        }
                        bits as usize
                    }
                }
            }
        }
    }

    /// Appends the saying.
    pub fn encode(&self, to: &mut BitWriter) {
        match self {
            Self::Residual {
                predictor,
                age,
                residual,
            } => {
                encode_predictor(*predictor, to);
                to.flag(false);
                to.golomb(age.count(), order::AGE);
                encode3(residual.position, order::POSITION, to);
                encode3(residual.turn, order::TURN, to);
                if *predictor != Predictor::Rest {
                    encode3(residual.linear, order::LINEAR, to);
                    encode3(residual.angular, order::ANGULAR, to);
                }
            }
            Self::Whole(TrackSaying { predictor, anchor }) => {
                encode_predictor(*predictor, to);
                to.flag(true);
                to.flag(matches!(anchor, Anchor::Verbatim(_)));
                encode_anchor(anchor, *predictor, to);
            }
        }
    }

    /// Takes a saying.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for what is no saying within the limits.
    pub fn decode(from: &mut BitReader<'_>) -> Result<Self, Malformed> {
        let predictor = decode_predictor(from)?;
        if from.flag()? {
            let verbatim = from.flag()?;
            return decode_anchor(predictor, verbatim, from).map(Self::Whole);
        }
        let age = Ticks::new(from.golomb(order::AGE)?);
        if age == Ticks::ZERO {
            return Err(Malformed::OutOfRange);
        }
        let mut residual = Residual {
            position: decode3(order::POSITION, from)?,
            turn: decode3(order::TURN, from)?,
            ..Residual::default()
        };
        if predictor != Predictor::Rest {
            residual.linear = decode3(order::LINEAR, from)?;
            residual.angular = decode3(order::ANGULAR, from)?;
        }
        if !residual.is_within_limits() {
            return Err(Malformed::OutOfRange);
        }
        Ok(Self::Residual {
            predictor,
            age,
            residual,
        })
    }
}

fn encode_predictor(predictor: Predictor, to: &mut BitWriter) {
    to.bits(
        match predictor {
            Predictor::Rest => 0,
            Predictor::Uniform => 1,
            Predictor::Ballistic => 2,
        },
        2,
    );
}

fn decode_predictor(from: &mut BitReader<'_>) -> Result<Predictor, Malformed> {
    match from.bits(2)? {
        0 => Ok(Predictor::Rest),
        1 => Ok(Predictor::Uniform),
        2 => Ok(Predictor::Ballistic),
        _ => Err(Malformed::UnknownCode),
    }
}

fn encode_anchor(anchor: &Anchor, predictor: Predictor, to: &mut BitWriter) {
    let moving = predictor != Predictor::Rest;
    match anchor {
        Anchor::Verbatim(verbatim) => {
            let parts = verbatim.parts();
            let said = if moving { &parts[..] } else { &parts[..7] };
            for part in said {
                to.bits(part.to_bits(), 32);
            }
        }
        Anchor::Snapped(snapped) => {
            encode3(snapped.position, order::ALONE_POSITION, to);
            encode_rotation(snapped.rotation, to);
            if moving {
                encode3(snapped.linear, order::ALONE_VELOCITY, to);
                encode3(snapped.angular, order::ALONE_VELOCITY, to);
            }
        }
    }
}

fn decode_anchor(
    predictor: Predictor,
    verbatim: bool,
    from: &mut BitReader<'_>,
) -> Result<TrackSaying, Malformed> {
    let moving = predictor != Predictor::Rest;
    let anchor = if verbatim {
        Anchor::Verbatim(decode_verbatim(moving, from)?)
    } else {
        let mut snapped = Snapped {
            position: decode3(order::ALONE_POSITION, from)?,
            rotation: decode_rotation(from)?,
            linear: [0; 3],
            angular: [0; 3],
        };
        if moving {
            snapped.linear = decode3(order::ALONE_VELOCITY, from)?;
            snapped.angular = decode3(order::ALONE_VELOCITY, from)?;
        }
        if !snapped.is_within_limits() {
            return Err(Malformed::OutOfRange);
        }
        Anchor::Snapped(snapped)
    };
    Ok(TrackSaying { predictor, anchor })
}

fn decode_verbatim(moving: bool, from: &mut BitReader<'_>) -> Result<Verbatim, Malformed> {
    let mut parts = [0.0_f32; 13];
    let said = if moving { 13 } else { 7 };
    for part in &mut parts[..said] {
        *part = f32::from_bits(from.bits(32)?);
    }
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = parts;
    Verbatim::new([px, py, pz], [x, y, z, w], [vx, vy, vz], [wx, wy, wz])
        .map_err(|_| Malformed::NotFinite)
}

/// A packed component is at most 370,728 in size and so fits 20 bits with its sign.
const COMPONENT_BITS: u32 = 20;

fn encode_rotation(rotation: PackedRotation, to: &mut BitWriter) {
    let (largest, others) = rotation.parts();
    to.bits(u32::from(largest), 2);
    for other in others {
        to.bits((other + (1 << (COMPONENT_BITS - 1))) as u32, COMPONENT_BITS);
    }
}

fn decode_rotation(from: &mut BitReader<'_>) -> Result<PackedRotation, Malformed> {
    let largest = from.bits(2)? as u8;
    let mut others = [0; 3];
    for other in &mut others {
        *other = from.bits(COMPONENT_BITS)? as i32 - (1 << (COMPONENT_BITS - 1));
    }
    PackedRotation::from_parts(largest, others).ok_or(Malformed::NotCanonical)
}

fn encode3(values: [i32; 3], order: u32, to: &mut BitWriter) {
    for value in values {
        to.signed_golomb(value, order);
    }
}

fn decode3(order: u32, from: &mut BitReader<'_>) -> Result<[i32; 3], Malformed> {
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

// The longest codes: every residual within its limit can be written, and an age within the horizon.
const _: () = assert!((POSITION_LIMIT as u32) * 2 < crate::wire::bits::GOLOMB_MAX);
const _: () = assert!(VELOCITY_LIMIT < POSITION_LIMIT);
const _: () = assert!(HORIZON.count() < 1 << 10);

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    pub(crate) fn predictor() -> impl Strategy<Value = Predictor> {
        prop_oneof![
            Just(Predictor::Rest),
            Just(Predictor::Uniform),
            Just(Predictor::Ballistic)
        ]
    }

    fn steps(limit: i32) -> impl Strategy<Value = [i32; 3]> {
        prop_oneof![
            proptest::array::uniform3(-limit..=limit),
            proptest::array::uniform3(-9_i32..=9)
        ]
    }

    fn whole() -> impl Strategy<Value = TrackSaying> {
        let rotation = proptest::array::uniform4(-1.0_f64..1.0).prop_filter_map("too short", |q| {
            let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
            (length > 0.1).then(|| glam::DQuat::from_array(q.map(|c| c / length)))
        });
        let velocity = || steps(VELOCITY_LIMIT);
        (
            predictor(),
            any::<bool>(),
            steps(POSITION_LIMIT),
            rotation,
            velocity(),
            velocity(),
        )
            .prop_map(
                |(predictor, verbatim, position, rotation, linear, angular)| {
                    let anchor = if verbatim {
                        let float = |values: [i32; 3]| values.map(|v| v as f32 / 1024.0);
                        let quaternion = rotation.to_array().map(|c| c as f32);
                        let whole = Verbatim::new(
                            float(position),
                            quaternion,
                            float(linear),
                            float(angular),
                        )
                        .unwrap();
                        Anchor::Verbatim(if predictor == Predictor::Rest {
                            whole.stilled()
                        } else {
                            whole
                        })
                    } else {
                        let rotation = PackedRotation::of(rotation);
                        let snapped = Snapped {
                            position,
                            rotation,
                            linear,
                            angular,
                        };
                        Anchor::Snapped(if predictor == Predictor::Rest {
                            snapped.stilled()
                        } else {
                            snapped
                        })
                    };
                    TrackSaying { predictor, anchor }
                },
            )
    }

    pub(crate) fn saying() -> impl Strategy<Value = Saying> {
        let turn = steps(rhumb_reckoning::TURN_LIMIT);
        let residual = (
            steps(POSITION_LIMIT),
            turn,
            steps(VELOCITY_LIMIT),
            steps(VELOCITY_LIMIT),
        );
        prop_oneof![
            whole().prop_map(Saying::Whole),
            (predictor(), 1_u32..=HORIZON.count(), residual).prop_map(
                |(predictor, age, (position, turn, linear, angular))| {
                    let rest = predictor == Predictor::Rest;
                    Saying::Residual {
                        predictor,
                        age: Ticks::new(age),
                        residual: Residual {
                            position,
                            turn,
                            linear: if rest { [0; 3] } else { linear },
                            angular: if rest { [0; 3] } else { angular },
                        },
                    }
                }
            ),
        ]
    }

    proptest! {
        #[test]
        fn a_saying_comes_back_in_as_many_bits_as_announced(saying in saying()) {
            let mut writer = BitWriter::default();
            saying.encode(&mut writer);
            prop_assert_eq!(writer.bit_len(), saying.bit_len());
            prop_assert!(saying.bit_len() <= Saying::MAX_BITS);
            let bytes = writer.into_bytes();
            let mut reader = BitReader::new(&bytes);
            prop_assert_eq!(Saying::decode(&mut reader), Ok(saying));
            prop_assert_eq!(reader.finish(), Ok(()));
        }

        #[test]
        fn what_decodes_encodes_to_the_same_bits(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let mut reader = BitReader::new(&bytes);
            if let Ok(saying) = Saying::decode(&mut reader) {
                let mut writer = BitWriter::default();
                saying.encode(&mut writer);
                prop_assert_eq!(writer.bit_len(), reader.position());
                let again = writer.into_bytes();
                let mut reread = BitReader::new(&again);
                prop_assert_eq!(Saying::decode(&mut reread), Ok(saying));
            }
        }
    }
}
