//! Symbol counts of packets, and packets that no publisher sends.
//!
//! Not part of the protocol: a tool that fits tables decodes recorded packets and counts their symbols
//! (docs/decisions/0014); tests need packets that a subscriber refuses.

use alloc::vec::Vec;

use super::model::{Model, code_cost};
use super::payload::{CountSink, UpdateCoder};
use super::tables::{CLASSES, CODE_COUNT, CONTEXTS, GROUPS, MODES, SHAPES, SYMBOLS, contexts};
use super::update::Update;
use crate::wire::range::{RangeWriter, TOTAL_BITS};

/// The symbols of one packet.
#[derive(Clone, Debug, Default)]
pub struct SymbolCounts {
    /// Row and code of each form, of each alias assignment, and of the end.
    pub codes: Vec<[usize; 2]>,
    /// Context and value of each number, in order.
    pub numbers: Vec<(usize, u32)>,
}

impl SymbolCounts {
    /// The number of rows of forms, and of codes in each.
    pub const CODES: [usize; 2] = [4, CODE_COUNT];
    /// The numbers of contexts, of context groups, of classes in each group, and of symbols in an alphabet.
    pub const NUMBERS: [usize; 4] = [CONTEXTS, GROUPS, CLASSES, SYMBOLS];

    /// Counts a packet's updates.
    #[must_use]
    pub fn of(updates: &[Update]) -> Self {
        let (mut tally, mut coder, mut next) = (Self::default(), UpdateCoder::default(), 0);
        for update in updates {
            let (gap, named) = (update.alias - next, update.body.is_some());
            coder.note(gap, named, &update.payload, &mut tally);
            next = update.alias + 1;
        }
        coder.note_end(&mut tally);
        tally
    }

    /// The cost of all symbols under the packet coder, in 1/256 bits.
    #[must_use]
    pub fn coded(&self) -> u64 {
        let mut model = Model::default();
        let codes = self.codes.iter().map(|&[row, code]| code_cost(row, code));
        let codes: u64 = codes.map(u64::from).sum();
        let numbers = self.numbers.iter().map(|&(context, number)| {
            let cost = model.cost(context, number);
            model.learn(context, number);
            u64::from(cost)
        });
        codes + numbers.sum::<u64>()
    }

    /// The group of a context. Contexts of one group share their alphabets.
    #[must_use]
    pub const fn group(context: usize) -> usize {
        contexts::group(context)
    }
}

impl CountSink for SymbolCounts {
    fn code(&mut self, row: usize, code: usize) {
        self.codes.push([row, code]);
    }

    fn number(&mut self, context: usize, number: u32) {
        self.numbers.push((context, number));
    }
}

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
