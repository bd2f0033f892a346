//! Requests of a member: the stream that it takes, authority; denials.
//!
//! Codec only: the server decides who may take which stream or authority over bodies, and what it denies. `session` encodes the
//! motion of an upstream.

use alloc::vec::Vec;
use core::fmt;

use rhumb_reckoning::{
    BodyId, BodyState, LengthBound, Predictor, Tick, Tolerance, Track, TurnBound,
};

use crate::limits::AUTHORITY_BODIES_MAX;
use crate::packet::{LargestPacket, StreamId};
use crate::scene::{Invalid, Quantity, Rule};
use crate::stream::Budget;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, OPTIONAL, Wire};

/// The cause of a member's request for a new snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResyncCause {
    /// Too many packets are missing for refreshes.
    LostSync,
    /// A checksum of the stream differs from that of the copy: a fault of the publisher or of the subscriber.
    ChecksumMismatch,
}

impl Wire for ResyncCause {
    fn encode(&self, to: &mut Writer) {
        to.u8(match self {
            Self::LostSync => 0,
            Self::ChecksumMismatch => 1,
        });
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::LostSync),
            1 => Ok(Self::ChecksumMismatch),
            _ => Err(Malformed::OutOfRange),
        }
    }
}

/// A stream of a scene that a member chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StreamChoice {
    /// Predicted, within this tolerance.
    Within(Tolerance),
    /// The same under a budget: where the budget does not suffice, the stream states its error scale.
    Capped {
        /// Tolerance while the budget suffices.
        tolerance: Tolerance,
        /// Bandwidth budget.
        budget: Budget,
    },
    /// Every state at every tick, exact.
    Full,
    /// Every state that changed, exact: a full stream without the bodies that rest.
    Changed,
}

impl StreamChoice {
    /// True for a stream of exact states.
    #[must_use]
    pub const fn is_exact(self) -> bool {
        matches!(self, Self::Full | Self::Changed)
    }

    /// Tolerance of a copy by this stream. A full or changed stream is exact: for it the value means nothing.
    #[must_use]
    pub const fn tolerance(self) -> Tolerance {
        match self {
            Self::Within(tolerance) | Self::Capped { tolerance, .. } => tolerance,
            Self::Full | Self::Changed => Tolerance::LEAST,
        }
    }
}

impl Wire for StreamChoice {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Within(Tolerance::Surface(length)) => {
                to.u8(0);
                to.varint(u64::from(length.micrometres()));
            }
            Self::Full => to.u8(1),
            Self::Changed => to.u8(4),
            Self::Within(Tolerance::Parts { position, turn }) => {
                to.u8(2);
                to.varint(u64::from(position.micrometres()));
                to.varint(u64::from(turn.microradians()));
            }
            Self::Capped { tolerance, budget } => {
                to.u8(CAPPED);
                budget.encode(to);
                Self::Within(*tolerance).encode(to);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let code = from.u8()?;
        if code != CAPPED {
            return Self::uncapped(code, from);
        }
        let budget = Budget::decode(from)?;
        match Self::uncapped(from.u8()?, from)? {
            Self::Within(tolerance) => Ok(Self::Capped { tolerance, budget }),
            Self::Full | Self::Changed | Self::Capped { .. } => Err(Malformed::UnknownCode),
        }
    }
}

/// Code before a budget and the choice that it limits.
const CAPPED: u8 = 3;

impl StreamChoice {
    /// Decodes a choice without a budget, after its code.
    fn uncapped(code: u8, from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match code {
            0 => Self::Within(Tolerance::Surface(decode_length(from)?)),
            1 => Self::Full,
            4 => Self::Changed,
            2 => Self::Within(Tolerance::Parts {
                position: decode_length(from)?,
                turn: TurnBound::from_microradians(from.varint32()?)
                    .map_err(|_| Malformed::OutOfRange)?,
            }),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

fn decode_length(from: &mut Reader<'_>) -> Result<LengthBound, Malformed> {
    LengthBound::from_micrometres(from.varint32()?).map_err(|_| Malformed::OutOfRange)
}

/// Reason of a tier change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TierChangeCause {
    /// The link could not carry the stream.
    LinkCongested,
    /// The link has carried the coarser stream with ease for long enough to try the finer one again.
    LinkRecovered,
}

impl Wire for TierChangeCause {
    fn encode(&self, to: &mut Writer) {
        to.u8(match self {
            Self::LinkCongested => 0,
            Self::LinkRecovered => 1,
        });
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::LinkCongested),
            1 => Ok(Self::LinkRecovered),
            _ => Err(Malformed::UnknownCode),
        }
    }
}

/// Tiers that the server may choose when a member's link is congested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TierPolicy {
    /// None: late and lossy state is preferred to coarse state.
    Never,
    /// Tiers up to this tolerance.
    UpTo(LengthBound),
}

