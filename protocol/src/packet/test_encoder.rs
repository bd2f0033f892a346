//! Encodes packets that no publisher sends, for vectors of refused packets.

use alloc::vec::Vec;

use super::model::Model;
use super::tables::{MODES, SHAPES, SYMBOLS};
use crate::wire::alphabet::TOTAL_BITS;
use crate::wire::range::RangeWriter;

/// The updates of one packet, encoded number by number without checks.
#[derive(Debug, Default)]
pub struct TestEncoder {
    model: Model,
    range_writer: RangeWriter,
}

impl TestEncoder {
    /// Appends a number in a context.
    #[must_use]
    pub fn number(mut self, context: usize, number: u32) -> Self {
        self.model.write(context, number, &mut self.range_writer);
        self
    }

    /// Appends a code of a form, or of an alias assignment, after a form of this row.
    #[must_use]
    pub fn code(mut self, row: usize, code: usize) -> Self {
        let starts = &MODES[row];
        let size = starts[code + 1] - starts[code];
        self.range_writer
            .symbol(u32::from(starts[code]), u32::from(size), TOTAL_BITS);
        self
    }

    /// Appends the last symbol of a shape.
    #[must_use]
    pub fn escape(mut self, shape: usize) -> Self {
        let start = SHAPES[shape][SYMBOLS - 1];
        let size = SHAPES[shape][SYMBOLS] - start;
        self.range_writer
            .symbol(u32::from(start), u32::from(size), TOTAL_BITS);
        self
    }

    /// Appends raw bits; `count` is at most 32.
    #[must_use]
    pub fn raw(mut self, value: u32, count: u32) -> Self {
        self.range_writer.raw(value, count);
        self
    }

    /// The encoded bytes.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.range_writer.into_bytes()
    }
}
