//! How likely each number is: what the range coder of a packet goes by.
//!
//! Every packet begins with the same expectations and learns from its own numbers alone, so that a lost packet derails
//! no other (PROTOCOL 5.4). Writer and reader hold one of these each and change it by the same calls.

use super::tables::{CLASSES, CONTEXTS, EXPECTED, MODES, SHAPES, SYMBOLS, contexts};
use crate::wire::Malformed;
use crate::wire::range::{RangeReader, RangeWriter, TOTAL_BITS};

/// The last symbol of each alphabet: the number is at least this, and the rest of it follows.
const ESCAPE: u32 = SYMBOLS as u32 - 1;
/// One expected step, in fixed point.
const ONE: u32 = 256;
/// Numbers above this are learnt from as if they were this.
const LEARNT_MOST: u32 = 4_095;
/// How slowly a context learns: an eighth of each surprise, as a power of two.
const LEARNING_SHIFT: u32 = 3;
/// From this octave of the expectation on, low bits are said raw.
const OCTAVES: u32 = CLASSES as u32 / 4;

/// What one packet expects of its numbers, by context.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    contexts: [Context; CONTEXTS],
}

impl Default for Model {
    fn default() -> Self {
        Self {
            contexts: BEGINNING,
        }
    }
}

/// What one context expects, and the alphabet that follows from it: numbers are priced far more often than they are said.
#[derive(Clone, Copy, Debug)]
struct Context {
    expected: u32,
    alphabet: Alphabet,
}

/// The alphabet by which a number is said: how many low bits go raw, and the shape of the rest.
#[derive(Clone, Copy, Debug)]
struct Alphabet {
    raw: u8,
    shape: u8,
}

impl Alphabet {
    /// Expectations fall into classes of a quarter of an octave.
    const fn of(expected: u32, first_shape: u8) -> Self {
        let sixteenths = (expected / (ONE / 16)) + 1;
        let octave = sixteenths.ilog2();
        let raw = (octave + 1).saturating_sub(OCTAVES);
        let octave = octave - raw;
        let quarter = (((sixteenths >> raw) << 2) >> octave) & 3;
        Self {
            // There are fewer octaves and fewer alphabets than 256.
            raw: raw as u8,
            shape: first_shape + (octave * 4 + quarter) as u8,
        }
    }

    /// What a number would cost, in 1/256 bits.
    const fn cost(self, number: u32) -> u32 {
        let (raw, shape) = self.parts();
        let high = number >> raw;
        let symbol = if high < ESCAPE { high } else { ESCAPE };
        let cost = COSTS[shape][symbol as usize] as u32 + raw * 256;
        if high < ESCAPE {
            return cost;
        }
        cost + (2 * (high - ESCAPE + 1).ilog2() + 1) * 256
    }

    /// Low bits that go raw, and the place of the shape.
    const fn parts(self) -> (u32, usize) {
        (self.raw as u32, self.shape as usize)
    }
}

impl Model {
    pub(super) fn learn(&mut self, context: usize, number: u32) {
        let seen = number.min(LEARNT_MOST) * ONE;
        let Context { expected, alphabet } = &mut self.contexts[context];
        // Towards what was seen by an eighth of the difference, rounded down; both stay below 2²⁰.
        let step = (seen as i32 - *expected as i32) >> LEARNING_SHIFT;
        *expected = expected.wrapping_add_signed(step);
        *alphabet = Alphabet::of(*expected, FIRST_SHAPES[context]);
    }

    /// Says a number.
    pub(crate) fn write(&mut self, context: usize, number: u32, to: &mut RangeWriter) {
        let (raw, shape) = self.contexts[context].alphabet.parts();
        let high = number >> raw;
        let symbol = high.min(ESCAPE) as usize;
        let starts = &SHAPES[shape];
        let size = starts[symbol + 1] - starts[symbol];
        to.symbol(u32::from(starts[symbol]), u32::from(size), TOTAL_BITS);
        if high >= ESCAPE {
            write_rest(high - ESCAPE, to);
        }
        to.raw(number & ((1 << raw) - 1), raw);
        self.learn(context, number);
    }

    /// Reads a number.
    pub(crate) fn read(
        &mut self,
        context: usize,
        from: &mut RangeReader<'_>,
    ) -> Result<u32, Malformed> {
        let (raw, shape) = self.contexts[context].alphabet.parts();
        let mut high = from.symbol(&SHAPES[shape])? as u32;
        if high == ESCAPE {
            high = high
                .checked_add(read_rest(from)?)
                .ok_or(Malformed::OutOfRange)?;
        }
        if high.leading_zeros() < raw {
            return Err(Malformed::OutOfRange);
        }
        let low = if raw > 0 { from.raw(raw)? } else { 0 };
        let number = (high << raw) | low;
        self.learn(context, number);
        Ok(number)
    }

    /// What a number would cost now, in 1/256 bits.
    #[inline]
    pub(crate) fn cost(&self, context: usize, number: u32) -> u32 {
        self.contexts[context].alphabet.cost(number)
    }
}

/// What a number would cost at the beginning of a packet, in 1/256 bits.
#[inline]
pub(crate) fn opening_cost(context: usize, number: u32) -> u32 {
    match OPENING_COSTS[context].get(number as usize) {
        Some(cost) => u32::from(*cost),
        None => opening_cost_of_many(context, number),
    }
}

