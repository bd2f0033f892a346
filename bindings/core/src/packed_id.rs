//! A body's id packed into one number, for languages without such a type.
//!
//! The number of no body is zero, so that memory full of zeros names none.

use std::fmt;

use rhumb_client::BodyId;

/// The packed id of a body: one more than its index, with its generation above the low 33 bits.
#[must_use]
pub fn packed_id(id: BodyId) -> u64 {
    (u64::from(id.generation()) << INDEX_BITS) | (u64::from(id.index()) + 1)
}

/// The body of a packed id.
///
/// # Errors
///
/// [`InvalidPackedId`] for a number that names no body.
pub fn parse_packed_id(number: u64) -> Result<BodyId, InvalidPackedId> {
    let invalid = InvalidPackedId(number);
    let index = (number & INDEX_MASK).checked_sub(1).ok_or(invalid)?;
    let index = u32::try_from(index).map_err(|_| invalid)?;
    let generation = u16::try_from(number >> INDEX_BITS).map_err(|_| invalid)?;
    Ok(BodyId::new(index, generation))
}

/// An index has 32 bits, and one more than the greatest has 33.
const INDEX_BITS: u32 = 33;
const INDEX_MASK: u64 = (1 << INDEX_BITS) - 1;

/// A number that no body has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidPackedId(pub u64);

impl fmt::Display for InvalidPackedId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#x} is the id of no body", self.0)
    }
}

impl std::error::Error for InvalidPackedId {}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_body_has_one_number(index: u32, generation: u16) {
            let id = BodyId::new(index, generation);
            prop_assert_eq!(parse_packed_id(packed_id(id)), Ok(id));
        }

        #[test]
        fn a_number_that_names_a_body_is_that_bodys_number(number: u64) {
            if let Ok(id) = parse_packed_id(number) {
                prop_assert_eq!(packed_id(id), number);
            }
        }
    }

    #[test]
    fn zero_and_numbers_out_of_range_name_no_body() {
        for number in [0, 1 << INDEX_BITS, 1 << 49 | 1, u64::MAX, 0x1_0000_0001] {
            assert_eq!(
                parse_packed_id(number),
                Err(InvalidPackedId(number)),
                "{number:#x}"
            );
        }
        assert_eq!(packed_id(BodyId::new(0, 0)), 1);
    }
}
