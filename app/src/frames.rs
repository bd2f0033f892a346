//! Where one message on a stream ends and the next begins.
//!
//! The published plug-in sends torques without a header: 24 zero bytes, then 20 of body. Such a one is read as what it is
//! meant to be; whoever trusted its length of zero would lose the stream.

use alloc::vec::Vec;

use crate::header::{HEADER_BYTES, Header};
use crate::kind::Kind;
use crate::malformed::Malformed;
use crate::message::Message;
use crate::wire::Reader;

/// A message, with its sender's counter.
#[derive(Clone, Debug, PartialEq)]
pub struct Framed {
    /// The counter, as it came.
    pub index: u32,
    /// The message.
    pub message: Message,
}

/// Cuts a stream of bytes into messages. Holds at most one unfinished message and what came with it.
#[derive(Debug, Default)]
pub struct Frames {
    buffer: Vec<u8>,
    /// Bytes at the front of the buffer that were handed out already.
    taken: usize,
}

impl Frames {
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
    pub fn next_message(&mut self) -> Result<Option<Framed>, Malformed> {
        let front = &self.buffer[self.taken..];
        let Some(head) = front.first_chunk::<HEADER_BYTES>() else {
            return Ok(None);
        };
        let header = if *head == [0; HEADER_BYTES] {
            Header {
                kind: Kind::ApplyTorque,
                index: 0,
                length: TORQUE_BYTES,
            }
        } else {
            Header::take(&mut Reader::new(head))?
        };
        let Some(body) = front.get(HEADER_BYTES..header.length) else {
            return Ok(None);
        };
        let message = Message::decode(header.kind, body)?;
        self.taken += header.length;
        Ok(Some(Framed {
            index: header.index,
            message,
        }))
    }
}

/// A torque, header included.
const TORQUE_BYTES: usize = HEADER_BYTES + 20;
