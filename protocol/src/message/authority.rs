//! Authority over bodies: a member's request, and the answers.
//!
//! Names only: the server decides who may take authority over bodies; `session` encodes the motion.

use alloc::vec::Vec;
use core::fmt;

use rhumb_reckoning::{BodyId, BodyState, Predictor, Tick, Tolerance, Track};

use super::choice::StreamChoice;
use crate::limits::AUTHORITY_BODIES_MAX;
use crate::packet::{LargestPacket, StreamId};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, OPTIONAL, Wire};

/// A member's request for authority over bodies, in place of its former ones.
#[derive(Clone, Debug, PartialEq)]
pub struct TakeAuthority {
    /// Bound on the distance of the server's bodies from the member's.
    pub tolerance: Tolerance,
    /// The largest packet of the upstream.
    pub largest_packet: LargestPacket,
    /// Kinematic bodies in rising order, each once; an empty list ends the authority.
    pub bodies: Vec<BodyId>,
}

/// A member's grant of authority: the start of its upstream.
#[derive(Clone, Debug, PartialEq)]
pub struct AuthorityGrant {
    /// Name of the upstream.
    pub stream: StreamId,
    /// The newest tick of the scene.
    pub tick: Tick,
    /// The bodies and their states at that tick. A body's place is its index in the stream.
    pub bodies: Vec<(BodyId, BodyState)>,
}

/// Reason of a refused or ended authority.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum AuthorityError {
    /// The scene has no such body.
    UnknownBody(BodyId),
    /// The body's index was granted to another member, which is still there.
    NotYours(BodyId),
    /// The body is fixed, or the engine moves it.
    NotKinematic(BodyId),
    /// Another member has authority over it.
    HeldByAnother(BodyId),
    /// The scene's engine has failed.
    SceneFaulted,
    /// The upstream has lost sync; the member has no authority until it requests it again.
    LostSync,
    /// The client's role does not include authority, or a body belongs to another client.
    NotAllowed,
    /// A reason of a later version; the code is from [`OPTIONAL`] on.
    Other(u8),
}

impl AuthorityGrant {
    /// The track of a body of this stream before its first update, at both ends.
    #[must_use]
    pub fn first_track(&self, motion: BodyState) -> Track {
        if motion == motion.stilled() {
            return Track::resting(self.tick, motion);
        }
        Track {
            predictor: Predictor::Uniform,
            anchor: rhumb_reckoning::Anchor::Exact(motion),
            ..Track::resting(self.tick, motion)
        }
    }
}

impl AuthorityError {
    /// Its name in languages without enumerations.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        match self {
            Self::UnknownBody(_) => "unknown body",
            Self::NotYours(_) => "not yours",
            Self::NotKinematic(_) => "not kinematic",
            Self::HeldByAnother(_) => "held by another",
            Self::SceneFaulted => "scene faulted",
            Self::LostSync => "lost sync",
            Self::NotAllowed => "not allowed",
            Self::Other(_) => "other",
        }
    }

    /// The body that it names.
    #[must_use]
    pub const fn body(&self) -> Option<BodyId> {
        match *self {
            Self::UnknownBody(id)
            | Self::NotYours(id)
            | Self::NotKinematic(id)
            | Self::HeldByAnother(id) => Some(id),
            _ => None,
        }
    }
}

impl fmt::Display for AuthorityError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::UnknownBody(id) => write!(f, "the scene has no {id}"),
            Self::NotYours(id) => write!(f, "{id} was granted to another member"),
            Self::NotKinematic(id) => write!(f, "{id} is not kinematic and takes no authority"),
            Self::HeldByAnother(id) => write!(f, "another member has authority over {id}"),
            Self::SceneFaulted => f.write_str("the scene's engine has failed"),
            Self::LostSync => f.write_str("the upstream has lost sync"),
            Self::NotAllowed => f.write_str(
                "the client may not take authority, or not over what belongs to another client",
            ),
            Self::Other(code) => write!(f, "the server gave an unknown reason, number {code}"),
        }
    }
}

impl core::error::Error for AuthorityError {}

fn decode_count(from: &mut Reader<'_>) -> Result<usize, Malformed> {
    Ok(from.varint_to(AUTHORITY_BODIES_MAX as u64)? as usize)
}

/// Appends bodies under one member's authority, in rising order.
pub(super) fn encode_bodies(bodies: &[BodyId], to: &mut Writer) {
    to.varint(bodies.len() as u64);
    for id in bodies {
        id.encode(to);
    }
}

pub(super) fn decode_bodies(from: &mut Reader<'_>) -> Result<Vec<BodyId>, Malformed> {
    let mut bodies: Vec<BodyId> = Vec::new();
    for _ in 0..decode_count(from)? {
        let id = BodyId::decode(from)?;
        if bodies.last().is_some_and(|last| *last >= id) {
            return Err(Malformed::NotCanonical);
        }
        bodies.push(id);
    }
    Ok(bodies)
}

