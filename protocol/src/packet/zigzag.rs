//! A bit length, coded as its difference from an expected one.

use crate::wire::Malformed;

/// The longest step of a rest correction, bits.
const STEP_BITS_MAX: u32 = 31;

/// The difference of a length from the expected one, mapped to an unsigned number.
pub(super) const fn zigzag(length: u32, expected: u32) -> u32 {
    if length >= expected {
        (length - expected) * 2
    } else {
        (expected - length) * 2 - 1
    }
}

/// The length that [`zigzag`] encoded as `number`.
pub(super) fn unzigzag(number: u32, expected: u32) -> Result<u32, Malformed> {
    let by = number / 2;
    let length = if number.is_multiple_of(2) {
        expected.checked_add(by)
    } else {
        expected.checked_sub(by + 1)
    };
    length
        .filter(|length| *length <= STEP_BITS_MAX)
        .ok_or(Malformed::OutOfRange)
}
