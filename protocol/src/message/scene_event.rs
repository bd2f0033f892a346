//! Scene events: changes of a scene that every member must know.
//!
//! A scene event is encoded once for all members and counted by both ends; each state packet tells the count that it
//! needs. A body's inertia is omitted where it is implied: equal moments, and axes that are the body's own (PROTOCOL
//! 4.6).

use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{Anchor, BodyId, BodyState, Inertia, Predictor, Tick, Track};

use super::request::{decode_bodies, encode_bodies};
use crate::limits::INDICES_MAX;
use crate::packet::{Keyframe, predictor_code, predictor_of};
use crate::scene::{BodyDesc, Joint, JointId, Shape, ShapeId};
use crate::wire::bits::{BitReader, BitWriter};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, OPTIONAL, Wire};

/// Reason of a body's removal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RemovalCause {
    /// A member removed it.
    Command,
    /// It left the world's bounds.
    LeftWorld,
    /// Its state was no longer finite.
    NotFinite,
}

/// Reason why a scene stopped after its engine failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FaultCause {
    /// The server keeps no earlier state of the scene.
    NoWayBack,
    /// The engine fails again from each earlier state, whatever commands are left out.
    FailedAgain,
    /// The scene was restored as often as the server allows.
    TooOften,
}

/// One change of a scene, sent to all members.
#[derive(Clone, Debug, PartialEq)]
pub enum SceneEvent {
    /// A shape was added.
    ShapeAdded {
        /// Its id.
        id: ShapeId,
        /// The shape.
        shape: Shape,
    },
    /// A shape was removed.
    ShapeRemoved {
        /// Its id.
        id: ShapeId,
    },
    /// A body was added.
    BodyPlaced {
        /// Its description.
        desc: BodyDesc,
        /// Its moments of inertia, if it rotates freely and they are not equal.
        inertia: Option<Inertia>,
        /// Its track.
        track: Track,
        /// Its alias in the stream, if it has one.
        alias: Option<u32>,
    },
    /// A body was removed.
    BodyRemoved {
        /// The body.
        id: BodyId,
        /// The reason.
        cause: RemovalCause,
    },
    /// Gravity changed.
    GravityChanged {
        /// First tick of the new gravity.
        since: Tick,
        /// m/s², world frame.
        gravity: Vec3,
    },
    /// The engine failed; the scene has stopped.
    SceneFaulted {
        /// The last complete tick.
        tick: Tick,
        /// The reason why the scene was not restored.
        cause: FaultCause,
    },
    /// The engine failed, and the scene continues without the commands that are refused for it.
    SceneRestored {
        /// The tick from which the scene continues.
        tick: Tick,
    },
    /// A joint was added.
    JointAdded {
        /// Its id.
        id: JointId,
        /// The joint.
        joint: Joint,
    },
    /// A joint was removed. Not sent for a joint that goes with a body.
    JointRemoved {
        /// Its id.
        id: JointId,
    },
    /// Nothing arrives from a member with authority: the poses of its bodies are guesses.
    PublisherSilent {
        /// The first tick that it has not confirmed.
        since: Tick,
        /// The bodies, in rising order.
        bodies: Vec<BodyId>,
    },
    /// It is active again, or its authority has ended.
    PublisherActive {
        /// The tick from which on the poses are no guesses.
        tick: Tick,
        /// The bodies, in rising order.
        bodies: Vec<BodyId>,
    },
    /// An event of a later version that changes nothing for this one. It counts like any other.
    Unknown {
        /// From [`OPTIONAL`] on.
        code: u8,
        /// The remaining bytes, unchanged.
        fields: Vec<u8>,
    },
}

