//! Fuzzes the decoders of control messages of both sides with arbitrary bytes.
//!
//! Promises: messages are decoded the same however a stream is split. A decoded message is encoded as it was. The
//! table of the specification contains every message of the codec.

use std::sync::LazyLock;

use rhumb_protocol::message::{Framed, Frames, frame};
use rhumb_protocol::wire::Malformed;

use rhumb_conformance::grammar::Grammar;
use rhumb_conformance::vectors::{Decoded, Sender};

/// Longer bodies are decoded by the codec only: the table decoder is written for readability, not speed.
const BODY_BYTES_OF_THE_TABLE: usize = 2_000;

static GRAMMAR: LazyLock<Grammar> = LazyLock::new(Grammar::load);

/// Messages of a client. The first byte selects how the rest is split.
pub fn client_messages(data: &[u8]) {
    check(Sender::Client, data);
}

/// Messages of a server. The first byte selects how the rest is split.
pub fn server_messages(data: &[u8]) {
    check(Sender::Server, data);
}

fn check(side: Sender, data: &[u8]) {
    let Some((cut, stream)) = data.split_first() else {
        return;
    };
    let (framed, end) = read(stream, stream.len().max(1));
    let in_pieces = read(stream, usize::from(*cut).max(1));
    assert!(
        in_pieces.0 == framed && in_pieces.1 == end,
        "the pieces decode differently"
    );
    let mut again = Vec::new();
    for Framed { kind, body } in &framed {
        frame(*kind, body, &mut again);
        check_message(side, *kind, body);
    }
    assert!(stream.starts_with(&again), "a length has one encoding");
}

/// The messages of a stream that is split into pieces, and the error that ended it, if any.
fn read(stream: &[u8], piece: usize) -> (Vec<Framed>, Option<Malformed>) {
    let (mut frames, mut all) = (Frames::new(), Vec::new());
    for bytes in stream.chunks(piece) {
        frames.push(bytes);
        loop {
            match frames.next_frame() {
                Ok(Some(framed)) => all.push(framed),
                Ok(None) => break,
                Err(malformed) => return (all, Some(malformed)),
            }
        }
    }
    (all, None)
}

/// `Sender::outcome` itself checks that a decoded message is encoded as it was.
fn check_message(side: Sender, kind: u8, body: &[u8]) {
    let outcome = side.outcome(kind, body);
    if body.len() > BODY_BYTES_OF_THE_TABLE {
        return;
    }
    let mut message = vec![kind];
    message.extend_from_slice(body);
    let by_table = GRAMMAR.read(side.type_name(), &message);
    // The table does not express constraints between numbers, so it accepts more.
    let is_accepted = !matches!(outcome, Decoded::Refused(_));
    assert!(
        by_table.is_ok() || !is_accepted,
        "the table says {by_table:?}, the codec {outcome:?}"
    );
}
