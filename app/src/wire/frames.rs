//! Framing: splits a byte stream into messages.
//!
//! The published plug-in sends torques without a header: 24 zero bytes, then 20 of body. Such bytes are decoded as a
//! torque: a length of zero would lose the stream.

use super::codec::FieldReader;
use super::header::Header;
use super::kind::Kind;
use super::limits::HEADER_BYTES;
use super::malformed::MalformedMessage;
use super::message::Message;

/// A message, with its sender's counter.
#[derive(Clone, Debug, PartialEq)]
pub struct FramedMessage {
    /// The counter, as received.
    pub index: u32,
    /// The message.
    pub message: Message,
}

/// Splits a stream of bytes into messages. Holds at most one unfinished message and the bytes received with it.
#[derive(Debug, Default)]
pub struct MessageFraming {
    buffer: Vec<u8>,
    /// Bytes at the front of the buffer that are decoded already.
    taken: usize,
}

impl MessageFraming {
    /// Appends the next bytes of the stream, cut at any place.
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
    /// [`MalformedMessage`] when the front cannot be a message; nothing after it can be decoded either.
    pub fn next_message(&mut self) -> Result<Option<FramedMessage>, MalformedMessage> {
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
            Header::take(&mut FieldReader::new(head))?
        };
        let Some(body) = front.get(HEADER_BYTES..header.length) else {
            return Ok(None);
        };
        let message = Message::decode(header.kind, body)?;
        self.taken += header.length;
        Ok(Some(FramedMessage {
            index: header.index,
            message,
        }))
    }
}

/// Bytes of a torque, header included.
const TORQUE_BYTES: usize = HEADER_BYTES + 20;
