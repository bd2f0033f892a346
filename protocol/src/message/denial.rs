//! Denials: why a request had no effect.
//!
//! Codec only: the server decides what it denies.

use core::fmt;

use crate::scene::{Invalid, Quantity, Rule};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, OPTIONAL, Wire};

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
