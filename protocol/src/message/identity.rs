//! The first messages' fields: a client's identity, extensions, grease.
//!
//! Tokens are opaque here: the server's keys decide what one is worth (PROTOCOL 3.6). A session is a client's place in
//! its order of commands, across connections: the client draws the key, and a scene keeps what it needs to resume the
//! session.
//!
//! An extension is a numbered field. This file tells which extensions may be skipped. Decoded extensions keep their
//! bytes, so that they are passed on unchanged. Grease keeps peers tolerant of unknown values: every peer must ignore
//! it (PROTOCOL 3.5). A seed determines its values.

use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;
use core::str::FromStr;

use rhumb_reckoning::Tick;

use super::frame;
use crate::limits::{EXTENSION_BYTES_MAX, EXTENSIONS_MAX};
use crate::scene::CellGrid;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A signed text that a client shows in its first message.
#[derive(Clone, PartialEq, Eq)]
pub struct Token(String);

/// The rights of a client. Each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Joins scenes and receives streams.
    Observer,
    /// Also adds bodies, commands its own ones, and advances a lockstep scene.
    Controller,
    /// Also creates and deletes scenes, and commands everything in them.
    Owner,
}

impl Token {
    /// As text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The extension of `Hello` that carries it.
    #[must_use]
    pub fn extension(&self) -> Extension {
        Extension {
            id: Extension::TOKEN,
            value: self.0.as_bytes().to_vec(),
        }
    }
}

impl FromStr for Token {
    type Err = InvalidToken;

    /// Accepts printable ASCII of at most [`EXTENSION_BYTES_MAX`] bytes, without the space around it.
    fn from_str(text: &str) -> Result<Self, InvalidToken> {
        let text = text.trim();
        let fits = (1..=EXTENSION_BYTES_MAX).contains(&text.len());
        if fits && text.bytes().all(|byte| byte.is_ascii_graphic()) {
            Ok(Self(text.into()))
        } else {
            Err(InvalidToken)
        }
    }
}

/// Leaves the text out: a log is no place for a secret.
impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(…)")
    }
}

impl Role {
    /// Its number on the wire.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Observer => 0,
            Self::Controller => 1,
            Self::Owner => 2,
        }
    }

    /// The role of a number.
    #[must_use]
    pub const fn from_code(code: u8) -> Option<Self> {
        match code {
            0 => Some(Self::Observer),
            1 => Some(Self::Controller),
            2 => Some(Self::Owner),
            _ => None,
        }
    }

    /// The extension of `Welcome` that tells it.
    #[must_use]
    pub fn extension(self) -> Extension {
        Extension {
            id: Extension::TOKEN,
            value: alloc::vec![self.code()],
        }
    }
}

/// A text that cannot be a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidToken;

impl fmt::Display for InvalidToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "a token is 1 to {EXTENSION_BYTES_MAX} printable characters without spaces"
        )
    }
}

impl core::error::Error for InvalidToken {}

/// Names a session of one scene. It is secret: a client that knows it may take the session over.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionKey(pub [u8; 16]);

impl fmt::Debug for SessionKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SessionKey")
    }
}

/// A client's request to begin a session with its next join, or to take up the one of that key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionRequest {
    /// Its key.
    pub key: SessionKey,
    /// Commands of the session that the client knows to be done: no earlier refusal is repeated.
    pub answered: u64,
}

/// The state from which a session resumes; sent before the answer to the join.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionState {
    /// True if the scene knows the session; otherwise it has just begun.
    pub resumed: bool,
    /// True if the scene has a command log, so that `Durable` is sent.
    pub durable: bool,
    /// Commands of the session that were applied or refused; the next one has this number.
    pub commands: u64,
    /// The tick at which the scene resumes. After a restart of the server it may be earlier than the last one sent.
    pub tick: Tick,
}

impl Wire for SessionKey {
    fn encode(&self, to: &mut Writer) {
        to.raw(&self.0);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let bytes = from.raw(16)?;
        bytes.try_into().map(Self).map_err(|_| Malformed::Truncated)
    }
}

