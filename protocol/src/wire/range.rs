//! Range coder: a symbol takes as many bits as its probability demands.
//!
//! Thirty-two bits wide, most significant byte first. Writing asserts; reading never does, and refuses every string
//! that writing does not give (PROTOCOL 5.3). The decoder looks symbols up in tables that are computed at compile
//! time.

use alloc::vec;
use alloc::vec::Vec;

use super::Malformed;
use super::bits::{PutBits, TakeBits};

/// Least range at the start of a symbol.
const RANGE_MIN: u32 = 1 << 24;
/// Most raw bits that one step takes.
const RAW_BITS_STEP: u32 = 16;
const _: () = assert!(RAW_BITS_STEP <= 16 && TOTAL_BITS < 16);

/// Encodes symbols.
#[derive(Clone, Debug)]
pub(crate) struct RangeWriter {
    /// Only the first `len` bytes are written; the rest is space, so that a symbol stores four bytes at once.
    bytes: Vec<u8>,
    len: usize,
    /// The carry beyond it has been added to `bytes`.
    low: u32,
    range: u32,
}

impl Default for RangeWriter {
    fn default() -> Self {
        Self::with_capacity(0)
    }
}

impl RangeWriter {
    /// A writer with capacity for this many bytes.
    pub(crate) fn with_capacity(bytes: usize) -> Self {
        Self {
            bytes: vec![0; bytes],
            len: 0,
            low: 0,
            range: u32::MAX,
        }
    }

    /// A symbol that covers `size` of the 2^`bits` parts of its alphabet, from part `start` on.
    ///
    /// # Panics
    ///
    /// When `size` is zero.
    #[inline]
    pub(crate) fn symbol(&mut self, start: u32, size: u32, bits: u32) {
        assert!(size > 0, "a symbol without probability cannot be coded");
        let part = self.range >> bits;
        let low = self.low.wrapping_add(part * start);
        self.widen(u64::from(low) << 32, u64::from(part * size) << 32);
    }

    /// The same for an alphabet of 2^[`TOTAL_BITS`] parts, then a raw bit if there is one.
    #[inline(always)]
    pub(crate) fn symbol_and_bit(&mut self, start: u32, size: u32, bit: Option<bool>) {
        assert!(size > 0, "a symbol without probability cannot be coded");
        let part = self.range >> TOTAL_BITS;
        let (low, range) = (self.low.wrapping_add(part * start), part * size);
        if range >= 2 * RANGE_MIN {
            return self.narrow(low, range, bit);
        }
        // A range that gives bytes away has an exact half after them; otherwise the half is rounded down.
        let rounded = u64::from(range >= RANGE_MIN) << 31;
        let range = u64::from(range) << 32;
        let part = match bit {
            Some(_) => (range >> 1) & !rounded,
            None => range,
        };
        let upper = if bit == Some(true) { part } else { 0 };
        self.widen((u64::from(low) << 32).wrapping_add(upper), part);
    }

    /// Continues with an end of the range and a range so wide that no bytes are due, before a raw bit or after it.
    #[inline(always)]
    fn narrow(&mut self, low: u32, range: u32, bit: Option<bool>) {
        let part = range >> u32::from(bit.is_some());
        let low = low.wrapping_add(if bit == Some(true) { part } else { 0 });
        // The range shrinks from its low end only: a lower end is one that has passed 2³².
        if low < self.low {
            self.carry();
        }
        (self.low, self.range) = (low, part);
    }

    /// Continues with an end of the range and a range, each with 32 bits below, once they are wide enough. Writes the
    /// bytes above.
    ///
    /// Without a branch on their number, which is unpredictable.
    #[inline(always)]
    fn widen(&mut self, low: u64, range: u64) {
        // The range shrinks from its low end only: a lower end is one that has passed 2⁶⁴.
        if ((low >> 32) as u32) < self.low {
            self.carry();
        }
        let bits = missing_bits(range);
        let four = ((low >> 32) as u32).to_be_bytes();
        match self.bytes.get_mut(self.len..self.len + 4) {
            Some(space) => space.copy_from_slice(&four),
            None => self.extend(four),
        }
        self.len += bits as usize / 8;
        self.low = ((low << bits) >> 32) as u32;
        self.range = ((range << bits) >> 32) as u32;
    }

