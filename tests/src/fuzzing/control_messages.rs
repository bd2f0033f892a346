//! Control messages of either side, from any bytes.
//!
//! Promises: however a stream is cut, the same is read of it; what is read is written again as it was; and the table of
//! the specification has every message that the codec has.

use std::sync::LazyLock;

use rhumb_protocol::message::{Framed, Frames, frame};
use rhumb_protocol::wire::Malformed;

use crate::grammar::Grammar;
use crate::vectors::{Decoded, Sender};

/// Longer bodies are left to the codec: the table's reader is made to be read.
const BODY_BYTES_OF_THE_TABLE: usize = 2_000;

static GRAMMAR: LazyLock<Grammar> = LazyLock::new(Grammar::load);

/// What a client says. The first byte says how the rest is cut.
pub fn client_messages(data: &[u8]) {
    check(Sender::Client, data);
}

/// What a server says. The first byte says how the rest is cut.
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
        "it reads otherwise in pieces"
    );
    let mut again = Vec::new();
    for Framed { kind, body } in &framed {
        frame(*kind, body, &mut again);
        check_message(side, *kind, body);
    }
    assert!(stream.starts_with(&again), "a length has one form");
}

/// The messages of a stream that comes in pieces, and why there are no more, if it cannot go on.
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

/// The outcome itself holds that what is read is written alike.
fn check_message(side: Sender, kind: u8, body: &[u8]) {
    let outcome = side.outcome(kind, body);
    if body.len() > BODY_BYTES_OF_THE_TABLE {
        return;
    }
    let mut message = vec![kind];
    message.extend_from_slice(body);
    let by_table = GRAMMAR.read(side.type_name(), &message);
    // The table does not tell what numbers mean together, so that it reads more.
    let is_said = !matches!(outcome, Decoded::Refused(_));
    assert!(
        by_table.is_ok() || !is_said,
        "{by_table:?}, but the codec {outcome:?}"
    );
}
