//! A whole track, in bits that can be read without knowing any other.
//!
//! Notices, snapshots and repairs say tracks so, and packets what cannot be said as a correction (PROTOCOL 5.5).

use rhumb_reckoning::{
    Anchor, BodyId, PackedRotation, Predictor, Push, Snapped, Tick, Track, Verbatim,
};

use crate::limits::INDICES_MAX;
use crate::wire::Malformed;
use crate::wire::bits::{PutBits, TakeBits, golomb_len};

/// Orders of the Golomb codes of numbers that are as large as the world.
const POSITION_ORDER: u32 = 14;
const VELOCITY_ORDER: u32 = 6;

const PUSH_ORDER: u32 = 6;
const DOUBLINGS_BITS: u32 = 4;

/// Bits of a body's index and of its generation.
const INDEX_BITS: u32 = INDICES_MAX.ilog2();
const GENERATION_BITS: u32 = 16;

/// A track without its tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TrackSaying {
    /// How the body goes on.
    pub predictor: Predictor,
    /// From which motion.
    pub anchor: Anchor,
    /// In whose frame.
    pub carrier: Option<BodyId>,
}

impl TrackSaying {
    /// Most bits that a saying takes.
    pub(crate) const BITS_MAX: usize = 5 + 36 + 13 * 32 + 3 * 63;

    /// What says this track again.
    #[must_use]
    pub const fn of(track: &Track) -> Self {
        Self {
            predictor: track.predictor,
            anchor: track.anchor,
            carrier: track.carrier,
        }
    }

    /// The track that this says.
    #[must_use]
    pub const fn track(&self, origin: Tick) -> Track {
        Track {
            origin,
            predictor: self.predictor,
            anchor: self.anchor,
            carrier: self.carrier,
        }
    }

    /// How many bits [`Self::encode`] appends.
    #[must_use]
    pub fn bit_len(&self) -> usize {
        let moving = self.predictor != Predictor::Rest;
        let mut bits = LAW_BITS + 2;
        if self.carrier.is_some() {
            bits += INDEX_BITS + GENERATION_BITS;
        }
        if let Some(push) = self.predictor.push() {
            bits += DOUBLINGS_BITS + signed3_len(push.steps().map(i32::from), PUSH_ORDER);
        }
        bits += match &self.anchor {
            Anchor::Verbatim(_) if moving => 13 * 32,
            Anchor::Verbatim(_) => 7 * 32,
            Anchor::Snapped(snapped) => {
                let velocities = signed3_len(snapped.linear, VELOCITY_ORDER)
                    + signed3_len(snapped.angular, VELOCITY_ORDER);
                signed3_len(snapped.position, POSITION_ORDER)
                    + 2
                    + 3 * COMPONENT_BITS
                    + if moving { velocities } else { 0 }
            }
        };
        bits as usize
    }

    /// Appends the law, the carrier or the push, and the motion.
    pub fn encode(&self, to: &mut impl PutBits) {
        to.bits(law_code(self.predictor), LAW_BITS);
        to.flag(self.carrier.is_some());
        if let Some(carrier) = self.carrier {
            to.bits(carrier.index(), INDEX_BITS);
            to.bits(u32::from(carrier.generation()), GENERATION_BITS);
        }
        if let Some(push) = self.predictor.push() {
            to.bits(u32::from(push.doublings()), DOUBLINGS_BITS);
            encode3(push.steps().map(i32::from), PUSH_ORDER, to);
        }
        to.flag(matches!(self.anchor, Anchor::Verbatim(_)));
        let moving = self.predictor != Predictor::Rest;
        match &self.anchor {
            Anchor::Verbatim(verbatim) => {
                let parts = verbatim.parts();
                let said = if moving { &parts[..] } else { &parts[..7] };
                for part in said {
                    to.bits(part.to_bits(), 32);
                }
            }
            Anchor::Snapped(snapped) => {
                encode3(snapped.position, POSITION_ORDER, to);
                encode_rotation(snapped.rotation, to);
                if moving {
                    encode3(snapped.linear, VELOCITY_ORDER, to);
                    encode3(snapped.angular, VELOCITY_ORDER, to);
                }
            }
        }
    }