    /// The same store where space is short.
    #[cold]
    fn extend(&mut self, four: [u8; 4]) {
        self.bytes.truncate(self.len);
        self.bytes.extend_from_slice(&four);
        self.bytes.resize(2 * self.len + 64, 0);
    }

    /// The low `count` bits of `value`, all equally likely; `count` is at most 32.
    #[inline]
    pub(crate) fn raw(&mut self, value: u32, count: u32) {
        let low_count = count.min(RAW_BITS_STEP);
        if count > RAW_BITS_STEP {
            self.symbol(value >> RAW_BITS_STEP, 1, count - RAW_BITS_STEP);
        }
        if low_count > 0 {
            self.symbol(value & ((1 << low_count) - 1), 1, low_count);
        }
    }

    #[cold]
    fn carry(&mut self) {
        for byte in self.bytes[..self.len].iter_mut().rev() {
            *byte = byte.wrapping_add(1);
            if *byte != 0 {
                return;
            }
        }
    }

    /// Greatest length of [`Self::into_bytes`].
    pub(crate) fn byte_len_max(&self) -> usize {
        self.len + 4
    }

    /// Ends with the fewest bytes that determine all symbols; trailing zeros are omitted.
    pub(crate) fn into_bytes(mut self) -> Vec<u8> {
        let tail = shortest_tail(i64::from(self.low), self.range);
        if tail >> 32 != 0 {
            self.carry();
        }
        self.bytes.truncate(self.len);
        self.bytes.extend_from_slice(&(tail as u32).to_be_bytes());
        while self.bytes.last() == Some(&0) {
            self.bytes.pop();
        }
        self.bytes
    }
}

/// Bits of the whole bytes by which a range, with 32 bits below, must be widened: none, eight or sixteen.
///
/// A symbol takes at most [`RAW_BITS_STEP`] bits, and so no more bytes than two. Two comparisons are faster than to
/// count leading zeros on processors without an instruction for it.
#[inline(always)]
fn missing_bits(range: u64) -> u32 {
    let below = |bits: u32| u32::from(range < u64::from(RANGE_MIN) << 32 >> bits);
    8 * (below(0) + below(8))
}

impl PutBits for RangeWriter {
    fn bits(&mut self, value: u32, count: u32) {
        self.raw(value, count);
    }
}

impl TakeBits for RangeReader<'_> {
    fn bits(&mut self, count: u32) -> Result<u32, Malformed> {
        self.raw(count)
    }
}

/// Of the numbers in `low..low + range`, the one with the most zero bytes at its low end, of 32 bits; among those the
/// least.
fn shortest_tail(low: i64, range: u32) -> i64 {
    for zeros in [32, 24, 16, 8] {
        let unit = 1_i64 << zeros;
        let value = (low + unit - 1).div_euclid(unit) * unit;
        if value - low < i64::from(range) {
            return value;
        }
    }
    low
}

/// Decodes symbols.
#[derive(Clone, Debug)]
pub(crate) struct RangeReader<'a> {
    bytes: &'a [u8],
    /// Bytes taken, with those beyond the end, which count as zeros.
    taken: u32,
    state: RangeState,
}

/// The range of a reader. Symbols that need no bytes change nothing else.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RangeState {
    /// The read number, from the low end of the range on.
    offset: u32,
    range: u32,
}

impl RangeState {
    /// The next symbol, without renormalisation: [`RangeReader::fill`] must follow, or a bit.
    ///
    /// # Errors
    ///
    /// As [`RangeReader::symbol`].
    #[inline(always)]
    pub(crate) fn symbol(&mut self, of: &Alphabet) -> Result<usize, Malformed> {
        let unit = self.range >> TOTAL_BITS;
        let part = self.offset / unit;
        // Division leaves a remainder at the upper end that no symbol encodes to.
        if part >> TOTAL_BITS != 0 {
            return Err(Malformed::NotCanonical);
        }
        let covering = of.at(part);
        self.offset -= unit * covering.start;
        self.range = unit * covering.size;
        Ok(covering.symbol)
    }

    /// True if no bytes are due before a bit or after it.
    #[inline(always)]
    pub(crate) const fn is_wide(self) -> bool {
        self.range >= 2 * RANGE_MIN
    }

