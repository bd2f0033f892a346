//! Symbol counts of packets, the data to which coding tables are fitted.
//!
//! Not part of the protocol: a tool that fits tables decodes recorded packets and counts their symbols
//! (ARCHITECTURE.md, "Tables").

use alloc::vec::Vec;

use super::codes::CODE_COUNT;
use super::model::{Model, code_cost};
use super::payload::{CountSink, UpdateCoder};
use super::tables::{CLASSES, CONTEXTS, GROUPS, SYMBOLS, contexts};
use super::update::Update;

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