impl Wire for SessionRequest {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.answered);
        self.key.encode(to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let answered = from.count()?;
        let key = SessionKey::decode(from)?;
        Ok(Self { key, answered })
    }
}

/// Bits of a session's first byte.
mod flag {
    pub(super) const RESUMED: u8 = 1;
    pub(super) const DURABLE: u8 = 2;
}

impl Wire for SessionState {
    fn encode(&self, to: &mut Writer) {
        let resumed = if self.resumed { flag::RESUMED } else { 0 };
        let durable = if self.durable { flag::DURABLE } else { 0 };
        to.u8(resumed | durable);
        to.varint(self.commands);
        to.varint(self.tick.value());
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let flags = from.u8()?;
        if flags > flag::RESUMED | flag::DURABLE {
            return Err(Malformed::UnknownCode);
        }
        Ok(Self {
            resumed: flags & flag::RESUMED != 0,
            durable: flags & flag::DURABLE != 0,
            commands: from.count()?,
            tick: Tick::new(from.count()?),
        })
    }
}

/// One field: its number, and bytes with a meaning for peers that know the number.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Extension {
    /// Even: a peer that does not know it refuses the whole message. Odd: such a peer skips it.
    pub id: u32,
    /// At most [`EXTENSION_BYTES_MAX`].
    pub value: Vec<u8>,
}

impl Extension {
    /// In `Hello` the client's token, as text; in `Welcome` the role that it gives, one byte (PROTOCOL 3.6).
    pub const TOKEN: u32 = 1;
    /// The number of the address of the server that has the scene, in a `Welcome` before the connection closes.
    pub const ELSEWHERE: u32 = 3;
    /// The number of the grid of the scene's cells, in the `Joined` of a member that takes the scene by cells.
    pub const CELLS: u32 = 5;

    /// The extension that tells a scene's grid.
    #[must_use]
    pub fn of_cells(grid: &CellGrid) -> Self {
        let mut value = Writer::new();
        grid.encode(&mut value);
        Self {
            id: Self::CELLS,
            value: value.into_bytes(),
        }
    }

    /// True if a peer that does not know it must refuse the message.
    #[must_use]
    const fn is_critical(&self) -> bool {
        self.id.is_multiple_of(2)
    }
}

/// The extensions of one message, in rising order of their numbers, each once.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Extensions(Vec<Extension>);

impl Extensions {
    /// No extensions.
    pub const NONE: Self = Self(Vec::new());

    /// Adds one; returns `false` when its number is taken, the list is full, or the value too long.
    #[must_use]
    pub fn insert(&mut self, extension: Extension) -> bool {
        let fits = self.0.len() < EXTENSIONS_MAX && extension.value.len() <= EXTENSION_BYTES_MAX;
        match self.0.binary_search_by_key(&extension.id, |one| one.id) {
            Err(place) if fits => {
                self.0.insert(place, extension);
                true
            }
            _ => false,
        }
    }

    /// All of them, in order.
    pub fn iter(&self) -> impl Iterator<Item = &Extension> {
        self.0.iter()
    }

    /// The value of one of them.
    #[must_use]
    pub fn value(&self, id: u32) -> Option<&[u8]> {
        let place = self.0.binary_search_by_key(&id, |one| one.id).ok()?;
        self.0.get(place).map(|one| one.value.as_slice())
    }

    /// The grid of the scene's cells; `None` without one.
    #[must_use]
    pub fn cell_grid(&self) -> Option<CellGrid> {
        let mut from = Reader::new(self.value(Extension::CELLS)?);
        let grid = CellGrid::decode(&mut from).ok()?;
        from.finish().ok().map(|()| grid)
    }

    /// True if any extension is critical: this version knows no critical one.
    #[must_use]
    pub fn has_unknown_critical(&self) -> bool {
        self.0.iter().any(Extension::is_critical)
    }
}

