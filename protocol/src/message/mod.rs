//! The control messages, reliable and in order, and their framing.
//!
//! A message is its length (a variable integer that counts type and body), a type byte, and a body. A peer may ignore
//! unknown types from 0x80 on, but no others (PROTOCOL 4.1). A body too long for one message is preceded by pieces of
//! itself, each of the greatest message length.

mod cell;
mod client;
mod identity;
mod request;
mod scene_event;
mod server;

use alloc::vec::Vec;

use crate::limits::{LONG_MESSAGE_BYTES_MAX, MESSAGE_BYTES_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

pub use cell::{CellNews, CellRequest, CellStart};
pub use client::ClientMessage;
pub use identity::{Extension, Extensions, Grease, is_no_version};
pub use identity::{InvalidToken, Role, SessionKey, SessionRequest, SessionState, Token};
pub use request::{
    AuthorityError, AuthorityGrant, Denial, ResyncCause, StreamChoice, TakeAuthority,
    TierChangeCause, TierPolicy,
};
pub use scene_event::{FaultCause, RemovalCause, SceneEvent};
pub use server::{
    Inspection, Joined, QueryError, QueryResult, ServerMessage, StageTimes, TickEvents, Welcome,
};

/// Supported versions of the protocol, newest first.
pub const VERSIONS: [u16; 1] = [1];
/// First bytes of a client's control stream.
pub const MAGIC: [u8; 4] = *b"RHMB";

/// Type of a piece of the next message's body.
const PIECE: u8 = 0;

/// Appends one message, after the pieces that do not fit it.
///
/// # Panics
///
/// When the body is longer than the limit of long messages: the caller is part of the product.
pub fn frame(kind: u8, mut body: &[u8], to: &mut Vec<u8>) {
    assert!(
        body.len() <= LONG_MESSAGE_BYTES_MAX,
        "a message fits its limit"
    );
    while body.len() > MESSAGE_BYTES_MAX {
        let (piece, rest) = body.split_at(MESSAGE_BYTES_MAX);
        frame_one(PIECE, piece, to);
        body = rest;
    }
    frame_one(kind, body, to);
}

fn frame_one(kind: u8, body: &[u8], to: &mut Vec<u8>) {
    let mut writer = Writer::new();
    writer.varint(body.len() as u64 + 1);
    writer.u8(kind);
    writer.raw(body);
    to.extend_from_slice(&writer.into_bytes());
}

/// Appends the only field of a message; returns the message's type.
fn put(field: &impl Wire, kind: u8, to: &mut Writer) -> u8 {
    field.encode(to);
    kind
}

/// One message, not decoded yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Framed {
    /// Its type.
    pub kind: u8,
    /// Its body.
    pub body: Vec<u8>,
}

/// Splits a stream of bytes into messages. Holds at most one unfinished message and the bytes received with it.
#[derive(Debug, Default)]
pub struct Frames {
    buffer: Vec<u8>,
    /// The pieces of a long body so far.
    pieces: Vec<u8>,
    /// Bytes at the front of the buffer that were returned already.
    taken: usize,
}

impl Frames {
    /// A buffer without bytes.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: Vec::new(),
            pieces: Vec::new(),
            taken: 0,
        }
    }

    /// Appends the next bytes of the stream, cut at any place.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.taken > 0 {
            self.buffer.drain(..self.taken);
            self.taken = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// Bytes that no returned message has used.
    #[must_use]
    pub const fn unread_bytes(&self) -> usize {
        self.buffer.len() - self.taken
    }

    /// The next whole message, or `None` until more bytes come.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when the front cannot be a message; nothing after it can be decoded either.
    pub fn next_frame(&mut self) -> Result<Option<Framed>, Malformed> {
        while let Some(framed) = self.next_one()? {
            if framed.kind == PIECE {
                self.keep(&framed.body)?;
            } else if self.pieces.is_empty() {
                return Ok(Some(framed));
            } else {
                return self.joined(framed).map(Some);
            }
        }
        Ok(None)
    }

    /// Keeps a piece until its message comes.
    fn keep(&mut self, piece: &[u8]) -> Result<(), Malformed> {
        if piece.len() != MESSAGE_BYTES_MAX {
            return Err(Malformed::NotCanonical);
        }
        if self.pieces.len() + piece.len() > LONG_MESSAGE_BYTES_MAX {
            return Err(Malformed::TooLong);
        }
        self.pieces.extend_from_slice(piece);
        Ok(())
    }

    /// A message joined with the pieces before it.
    fn joined(&mut self, last: Framed) -> Result<Framed, Malformed> {
        let mut body = core::mem::take(&mut self.pieces);
        if last.body.is_empty() {
            return Err(Malformed::NotCanonical);
        }
        if body.len() + last.body.len() > LONG_MESSAGE_BYTES_MAX {
            return Err(Malformed::TooLong);
        }
        body.extend_from_slice(&last.body);
        Ok(Framed {
            kind: last.kind,
            body,
        })
    }

    /// The next message or piece.
    fn next_one(&mut self) -> Result<Option<Framed>, Malformed> {
        let mut reader = Reader::new(&self.buffer[self.taken..]);
        let length = match reader.varint_to(MESSAGE_BYTES_MAX as u64 + 1) {
            Ok(0) => return Err(Malformed::OutOfRange),
            Ok(length) => length as usize,
            Err(Malformed::Truncated) => return Ok(None),
            Err(Malformed::OutOfRange) => return Err(Malformed::TooLong),
            Err(malformed) => return Err(malformed),
        };
        let Ok(message) = reader.raw(length) else {
            return Ok(None);
        };
        let framed = Framed {
            kind: message[0],
            body: message[1..].to_vec(),
        };
        self.taken = self.buffer.len() - reader.rest().len();
        Ok(Some(framed))
    }
}

