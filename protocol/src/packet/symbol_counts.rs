//! What tables are fitted to: the forms and numbers of packets, counted
//!
//! No part of the conversation: who fits tables reads packets that were said and counts them (ARCHITECTURE.md,
//! "Tables").

use alloc::vec::Vec;

use super::model::{Model, code_cost};
use super::payload::{CODE_COUNT, CountSink, UpdateCoder};
use super::tables::{CLASSES, CONTEXTS, GROUPS, SYMBOLS, contexts};
use super::update::Update;

/// What was said in one packet.
#[derive(Clone, Debug, Default)]
pub struct SymbolCounts {
    /// Row and code of each form, of each taking of a alias, and of the end.
    pub codes: Vec<[usize; 2]>,
    /// Context and value of each number, in order.
    pub numbers: Vec<(usize, u32)>,
}

impl SymbolCounts {
    /// Rows of forms, and codes in each.
    pub const CODES: [usize; 2] = [4, CODE_COUNT];
    /// How many contexts there are, groups of them, classes in each group, and symbols of an alphabet.
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

    /// What all of it takes by a packet's coder, in 1/256 bits.
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

    /// The group of a context: those of one group share their alphabets.
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
