//! Where one control message ends and the next begins.
//!
//! A message is its length (a variable integer that counts type and body), a type byte, and a body. Types from 0x80 on
//! may be ignored by who does not know them; others may not (PROTOCOL 4.1).

use alloc::vec::Vec;

use crate::limits::MESSAGE_BYTES_MAX;
use crate::wire::Malformed;
use crate::wire::bytes::{Reader, Writer};

/// Appends one message.
///
/// # Panics
///
/// When the body is longer than the limit: the caller is one of us.
pub fn frame(kind: u8, body: &[u8], to: &mut Vec<u8>) {
    assert!(body.len() <= MESSAGE_BYTES_MAX, "a message fits its limit");
    let mut writer = Writer::new();
    writer.varint(body.len() as u64 + 1);
    writer.u8(kind);
    writer.raw(body);
    to.extend_from_slice(&writer.into_bytes());
}

/// One message, still in its bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Framed {
    /// Its type.
    pub kind: u8,
    /// Its body.
    pub body: Vec<u8>,
}

/// Cuts a stream of bytes into messages. Holds at most one unfinished message and what came with it.
#[derive(Debug, Default)]
pub struct Frames {
    buffer: Vec<u8>,
    /// Bytes at the front of the buffer that were handed out already.
    taken: usize,
}

impl Frames {
    /// Nothing came yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            buffer: Vec::new(),
            taken: 0,
        }
    }

    /// The next bytes of the stream, cut anywhere.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.taken > 0 {
            self.buffer.drain(..self.taken);
            self.taken = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole message, or `None` until more bytes come.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when the front cannot be a message; nothing after it can be read either.
    pub fn next_frame(&mut self) -> Result<Option<Framed>, Malformed> {
        let mut reader = Reader::new(&self.buffer[self.taken..]);
        let length = match reader.varint_to(MESSAGE_BYTES_MAX as u64 + 1) {
            Ok(0) => return Err(Malformed::OutOfRange),
            Ok(length) => length as usize,
            Err(Malformed::Truncated) => return Ok(None),
            Err(Malformed::OutOfRange) => return Err(Malformed::TooLong),
            Err(malformed) => return Err(malformed),
        };
        let Ok(whole) = reader.raw(length) else {
            return Ok(None);
        };
        let framed = Framed {
            kind: whole[0],
            body: whole[1..].to_vec(),
        };
        self.taken = self.buffer.len() - reader.rest().len();
        Ok(Some(framed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn messages_come_back_however_the_stream_is_cut(
            bodies in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..300), 0..8),
            cut in 1_usize..64,
        ) {
            let mut stream = Vec::new();
            for body in &bodies {
                frame(7, body, &mut stream);
            }
            let mut frames = Frames::default();
            let mut heard = Vec::new();
            for chunk in stream.chunks(cut) {
                frames.push(chunk);
                while let Some(framed) = frames.next_frame().unwrap() {
                    prop_assert_eq!(framed.kind, 7);
                    heard.push(framed.body);
                }
            }
            prop_assert_eq!(heard, bodies);
        }
    }

    #[test]
    fn a_message_of_no_length_or_too_much_is_refused() {
        let mut frames = Frames::default();
        frames.push(&[0]);
        assert_eq!(frames.next_frame(), Err(Malformed::OutOfRange));
        let mut frames = Frames::default();
        frames.push(&[0xff, 0xff, 0xff, 0x0f]);
        assert_eq!(frames.next_frame(), Err(Malformed::TooLong));
    }
}