    /// A raw bit of a filled state if `there` is set; otherwise returns an unset bit.
    ///
    /// # Errors
    ///
    /// As [`RangeReader::symbol`].
    #[inline(always)]
    pub(crate) fn bit(&mut self, there: bool) -> Result<bool, Malformed> {
        // Without a branch on whether there is a bit: nothing is halved for none.
        let part = self.range >> u32::from(there);
        let set = self.offset >= part;
        self.offset -= if set { part } else { 0 };
        self.range = part;
        if self.offset >= part {
            return Err(Malformed::NotCanonical);
        }
        Ok(set)
    }
}

impl<'a> RangeReader<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        let mut reader = Self {
            bytes,
            taken: 4,
            state: RangeState {
                offset: 0,
                range: u32::MAX,
            },
        };
        reader.state.offset = four_at(bytes, 0);
        reader
    }

    /// The range, to be given back by [`Self::set_state`].
    #[inline(always)]
    pub(crate) const fn state(&self) -> RangeState {
        self.state
    }

    #[inline(always)]
    pub(crate) const fn set_state(&mut self, state: RangeState) {
        self.state = state;
    }

    /// The next symbol.
    ///
    /// # Errors
    ///
    /// [`Malformed::NotCanonical`] for bytes that no symbol encodes to.
    #[inline(always)]
    pub(crate) fn symbol(&mut self, of: &Alphabet) -> Result<usize, Malformed> {
        let symbol = self.state.symbol(of)?;
        self.fill();
        Ok(symbol)
    }

    /// Takes as many bytes as bring the range up to [`RANGE_MIN`] again: few symbols need any, and few of those two.
    #[inline(always)]
    pub(crate) fn fill(&mut self) {
        while self.state.range < RANGE_MIN {
            let byte = self.bytes.get(self.taken as usize).copied();
            self.state.offset = self.state.offset << 8 | u32::from(byte.unwrap_or_default());
            self.state.range <<= 8;
            self.taken += 1;
        }
    }

    /// The same, then a raw bit if `there` is set; otherwise returns an unset bit.
    ///
    /// # Errors
    ///
    /// As [`Self::symbol`].
    #[inline(always)]
    pub(crate) fn fill_with_bit(&mut self, there: bool) -> Result<bool, Malformed> {
        // If the range takes bytes, its half is exact after them; otherwise the half is rounded down.
        self.fill();
        let set = self.state.bit(there)?;
        self.fill();
        Ok(set)
    }

    /// The next `count` raw bits; `count` is at most 32.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when more was read beyond the end than any writer omits.
    #[inline]
    pub(crate) fn raw(&mut self, count: u32) -> Result<u32, Malformed> {
        if count > RAW_BITS_STEP {
            let high = self.step(count - RAW_BITS_STEP)? << RAW_BITS_STEP;
            return Ok(high | self.step(RAW_BITS_STEP)?);
        }
        // No bits are a step too, which changes nothing.
        self.step(count)
    }

    /// The next raw bit: two equally likely values.
    ///
    /// # Errors
    ///
    /// As [`Self::symbol`].
    #[inline]
    pub(crate) fn bit(&mut self) -> Result<bool, Malformed> {
        self.fill_with_bit(true)
    }

    #[inline]
    fn step(&mut self, bits: u32) -> Result<u32, Malformed> {
        let unit = self.state.range >> bits;
        let value = self.state.offset / unit;
        if value >> bits != 0 {
            return Err(Malformed::NotCanonical);
        }
        self.state.offset -= unit * value;
        self.state.range = unit;
        self.fill();
        Ok(value)
    }

    /// Checks that a writer of these symbols gives exactly these bytes.
    ///
    /// # Errors
    ///
    /// [`Malformed::Trailing`] for more bytes than that, [`Malformed::NotCanonical`] for others.
    pub(crate) fn finish(&self) -> Result<(), Malformed> {
        if self.bytes.len() > self.taken as usize {
            return Err(Malformed::Trailing);
        }
        if self.state.offset >= self.state.range {
            return Err(Malformed::NotCanonical);
        }
        let window = i64::from(four_at(self.bytes, self.taken - 4));
        let low = window - i64::from(self.state.offset);
        let ends_in_zero = self.bytes.last() == Some(&0);
        if ends_in_zero || shortest_tail(low, self.state.range) != window {
            return Err(Malformed::NotCanonical);
        }
        Ok(())
    }
}

