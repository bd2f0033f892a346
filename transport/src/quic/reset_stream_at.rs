//! Resets of streams with partial delivery, for a QUIC library without them.
//!
//! A frame RESET_STREAM_AT resets a stream and has the peer deliver its first bytes all the same: the bytes in which
//! WebTransport names the session. This protocol has no use for any byte of a stream that was reset, so that its end may
//! take such a frame for a plain RESET_STREAM, which every library knows. An end never sends one: it opens no stream
//! that has such bytes. Source: draft-ietf-quic-reliable-stream-reset, sections 3 and 4; RFC 9000, section 19.

use std::mem;

/// The numbers of the transport parameter by which an end allows the frame: the registered one, and that of drafts.
pub(super) const PARAMETERS: [u64; 2] = [0x1d, 0x17_f758_6d2c_b571];

const RESET_STREAM: u8 = 0x04;
const RESET_STREAM_AT: u8 = 0x24;

/// Turns each RESET_STREAM_AT among the frames of a packet into a RESET_STREAM with padding behind it.
///
/// An invalid one stays: the library then closes the connection, as it must.
pub(super) fn make_plain(mut frames: &mut [u8]) {
    while let Some(length) = frame_length(frames) {
        let (frame, rest) = mem::take(&mut frames).split_at_mut(length);
        if frame[0] == RESET_STREAM_AT {
            make_reset_plain(frame);
        }
        frames = rest;
    }
}

fn make_reset_plain(frame: &mut [u8]) {
    let mut numbers = PacketReader { rest: &frame[1..] };
    // Stream, code, and the length of the whole stream.
    let Some((_, _, final_size)) = numbers.three() else {
        return;
    };
    let padded = numbers.rest.len();
    if numbers
        .number()
        .is_some_and(|reliable| reliable <= final_size)
    {
        frame[0] = RESET_STREAM;
        let kept = frame.len() - padded;
        // A byte of zero is a frame PADDING.
        frame[kept..].fill(0);
    }
}

/// Bytes of the first of some frames; `None` for no frame, for one that is cut off, and for one of another extension.
fn frame_length(frames: &[u8]) -> Option<usize> {
    let mut reader = PacketReader { rest: frames };
    match reader.number()? {
        // PADDING, PING, HANDSHAKE_DONE.
        0x00 | 0x01 | 0x1e => {}
        // ACK: the largest, the delay, further ranges; then the first range and two numbers for each further one.
        kind @ 0x02..=0x03 => {
            let (_, _, ranges) = reader.three()?;
            reader.numbers(ranges.saturating_mul(2).saturating_add(1))?;
            reader.numbers(if kind == 0x03 { 3 } else { 0 })?;
        }
        // RESET_STREAM.
        0x04 => reader.numbers(3)?,
        // STOP_SENDING, MAX_STREAM_DATA, STREAM_DATA_BLOCKED.
        0x05 | 0x11 | 0x15 => reader.numbers(2)?,
        // CRYPTO.
        0x06 => {
            reader.number()?;
            reader.counted()?;
        }
        // NEW_TOKEN, DATAGRAM with its length.
        0x07 | 0x31 => reader.counted()?,
        // STREAM, with or without its offset and its length.
        kind @ 0x08..=0x0f => {
            reader.numbers(if kind & 0x04 == 0 { 1 } else { 2 })?;
            match kind & 0x02 {
                0 => reader.rest = &[],
                _ => reader.counted()?,
            }
        }
        // MAX_DATA, MAX_STREAMS, DATA_BLOCKED, STREAMS_BLOCKED, RETIRE_CONNECTION_ID.
        0x10 | 0x12..=0x14 | 0x16 | 0x17 | 0x19 => reader.numbers(1)?,
        // NEW_CONNECTION_ID: two numbers, the id by its length, a token.
        0x18 => {
            reader.numbers(2)?;
            let (&length, rest) = reader.rest.split_first()?;
            reader.rest = rest;
            reader.skip(usize::from(length) + 16)?;
        }
        // PATH_CHALLENGE, PATH_RESPONSE.
        0x1a | 0x1b => reader.skip(8)?,
        // CONNECTION_CLOSE of the transport, and of the application.
        kind @ 0x1c..=0x1d => {
            reader.numbers(if kind == 0x1c { 2 } else { 1 })?;
            reader.counted()?;
        }
        // RESET_STREAM_AT.
        0x24 => reader.numbers(4)?,
        // DATAGRAM, to the end of the packet.
        0x30 => reader.rest = &[],
        _ => return None,
    }
    Some(frames.len() - reader.rest.len())
}

/// Reads numbers of QUIC; `None` where they are cut off.
struct PacketReader<'a> {
    rest: &'a [u8],
}