    /// Takes the law, the carrier or the push, and the motion.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for what is no motion within the limits.
    pub fn decode(from: &mut impl TakeBits) -> Result<Self, Malformed> {
        let law = from.bits(LAW_BITS)?;
        let carrier = if from.flag()? {
            let index = from.bits(INDEX_BITS)?;
            Some(BodyId::new(index, from.bits(GENERATION_BITS)? as u16))
        } else {
            None
        };
        let predictor = match law {
            PUSHED => Predictor::Pushed(decode_push(from)?),
            _ => law_of(law)?,
        };
        let moving = predictor != Predictor::Rest;
        let anchor = if from.flag()? {
            Anchor::Verbatim(decode_verbatim(moving, from)?)
        } else {
            Anchor::Snapped(decode_snapped(moving, from)?)
        };
        let held_still = !moving && matches!(anchor, Anchor::Snapped(_));
        let exactly_pushed = predictor.push().is_some() && matches!(anchor, Anchor::Verbatim(_));
        if exactly_pushed || carrier.is_some() && !held_still {
            return Err(Malformed::OutOfRange);
        }
        Ok(Self {
            predictor,
            anchor,
            carrier,
        })
    }
}

/// Bits of a law's code.
const LAW_BITS: u32 = 3;

/// The code of a law on the wire.
pub(crate) const fn law_code(predictor: Predictor) -> u32 {
    match predictor {
        Predictor::Rest => 0,
        Predictor::Uniform => 1,
        Predictor::Ballistic => 2,
        Predictor::Tumbling => 3,
        Predictor::Thrown => 4,
        Predictor::Pushed(_) => PUSHED,
    }
}

/// The code of the law that is said with a push.
pub(crate) const PUSHED: u32 = 5;

/// The law of a code, but for [`PUSHED`]: that one is more than its code.
pub(crate) const fn law_of(code: u32) -> Result<Predictor, Malformed> {
    match code {
        0 => Ok(Predictor::Rest),
        1 => Ok(Predictor::Uniform),
        2 => Ok(Predictor::Ballistic),
        3 => Ok(Predictor::Tumbling),
        4 => Ok(Predictor::Thrown),
        _ => Err(Malformed::UnknownCode),
    }
}

fn decode_snapped(moving: bool, from: &mut impl TakeBits) -> Result<Snapped, Malformed> {
    let mut snapped = Snapped {
        position: decode3(POSITION_ORDER, from)?,
        rotation: decode_rotation(from)?,
        linear: [0; 3],
        angular: [0; 3],
    };
    if moving {
        snapped.linear = decode3(VELOCITY_ORDER, from)?;
        snapped.angular = decode3(VELOCITY_ORDER, from)?;
    }
    if !snapped.is_within_limits() {
        return Err(Malformed::OutOfRange);
    }
    Ok(snapped)
}

fn decode_push(from: &mut impl TakeBits) -> Result<Push, Malformed> {
    let doublings = from.bits(DOUBLINGS_BITS)? as u8;
    let mut steps = [0; 3];
    for (steps, said) in steps.iter_mut().zip(decode3(PUSH_ORDER, from)?) {
        *steps = i16::try_from(said).map_err(|_| Malformed::OutOfRange)?;
    }
    Push::new(steps, doublings).ok_or(Malformed::OutOfRange)
}

