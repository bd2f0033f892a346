//! Events, and refusals of the server, as flat structs of C.

use std::ffi::c_char;

use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::{EventRecord, RefusalRecord, packed_id};

use crate::border::{RhumbCode, check_out, copy_text, guard, write};
use crate::descriptions::RhumbBody;
use crate::generated::RhumbEventKind;
use crate::scene::{RhumbScene, with};

/// Bytes of the text of an event, with the zero byte that ends it.
pub const RHUMB_EVENT_TEXT_BYTES: usize = 192;

/// An event. Fields that its kind does not name are zero.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbEvent {
    /// A `RhumbEventKind`.
    pub kind: u32,
    /// Of a contact: units of length; negative if the bodies overlap.
    pub separation: f32,
    /// The newest complete tick when the event was read. No view of an earlier tick shows its effect.
    pub after: u64,
    /// The tick in which it happened, if the server says so; otherwise `after`.
    pub tick: u64,
    /// The number that the kind names.
    pub number: u64,
    /// The body.
    pub body: RhumbBody,
    /// The other body.
    pub other: RhumbBody,
    /// Of a contact: a point on `body`.
    pub point: [f32; 3],
    /// Of a contact: from `other` towards `body`, unit.
    pub normal: [f32; 3],
    /// Of a contact: the sum of all forces between the bodies.
    pub force: f32,
    /// A sentence in UTF-8 that ends with a zero byte; a longer one is cut.
    pub text: [c_char; 192],
}

/// Takes the oldest unread event. If there is none, the kind is `RHUMB_EVENT_KIND_NONE`. At most 65,536 unread events are
/// kept; `events_left_out` of the statistics counts those that were dropped, the oldest first.
///
/// # Safety
///
/// `event` points to memory for a `RhumbEvent`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_poll_event(
    scene: RhumbScene,
    event: *mut RhumbEvent,
) -> RhumbCode {
    guard(|| {
        check_out(event, "event")?;
        let record = with(scene, |scene| Ok(scene.poll_event()))?;
        let record = record.map_or(RhumbEvent::NONE, |record| RhumbEvent::of(&record));
        // SAFETY: the caller promises the memory.
        unsafe { write(event, record, "event") }
    })
}

impl RhumbEvent {
    const NONE: Self = Self {
        kind: RhumbEventKind::None as u32,
        separation: 0.0,
        after: 0,
        tick: 0,
        number: 0,
        body: RhumbBody(0),
        other: RhumbBody(0),
        point: [0.0; 3],
        normal: [0.0; 3],
        force: 0.0,
        text: [0; RHUMB_EVENT_TEXT_BYTES],
    };

    fn of(record: &EventRecord) -> Self {
        let word = |id: Option<BodyId>| RhumbBody(id.map_or(0, packed_id));
        Self {
            kind: RhumbEventKind::of(record.kind) as u32,
            separation: record.separation,
            after: record.after.value(),
            tick: record.tick.value(),
            number: record.number,
            body: word(record.body),
            other: word(record.other),
            point: record.point.to_array(),
            normal: record.normal.to_array(),
            force: record.force,
            text: copy_text(&record.text),
        }
    }
}

/// Bytes of the reason of a refusal, with the zero byte that ends it.
pub const RHUMB_REASON_BYTES: usize = 32;

/// A request that the server refused, and that changed nothing.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbRefusal {
    /// Zero: there is no further refusal, and all other fields are zero.
    pub exists: u8,
    /// Not zero: `number` is that of a command. Zero: the request was for authority, or of another member.
    pub is_command: u8,
    /// The command's number.
    pub number: u64,
    /// The body that the request is about; zero if that is not known.
    pub body: RhumbBody,
    /// The reason in one or a few words, such as "unknown body"; it ends with a zero byte.
    pub reason: [c_char; 32],
    /// The reason, a sentence in UTF-8 that ends with a zero byte; a longer one is cut.
    pub text: [c_char; 192],
}

