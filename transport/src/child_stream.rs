//! Frames between a process and its child: a length, and as many bytes.
//!
//! The stream is the child's standard input, and carries both directions. No bytes are interpreted here. Invariants: the
//! parent never waits when it sends; neither end takes a frame of more than [`CHILD_FRAME_BYTES_MAX`].

use std::collections::VecDeque;
use std::io::{self, IoSlice, Read, Write};
use std::net::Shutdown;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::sync::{Mutex, PoisonError};

use bytes::{BufMut, Bytes, BytesMut};
use rustix::io::Errno;
use rustix::net::{SendFlags, send};

/// Most bytes of one frame.
pub const CHILD_FRAME_BYTES_MAX: usize = 8 << 20;
/// Bytes of a frame before its payload.
const HEAD_BYTES: usize = 4;
/// Bytes of one read.
const READ_BYTES: usize = 256 << 10;

/// The parent's sending end. Frames that the stream does not take wait here.
#[derive(Debug)]
pub struct ChildSender {
    stream: UnixStream,
    waiting: VecDeque<Bytes>,
}

/// A receiving end, of the parent or of the child.
#[derive(Debug)]
pub struct FrameReceiver {
    stream: UnixStream,
    bytes: BytesMut,
    buffer: Box<[u8]>,
}

/// The child's sending end, which several threads may share.
#[derive(Debug)]
pub struct ParentSender(Mutex<UnixStream>);

/// The parent's ends of a stream, and the standard input of a child that is to be started.
///
/// # Errors
///
/// The system's, if it has no descriptors left.
pub fn child_stream() -> io::Result<(ChildSender, FrameReceiver, OwnedFd)> {
    let (own, of_child) = UnixStream::pair()?;
    let sender = ChildSender {
        stream: own.try_clone()?,
        waiting: VecDeque::new(),
    };
    Ok((sender, FrameReceiver::new(own), of_child.into()))
}

/// The child's ends of the stream at its standard input.
///
/// # Errors
///
/// The system's, if it has no descriptors left.
pub fn parent_stream() -> io::Result<(ParentSender, FrameReceiver)> {
    let input = io::stdin().as_fd().try_clone_to_owned()?;
    let stream = UnixStream::from(input);
    let receiver = FrameReceiver::new(stream.try_clone()?);
    Ok((ParentSender(Mutex::new(stream)), receiver))
}

impl ChildSender {
    /// Sends a frame, now or by a later call. A child that has ended gets nothing.
    pub fn send(&mut self, payload: &[u8]) {
        let mut frame = BytesMut::with_capacity(HEAD_BYTES + payload.len());
        frame.put_slice(&head(payload));
        frame.put_slice(payload);
        self.waiting.push_back(frame.freeze());
        self.flush();
    }

    /// Tries again to send what waits.
    pub fn flush(&mut self) {
        while let Some(frame) = self.waiting.front_mut() {
            let flags = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
            match send(&self.stream, frame, flags) {
                Ok(sent) if sent == frame.len() => drop(self.waiting.pop_front()),
                Ok(sent) => *frame = frame.slice(sent..),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return,
                // The receiving end learns that the child has ended.
                Err(_) => self.waiting.clear(),
            }
        }
    }

    /// Number of frames that the stream has not taken.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }
}

impl Drop for ChildSender {
    /// Ends the stream towards the child, which ends by that.
    fn drop(&mut self) {
        // A stream whose other end is gone is ended already.
        let _ = self.stream.shutdown(Shutdown::Write);
    }
}

impl FrameReceiver {
    fn new(stream: UnixStream) -> Self {
        Self {
            stream,
            bytes: BytesMut::new(),
            buffer: vec![0; READ_BYTES].into_boxed_slice(),
        }
    }

