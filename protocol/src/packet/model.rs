//! The adaptive model of a packet's numbers, for its range coder.
//!
//! Every packet starts with the same expectations and adapts to its own numbers alone, so a lost packet does not
//! disturb another one (PROTOCOL 5.4). Writer and reader hold one model each and change it by the same calls.

use super::tables::contexts::TripleContexts;
use super::tables::{
    CLASSES, CODE_COUNT, CONTEXTS, EXPECTED, GROUPS, MODES, SHAPES, SYMBOLS, contexts,
};
use crate::wire::Malformed;
use crate::wire::range::{Alphabet, RangeReader, RangeWriter, TOTAL_BITS};

/// The last symbol of each alphabet: the number is at least this large, and the rest of it follows.
const ESCAPE: u32 = SYMBOLS as u32 - 1;
/// One step of an expectation, in fixed point.
const ONE: u32 = 256;
/// The model adapts to larger numbers as if they were this one.
const LEARNT_MAX: u32 = 4_095;
/// The adaptation rate of a context: an eighth of the difference, as a power of two.
const LEARNING_SHIFT: u32 = 3;
/// From this octave of the expectation on, low bits are written raw.
const OCTAVES: u32 = CLASSES as u32 / 4;

/// The expected size of a packet's numbers, by context.
#[derive(Clone, Debug)]
pub(crate) struct Model {
    expected: [u32; CONTEXTS],
}

impl Default for Model {
    fn default() -> Self {
        Self {
            expected: EXPECTED.map(u32::from),
        }
    }
}

/// The code of a number: the number of raw low bits, and the shape for the rest.
#[derive(Clone, Copy, Debug)]
struct CodeChoice {
    raw: u32,
    shape: usize,
}

impl CodeChoice {
    const fn of(context: usize, expected: u32) -> Self {
        let (raw, class) = class_of(expected);
        let shape = FIRST_SHAPES[context] as usize + class;
        Self { raw, shape }
    }

    /// The cost of a number, in 1/256 bits.
    const fn cost(self, number: u32) -> u32 {
        let Self { raw, shape } = self;
        let high = number >> raw;
        let symbol = if high < ESCAPE { high } else { ESCAPE };
        let cost = COSTS[shape][symbol as usize] as u32 + raw * 256;
        if high < ESCAPE {
            return cost;
        }
        cost + (2 * (high - ESCAPE + 1).ilog2() + 1) * 256
    }
}

impl Model {
    #[inline]
    fn code_choice(&self, context: usize) -> CodeChoice {
        CodeChoice::of(context, self.expected[context])
    }

    pub(super) fn learn(&mut self, context: usize, number: u32) {
        self.expected[context] = learnt(self.expected[context], number);
    }

    /// Writes a number and adapts its context.
    pub(crate) fn write(&mut self, context: usize, number: u32, to: &mut RangeWriter) {
        self.write_with(context, number, None, to);
    }

    /// Writes a number with its sign; zero has none.
    #[inline]
    pub(crate) fn write_signed(&mut self, context: usize, number: i32, to: &mut RangeWriter) {
        let sign = (number != 0).then_some(number < 0);
        self.write_with(context, number.unsigned_abs(), sign, to);
    }

    #[inline(always)]
    fn write_with(
        &mut self,
        context: usize,
        number: u32,
        sign: Option<bool>,
        to: &mut RangeWriter,
    ) {
        let expected = self.expected[context];
        let close = CLOSE.get((expected / (ONE / 16)) as usize);
        match close {
            Some(class) if number < ESCAPE => {
                let shape = usize::from(FIRST_SHAPES[context]) + usize::from(*class);
                let starts = &SHAPES[shape][number as usize..number as usize + 2];
                let size = starts[1] - starts[0];
                to.symbol_and_bit(u32::from(starts[0]), u32::from(size), sign);
            }
            _ => self.write_large(context, number, sign, to),
        }
        self.learn(context, number);
    }

    /// As [`Self::write_with`] before the adaption, for a number with raw bits or beyond the symbols.
    #[inline(never)]
    fn write_large(&self, context: usize, number: u32, sign: Option<bool>, to: &mut RangeWriter) {
        let CodeChoice { raw, shape } = self.code_choice(context);
        let high = number >> raw;
        let symbol = high.min(ESCAPE) as usize;
        let starts = &SHAPES[shape];
        let size = starts[symbol + 1] - starts[symbol];
        to.symbol(u32::from(starts[symbol]), u32::from(size), TOTAL_BITS);
        if high >= ESCAPE {
            write_rest(high - ESCAPE, to);
        }
        if raw > 0 {
            to.raw(number & ((1 << raw) - 1), raw);
        }
        if let Some(negative) = sign {
            to.raw(u32::from(negative), 1);
        }
    }

