//! What a client says on the control stream.

use alloc::vec::Vec;

use rhumb_reckoning::{LengthBound, Tick, Tolerance, TurnBound};

use super::MAGIC;
use super::frame::{Framed, OPTIONAL, frame};
use crate::limits::{RESERVE_MAX, VERSIONS_MAX};
use crate::packet::StreamId;
use crate::scene::{Command, SceneName, SceneTerms};
use crate::time::Instant;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Which stream of a scene a member wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StreamChoice {
    /// Reckoned, within this tolerance.
    Within(Tolerance),
    /// Everything, every tick, to the bit.
    Full,
}

impl StreamChoice {
    /// How far off a copy by this stream may be. A full stream says the very bits: for it this means nothing.
    #[must_use]
    pub const fn tolerance(self) -> Tolerance {
        match self {
            Self::Within(tolerance) => tolerance,
            Self::Full => Tolerance::LEAST,
        }
    }
}

/// One message of a client. A connection is about one scene, which its `Hello` names.
#[derive(Clone, Debug, PartialEq)]
pub enum ClientMessage {
    /// The first: which versions are spoken, newest first, and which scene it is about.
    Hello {
        /// At least one.
        versions: Vec<u16>,
        /// The scene of this connection.
        scene: SceneName,
    },
    /// Creates the scene.
    Create(SceneTerms),
    /// Becomes a member and follows a stream.
    Join(StreamChoice),
    /// Is no longer a member.
    Leave,
    /// Ends the scene for everyone.
    Delete,
    /// Wants more body indices.
    Reserve {
        /// How many; at least one.
        count: u32,
    },
    /// A wish. The first of a membership has number 0, the next 1, and so on.
    Command(Command),
    /// Steps a lockstep scene until it has reached a tick.
    Advance {
        /// The tick.
        to: Tick,
    },
    /// Lost so much that only a new snapshot helps.
    Resync,
    /// What time is it?
    Ping {
        /// The client's own moment, which comes back.
        sent: Instant,
    },
    /// How is the scene?
    Inspect,
    /// Follows another stream from now on, and goes on hearing the one before until the snapshot is whole.
    Follow(StreamChoice),
    /// Has caught up with a stream that it changed to, and needs the one before no more.
    Followed(StreamId),
}

/// Type bytes.
mod kind {
    pub(super) const HELLO: u8 = 1;
    pub(super) const CREATE: u8 = 2;
    pub(super) const JOIN: u8 = 3;
    pub(super) const LEAVE: u8 = 4;
    pub(super) const DELETE: u8 = 5;
    pub(super) const RESERVE: u8 = 6;
    pub(super) const COMMAND: u8 = 7;
    pub(super) const ADVANCE: u8 = 8;
    pub(super) const RESYNC: u8 = 9;
    pub(super) const PING: u8 = 10;
    pub(super) const INSPECT: u8 = 11;
    pub(super) const FOLLOW: u8 = 12;
    pub(super) const FOLLOWED: u8 = 13;
}

