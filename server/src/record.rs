//! Records of a command log: everything that decides the truth of a scene.
//!
//! One record follows another without gaps; a frame of the log holds whole records. Reading never panics. Sessions are
//! named by their number in the log, which is given once.

use rhumb_protocol::message::SessionKey;
use rhumb_protocol::scene::{Command, CommandError, IdRange};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Tick;

use crate::permit::{ClientName, decode_client, decode_client_of, encode_client_of};

/// Number of a session in the log of its scene; not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionNumber(pub u32);

/// One record.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// A command that changed the scene, whatever its source: a member, an upstream or a hook.
    Applied(Command),
    /// The object that the `Applied` before it added belongs to this client.
    Owned(ClientName),
    /// A step; the digest of all observations after it.
    Stepped(u64),
    /// A session of a client begins; `None` without a token.
    Opened(SessionNumber, SessionKey, Option<ClientName>),
    /// A session has more body indices.
    Granted(SessionNumber, IdRange),
    /// A numbered command of a session is done. One that was applied follows its `Applied`.
    Counted(SessionNumber, Option<CommandError>),
    /// A session is over; its indices are free.
    Closed(SessionNumber),
}

mod kind {
    pub(super) const APPLIED: u8 = 1;
    pub(super) const STEPPED: u8 = 2;
    pub(super) const OPENED: u8 = 3;
    pub(super) const GRANTED: u8 = 4;
    pub(super) const COUNTED: u8 = 5;
    pub(super) const REFUSED: u8 = 6;
    pub(super) const CLOSED: u8 = 7;
    pub(super) const OWNED: u8 = 8;
}

/// Bytes of one encoded command, at most: a long message.
const COMMAND_BYTES_MAX: usize = rhumb_protocol::limits::LONG_MESSAGE_BYTES_MAX;

impl Record {
    /// Appends a command, without a copy of it.
    pub(crate) fn encode_applied(command: &Command, to: &mut Writer) {
        let mut bytes = Writer::new();
        command.encode(&mut bytes);
        to.u8(kind::APPLIED);
        to.sized(&bytes.into_bytes());
    }

    /// Reads every record of a frame.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for bytes that are no records of this version.
    pub fn decode_all(bytes: &[u8]) -> Result<Vec<Self>, Malformed> {
        let mut from = Reader::new(bytes);
        let mut records = Vec::new();
        while !from.rest().is_empty() {
            records.push(Self::decode(&mut from)?);
        }
        Ok(records)
    }
}

impl Wire for SessionNumber {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.0));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        from.varint32().map(Self)
    }
}

impl Wire for Record {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Applied(command) => Self::encode_applied(command, to),
            Self::Stepped(digest) => {
                to.u8(kind::STEPPED);
                to.raw(&digest.to_le_bytes());
            }
            Self::Opened(number, key, client) => {
                to.u8(kind::OPENED);
                number.encode(to);
                key.encode(to);
                encode_client_of(client.as_ref(), to);
            }
            Self::Granted(number, range) => {
                to.u8(kind::GRANTED);
                number.encode(to);
                range.encode(to);
            }
            Self::Counted(number, None) => {
                to.u8(kind::COUNTED);
                number.encode(to);
            }
            Self::Counted(number, Some(error)) => {
                to.u8(kind::REFUSED);
                number.encode(to);
                error.encode(to);
            }
            Self::Owned(client) => {
                to.u8(kind::OWNED);
                to.sized(client.as_bytes());
            }
            Self::Closed(number) => {
                to.u8(kind::CLOSED);
                number.encode(to);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            kind::APPLIED => {
                let mut inner = Reader::new(from.sized(COMMAND_BYTES_MAX)?);
                let command = Command::decode(&mut inner)?;
                inner.finish()?;
                Self::Applied(command)
            }
            kind::STEPPED => Self::Stepped(decode_u64(from)?),
            kind::OPENED => {
                let number = SessionNumber::decode(from)?;
                let key = SessionKey::decode(from)?;
                Self::Opened(number, key, decode_client_of(from)?)
            }
            kind::GRANTED => Self::Granted(SessionNumber::decode(from)?, IdRange::decode(from)?),
            kind::COUNTED => Self::Counted(SessionNumber::decode(from)?, None),
            kind::REFUSED => {
                let number = SessionNumber::decode(from)?;
                Self::Counted(number, Some(CommandError::decode(from)?))
            }
            kind::OWNED => Self::Owned(decode_client(from)?),
            kind::CLOSED => Self::Closed(SessionNumber::decode(from)?),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

/// Eight bytes, little-endian.
///
/// # Errors
///
/// [`Malformed::Truncated`] for fewer.
pub fn decode_u64(from: &mut Reader<'_>) -> Result<u64, Malformed> {
    let bytes = from.raw(8)?;
    bytes
        .try_into()
        .map(u64::from_le_bytes)
        .map_err(|_| Malformed::Truncated)
}

/// Records in their order.
#[derive(Debug, Default)]
pub struct Journal {
    records: Writer,
    /// The scene's tick before the first of them.
    tick: Option<Tick>,
}

/// Records that are written as a whole or not at all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// The scene's tick before them.
    pub tick: Tick,
    /// Their bytes.
    pub records: Vec<u8>,
}

impl Batch {
    /// Bytes that it takes in memory.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>() + self.records.capacity()
    }
}

impl Journal {
    /// Adds a command that was applied.
    pub(crate) fn applied(&mut self, tick: Tick, command: &Command) {
        self.tick.get_or_insert(tick);
        Record::encode_applied(command, &mut self.records);
    }

    /// Adds a record.
    pub fn push(&mut self, tick: Tick, record: &Record) {
        self.tick.get_or_insert(tick);
        record.encode(&mut self.records);
    }

    /// Everything since the last call.
    pub fn take(&mut self) -> Option<Batch> {
        let tick = self.tick.take()?;
        let records = std::mem::take(&mut self.records).into_bytes();
        Some(Batch { tick, records })
    }
}
