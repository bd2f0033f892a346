//! Frames of a Unix stream: a lane, a length, bytes.

use bytes::{Buf, BufMut, Bytes, BytesMut};

/// Most bytes of one frame.
pub(super) const FRAME_BYTES_MAX: usize = 64 << 10;
/// Bytes of a frame before its payload.
const HEAD_BYTES: usize = 5;

/// Numbers of the lanes.
const CONTROL: u8 = 0;
const STATE: u8 = 1;
const END: u8 = 2;

/// One frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum StreamFrame {
    /// The next bytes of the control stream.
    Control(Bytes),
    /// One state datagram.
    State(Bytes),
    /// The sender has closed the connection, with this code.
    End(u32),
}

/// The bytes cannot be frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct InvalidFrame;

/// Cuts a stream into frames.
#[derive(Debug, Default)]
pub(super) struct FrameReader {
    bytes: BytesMut,
}

impl StreamFrame {
    /// The frame's bytes on the stream.
    pub(super) fn encode(&self) -> Bytes {
        let (lane, payload) = match self {
            Self::Control(bytes) => (CONTROL, bytes.as_ref()),
            Self::State(bytes) => (STATE, bytes.as_ref()),
            Self::End(code) => (END, &code.to_le_bytes()[..]),
        };
        let mut out = BytesMut::with_capacity(HEAD_BYTES + payload.len());
        out.put_u8(lane);
        out.put_u32_le(u32::try_from(payload.len()).unwrap_or(u32::MAX));
        out.put_slice(payload);
        out.freeze()
    }
}

impl FrameReader {
    /// Adds received bytes.
    pub(super) fn put(&mut self, bytes: &[u8]) {
        self.bytes.put_slice(bytes);
    }

    /// The next whole frame.
    pub(super) fn next(&mut self) -> Result<Option<StreamFrame>, InvalidFrame> {
        let Some(head) = self.bytes.get(..HEAD_BYTES) else {
            return Ok(None);
        };
        let lane = head[0];
        let length = u32::from_le_bytes([head[1], head[2], head[3], head[4]]) as usize;
        if lane > END || length > FRAME_BYTES_MAX {
            return Err(InvalidFrame);
        }
        if self.bytes.len() < HEAD_BYTES + length {
            return Ok(None);
        }
        self.bytes.advance(HEAD_BYTES);
        let mut payload = self.bytes.split_to(length).freeze();
        match lane {
            CONTROL => Ok(Some(StreamFrame::Control(payload))),
            STATE => Ok(Some(StreamFrame::State(payload))),
            _ if length == size_of::<u32>() => Ok(Some(StreamFrame::End(payload.get_u32_le()))),
            _ => Err(InvalidFrame),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_cut_anywhere_has_the_same_frames() {
        let frames = [
            StreamFrame::Control(Bytes::from_static(b"hello")),
            StreamFrame::State(Bytes::new()),
            StreamFrame::State(Bytes::from(vec![7; FRAME_BYTES_MAX])),
            StreamFrame::End(0x104),
        ];
        let stream: Vec<u8> = frames.iter().flat_map(StreamFrame::encode).collect();
        for step in [1, 2, 7, 4_096, stream.len()] {
            let mut reader = FrameReader::default();
            let mut read = Vec::new();
            for piece in stream.chunks(step) {
                reader.put(piece);
                while let Some(frame) = reader.next().expect("valid frames") {
                    read.push(frame);
                }
            }
            assert_eq!(read, frames);
        }
    }

    #[test]
    fn frames_of_no_lane_and_of_too_many_bytes_are_invalid() {
        for bytes in [
            [3, 0, 0, 0, 0],
            [CONTROL, 0xff, 0xff, 0xff, 0xff],
            [STATE, 1, 0, 1, 0],
            [END, 0, 0, 0, 0],
        ] {
            let mut reader = FrameReader::default();
            reader.put(&bytes);
            assert_eq!(reader.next(), Err(InvalidFrame), "{bytes:?}");
        }
    }
}
