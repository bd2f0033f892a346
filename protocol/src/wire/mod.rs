//! Bytes and bits: the only place where numbers become either.
pub(crate) mod alphabet;
pub mod bits;
pub mod bytes;
mod malformed;
pub(crate) mod range;

pub use malformed::Malformed;

use self::bytes::{Reader, Writer};

/// Codes from here on may be met by who does not know them; what is then done stands with each (PROTOCOL 3.5).
pub const OPTIONAL: u8 = 0x80;

/// A value with one form in whole bytes.
pub trait Wire: Sized {
    /// Appends the value's one form.
    fn encode(&self, to: &mut Writer);

    /// Takes a value off the front.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when the front is not a value of this type in its one form.
    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed>;
}