impl Wire for TierPolicy {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Never => to.u8(0),
            Self::UpTo(coarsest) => {
                to.u8(1);
                to.varint(u64::from(coarsest.micrometres()));
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::Never),
            1 => LengthBound::from_micrometres(from.varint32()?)
                .map(Self::UpTo)
                .map_err(|_| Malformed::OutOfRange),
            _ => Err(Malformed::UnknownCode),
        }
    }
}

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

/// The denial of a request. It had no effect; the connection continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Denial {
    /// The scene that the connection names does not exist.
    NoSuchScene,
    /// A scene of this name exists already.
    SceneExists,
    /// A number in the configuration of a new scene is invalid.
    InvalidConfig(Invalid),
    /// The server has reached its limit of scenes.
    TooManyScenes,
    /// The scene has reached its limit of members.
    TooManyMembers,
    /// The scene has reached its limit of different streams.
    TooManyStreams,
    /// The scene has no more body indices to grant.
    NoIndicesLeft,
    /// The scene runs by the server's clock; members cannot advance it.
    NotLockstep,
    /// The advance leads too far ahead.
    TooFarAhead,
    /// The scene's engine has failed; only leaving and deleting are left.
    SceneFaulted,
    /// A client of another protocol owns the scene: it advances and ends it.
    Owned,
    /// The client's role does not include the request.
    NotAllowed,
    /// The client's role does not include advancing the scene.
    AdvanceNotAllowed,
    /// The request exceeds a quota of the client's token.
    OverQuota,
    /// The machine has no time left for what is asked; a later attempt may succeed.
    Overloaded {
        /// When to try again, seconds from now.
        retry_seconds: u8,
    },
    /// A reason of a later version; the code is from [`OPTIONAL`] on.
    Other(u8),
}

impl Denial {
    /// True if the same request may succeed later, without another token or scene (PROTOCOL 4.16).
    #[must_use]
    pub const fn is_transient(self) -> bool {
        match self {
            Self::TooManyScenes
            | Self::TooManyMembers
            | Self::TooManyStreams
            | Self::NoIndicesLeft
            | Self::OverQuota
            | Self::Overloaded { .. }
            | Self::Other(_) => true,
            Self::NoSuchScene
            | Self::SceneExists
            | Self::InvalidConfig(_)
            | Self::NotLockstep
            | Self::TooFarAhead
            | Self::SceneFaulted
            | Self::Owned
            | Self::NotAllowed
            | Self::AdvanceNotAllowed => false,
        }
    }
}

impl fmt::Display for Denial {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoSuchScene => f.write_str("the server has no scene of that name"),
            Self::SceneExists => f.write_str("a scene of that name exists already"),
            Self::InvalidConfig(invalid) => {
                write!(f, "the scene's configuration is invalid: {invalid}")
            }
            Self::TooManyScenes => f.write_str("the server has reached its limit of scenes"),
            Self::TooManyMembers => f.write_str("the scene has reached its limit of members"),
            Self::TooManyStreams => {
                f.write_str("the scene has reached its limit of different streams")
            }
            Self::NoIndicesLeft => f.write_str("the scene has no more body indices to grant"),
            Self::NotLockstep => {
                f.write_str("the scene runs by the server's clock and cannot be advanced")
            }
            Self::TooFarAhead => f.write_str("the advance leads too far ahead"),
            Self::SceneFaulted => f.write_str("the scene's engine has failed"),
            Self::Owned => f.write_str("a client of another protocol owns the scene"),
            Self::NotAllowed => f.write_str("the client's role does not include the request"),
            Self::AdvanceNotAllowed => {
                f.write_str("the client's role does not include advancing the scene")
            }
            Self::OverQuota => f.write_str("the request exceeds a quota of the client's token"),
            Self::Overloaded { retry_seconds } => write!(
                f,
                "the server has no time left for it; try again in {retry_seconds} s"
            ),
            Self::Other(code) => write!(f, "the server gave an unknown reason, number {code}"),
        }
    }
}

impl core::error::Error for Denial {}

