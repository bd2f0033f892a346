//! A body's id as one word, for languages without such a type.
//!
//! The word of no body is zero, so that memory full of zeros names none.

use std::fmt;

use rhumb_client::BodyId;

/// The word of a body: one more than its index, with its generation above the low 33 bits.
#[must_use]
pub fn body_word(id: BodyId) -> u64 {
    (u64::from(id.generation()) << INDEX_BITS) | (u64::from(id.index()) + 1)
}

/// The body of a word.
///
/// # Errors
///
/// [`InvalidBodyWord`] for a word that names no body.
pub fn parse_body_word(word: u64) -> Result<BodyId, InvalidBodyWord> {
    let invalid = InvalidBodyWord(word);
    let index = (word & INDEX_MASK).checked_sub(1).ok_or(invalid)?;
    let index = u32::try_from(index).map_err(|_| invalid)?;
    let generation = u16::try_from(word >> INDEX_BITS).map_err(|_| invalid)?;
    Ok(BodyId::new(index, generation))
}

/// An index has 32 bits, and one more than the greatest has 33.
const INDEX_BITS: u32 = 33;
const INDEX_MASK: u64 = (1 << INDEX_BITS) - 1;

/// A word that no body has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidBodyWord(pub u64);

impl fmt::Display for InvalidBodyWord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:#x} is the id of no body", self.0)
    }
}

impl std::error::Error for InvalidBodyWord {}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_body_has_one_word(index: u32, generation: u16) {
            let id = BodyId::new(index, generation);
            prop_assert_eq!(parse_body_word(body_word(id)), Ok(id));
        }

        #[test]
        fn a_word_that_names_a_body_is_that_bodys_word(word: u64) {
            if let Ok(id) = parse_body_word(word) {
                prop_assert_eq!(body_word(id), word);
            }
        }
    }

    #[test]
    fn zero_and_words_out_of_range_name_no_body() {
        for word in [0, 1 << INDEX_BITS, 1 << 49 | 1, u64::MAX, 0x1_0000_0001] {
            assert_eq!(
                parse_body_word(word),
                Err(InvalidBodyWord(word)),
                "{word:#x}"
            );
        }
        assert_eq!(body_word(BodyId::new(0, 0)), 1);
    }
}
