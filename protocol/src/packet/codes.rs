//! The symbols that begin an update: form, alias assignment, end of packet.
//!
//! `tables` has their alphabets; `payload` reads and writes them (PROTOCOL 5.6).

/// The number of forms.
pub(super) const FORM_COUNT: usize = 16;
/// The code of an alias assignment; the form follows.
pub(super) const ASSIGN_ALIAS: usize = FORM_COUNT;
/// The code of the end of the updates.
pub(super) const END: usize = ASSIGN_ALIAS + 1;
/// The number of codes.
pub(super) const CODE_COUNT: usize = END + 1;
