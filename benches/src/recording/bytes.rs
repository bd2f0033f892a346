//! Little-endian numbers of an `.rhtrace`, one after the other.

use super::error::RecordingError;

/// Reader over the remaining bytes.
pub(super) struct ByteReader<'a> {
    rest: &'a [u8],
    /// The frame that is being read; none in the head of the file.
    frame: Option<u64>,
}

impl<'a> ByteReader<'a> {
    pub(super) const fn new(rest: &'a [u8]) -> Self {
        Self { rest, frame: None }
    }

    /// Begins a frame: errors that follow name it.
    pub(super) const fn begin(&mut self, frame: u64) {
        self.frame = Some(frame);
    }

    pub(super) fn take<const COUNT: usize>(&mut self) -> Result<[u8; COUNT], RecordingError> {
        let short = || RecordingError::Short {
            within: (self.frame)
                .map_or_else(|| "its head".to_owned(), |frame| format!("frame {frame}")),
        };
        let (taken, rest) = self.rest.split_first_chunk().ok_or_else(short)?;
        self.rest = rest;
        Ok(*taken)
    }

    pub(super) fn u16(&mut self) -> Result<u16, RecordingError> {
        self.take().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, RecordingError> {
        self.take().map(u32::from_le_bytes)
    }

    pub(super) fn f32(&mut self) -> Result<f32, RecordingError> {
        self.take().map(f32::from_le_bytes)
    }

    pub(super) fn f32s<const COUNT: usize>(&mut self) -> Result<[f32; COUNT], RecordingError> {
        let mut all = [0.0; COUNT];
        for one in &mut all {
            *one = self.f32()?;
        }
        Ok(all)
    }

    /// Refuses bytes behind the last frame.
    pub(super) const fn end(&self) -> Result<(), RecordingError> {
        match self.rest.len() {
            0 => Ok(()),
            bytes => Err(RecordingError::Long { bytes }),
        }
    }
}
