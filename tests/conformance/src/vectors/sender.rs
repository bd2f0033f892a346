//! The side that sends a message, and how the codec reads it.

use rhumb_protocol::limits::MESSAGE_BYTES_MAX;
use rhumb_protocol::message::{ClientMessage, Framed, ServerMessage, frame};
use rhumb_protocol::scene::{Command, Invalid, Quantity, Rule};
use rhumb_protocol::wire::Malformed;
use rhumb_protocol::wire::bytes::Writer;
use serde_json::{Value, json};

/// The sender of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sender {
    /// A client.
    Client,
    /// A server.
    Server,
}

/// The result of decoding a message.
#[derive(Clone, Debug, PartialEq)]
pub enum Decoded {
    /// Valid, and encoded as it was; contains the number that the server must refuse, if any.
    Accepted(Option<Invalid>),
    /// An unknown optional message, which is skipped.
    Skipped,
    /// An unknown command, which is refused.
    UnknownCommand,
    /// A command with an invalid motion, which is refused.
    NoMotion(Quantity),
    /// Malformed.
    Refused(Malformed),
}

impl Sender {
    /// The table's name for this side's messages.
    #[must_use]
    pub const fn type_name(self) -> &'static str {
        match self {
            Self::Client => "client message",
            Self::Server => "server message",
        }
    }

    /// The codec's result for a message.
    ///
    /// # Panics
    ///
    /// When a decoded message is not encoded as it was.
    #[must_use]
    pub fn outcome(self, kind: u8, body: &[u8]) -> Decoded {
        let framed = Framed {
            kind,
            body: body.to_vec(),
        };
        let mut written = Vec::new();
        let invalid = match self {
            Self::Client => match ClientMessage::decode(&framed) {
                Ok(Some(message)) => {
                    message.encode(&mut written);
                    check(&message)
                }
                Ok(None) => return Decoded::Skipped,
                Err(Malformed::UnknownCommand) => return Decoded::UnknownCommand,
                Err(Malformed::Motion(invalid)) => {
                    return Decoded::NoMotion(Invalid::from(invalid).quantity);
                }
                Err(malformed) => return Decoded::Refused(malformed),
            },
            Self::Server => match ServerMessage::decode(&framed) {
                Ok(Some(message)) => {
                    message.encode(&mut written);
                    None
                }
                Ok(None) => return Decoded::Skipped,
                Err(malformed) => return Decoded::Refused(malformed),
            },
        };
        assert_eq!(
            written,
            framed_bytes(kind, body),
            "each value has one encoding"
        );
        Decoded::Accepted(invalid)
    }
}

/// The number for which the server must refuse a well-formed message.
fn check(message: &ClientMessage) -> Option<Invalid> {
    match message {
        ClientMessage::Command(command) => Command::check(command).err(),
        ClientMessage::Create(config) => config.check().err(),
        ClientMessage::Query(queries) => queries.iter().find_map(|query| query.check().err()),
        _ => None,
    }
}

/// A message as bytes of the control stream.
#[must_use]
pub fn framed_bytes(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    frame(kind, body, &mut bytes);
    bytes
}

/// A message of any length, also above the greatest, as bytes of the control stream.
#[must_use]
pub fn in_pieces(kind: u8, body: &[u8]) -> Vec<u8> {
    let rest = body.len().saturating_sub(1) / MESSAGE_BYTES_MAX * MESSAGE_BYTES_MAX;
    let mut to = Writer::new();
    let pieces = body[..rest].chunks(MESSAGE_BYTES_MAX);
    for (kind, body) in pieces
        .map(|piece| (0, piece))
        .chain([(kind, &body[rest..])])
    {
        to.varint(body.len() as u64 + 1);
        to.u8(kind);
        to.raw(body);
    }
    to.into_bytes()
}

/// The error that answers a message with such a number.
#[must_use]
pub fn error_json(invalid: Invalid) -> Value {
    let rule = match invalid.rule {
        Rule::NotFinite => "NotFinite",
        Rule::OutOfRange => "OutOfRange",
    };
    json!({"is": rule, "quantity": invalid.quantity.code()})
}