fn decode_verbatim(moving: bool, from: &mut impl TakeBits) -> Result<Verbatim, Malformed> {
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

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::wire::bits::{BitReader, BitWriter};
    use proptest::prelude::*;
    use rhumb_reckoning::{POSITION_LIMIT, VELOCITY_LIMIT};

    pub(crate) fn steps(limit: i32) -> impl Strategy<Value = [i32; 3]> {
        prop_oneof![
            proptest::array::uniform3(-limit..=limit),
            proptest::array::uniform3(-9_i32..=9)
        ]
    }

    fn snapped() -> impl Strategy<Value = Snapped> {
        let rotation = proptest::array::uniform4(-1.0_f64..1.0).prop_filter_map("too short", |q| {
            let length = q.iter().map(|c| c * c).sum::<f64>().sqrt();
            (length > 0.1).then(|| glam::DQuat::from_array(q.map(|c| c / length)))
        });
        let velocity = || steps(VELOCITY_LIMIT);
        (steps(POSITION_LIMIT), rotation, velocity(), velocity()).prop_map(
            |(position, rotation, linear, angular)| Snapped {
                position,
                rotation: PackedRotation::of(rotation),
                linear,
                angular,
            },
        )
    }

    fn verbatim() -> impl Strategy<Value = Verbatim> {
        (steps(POSITION_LIMIT), snapped()).prop_map(|(position, other)| {
            let float = |values: [i32; 3]| values.map(|v| v as f32 / 1024.0);
            let quaternion = other.rotation.value().to_array().map(|c| c as f32);
            Verbatim::new(
                float(position),
                quaternion,
                float(other.linear),
                float(other.angular),
            )
            .unwrap()
        })
    }

    fn carrier() -> impl Strategy<Value = BodyId> {
        (0..INDICES_MAX, any::<u16>())
            .prop_map(|(index, generation)| BodyId::new(index, generation))
    }

    pub(crate) fn whole() -> impl Strategy<Value = TrackSaying> {
        let law = prop::sample::select(&Predictor::ALL[..]);
        let said_alone = law
            .clone()
            .prop_filter("what is pushed lies on its grid", |law| {
                law.push().is_none()
            });
        prop_oneof![
            (law, snapped()).prop_map(|(predictor, snapped)| TrackSaying {
                predictor,
                anchor: Anchor::Snapped(if predictor == Predictor::Rest {
                    snapped.stilled()
                } else {
                    snapped
                }),
                carrier: None,
            }),
            (said_alone, verbatim()).prop_map(|(predictor, verbatim)| TrackSaying {
                predictor,
                anchor: Anchor::Verbatim(if predictor == Predictor::Rest {
                    verbatim.stilled()
                } else {
                    verbatim
                }),
                carrier: None,
            }),
            (carrier(), snapped()).prop_map(|(carrier, snapped)| TrackSaying {
                predictor: Predictor::Rest,
                anchor: Anchor::Snapped(snapped.stilled()),
                carrier: Some(carrier),
            }),
        ]
    }

    proptest! {
        #[test]
        fn a_track_comes_back_in_as_many_bits_as_announced(whole in whole()) {
            let mut writer = BitWriter::default();
            whole.encode(&mut writer);
            prop_assert_eq!(writer.bit_len(), whole.bit_len());
            prop_assert!(whole.bit_len() <= TrackSaying::BITS_MAX);
            let bytes = writer.into_bytes();
            let mut reader = BitReader::new(&bytes);
            prop_assert_eq!(TrackSaying::decode(&mut reader), Ok(whole));
            prop_assert_eq!(reader.finish(), Ok(()));
        }

        #[test]
        fn what_decodes_encodes_to_the_same_bits(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let mut reader = BitReader::new(&bytes);
            if let Ok(whole) = TrackSaying::decode(&mut reader) {
                let mut writer = BitWriter::default();
                whole.encode(&mut writer);
                prop_assert_eq!(writer.bit_len(), reader.position());
                let again = writer.into_bytes();
                let mut reread = BitReader::new(&again);
                prop_assert_eq!(TrackSaying::decode(&mut reread), Ok(whole));
            }
        }
    }
}