/// The four bytes from a place on, zeros beyond the end.
#[inline(always)]
fn four_at(bytes: &[u8], place: u32) -> u32 {
    let place = place as usize;
    match bytes.get(place..place + 4).and_then(<[u8]>::first_chunk) {
        Some(four) => u32::from_be_bytes(*four),
        None => last_at(bytes, place),
    }
}

/// The same near the end.
#[cold]
fn last_at(bytes: &[u8], place: usize) -> u32 {
    let byte = |place: usize| bytes.get(place).copied().unwrap_or_default();
    u32::from_be_bytes([
        byte(place),
        byte(place + 1),
        byte(place + 2),
        byte(place + 3),
    ])
}

/// The frequencies of an alphabet add up to two to this power.
pub(crate) const TOTAL_BITS: u32 = 12;

/// The start of each symbol's parts, and for each stretch of parts the symbols near its first part.
#[derive(Clone, Debug)]
pub(crate) struct Alphabet {
    /// After the last symbol, the end of all parts, repeated.
    starts: [u16; STARTS],
    near: [NearSymbols; STRETCHES],
}

/// The symbol that covers the first part of a stretch, its start, and the starts of the two symbols after it.
#[derive(Clone, Copy, Debug)]
struct NearSymbols {
    symbol: u16,
    first: u16,
    second: u16,
    third: u16,
}

/// A symbol and the parts that it covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct SymbolSpan {
    symbol: usize,
    /// The first part.
    start: u32,
    /// Number of parts.
    size: u32,
}

/// Greatest number of symbols, with the end.
const SYMBOLS_MAX: usize = 32;
/// Two more entries after the symbols.
const STARTS: usize = SYMBOLS_MAX + 2;
/// Parts of a stretch, as a power of two: few stretches have more than two symbols.
const STRETCH_BITS: u32 = 6;
const STRETCHES: usize = 1 << (TOTAL_BITS - STRETCH_BITS);

impl Alphabet {
    /// Tables of symbols that start at these parts, followed by the end.
    pub(crate) const fn new<const N: usize>(of: &[u16; N]) -> Self {
        assert!(N <= SYMBOLS_MAX && of[0] == 0 && of[N - 1] == 1 << TOTAL_BITS);
        let mut starts = [1 << TOTAL_BITS; STARTS];
        let mut place = 0;
        while place < N {
            starts[place] = of[place];
            place += 1;
        }
        let mut near = [const {
            NearSymbols {
                symbol: 0,
                first: 0,
                second: 0,
                third: 0,
            }
        }; STRETCHES];
        let (mut stretch, mut symbol) = (0, 0);
        while stretch < STRETCHES {
            while starts[symbol + 1] as usize <= stretch << STRETCH_BITS {
                symbol += 1;
            }
            near[stretch] = NearSymbols {
                // There are at most 32 symbols.
                symbol: symbol as u16,
                first: starts[symbol],
                second: starts[symbol + 1],
                third: starts[symbol + 2],
            };
            stretch += 1;
        }
        Self { starts, near }
    }

    /// The symbol that covers a part, one of 2^[`TOTAL_BITS`].
    #[inline(always)]
    fn at(&self, part: u32) -> SymbolSpan {
        let stretch = (part >> STRETCH_BITS) as usize % STRETCHES;
        let near = &self.near[stretch];
        let [first, second, third] = [near.first, near.second, near.third].map(u32::from);
        let symbol = usize::from(near.symbol);
        if third <= part {
            return self.beyond(symbol, part);
        }
        // The code does not branch between the two symbols: no processor predicts which one it is.
        let past = u32::from(second <= part);
        let one = past.wrapping_neg();
        let start = first ^ ((first ^ second) & one);
        let end = second ^ ((second ^ third) & one);
        SymbolSpan {
            symbol: symbol + past as usize,
            start,
            size: end - start,
        }
    }