impl Wire for Extensions {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.0.len() as u64);
        for extension in &self.0 {
            to.varint(u64::from(extension.id));
            to.sized(&extension.value);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let count = from.varint()?;
        if count > EXTENSIONS_MAX as u64 {
            return Err(Malformed::TooLong);
        }
        let mut extensions: Vec<Extension> = Vec::new();
        for _ in 0..count {
            let id = from.varint32()?;
            if extensions.last().is_some_and(|last| last.id >= id) {
                return Err(Malformed::NotCanonical);
            }
            let value = from.sized(EXTENSION_BYTES_MAX)?.to_vec();
            extensions.push(Extension { id, value });
        }
        Ok(Self(extensions))
    }
}

/// Seeded random numbers for grease: xorshift of 64 bits, multiplied.
///
/// Source: Vigna, "An experimental exploration of Marsaglia's xorshift generators, scrambled", 2016, section 5.
#[derive(Clone, Debug)]
pub struct Grease(u64);

impl Grease {
    /// The random numbers of one connection.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        // Neighbouring seeds diverge at once; zero, which the generator cannot leave, results from one seed only.
        match seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15) {
            0 => Self(1),
            state => Self(state),
        }
    }

    /// The versions in `known` with a reserved one at a random place.
    #[must_use]
    pub fn versions(&mut self, known: &[u16]) -> Vec<u16> {
        let mut versions = known.to_vec();
        let place = self.below(versions.len() as u32 + 1) as usize;
        let nibble = self.below(16) as u16;
        versions.insert(place, nibble * 0x1010 + 0x0a0a);
        versions
    }

    /// One extension that peers skip.
    #[must_use]
    pub fn extensions(&mut self) -> Extensions {
        let mut extensions = Extensions::NONE;
        let id = FIRST + STRIDE * self.below(1 << 20);
        let value = self.bytes();
        let fits = extensions.insert(Extension { id, value });
        debug_assert!(fits, "one short value always fits");
        extensions
    }

    /// Appends a message that peers ignore, every second time.
    pub fn message(&mut self, to: &mut Vec<u8>) {
        if self.below(2) == 0 {
            let kind = 0x8a + 0x10 * self.below(8) as u8;
            frame(kind, &self.bytes(), to);
        }
    }

    fn bytes(&mut self) -> Vec<u8> {
        let length = self.below(9);
        (0..length).map(|_| self.below(256) as u8).collect()
    }

    /// A number below `end`.
    const fn below(&mut self, end: u32) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let mixed = self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32;
        ((mixed * end as u64) >> 32) as u32
    }
}

/// Numbers of reserved extensions: this one and each `STRIDE`-th from it on, all odd.
const FIRST: u32 = 27;
/// See [`FIRST`].
const STRIDE: u32 = 62;