impl Wire for TakeAuthority {
    fn encode(&self, to: &mut Writer) {
        StreamChoice::Within(self.tolerance).encode(to);
        self.largest_packet.encode(to);
        encode_bodies(&self.bodies, to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let StreamChoice::Within(tolerance) = StreamChoice::decode(from)? else {
            return Err(Malformed::UnknownCode);
        };
        Ok(Self {
            tolerance,
            largest_packet: LargestPacket::decode(from)?,
            bodies: decode_bodies(from)?,
        })
    }
}

impl Wire for AuthorityGrant {
    fn encode(&self, to: &mut Writer) {
        self.stream.encode(to);
        to.varint(self.tick.value());
        to.varint(self.bodies.len() as u64);
        for (id, motion) in &self.bodies {
            id.encode(to);
            motion.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let stream = StreamId::decode(from)?;
        let tick = Tick::new(from.count()?);
        let mut bodies: Vec<(BodyId, BodyState)> = Vec::new();
        for _ in 0..decode_count(from)? {
            let id = BodyId::decode(from)?;
            if bodies.last().is_some_and(|(last, _)| *last >= id) {
                return Err(Malformed::NotCanonical);
            }
            bodies.push((id, BodyState::decode(from)?));
        }
        Ok(Self {
            stream,
            tick,
            bodies,
        })
    }
}

impl Wire for AuthorityError {
    fn encode(&self, to: &mut Writer) {
        let mut named = |code, id: BodyId| {
            to.u8(code);
            id.encode(to);
        };
        match *self {
            Self::UnknownBody(id) => named(0, id),
            Self::NotYours(id) => named(1, id),
            Self::NotKinematic(id) => named(2, id),
            Self::HeldByAnother(id) => named(3, id),
            Self::SceneFaulted => to.u8(4),
            Self::LostSync => to.u8(5),
            Self::NotAllowed => to.u8(16),
            Self::Other(code) => to.u8(code),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            0 => Self::UnknownBody(BodyId::decode(from)?),
            1 => Self::NotYours(BodyId::decode(from)?),
            2 => Self::NotKinematic(BodyId::decode(from)?),
            3 => Self::HeldByAnother(BodyId::decode(from)?),
            4 => Self::SceneFaulted,
            5 => Self::LostSync,
            16 => Self::NotAllowed,
            code @ OPTIONAL.. => Self::Other(code),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

// The longest motion with the longest id, as often as allowed, fits a message.
const _: () =
    assert!(AUTHORITY_BODIES_MAX * (3 + 3 + 1 + 13 * 4) + 16 < crate::limits::MESSAGE_BYTES_MAX);

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that a value round-trips through these bytes, and that every truncation is refused.
    fn round_trips<T: Wire + PartialEq + fmt::Debug>(value: &T, bytes: &[u8]) {
        let mut writer = Writer::new();
        value.encode(&mut writer);
        assert_eq!(writer.into_bytes(), bytes);
        let mut reader = Reader::new(bytes);
        assert_eq!(T::decode(&mut reader).as_ref(), Ok(value));
        assert_eq!(reader.finish(), Ok(()));
        for cut in 0..bytes.len() {
            let mut reader = Reader::new(&bytes[..cut]);
            assert_eq!(T::decode(&mut reader), Err(Malformed::Truncated));
        }
    }

    #[test]
    fn authority_messages_round_trip() {
        let (one, other) = (BodyId::new(3, 0), BodyId::new(300, 2));
        let request = TakeAuthority {
            tolerance: Tolerance::NORMAL,
            largest_packet: LargestPacket::DEFAULT,
            bodies: alloc::vec![one, other],
        };
        round_trips(&request, &[0, 0xd0, 0x86, 3, 0xcc, 8, 2, 3, 0, 0xac, 2, 2]);
        let at = |x| BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let driving = AuthorityGrant {
            stream: StreamId(7),
            tick: Tick::new(300),
            bodies: alloc::vec![(one, at(1.0).unwrap())],
        };
        let bytes = [
            7, 0xac, 2, 1, 3, 0, 0, 0, 0, 0x80, 0x3f, 0, 0, 0, 0, 0, 0, 0, 0,
        ];
        round_trips(&driving, &bytes);
        round_trips(&AuthorityError::HeldByAnother(other), &[3, 0xac, 2, 2]);
        round_trips(&AuthorityError::LostSync, &[5]);
    }

    #[test]
    fn bodies_that_do_not_rise_are_refused() {
        for bytes in [
            &[0, 0xd0, 0x86, 3, 0xcc, 8, 2, 3, 0, 3, 0][..],
            &[0, 0xd0, 0x86, 3, 0xcc, 8, 2, 4, 0, 3, 9],
        ] {
            let refused = TakeAuthority::decode(&mut Reader::new(bytes));
            assert_eq!(refused, Err(Malformed::NotCanonical));
        }
    }

    #[test]
    fn a_full_stream_gives_no_authority_tolerance() {
        let refused = TakeAuthority::decode(&mut Reader::new(&[1, 0]));
        assert_eq!(refused, Err(Malformed::UnknownCode));
    }

    #[test]
    fn a_body_without_velocity_is_predicted_to_rest() {
        let driving = AuthorityGrant {
            stream: StreamId(0),
            tick: Tick::new(5),
            bodies: Vec::new(),
        };
        let motion = |speed| BodyState::new([1.0; 3], [0.0, 0.0, 0.0, 1.0], [speed; 3], [0.0; 3]);
        assert!(driving.first_track(motion(0.0).unwrap()).is_exact_rest());
        let moving = driving.first_track(motion(2.0).unwrap());
        assert_eq!(moving.predictor, Predictor::Uniform);
        assert_eq!(moving.origin, Tick::new(5));
    }
}