impl Wire for FaultCause {
    fn encode(&self, to: &mut Writer) {
        to.u8(match self {
            Self::NoWayBack => 0,
            Self::FailedAgain => 1,
            Self::TooOften => 2,
        });
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            0 => Self::NoWayBack,
            1 => Self::FailedAgain,
            2 => Self::TooOften,
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

/// The code of a body that is placed.
pub(super) const BODY_PLACED: u8 = 2;
const PUBLISHER_SILENT: u8 = OPTIONAL;
const PUBLISHER_ACTIVE: u8 = OPTIONAL + 1;

impl Wire for SceneEvent {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::ShapeAdded { id, shape } => {
                to.u8(0);
                id.encode(to);
                shape.encode(to);
            }
            Self::ShapeRemoved { id } => {
                to.u8(1);
                id.encode(to);
            }
            Self::BodyPlaced {
                desc,
                inertia,
                track,
                alias,
            } => {
                to.u8(BODY_PLACED);
                desc.encode(to);
                if desc.can_tumble() {
                    encode_inertia(inertia.as_ref(), to);
                }
                track.encode(to);
                to.varint(alias.map_or(0, |alias| u64::from(alias) + 1));
            }
            Self::BodyRemoved { id, cause } => {
                to.u8(3);
                id.encode(to);
                to.u8(match cause {
                    RemovalCause::Command => 0,
                    RemovalCause::LeftWorld => 1,
                    RemovalCause::NotFinite => 2,
                });
            }
            Self::GravityChanged { since, gravity } => {
                to.u8(4);
                to.varint(since.value());
                to.f32s(&gravity.to_array());
            }
            Self::SceneFaulted { tick, cause } => {
                to.u8(5);
                to.varint(tick.value());
                cause.encode(to);
            }
            Self::SceneRestored { tick } => {
                to.u8(8);
                to.varint(tick.value());
            }
            Self::JointAdded { id, joint } => {
                to.u8(6);
                id.encode(to);
                joint.encode(to);
            }
            Self::JointRemoved { id } => {
                to.u8(7);
                id.encode(to);
            }
            Self::PublisherSilent { since, bodies } => {
                encode_publisher(PUBLISHER_SILENT, *since, bodies, to);
            }
            Self::PublisherActive { tick, bodies } => {
                encode_publisher(PUBLISHER_ACTIVE, *tick, bodies, to);
            }
            Self::Unknown { code, fields } => {
                to.u8(*code);
                to.raw(fields);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            0 => {
                let id = ShapeId::decode(from)?;
                let shape = Shape::decode(from)?;
                shape.check().map_err(|_| Malformed::OutOfRange)?;
                Self::ShapeAdded { id, shape }
            }
            1 => Self::ShapeRemoved {
                id: ShapeId::decode(from)?,
            },
            BODY_PLACED => {
                let desc = BodyDesc::decode(from)?;
                desc.check().map_err(|_| Malformed::OutOfRange)?;
                let inertia = if desc.can_tumble() {
                    decode_inertia(from)?
                } else {
                    None
                };
                Self::BodyPlaced {
                    desc,
                    inertia,
                    track: Track::decode(from)?,
                    alias: (from.varint_to(u64::from(INDICES_MAX))? as u32).checked_sub(1),
                }
            }
            3 => Self::BodyRemoved {
                id: BodyId::decode(from)?,
                cause: match from.u8()? {
                    0 => RemovalCause::Command,
                    1 => RemovalCause::LeftWorld,
                    2 => RemovalCause::NotFinite,
                    _ => return Err(Malformed::UnknownCode),
                },
            },
            4 => {
                let since = Tick::new(from.count()?);
                let gravity = Vec3::from_array(from.f32s()?);
                if !gravity.is_finite() {
                    return Err(Malformed::NotFinite);
                }
                Self::GravityChanged { since, gravity }
            }
            5 => Self::SceneFaulted {
                tick: Tick::new(from.count()?),
                cause: FaultCause::decode(from)?,
            },
            8 => Self::SceneRestored {
                tick: Tick::new(from.count()?),
            },
            6 => {
                let id = JointId::decode(from)?;
                let joint = Joint::decode(from)?;
                joint.check().map_err(|_| Malformed::OutOfRange)?;
                Self::JointAdded { id, joint }
            }
            7 => Self::JointRemoved {
                id: JointId::decode(from)?,
            },
            code @ (PUBLISHER_SILENT | PUBLISHER_ACTIVE) => decode_publisher(code, from)?,
            code @ OPTIONAL.. => Self::Unknown {
                code,
                fields: from.raw(from.rest().len())?.to_vec(),
            },
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

fn encode_publisher(code: u8, tick: Tick, bodies: &[BodyId], to: &mut Writer) {
    to.u8(code);
    to.varint(tick.value());
    encode_bodies(bodies, to);
}

fn decode_publisher(code: u8, from: &mut Reader<'_>) -> Result<SceneEvent, Malformed> {
    let (tick, bodies) = (Tick::new(from.count()?), decode_bodies(from)?);
    Ok(match code {
        PUBLISHER_SILENT => SceneEvent::PublisherSilent {
            since: tick,
            bodies,
        },
        _ => SceneEvent::PublisherActive { tick, bodies },
    })
}

/// Bit of a track's first byte for an exact anchor; the predictor is in the bits below.
const EXACT: u8 = 1 << 3;

impl Wire for Track {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.origin.value());
        match &self.anchor {
            Anchor::Exact(body_state) => {
                to.u8(predictor_code(self.predictor) as u8 | EXACT);
                body_state.encode(to);
            }
            Anchor::Quantised(_) => {
                to.u8(0);
                let mut bits = BitWriter::default();
                Keyframe::of(self).encode(&mut bits);
                to.sized(&bits.into_bytes());
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let origin = Tick::new(from.count()?);
        let first = from.u8()?;
        if first & EXACT == 0 {
            return decode_quantised(origin, first, from);
        }
        let predictor = predictor_of(u32::from(first & !EXACT))?;
        let body_state = BodyState::decode(from)?;
        if predictor == Predictor::Rest && body_state != body_state.stilled() {
            return Err(Malformed::NotCanonical);
        }
        Ok(Self {
            origin,
            predictor,
            anchor: Anchor::Exact(body_state),
            parent: None,
        })
    }
}

fn decode_quantised(origin: Tick, first: u8, from: &mut Reader<'_>) -> Result<Track, Malformed> {
    if first != 0 {
        return Err(Malformed::UnknownCode);
    }
    let bytes = from.sized(Keyframe::BITS_MAX / 8 + 1)?;
    let mut bits = BitReader::new(bytes);
    let payload = Keyframe::decode(&mut bits)?;
    bits.finish()?;
    if matches!(payload.anchor, Anchor::Exact(_)) {
        return Err(Malformed::NotCanonical);
    }
    Ok(payload.track(origin))
}

/// Encodes the inertia of a body that can rotate torque-free.
fn encode_inertia(inertia: Option<&Inertia>, to: &mut Writer) {
    let Some(inertia) = inertia else {
        return to.u8(0);
    };
    assert!(!inertia.is_isotropic(), "equal moments are not encoded");
    let own_axes = bits(inertia.frame()) == bits(Inertia::OWN_AXES);
    to.u8(if own_axes { 1 } else { 2 });
    to.f32s(&inertia.moments());
    if !own_axes {
        to.f32s(&inertia.frame());
    }
}

/// Decodes the inertia of a body that can rotate torque-free.
///
/// # Errors
///
/// [`Malformed`] for an invalid or a redundant inertia.
fn decode_inertia(from: &mut Reader<'_>) -> Result<Option<Inertia>, Malformed> {
    let form = from.u8()?;
    let (moments, frame) = match form {
        0 => return Ok(None),
        1 => (from.f32s()?, Inertia::OWN_AXES),
        2 => (from.f32s()?, from.f32s()?),
        _ => return Err(Malformed::UnknownCode),
    };
    let inertia = Inertia::new(moments, frame).map_err(|_| Malformed::OutOfRange)?;
    let is_own_axes = form == 2 && bits(frame) == bits(Inertia::OWN_AXES);
    if inertia.is_isotropic() || is_own_axes {
        return Err(Malformed::NotCanonical);
    }
    Ok(Some(inertia))
}

fn bits(frame: [f32; 4]) -> [u32; 4] {
    frame.map(f32::to_bits)
}

#[cfg(test)]
mod tests {
    use alloc::vec::Vec;

    use super::*;

    fn bytes(form: u8, numbers: &[f32]) -> Vec<u8> {
        let mut writer = Writer::default();
        writer.u8(form);
        numbers.iter().for_each(|number| writer.f32(*number));
        writer.into_bytes()
    }

    fn read(bytes: &[u8]) -> Result<Option<Inertia>, Malformed> {
        let mut reader = Reader::new(bytes);
        let inertia = decode_inertia(&mut reader)?;
        reader.finish()?;
        Ok(inertia)
    }

    #[test]
    fn an_inertia_round_trips() {
        let slab = Inertia::new([1.0, 2.0, 2.5], Inertia::OWN_AXES).unwrap();
        let askew = Inertia::new([1.0, 2.0, 2.5], [0.5, -0.5, 0.5, 0.5]).unwrap();
        for (inertia, length) in [(None, 1), (Some(slab), 13), (Some(askew), 29)] {
            let mut writer = Writer::default();
            encode_inertia(inertia.as_ref(), &mut writer);
            let bytes = writer.into_bytes();
            assert_eq!(bytes.len(), length);
            assert_eq!(read(&bytes), Ok(inertia));
            for cut in 0..length {
                assert_eq!(read(&bytes[..cut]), Err(Malformed::Truncated));
            }
        }
    }

    #[test]
    fn invalid_or_redundant_inertia_is_refused() {
        let own = [1.0, 2.0, 2.5, 0.0, 0.0, 0.0, 1.0];
        assert_eq!(read(&bytes(2, &own)), Err(Malformed::NotCanonical));
        let equal = read(&bytes(1, &[3.0; 3]));
        assert_eq!(equal, Err(Malformed::NotCanonical));
        for wrong in [0.0, -1.0, f32::NAN, f32::INFINITY, 1e-12] {
            let refused = read(&bytes(1, &[1.0, wrong, 2.0]));
            assert_eq!(refused, Err(Malformed::OutOfRange));
        }
        assert_eq!(read(&bytes(3, &own)), Err(Malformed::UnknownCode));
    }
}