    /// Reads a number and adapts its context.
    #[inline]
    pub(crate) fn read(
        &mut self,
        context: usize,
        from: &mut RangeReader<'_>,
    ) -> Result<u32, Malformed> {
        let expected = self.expected[context];
        let (raw, class) = match CLOSE.get((expected / (ONE / 16)) as usize) {
            Some(class) => (0, usize::from(*class)),
            None => class_of(expected),
        };
        let group = usize::from(GROUP_OF[context]);
        let symbol = from.symbol(&ALPHABETS[group][class])? as u32;
        let number = if symbol == ESCAPE || raw > 0 {
            read_large(symbol, raw, from)?
        } else {
            symbol
        };
        self.expected[context] = learnt(expected, number);
        Ok(number)
    }

    /// Reads three consecutive numbers into `to`, each with its sign.
    pub(crate) fn read_three(
        &mut self,
        contexts: TripleContexts,
        from: &mut RangeReader<'_>,
        to: &mut [i32; 3],
    ) -> Result<(), Malformed> {
        let alphabets = &ALPHABETS[contexts.group()];
        // A local copy stays in registers from number to number.
        let (mut here, mut sum) = (from.state(), 0);
        for (part, number) in to.iter_mut().enumerate() {
            let context = contexts.context(part, sum);
            let expected = self.expected[context];
            let Some(class) = CLOSE.get((expected / (ONE / 16)) as usize) else {
                from.set_state(here);
                *number = self.read_large_signed(context, from)?;
                sum += u64::from(number.unsigned_abs());
                here = from.state();
                continue;
            };
            let symbol = here.symbol(&alphabets[usize::from(*class)])? as u32;
            if symbol == ESCAPE {
                from.set_state(here);
                *number = self.read_escaped_signed(context, from)?;
                sum += u64::from(number.unsigned_abs());
                here = from.state();
                continue;
            }
            let negative = if here.is_wide() {
                here.bit(symbol > 0)?
            } else {
                from.set_state(here);
                let negative = from.fill_with_bit(symbol > 0)?;
                here = from.state();
                negative
            };
            self.expected[context] = learnt_few(expected, symbol);
            sum += u64::from(symbol);
            let sign = -i32::from(negative);
            *number = (symbol as i32 ^ sign) - sign;
        }
        from.set_state(here);
        Ok(())
    }

    /// A number with its sign, with raw low bits.
    #[inline(never)]
    fn read_large_signed(
        &mut self,
        context: usize,
        from: &mut RangeReader<'_>,
    ) -> Result<i32, Malformed> {
        let size = self.read(context, from)?;
        with_sign(size, from)
    }

    /// The rest of a number and its sign, after an escape symbol.
    #[inline(never)]
    fn read_escaped_signed(
        &mut self,
        context: usize,
        from: &mut RangeReader<'_>,
    ) -> Result<i32, Malformed> {
        from.fill();
        let size = read_large(ESCAPE, 0, from)?;
        self.learn(context, size);
        with_sign(size, from)
    }

    /// The cost of a number now, in 1/256 bits.
    #[inline]
    pub(crate) fn cost(&self, context: usize, number: u32) -> u32 {
        self.code_choice(context).cost(number)
    }
}

/// The expectation after a number: an eighth of the way towards it, rounded down.
#[inline]
fn learnt(expected: u32, number: u32) -> u32 {
    learnt_few(expected, number.min(LEARNT_MAX))
}

/// The same for a number of at most [`LEARNT_MAX`].
#[inline]
fn learnt_few(expected: u32, number: u32) -> u32 {
    // Both operands stay below 2²⁰.
    let step = ((number * ONE) as i32 - expected as i32) >> LEARNING_SHIFT;
    expected.wrapping_add_signed(step)
}

/// The class of an alphabet by the sixteenths of an expectation that has no raw bits.
static CLOSE: [u8; (1 << OCTAVES) - 1] = {
    let mut classes = [0; (1 << OCTAVES) - 1];
    let mut sixteenths = 0;
    while sixteenths < classes.len() {
        let (_, class) = class_of(sixteenths as u32 * (ONE / 16));
        // There are fewer than 256 classes.
        classes[sixteenths] = class as u8;
        sixteenths += 1;
    }
    classes
};

/// The number of raw bits for an expectation, and the class of the alphabet for the rest: one for each quarter octave.
const fn class_of(expected: u32) -> (u32, usize) {
    let sixteenths = (expected / (ONE / 16)) + 1;
    let octave = sixteenths.ilog2();
    // The two bits below the leading one, whatever the number of raw bits.
    let quarter = ((sixteenths << 2) >> octave) & 3;
    let raw = (octave + 1).saturating_sub(OCTAVES);
    (raw, ((octave - raw) * 4 + quarter) as usize)
}

/// The cost of a number at the start of a packet, in 1/256 bits.
#[inline]
pub(crate) fn opening_cost(context: usize, number: u32) -> u32 {
    match OPENING_COSTS[context].get(number as usize) {
        Some(cost) => u32::from(*cost),
        None => opening_cost_of_many(context, number),
    }
}