#[cfg(test)]
mod tests {
    use core::fmt;

    use proptest::prelude::*;

    use super::*;

    /// Checks that a value round-trips through these bytes, and that every truncation is refused.
    pub(super) fn round_trips<T: Wire + PartialEq + fmt::Debug>(value: &T, bytes: &[u8]) {
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

    proptest! {
        #[test]
        fn messages_round_trip_however_the_stream_is_cut(
            bodies in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..300), 0..8),
            cut in 1_usize..64,
        ) {
            let mut stream = Vec::new();
            for body in &bodies {
                frame(7, body, &mut stream);
            }
            let mut frames = Frames::default();
            let mut received = Vec::new();
            for chunk in stream.chunks(cut) {
                frames.push(chunk);
                while let Some(framed) = frames.next_frame().unwrap() {
                    prop_assert_eq!(framed.kind, 7);
                    received.push(framed.body);
                }
            }
            prop_assert_eq!(received, bodies);
        }
    }

    #[test]
    fn a_long_message_is_sent_in_pieces_and_joined_again() {
        for length in [
            MESSAGE_BYTES_MAX,
            MESSAGE_BYTES_MAX + 1,
            2 * MESSAGE_BYTES_MAX,
            LONG_MESSAGE_BYTES_MAX,
        ] {
            let body: Vec<u8> = (0..length).map(|place| place as u8).collect();
            let mut stream = Vec::new();
            frame(7, &body, &mut stream);
            frame(8, &[1], &mut stream);
            let mut frames = Frames::default();
            let mut received = Vec::new();
            for chunk in stream.chunks(10_000) {
                frames.push(chunk);
                while let Some(framed) = frames.next_frame().unwrap() {
                    received.push((framed.kind, framed.body));
                }
            }
            assert_eq!(received, [(7, body), (8, [1].to_vec())]);
        }
    }

    #[test]
    fn short_unfinished_or_needless_pieces_are_refused() {
        let full = [0; MESSAGE_BYTES_MAX];
        let read = |parts: &[(u8, &[u8])]| {
            let mut stream = Vec::new();
            for (kind, body) in parts {
                frame_one(*kind, body, &mut stream);
            }
            let mut frames = Frames::default();
            frames.push(&stream);
            frames.next_frame()
        };
        assert_eq!(read(&[(PIECE, &[1])]), Err(Malformed::NotCanonical));
        assert_eq!(
            read(&[(PIECE, &full), (7, &[])]),
            Err(Malformed::NotCanonical)
        );
        assert_eq!(read(&[(PIECE, &full)]), Ok(None));
        let many = [(PIECE, &full[..]); LONG_MESSAGE_BYTES_MAX / MESSAGE_BYTES_MAX + 1];
        assert_eq!(read(&many), Err(Malformed::TooLong));
    }

    #[test]
    fn a_message_of_zero_or_excessive_length_is_refused() {
        let mut frames = Frames::default();
        frames.push(&[0]);
        assert_eq!(frames.next_frame(), Err(Malformed::OutOfRange));
        let mut frames = Frames::default();
        frames.push(&[0xff, 0xff, 0xff, 0x0f]);
        assert_eq!(frames.next_frame(), Err(Malformed::TooLong));
    }
}
