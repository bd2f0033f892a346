//! A value with exactly one encoding.

use super::bytes::{Reader, Writer};
use super::malformed::Malformed;

/// Peers must tolerate unknown codes from here on; the item of each code tells how (PROTOCOL 3.5).
pub const OPTIONAL: u8 = 0x80;

/// A value with exactly one encoding in whole bytes.
pub trait Wire: Sized {
    /// Appends the value's encoding.
    fn encode(&self, to: &mut Writer);

    /// Takes a value off the front.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when the front is not the encoding of a value of this type.
    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed>;
}