/// As [`opening_cost`], for a number beyond the table.
#[cold]
fn opening_cost_of_many(context: usize, number: u32) -> u32 {
    CodeChoice::of(context, u32::from(EXPECTED[context])).cost(number)
}

/// The number of table entries for each context.
const KNOWN: usize = 16;

/// The cost of each small number at the start of a packet, by context.
static OPENING_COSTS: [[u16; KNOWN]; CONTEXTS] = {
    let mut costs = [[0; KNOWN]; CONTEXTS];
    let mut context = 0;
    while context < CONTEXTS {
        let code_choice = CodeChoice::of(context, EXPECTED[context] as u32);
        let mut number = 0;
        while number < KNOWN {
            // At most twelve bits for a symbol, plus the raw bits of an expectation below 2²⁰.
            costs[context][number] = code_choice.cost(number as u32) as u16;
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
        // There are fewer than 256 alphabets.
        first[context] = (contexts::group(context) * CLASSES) as u8;
        context += 1;
    }
    first
};

/// The group of each context.
static GROUP_OF: [u8; CONTEXTS] = {
    let mut groups = [0; CONTEXTS];
    let mut context = 0;
    while context < CONTEXTS {
        // There are four.
        groups[context] = contexts::group(context) as u8;
        context += 1;
    }
    groups
};

/// The alphabets of [`SHAPES`] for reading, by group and class.
static ALPHABETS: [[Alphabet; CLASSES]; GROUPS] = {
    const FIRST: Alphabet = Alphabet::new(&SHAPES[0]);
    let mut alphabets = [const { [const { FIRST }; CLASSES] }; GROUPS];
    let mut shape = 1;
    while shape < SHAPES.len() {
        alphabets[shape / CLASSES][shape % CLASSES] = Alphabet::new(&SHAPES[shape]);
        shape += 1;
    }
    alphabets
};

/// The cost of a symbol with this frequency, in 1/256 bits. The logarithm is piecewise linear, which suffices to
/// compare candidates.
const fn symbol_cost(size: u32) -> u32 {
    let keyframe = size.ilog2();
    let fraction = (size << 8 >> keyframe) - 256;
    (TOTAL_BITS - keyframe) * 256 - fraction
}

/// The cost of a form by the frequencies of this row, in 1/256 bits.
pub(super) fn code_cost(row: usize, code: usize) -> u32 {
    CODE_COSTS[row][code].into()
}

/// The cost of each form, by row.
static CODE_COSTS: [[u16; CODE_COUNT]; MODES.len()] = {
    let mut costs = [[0; CODE_COUNT]; MODES.len()];
    let mut row = 0;
    while row < MODES.len() {
        let mut code = 0;
        while code < CODE_COUNT {
            let size = MODES[row][code + 1] - MODES[row][code];
            // At most twelve bits.
            costs[row][code] = symbol_cost(size as u32) as u16;
            code += 1;
        }
        row += 1;
    }
    costs
};

/// The cost of each symbol of each alphabet, in 1/256 bits.
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

/// Writes the rest of an escaped number: its length in ones, a zero, and its bits.
fn write_rest(rest: u32, to: &mut RangeWriter) {
    let width = (rest + 1).ilog2();
    for _ in 0..width {
        to.raw(1, 1);
    }
    to.raw(0, 1);
    to.raw(rest + 1 - (1 << width), width);
}

/// Reads the sign that follows a non-zero size and returns the signed number.
fn with_sign(size: u32, from: &mut RangeReader<'_>) -> Result<i32, Malformed> {
    let number = i32::try_from(size).map_err(|_| Malformed::OutOfRange)?;
    let negative = from.fill_with_bit(size > 0)?;
    Ok(if negative { -number } else { number })
}

/// Reads the bits after the symbol of a large number: the excess of an escaped one, and the raw bits.
fn read_large(symbol: u32, raw: u32, from: &mut RangeReader<'_>) -> Result<u32, Malformed> {
    let mut high = symbol;
    if high == ESCAPE {
        high = high
            .checked_add(read_rest(from)?)
            .ok_or(Malformed::OutOfRange)?;
    }
    if high.leading_zeros() < raw {
        return Err(Malformed::OutOfRange);
    }
    let low = if raw > 0 { from.raw(raw)? } else { 0 };
    Ok((high << raw) | low)
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

// With the greatest expectation, the raw bits still fit a 32-bit number.
const _: () = assert!(LEARNT_MAX * ONE < 1 << 20);
const _: () = assert!(SHAPES.len() <= 256);

#[cfg(test)]
mod tests {
    use alloc::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn numbers_round_trip_at_about_their_cost(
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
    fn every_shape_gives_every_symbol_a_frequency() {
        for shape in &SHAPES {
            assert_eq!((shape[0], shape[SYMBOLS]), (0, 1 << TOTAL_BITS));
            assert!(shape.windows(2).all(|pair| pair[0] < pair[1]));
        }
    }
}