/// Takes the oldest refusal of the last call that was `RHUMB_CODE_REFUSED`, of which 1,024 are kept. Its sentences are those
/// of `rhumb_last_error`, which names the first and tells how many others there are.
///
/// # Safety
///
/// `refusal` points to memory for a `RhumbRefusal`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_poll_refusal(
    scene: RhumbScene,
    refusal: *mut RhumbRefusal,
) -> RhumbCode {
    guard(|| {
        check_out(refusal, "refusal")?;
        let record = with(scene, |scene| Ok(scene.poll_refusal()))?;
        let record = record.map_or(RhumbRefusal::NONE, |record| RhumbRefusal::of(&record));
        // SAFETY: the caller promises the memory.
        unsafe { write(refusal, record, "refusal") }
    })
}

impl RhumbRefusal {
    const NONE: Self = Self {
        exists: 0,
        is_command: 0,
        number: 0,
        body: RhumbBody(0),
        reason: [0; RHUMB_REASON_BYTES],
        text: [0; RHUMB_EVENT_TEXT_BYTES],
    };

    fn of(record: &RefusalRecord) -> Self {
        Self {
            exists: 1,
            is_command: u8::from(record.number.is_some()),
            number: record.number.unwrap_or(0),
            body: RhumbBody(record.body.map_or(0, packed_id)),
            reason: copy_text(record.reason),
            text: copy_text(&record.text),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::ffi::CStr;

    use rhumb_bindings::Coordinates;
    use rhumb_bindings::rhumb_client::scene::CommandError;
    use rhumb_bindings::rhumb_client::{BodyId, Event, Tick};

    use super::*;

    #[test]
    fn a_record_keeps_its_numbers_and_its_sentence() {
        let id = BodyId::new(4, 1);
        let refused = Event::Refused {
            number: 9,
            error: CommandError::UnknownBody(id),
        };
        let record = EventRecord::new(Tick::new(7), refused, Coordinates::Rhumb);
        let event = RhumbEvent::of(&record);
        assert_eq!(event.kind, RhumbEventKind::CommandRefused as u32);
        assert_eq!((event.number, event.after, event.tick), (9, 7, 7));
        // SAFETY: the text of an event ends with a zero byte.
        let text = unsafe { CStr::from_ptr(event.text.as_ptr()) };
        assert_eq!(text.to_str(), Ok("the scene has no body 8589934597"));
    }

    #[test]
    fn a_long_sentence_is_cut_between_two_characters() {
        let placed = Event::BodyPlaced(BodyId::new(0, 0));
        let mut record = EventRecord::new(Tick::ZERO, placed, Coordinates::Rhumb);
        record.text = "å".repeat(200);
        let event = RhumbEvent::of(&record);
        // SAFETY: the text of an event ends with a zero byte.
        let text = unsafe { CStr::from_ptr(event.text.as_ptr()) };
        assert_eq!(text.to_str(), Ok("å".repeat(95).as_str()));
        assert_eq!(event.body, RhumbBody(1));
    }

    #[test]
    fn a_refusal_keeps_its_numbers_and_its_sentences() {
        let record = RefusalRecord {
            number: Some(0),
            subject: "command",
            body: Some(BodyId::new(4, 0)),
            reason: "unknown body",
            text: "the scene has no body 5".to_owned(),
        };
        let refusal = RhumbRefusal::of(&record);
        assert_eq!(
            (refusal.exists, refusal.is_command, refusal.number),
            (1, 1, 0)
        );
        assert_eq!(refusal.body, RhumbBody(5));
        // SAFETY: the texts of a refusal end with a zero byte.
        let texts = unsafe {
            [refusal.reason.as_ptr(), refusal.text.as_ptr()].map(|text| CStr::from_ptr(text))
        };
        assert_eq!(texts, [c"unknown body", c"the scene has no body 5"]);
        assert_eq!(RhumbRefusal::NONE.exists, 0);
    }
}