/// The same of a number that is seldom so large.
#[cold]
fn opening_cost_of_many(context: usize, number: u32) -> u32 {
    BEGINNING[context].alphabet.cost(number)
}

/// Numbers whose costs at the beginning are known.
const KNOWN: usize = 16;

/// What each small number costs at the beginning of a packet, by context.
static OPENING_COSTS: [[u16; KNOWN]; CONTEXTS] = {
    let mut costs = [[0; KNOWN]; CONTEXTS];
    let mut context = 0;
    while context < CONTEXTS {
        let mut number = 0;
        while number < KNOWN {
            // At most twelve bits of a symbol, and as many raw ones as an expectation below 2²⁰ has.
            costs[context][number] = BEGINNING[context].alphabet.cost(number as u32) as u16;
            number += 1;
        }
        context += 1;
    }
    costs
};

/// The first alphabet of each context's group.
const FIRST_SHAPES: [u8; CONTEXTS] = {
    let mut first = [0; CONTEXTS];
    let mut context = 0;
    while context < CONTEXTS {
        // There are fewer alphabets than 256.
        first[context] = (contexts::group(context) * CLASSES) as u8;
        context += 1;
    }
    first
};

/// What each context expects when a packet begins.
static BEGINNING: [Context; CONTEXTS] = {
    let nothing = Context {
        expected: 0,
        alphabet: Alphabet::of(0, 0),
    };
    let mut beginning = [nothing; CONTEXTS];
    let mut context = 0;
    while context < CONTEXTS {
        let expected = EXPECTED[context] as u32;
        beginning[context] = Context {
            expected,
            alphabet: Alphabet::of(expected, FIRST_SHAPES[context]),
        };
        context += 1;
    }
    beginning
};

/// What a symbol of this frequency costs, in 1/256 bits; the logarithm is a broken line, which is near enough to choose by.
pub(crate) const fn symbol_cost(size: u32) -> u32 {
    let whole = size.ilog2();
    let fraction = (size << 8 >> whole) - 256;
    (TOTAL_BITS - whole) * 256 - fraction
}

/// What a form costs by the expectation of this row, in 1/256 bits.
pub(super) fn code_cost(row: usize, code: usize) -> u32 {
    let starts = &MODES[row];
    symbol_cost(u32::from(starts[code + 1] - starts[code]))
}

/// What each symbol of each alphabet costs, in 1/256 bits.
static COSTS: [[u16; SYMBOLS]; SHAPES.len()] = {
    let mut costs = [[0; SYMBOLS]; SHAPES.len()];
    let mut shape = 0;
    while shape < SHAPES.len() {
        let mut symbol = 0;
        while symbol < SYMBOLS {
            let size = SHAPES[shape][symbol + 1] - SHAPES[shape][symbol];
            // At most twelve bits.
            costs[shape][symbol] = symbol_cost(size as u32) as u16;
            symbol += 1;
        }
        shape += 1;
    }
    costs
};

/// The rest of an escaped number: as many ones as its length, a zero, and the number.
fn write_rest(rest: u32, to: &mut RangeWriter) {
    let width = (rest + 1).ilog2();
    for _ in 0..width {
        to.raw(1, 1);
    }
    to.raw(0, 1);
    to.raw(rest + 1 - (1 << width), width);
}

fn read_rest(from: &mut RangeReader<'_>) -> Result<u32, Malformed> {
    let mut width = 0;
    while from.bit()? {
        width += 1;
        if width > 30 {
            return Err(Malformed::OutOfRange);
        }
    }
    Ok(from.raw(width)? + (1 << width) - 1)
}

// The greatest expectation that can be learnt still leaves raw bits for a 32-bit number.
const _: () = assert!(LEARNT_MOST * ONE < 1 << 20);
const _: () = assert!(SHAPES.len() <= 256);

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_come_back_at_about_their_cost(
            numbers in proptest::collection::vec((0..CONTEXTS, prop_oneof![0_u32..4, 0_u32..300, 0_u32..1 << 30]), 1..120),
        ) {
            let (mut model, mut writer, mut cost) = (Model::default(), RangeWriter::default(), 0);
            for (context, number) in &numbers {
                cost += model.cost(*context, *number);
                model.write(*context, *number, &mut writer);
            }
            let bytes = writer.into_bytes();
            prop_assert!(bytes.len() as f64 * 8.0 <= f64::from(cost) / 256.0 * 1.02 + 16.0);
            let (mut model, mut reader) = (Model::default(), RangeReader::new(&bytes));
            let read: Result<Vec<_>, _> = numbers
                .iter()
                .map(|(context, _)| model.read(*context, &mut reader).map(|number| (*context, number)))
                .collect();
            prop_assert_eq!(read, Ok(numbers));
            prop_assert_eq!(reader.finish(), Ok(()));
        }
    }

    #[test]
    fn every_shape_gives_every_symbol_a_chance() {
        for shape in &SHAPES {
            assert_eq!((shape[0], shape[SYMBOLS]), (0, 1 << TOTAL_BITS));
            assert!(shape.windows(2).all(|pair| pair[0] < pair[1]));
        }
    }
}