    /// The same for a stretch with more than two symbols.
    fn beyond(&self, mut symbol: usize, part: u32) -> SymbolSpan {
        let start = |symbol: usize| u32::from(self.starts[symbol]);
        while start(symbol + 1) <= part {
            symbol += 1;
        }
        SymbolSpan {
            symbol,
            start: start(symbol),
            size: start(symbol + 1) - start(symbol),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Symbols of an alphabet of skewed frequencies, and raw bits.
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum CodedItem {
        Symbol(usize),
        SymbolAndBit(usize, Option<bool>),
        Raw(u32, u32),
    }

    const STARTS: [u16; 6] = [0, 3_000, 3_900, 4_094, 4_095, 4_096];
    static ALPHABET: Alphabet = Alphabet::new(&STARTS);

    fn coded_item() -> impl Strategy<Value = CodedItem> {
        prop_oneof![
            (0_usize..5).prop_map(CodedItem::Symbol),
            Just(CodedItem::Symbol(0)),
            (0_usize..5, any::<Option<bool>>())
                .prop_map(|(s, bit)| CodedItem::SymbolAndBit(s, bit)),
            (0_u32..=32, any::<u32>()).prop_map(|(count, value)| CodedItem::Raw(
                if count == 32 {
                    value
                } else {
                    value & ((1 << count) - 1)
                },
                count
            )),
        ]
    }

    fn written(all: &[CodedItem]) -> Vec<u8> {
        let mut writer = RangeWriter::default();
        for coded_item in all {
            let span = |s: usize| {
                let (start, end) = (u32::from(STARTS[s]), u32::from(STARTS[s + 1]));
                (start, end - start)
            };
            match *coded_item {
                CodedItem::Symbol(s) => {
                    let (start, size) = span(s);
                    writer.symbol(start, size, TOTAL_BITS);
                }
                CodedItem::SymbolAndBit(s, bit) => {
                    let (start, size) = span(s);
                    writer.symbol_and_bit(start, size, bit);
                }
                CodedItem::Raw(value, count) => writer.raw(value, count),
            }
        }
        writer.into_bytes()
    }

    /// Decodes as many items as `like` has, each of the same kind.
    fn read(bytes: &[u8], like: &[CodedItem]) -> Result<Vec<CodedItem>, Malformed> {
        let mut reader = RangeReader::new(bytes);
        let mut all = Vec::new();
        for coded_item in like {
            all.push(match *coded_item {
                CodedItem::Symbol(_) => CodedItem::Symbol(reader.symbol(&ALPHABET)?),
                CodedItem::SymbolAndBit(_, bit) => {
                    let symbol = reader.symbol(&ALPHABET)?;
                    let bit = bit.map(|_| reader.bit()).transpose()?;
                    CodedItem::SymbolAndBit(symbol, bit)
                }
                CodedItem::Raw(_, count) => CodedItem::Raw(reader.raw(count)?, count),
            });
        }
        reader.finish()?;
        Ok(all)
    }

    proptest! {
        #[test]
        fn range_coder_round_trips(all in proptest::collection::vec(coded_item(), 0..200)) {
            let bytes = written(&all);
            prop_assert_eq!(read(&bytes, &all), Ok(all));
        }

        #[test]
        fn encoding_is_unique(
            all in proptest::collection::vec(coded_item(), 0..40),
            bytes in proptest::collection::vec(any::<u8>(), 0..40),
        ) {
            if let Ok(read) = read(&bytes, &all) {
                prop_assert_eq!(written(&read), bytes);
            }
        }

        #[test]
        fn changed_bits_are_refused_or_canonical(
            all in proptest::collection::vec(coded_item(), 1..40), at in any::<prop::sample::Index>(), bit in 0..8,
        ) {
            let mut bytes = written(&all);
            prop_assume!(!bytes.is_empty());
            let place = at.index(bytes.len());
            bytes[place] ^= 1_u8 << bit;
            if let Ok(read) = read(&bytes, &all) {
                prop_assert_eq!(written(&read), bytes);
            }
        }

        #[test]
        fn a_likely_symbol_takes_few_bits(count in 0_usize..2_000) {
            let bytes = written(&alloc::vec![CodedItem::Symbol(0); count]);
            // -log2(3000/4096) is 0.45 bits.
            prop_assert!(bytes.len() <= count * 45 / 800 + 2);
        }
    }

    /// A reader that follows PROTOCOL 5.3 literally.
    struct ReferenceReader<'a> {
        bytes: &'a [u8],
        taken: usize,
        offset: u32,
        range: u32,
    }

    impl ReferenceReader<'_> {
        fn byte(&mut self) -> u32 {
            self.taken += 1;
            u32::from(self.bytes.get(self.taken - 1).copied().unwrap_or(0))
        }

        fn symbol(&mut self, starts: &[u32], bits: u32) -> Option<usize> {
            let part = self.range >> bits;
            let place = self.offset / part;
            if place >> bits != 0 {
                return None;
            }
            let symbol = starts.iter().rposition(|start| *start <= place)?;
            self.offset -= part * starts[symbol];
            self.range = part * (starts[symbol + 1] - starts[symbol]);
            while self.range < RANGE_MIN {
                self.range <<= 8;
                self.offset = self.offset << 8 | self.byte();
            }
            Some(symbol)
        }
    }