/// True if a version is reserved and has no meaning.
#[must_use]
pub const fn is_no_version(version: u16) -> bool {
    version & 0x0f0f == 0x0a0a && version >> 12 == (version >> 4) & 0xf
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{ClientMessage, Frames, ServerMessage, VERSIONS};

    #[test]
    fn a_token_is_printable_and_fits_an_extension() {
        let token: Token = " v4.public.abc\n".parse().unwrap();
        assert_eq!(token.as_str(), "v4.public.abc");
        assert_eq!(token.extension().value, b"v4.public.abc");
        assert!(!token.extension().is_critical());
        let long = String::from_utf8(alloc::vec![b'a'; EXTENSION_BYTES_MAX + 1]);
        for text in ["", "two words", "\u{e9}", &long.unwrap()] {
            assert_eq!(text.parse::<Token>(), Err(InvalidToken), "{text}");
        }
    }

    #[test]
    fn roles_have_numbers_and_an_order() {
        for role in [Role::Observer, Role::Controller, Role::Owner] {
            assert_eq!(Role::from_code(role.code()), Some(role));
        }
        assert_eq!(Role::from_code(3), None);
        assert!(Role::Observer < Role::Controller && Role::Controller < Role::Owner);
    }

    #[test]
    fn a_session_state_round_trips_and_its_flags_are_known() {
        let state = SessionState {
            resumed: true,
            durable: false,
            commands: 300,
            tick: Tick::new(7),
        };
        let mut writer = Writer::new();
        state.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(bytes, [1, 0xac, 2, 7]);
        assert_eq!(SessionState::decode(&mut Reader::new(&bytes)), Ok(state));
        let unknown = SessionState::decode(&mut Reader::new(&[4, 0, 0]));
        assert_eq!(unknown, Err(Malformed::UnknownCode));
        for cut in 0..bytes.len() {
            let cut = SessionState::decode(&mut Reader::new(&bytes[..cut]));
            assert_eq!(cut, Err(Malformed::Truncated));
        }
    }

    #[test]
    fn a_key_is_not_printed() {
        assert_eq!(alloc::format!("{:?}", SessionKey([7; 16])), "SessionKey");
    }

    fn read(bytes: &[u8]) -> Result<Extensions, Malformed> {
        let mut reader = Reader::new(bytes);
        let extensions = Extensions::decode(&mut reader)?;
        reader.finish()?;
        Ok(extensions)
    }

    #[test]
    fn extensions_round_trip_in_order() {
        let mut extensions = Extensions::NONE;
        let value = |length| alloc::vec![7; length];
        for (id, length, taken) in [
            (301, 0, true),
            (27, 2, true),
            (27, 1, false),
            (29, EXTENSION_BYTES_MAX + 1, false),
        ] {
            let value = value(length);
            assert_eq!(extensions.insert(Extension { id, value }), taken);
        }
        let mut writer = Writer::new();
        extensions.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(bytes, [2, 27, 2, 7, 7, 0xad, 2, 0]);
        assert_eq!(read(&bytes), Ok(extensions));
        for cut in 0..bytes.len() {
            assert_eq!(read(&bytes[..cut]), Err(Malformed::Truncated));
        }
    }

    #[test]
    fn only_even_numbers_must_be_known() {
        let of = |id| {
            let value = Vec::new();
            Extensions(alloc::vec![Extension { id, value }])
        };
        assert!(of(4).has_unknown_critical() && of(0).has_unknown_critical());
        assert!(!of(27).has_unknown_critical() && !Extensions::NONE.has_unknown_critical());
    }

    #[test]
    fn numbers_that_do_not_rise_and_lists_that_are_too_long_are_refused() {
        assert_eq!(read(&[2, 5, 0, 5, 0]), Err(Malformed::NotCanonical));
        assert_eq!(read(&[2, 5, 0, 3, 0]), Err(Malformed::NotCanonical));
        assert_eq!(read(&[17]), Err(Malformed::TooLong));
        assert_eq!(read(&[1, 5, 0x81, 6]), Err(Malformed::TooLong));
    }

    #[test]
    fn grease_values_lie_in_the_reserved_range() {
        for seed in 0..2_000 {
            let mut grease = Grease::new(seed);
            let versions = grease.versions(&VERSIONS);
            let (none, known): (Vec<u16>, Vec<u16>) = versions
                .iter()
                .partition(|version| is_no_version(**version));
            assert_eq!((none.len(), &known[..]), (1, &VERSIONS[..]));
            let extensions = grease.extensions();
            assert!(!extensions.has_unknown_critical());
            assert!(extensions.iter().all(|one| one.id % STRIDE == FIRST));
        }
    }

    #[test]
    fn grease_messages_are_skipped_by_both_peers() {
        let mut sent = 0;
        for seed in 0..200 {
            let mut bytes = Vec::new();
            Grease::new(seed).message(&mut bytes);
            let mut frames = Frames::new();
            frames.push(&bytes);
            while let Some(framed) = frames.next_frame().unwrap() {
                assert_eq!(framed.kind & 0x8f, 0x8a);
                assert_eq!(ClientMessage::decode(&framed), Ok(None));
                assert_eq!(ServerMessage::decode(&framed), Ok(None));
                sent += 1;
            }
        }
        assert!((60..140).contains(&sent), "{sent} of 200");
    }

    #[test]
    fn no_supported_version_is_reserved() {
        assert!(!VERSIONS.iter().any(|version| is_no_version(*version)));
        let aside = (0..=u16::MAX).filter(|version| is_no_version(*version));
        assert_eq!(aside.count(), 16);
    }
}