    /// Waits for the next frame; `None` when the other end has ended.
    ///
    /// # Errors
    ///
    /// The system's, and [`io::ErrorKind::InvalidData`] for a frame that is too long.
    pub fn receive(&mut self) -> io::Result<Option<Bytes>> {
        loop {
            if let Some(head) = self.bytes.first_chunk::<HEAD_BYTES>() {
                let length = u32::from_le_bytes(*head) as usize;
                if length > CHILD_FRAME_BYTES_MAX {
                    return Err(io::ErrorKind::InvalidData.into());
                }
                if self.bytes.len() >= HEAD_BYTES + length {
                    let frame = self.bytes.split_to(HEAD_BYTES + length).freeze();
                    return Ok(Some(frame.slice(HEAD_BYTES..)));
                }
            }
            match self.stream.read(&mut self.buffer) {
                Ok(0) => return Ok(None),
                Ok(read) => self.bytes.put_slice(&self.buffer[..read]),
                Err(cause) if cause.kind() == io::ErrorKind::Interrupted => {}
                Err(cause) => return Err(cause),
            }
        }
    }
}

impl ParentSender {
    /// Sends a frame; waits while the parent does not read.
    ///
    /// # Errors
    ///
    /// The system's, if the parent has ended.
    pub fn send(&self, payload: &[u8]) -> io::Result<()> {
        // A frame is written whole, or the stream is broken anyway.
        let mut stream = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let head = head(payload);
        let mut parts = [IoSlice::new(&head), IoSlice::new(payload)];
        let mut parts = &mut parts[..];
        while !parts.is_empty() {
            match stream.write_vectored(parts) {
                Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
                Ok(written) => IoSlice::advance_slices(&mut parts, written),
                Err(cause) if cause.kind() == io::ErrorKind::Interrupted => {}
                Err(cause) => return Err(cause),
            }
        }
        Ok(())
    }
}

/// The length of a payload. Callers send less than the bound: a longer payload breaks the stream.
fn head(payload: &[u8]) -> [u8; HEAD_BYTES] {
    u32::try_from(payload.len())
        .unwrap_or(u32::MAX)
        .to_le_bytes()
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    /// Both ends, as two processes have them.
    fn ends() -> (ChildSender, FrameReceiver, ParentSender, FrameReceiver) {
        let (to_child, of_child, input) = child_stream().unwrap();
        let stream = UnixStream::from(input);
        let in_child = FrameReceiver::new(stream.try_clone().unwrap());
        (
            to_child,
            of_child,
            ParentSender(Mutex::new(stream)),
            in_child,
        )
    }

    #[test]
    fn frames_wait_for_a_child_that_does_not_read_and_arrive_in_order() {
        let (mut to_child, _of_child, _to_parent, mut in_child) = ends();
        let frame = |number: u32| vec![number as u8; number as usize * 1_000];
        for number in 0..200 {
            to_child.send(&frame(number));
        }
        assert!(to_child.waiting() > 0, "20 MB do not fit into a socket");
        let reading = thread::spawn(move || {
            (0..200).for_each(|number| {
                assert_eq!(in_child.receive().unwrap().unwrap(), frame(number));
            });
            assert_eq!(in_child.receive().unwrap(), None, "the parent has ended");
        });
        while to_child.waiting() > 0 {
            to_child.flush();
            thread::yield_now();
        }
        drop(to_child);
        reading.join().unwrap();
    }

    #[test]
    fn a_parent_gets_whole_frames_of_many_threads_and_learns_of_the_end() {
        let (_to_child, mut of_child, to_parent, in_child) = ends();
        thread::scope(|scope| {
            for number in 0..4_u8 {
                let to_parent = &to_parent;
                scope.spawn(move || {
                    (0..100).for_each(|_| to_parent.send(&vec![number; 100_000]).unwrap());
                });
            }
            for _ in 0..400 {
                let frame = of_child.receive().unwrap().unwrap();
                assert!(frame.len() == 100_000 && frame.iter().all(|byte| *byte == frame[0]));
            }
        });
        drop((to_parent, in_child));
        assert_eq!(of_child.receive().unwrap(), None);
    }

    #[test]
    fn a_frame_that_is_too_long_is_an_error() {
        let (_to_child, mut of_child, to_parent, _in_child) = ends();
        let mut stream = to_parent.0.into_inner().unwrap();
        stream.write_all(&[0xff; 8]).unwrap();
        let refused = of_child.receive().unwrap_err();
        assert_eq!(refused.kind(), io::ErrorKind::InvalidData);
    }
}