    /// One read operation.
    #[derive(Clone, Copy, Debug)]
    enum ReadStep {
        Symbol,
        SymbolAndBit { unless: usize },
        Bit,
        Raw(u32),
    }

    fn step() -> impl Strategy<Value = ReadStep> {
        prop_oneof![
            Just(ReadStep::Symbol),
            (0_usize..5).prop_map(|unless| ReadStep::SymbolAndBit { unless }),
            Just(ReadStep::Bit),
            (1_u32..=RAW_BITS_STEP).prop_map(ReadStep::Raw),
        ]
    }

    proptest! {
        #[test]
        fn any_bytes_are_decoded_as_by_the_reference_reader(
            bytes in proptest::collection::vec(any::<u8>(), 0..60), steps in proptest::collection::vec(step(), 0..200),
        ) {
            let starts = STARTS.map(u32::from);
            let mut plain = ReferenceReader { bytes: &bytes, taken: 0, offset: 0, range: u32::MAX };
            for _ in 0..4 {
                plain.offset = plain.offset << 8 | plain.byte();
            }
            let mut reader = RangeReader::new(&bytes);
            for step in steps {
                let bit = [0, 1, 2];
                let (expected, read) = match step {
                    ReadStep::Symbol => (plain.symbol(&starts, TOTAL_BITS), reader.symbol(&ALPHABET)),
                    ReadStep::Bit => (plain.symbol(&bit, 1), reader.bit().map(usize::from)),
                    ReadStep::Raw(count) => {
                        let all: Vec<u32> = (0..=1 << count).collect();
                        (plain.symbol(&all, count), reader.raw(count).map(|value| value as usize))
                    }
                    ReadStep::SymbolAndBit { unless } => {
                        let symbol = plain.symbol(&starts, TOTAL_BITS);
                        let set = symbol.and_then(|symbol| {
                            if symbol == unless { Some(0) } else { plain.symbol(&bit, 1) }
                        });
                        let both = symbol.zip(set).map(|(symbol, set)| symbol * 2 + set);
                        let read = reader.state.symbol(&ALPHABET).and_then(|symbol| {
                            let set = match reader.state.is_wide() {
                                true => reader.state.bit(symbol != unless)?,
                                false => reader.fill_with_bit(symbol != unless)?,
                            };
                            Ok(symbol * 2 + usize::from(set))
                        });
                        (both, read)
                    }
                };
                prop_assert_eq!(read.ok(), expected);
                if expected.is_none() {
                    break;
                }
                prop_assert_eq!(
                    (reader.state.offset, reader.state.range, reader.taken as usize),
                    (plain.offset, plain.range, plain.taken)
                );
            }
        }
    }

    #[test]
    fn no_symbols_take_no_bytes() {
        assert_eq!(written(&[]), []);
        assert_eq!(read(&[], &[]), Ok(Vec::new()));
        assert_eq!(read(&[1], &[]), Err(Malformed::NotCanonical));
    }

    #[test]
    fn the_lookup_equals_a_linear_search() {
        let dense = [
            0, 1, 2, 3, 4, 60, 70, 71, 72, 128, 4_000, 4_094, 4_095, 4_096,
        ];
        for alphabet in [
            &dense[..],
            &[0, 4_096],
            &[0, 4_095, 4_096],
            &[0, 64, 128, 4_096],
        ] {
            let mut starts = [4_096; SYMBOLS_MAX];
            starts[..alphabet.len()].copy_from_slice(alphabet);
            let fast = Alphabet::new(&starts);
            for part in 0..1 << TOTAL_BITS {
                let symbol = alphabet.iter().rposition(|start| u32::from(*start) <= part);
                let symbol = symbol.unwrap();
                let [start, end] = [symbol, symbol + 1].map(|place| u32::from(alphabet[place]));
                let size = end - start;
                assert_eq!(
                    fast.at(part),
                    SymbolSpan {
                        symbol,
                        start,
                        size
                    }
                );
            }
        }
    }
}