impl Wire for StreamChoice {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Within(Tolerance::Surface(length)) => {
                to.u8(0);
                to.varint(u64::from(length.micrometres()));
            }
            Self::Full => to.u8(1),
            Self::Within(Tolerance::Parts { position, turn }) => {
                to.u8(2);
                to.varint(u64::from(position.micrometres()));
                to.varint(u64::from(turn.microradians()));
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            0 => Self::Within(Tolerance::Surface(decode_length(from)?)),
            1 => Self::Full,
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

impl ClientMessage {
    /// Appends the message, framed.
    pub fn encode(&self, to: &mut Vec<u8>) {
        let mut body = Writer::new();
        let kind = match self {
            Self::Hello { versions, scene } => {
                body.raw(&MAGIC);
                body.varint(versions.len() as u64);
                for version in versions {
                    body.u16(*version);
                }
                scene.encode(&mut body);
                kind::HELLO
            }
            Self::Create(terms) => {
                terms.encode(&mut body);
                kind::CREATE
            }
            Self::Join(choice) => {
                choice.encode(&mut body);
                kind::JOIN
            }
            Self::Leave => kind::LEAVE,
            Self::Delete => kind::DELETE,
            Self::Reserve { count } => {
                body.varint(u64::from(*count));
                kind::RESERVE
            }
            Self::Command(command) => {
                command.encode(&mut body);
                kind::COMMAND
            }
            Self::Advance { to: tick } => {
                body.varint(tick.value());
                kind::ADVANCE
            }
            Self::Resync => kind::RESYNC,
            Self::Ping { sent } => {
                body.varint(sent.as_nanos());
                kind::PING
            }
            Self::Inspect => kind::INSPECT,
            Self::Follow(choice) => {
                choice.encode(&mut body);
                kind::FOLLOW
            }
            Self::Followed(stream) => {
                stream.encode(&mut body);
                kind::FOLLOWED
            }
        };
        frame(kind, &body.into_bytes(), to);
    }

    /// Reads a message; `None` for one of an unknown type that may be ignored.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when the bytes are no message that this version knows.
    pub fn decode(framed: &Framed) -> Result<Option<Self>, Malformed> {
        let mut from = Reader::new(&framed.body);
        let message = match framed.kind {
            kind::HELLO => decode_hello(&mut from)?,
            kind::CREATE => Self::Create(SceneTerms::decode(&mut from)?),
            kind::JOIN => Self::Join(StreamChoice::decode(&mut from)?),
            kind::LEAVE => Self::Leave,
            kind::DELETE => Self::Delete,
            kind::RESERVE => match from.varint_to(u64::from(RESERVE_MAX))? as u32 {
                0 => return Err(Malformed::OutOfRange),
                count => Self::Reserve { count },
            },
            kind::COMMAND => Self::Command(Command::decode(&mut from)?),
            kind::ADVANCE => Self::Advance {
                to: Tick::new(from.count()?),
            },
            kind::RESYNC => Self::Resync,
            kind::PING => Self::Ping {
                sent: Instant::from_nanos(from.varint()?),
            },
            kind::INSPECT => Self::Inspect,
            kind::FOLLOW => Self::Follow(StreamChoice::decode(&mut from)?),
            kind::FOLLOWED => Self::Followed(StreamId::decode(&mut from)?),
            OPTIONAL.. => return Ok(None),
            _ => return Err(Malformed::UnknownCode),
        };
        from.finish()?;
        Ok(Some(message))
    }
}

fn decode_hello(from: &mut Reader<'_>) -> Result<ClientMessage, Malformed> {
    if from.raw(MAGIC.len())? != MAGIC {
        return Err(Malformed::UnknownCode);
    }
    let count = from.varint()?;
    if count == 0 || count > VERSIONS_MAX as u64 {
        return Err(Malformed::TooLong);
    }
    let mut versions = Vec::new();
    for _ in 0..count {
        versions.push(from.u16()?);
    }
    Ok(ClientMessage::Hello {
        versions,
        scene: SceneName::decode(from)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<StreamChoice, Malformed> {
        let mut reader = Reader::new(bytes);
        let choice = StreamChoice::decode(&mut reader)?;
        reader.finish()?;
        Ok(choice)
    }

    #[test]
    fn a_choice_of_a_stream_comes_back_as_it_was_said() {
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
            (parts(10_000, 2_000), &[2, 0x90, 0x4e, 0xd0, 0x0f][..]),
            (
                parts(1_000, 3_141_593),
                &[2, 0xe8, 7, 0xd9, 0xdf, 0xbf, 1][..],
            ),
        ] {
            let mut writer = Writer::new();
            choice.encode(&mut writer);
            assert_eq!(writer.into_bytes(), bytes);
            assert_eq!(read(bytes), Ok(choice));
            for cut in 0..bytes.len() {
                assert_eq!(read(&bytes[..cut]), Err(Malformed::Truncated));
            }
        }
    }

    #[test]
    fn a_tolerance_that_no_stream_offers_is_refused() {
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
        assert_eq!(read(&[3]), Err(Malformed::UnknownCode));
    }
}