impl Wire for Denial {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::NoSuchScene => to.u8(0),
            Self::SceneExists => to.u8(1),
            Self::InvalidConfig(invalid) => {
                to.u8(match invalid.rule {
                    Rule::NotFinite => 2,
                    Rule::OutOfRange => 3,
                });
                to.u8(invalid.quantity.code());
            }
            Self::TooManyScenes => to.u8(4),
            Self::TooManyMembers => to.u8(5),
            Self::TooManyStreams => to.u8(6),
            Self::NoIndicesLeft => to.u8(7),
            Self::NotLockstep => to.u8(8),
            Self::TooFarAhead => to.u8(9),
            Self::SceneFaulted => to.u8(10),
            Self::Owned => to.u8(11),
            Self::NotAllowed => to.u8(16),
            Self::OverQuota => to.u8(17),
            Self::Overloaded { retry_seconds } => {
                to.u8(18);
                to.u8(*retry_seconds);
            }
            Self::AdvanceNotAllowed => to.u8(19),
            Self::Other(code) => to.u8(*code),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let quantity =
            |from: &mut Reader<'_>| Quantity::from_code(from.u8()?).ok_or(Malformed::UnknownCode);
        Ok(match from.u8()? {
            0 => Self::NoSuchScene,
            1 => Self::SceneExists,
            2 => Self::InvalidConfig(Invalid::not_finite(quantity(from)?)),
            3 => Self::InvalidConfig(Invalid::out_of_range(quantity(from)?)),
            4 => Self::TooManyScenes,
            5 => Self::TooManyMembers,
            6 => Self::TooManyStreams,
            7 => Self::NoIndicesLeft,
            8 => Self::NotLockstep,
            9 => Self::TooFarAhead,
            10 => Self::SceneFaulted,
            11 => Self::Owned,
            16 => Self::NotAllowed,
            17 => Self::OverQuota,
            18 => Self::Overloaded {
                retry_seconds: from.u8()?,
            },
            19 => Self::AdvanceNotAllowed,
            code @ OPTIONAL.. => Self::Other(code),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::tests::round_trips;

    fn read(bytes: &[u8]) -> Result<StreamChoice, Malformed> {
        let mut reader = Reader::new(bytes);
        let choice = StreamChoice::decode(&mut reader)?;
        reader.finish()?;
        Ok(choice)
    }

    #[test]
    fn a_stream_choice_round_trips() {
        let parts = |micrometres, microradians| {
            StreamChoice::Within(Tolerance::Parts {
                position: LengthBound::from_micrometres(micrometres).unwrap(),
                turn: TurnBound::from_microradians(microradians).unwrap(),
            })
        };
        for (choice, bytes) in [
            (
                StreamChoice::Within(Tolerance::NORMAL),
                &[0, 0xd0, 0x86, 3][..],
            ),
            (StreamChoice::Full, &[1][..]),
            (StreamChoice::Changed, &[4][..]),
            (parts(10_000, 2_000), &[2, 0x90, 0x4e, 0xd0, 0x0f][..]),
            (
                parts(1_000, 3_141_593),
                &[2, 0xe8, 7, 0xd9, 0xdf, 0xbf, 1][..],
            ),
            (
                StreamChoice::Capped {
                    tolerance: Tolerance::NORMAL,
                    budget: Budget::new(8_000, 2_000).unwrap(),
                },
                &[3, 0xc0, 0x3e, 0xd0, 0x0f, 0, 0xd0, 0x86, 3][..],
            ),
        ] {
            round_trips(&choice, bytes);
        }
    }

    #[test]
    fn an_invalid_tolerance_is_refused() {
        for (first, numbers) in [
            (0, &[999_u64][..]),
            (0, &[10_000_001][..]),
            (2, &[999, 2_000][..]),
            (2, &[10_000, 99][..]),
            (2, &[10_000, 3_141_594][..]),
        ] {
            let mut writer = Writer::new();
            writer.u8(first);
            numbers.iter().for_each(|number| writer.varint(*number));
            let refused = read(&writer.into_bytes());
            assert_eq!(refused, Err(Malformed::OutOfRange), "{numbers:?}");
        }
        assert_eq!(read(&[5]), Err(Malformed::UnknownCode));
        // A full or changed stream has no budget, and a budget is not nested.
        for inner in [1, 3, 4] {
            let refused = read(&[3, 0xc0, 0x3e, 0xd0, 0x0f, inner]);
            assert_eq!(refused, Err(Malformed::UnknownCode));
        }
    }

    #[test]
    fn valid_tier_policies_round_trip_and_others_are_refused() {
        let coarse = LengthBound::from_micrometres(200_000).unwrap();
        for (tier_policy, bytes) in [
            (TierPolicy::Never, &[0][..]),
            (TierPolicy::UpTo(coarse), &[1, 0xc0, 0x9a, 0x0c][..]),
        ] {
            round_trips(&tier_policy, bytes);
        }
        let refused = |bytes: &[u8]| TierPolicy::decode(&mut Reader::new(bytes)).unwrap_err();
        assert_eq!(refused(&[1, 1]), Malformed::OutOfRange);
        assert_eq!(refused(&[2]), Malformed::UnknownCode);
        let unknown = TierChangeCause::decode(&mut Reader::new(&[2]));
        assert_eq!(unknown, Err(Malformed::UnknownCode));
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
