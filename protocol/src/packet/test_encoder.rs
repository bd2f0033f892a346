//! Puts together what no publisher says, for vectors of what is refused.

use alloc::vec::Vec;

use super::model::Model;
use super::tables::{MODES, SHAPES, SYMBOLS};
use crate::wire::range::{RangeWriter, TOTAL_BITS};

/// The updates of one packet, number by number, without regard to their meaning.
#[doc(hidden)]
#[derive(Debug, Default)]
pub struct TestEncoder {
    model: Model,
    words: RangeWriter,
}

impl TestEncoder {
    /// A number in a context.
    #[must_use]
    pub fn number(mut self, context: usize, number: u32) -> Self {
        self.model.write(context, number, &mut self.words);
        self
    }

    /// A code of a form, or of the taking of a alias, after a form of this row.
    #[must_use]
    pub fn code(mut self, row: usize, code: usize) -> Self {
        let starts = &MODES[row];
        let size = starts[code + 1] - starts[code];
        self.words
            .symbol(u32::from(starts[code]), u32::from(size), TOTAL_BITS);
        self
    }

    /// The last symbol of a shape.
    #[must_use]
    pub fn escape(mut self, shape: usize) -> Self {
        let start = SHAPES[shape][SYMBOLS - 1];
        let size = SHAPES[shape][SYMBOLS] - start;
        self.words
            .symbol(u32::from(start), u32::from(size), TOTAL_BITS);
        self
    }

    /// Raw bits; `count` is at most 32.
    #[must_use]
    pub fn raw(mut self, value: u32, count: u32) -> Self {
        self.words.raw(value, count);
        self
    }

    /// The bytes.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.words.into_bytes()
    }
}