impl PacketReader<'_> {
    fn number(&mut self) -> Option<u64> {
        let length = 1 << (self.rest.first()? >> 6);
        let (bytes, rest) = self.rest.split_at_checked(length)?;
        self.rest = rest;
        let first = u64::from(bytes[0] & 0x3f);
        let more = bytes[1..].iter();
        Some(more.fold(first, |number, byte| number << 8 | u64::from(*byte)))
    }

    fn three(&mut self) -> Option<(u64, u64, u64)> {
        Some((self.number()?, self.number()?, self.number()?))
    }

    /// Passes numbers over. As many as a peer claims: each takes a byte at least.
    fn numbers(&mut self, count: u64) -> Option<()> {
        (0..count).try_for_each(|_| self.number().map(drop))
    }

    fn skip(&mut self, bytes: usize) -> Option<()> {
        self.rest = self.rest.get(bytes..)?;
        Some(())
    }

    /// Passes bytes behind their count over.
    fn counted(&mut self) -> Option<()> {
        let bytes = usize::try_from(self.number()?).ok()?;
        self.skip(bytes)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// A frame of each kind of RFC 9000 and RFC 9221 that says where it ends, with bytes like RESET_STREAM_AT inside.
    const FRAMES: &[&[u8]] = &[
        &[0x00],
        &[0x01],
        &[0x02, 0x24, 0x00, 0x02, 0x24, 0x01, 0x01, 0x24, 0x24],
        &[0x03, 0x40, 0x24, 0x00, 0x00, 0x24, 0x24, 0x24, 0x24],
        &[0x04, 0x24, 0x24, 0x24],
        &[0x05, 0x24, 0x24],
        &[0x06, 0x24, 0x02, 0x24, 0x24],
        &[0x07, 0x03, 0x24, 0x24, 0x24],
        &[0x0a, 0x04, 0x02, 0x24, 0x04],
        &[0x0f, 0x04, 0x24, 0x03, 0x24, 0x00, 0x00],
        &[0x10, 0x80, 0x00, 0x24, 0x24],
        &[0x11, 0x24, 0x24],
        &[0x12, 0x24],
        &[0x13, 0x24],
        &[0x14, 0x24],
        &[0x15, 0x24, 0x24],
        &[0x16, 0x24],
        &[0x17, 0x24],
        &[
            0x18, 0x24, 0x00, 0x02, 0x24, 0x24, // the id; a token follows
            0x24, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x24,
        ],
        &[0x19, 0x24],
        &[0x1a, 0x24, 0, 0, 0, 0, 0, 0, 0x24],
        &[0x1b, 0x24, 0, 0, 0, 0, 0, 0, 0x24],
        &[0x1c, 0x24, 0x24, 0x01, 0x24],
        &[0x1d, 0x24, 0x02, 0x24, 0x24],
        &[0x1e],
        &[0x31, 0x03, 0x24, 0x24, 0x24],
    ];

    /// The reset of stream 4 with code 0x170d7b68 after 700 bytes, the first three of which are to be delivered.
    const AT: &[u8] = &[0x24, 0x04, 0x97, 0x0d, 0x7b, 0x68, 0x42, 0xbc, 0x03];
    const PLAIN: &[u8] = &[0x04, 0x04, 0x97, 0x0d, 0x7b, 0x68, 0x42, 0xbc, 0x00];

    #[test]
    fn a_reset_behind_any_frame_becomes_plain_and_the_other_bytes_stay() {
        for before in FRAMES {
            for after in FRAMES {
                let mut frames = [before, AT, AT, after].concat();
                make_plain(&mut frames);
                assert_eq!(frames, [*before, PLAIN, PLAIN, after].concat());
            }
        }
    }

    #[test]
    fn bytes_behind_a_frame_without_an_end_are_its_own() {
        for kind in [0x08, 0x09, 0x0c, 0x30] {
            let open = [&[kind, 0x04, 0x05], AT].concat();
            let mut frames = open.clone();
            make_plain(&mut frames);
            assert_eq!(frames, open);
        }
    }

    #[test]
    fn an_invalid_reset_and_what_follows_an_unknown_frame_stay() {
        let beyond_the_end: &[u8] = &[0x24, 0x04, 0x00, 0x03, 0x04];
        for kept in [beyond_the_end, &AT[..AT.len() - 1], &[0x24]] {
            let mut frames = kept.to_vec();
            make_plain(&mut frames);
            assert_eq!(frames, kept);
        }
        // A number of two bytes, and the same kind in more bytes than it needs.
        for unknown in [&[0x40, 0xaf], &[0x40, 0x24]] {
            let kept = [unknown, AT].concat();
            let mut frames = kept.clone();
            make_plain(&mut frames);
            assert_eq!(frames[..2], kept[..2]);
        }
    }

    proptest! {
        #[test]
        fn any_bytes_keep_their_length_and_a_second_pass_changes_nothing(bytes: Vec<u8>) {
            let mut once = bytes.clone();
            make_plain(&mut once);
            prop_assert_eq!(once.len(), bytes.len());
            let mut twice = once.clone();
            make_plain(&mut twice);
            prop_assert_eq!(twice, once);
        }
    }
}
