//! Refusals of the server, as flat structs of C.

use std::ffi::c_char;

use rhumb_bindings::{RefusalRecord, packed_id};

use crate::border::{check_out, copy_text, guard, write};
use crate::descriptions::RhumbBody;
use crate::events::RHUMB_EVENT_TEXT_BYTES;
use crate::scene::{RhumbScene, with};
use crate::status::RhumbCode;

/// Bytes of the reason of a refusal, with the zero byte that ends it.
pub const RHUMB_REASON_BYTES: usize = 32;

/// A request that the server refused, and that changed nothing.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbRefusal {
    /// Zero: there is no further refusal, and all other fields are zero.
    pub exists: u8,
    /// Not zero: `number` is that of a command. Zero: the request was for authority.
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

    use rhumb_bindings::rhumb_client::BodyId;

    use super::*;

    #[test]
    fn a_refusal_keeps_its_numbers_and_its_sentences() {
        let record = RefusalRecord {
            number: Some(0),
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
