//! The end of a log behind its last step, which a restoration may leave out.
//!
//! A process that was killed because a step did not end would not end it the next time either. Whole frames are left
//! out: a step is the last record of its frame.

use rhumb_protocol::scene::CommandError;
use rhumb_scene::Record;

use super::frame::{LogFrames, OVERHEAD};

/// The use of the commands behind the last step of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum LogTail {
    /// They are done again.
    Kept,
    /// They are left out: the step after them did not end. Their sessions get them refused.
    LeftOut,
}

/// The part of a segment that stays, and the records of sessions behind it.
pub(super) struct CutTail {
    /// Bytes of the segment up to the end of its last step, or else of its header.
    pub(super) length: usize,
    /// Records of sessions behind that, in which no command was applied.
    pub(super) sessions: Vec<Record>,
}

/// Cuts a segment behind its last step.
pub(super) fn cut(frames: &LogFrames<'_>) -> Option<CutTail> {
    let records = |payload| Record::decode_all(payload).ok();
    let (mut length, mut kept) = (0, (0, 0));
    for (place, frame) in frames.frames.iter().enumerate() {
        length += OVERHEAD + frame.payload.len();
        let is_step = |record: &Record| matches!(record, Record::Stepped(_));
        // The first frame holds the header.
        if place == 0 || records(frame.payload)?.iter().any(is_step) {
            kept = (place + 1, length);
        }
    }
    let (count, length) = kept;
    let mut sessions = Vec::new();
    for frame in &frames.frames[count..] {
        for record in records(frame.payload)? {
            match record {
                Record::Applied(_) | Record::Owned(_) | Record::Stepped(_) => {}
                Record::Counted(number, refused) => {
                    let error = refused.unwrap_or(CommandError::EngineFailed);
                    sessions.push(Record::Counted(number, Some(error)));
                }
                record => sessions.push(record),
            }
        }
    }
    Some(CutTail { length, sessions })
}
