//! Lookup tables of an alphabet for the range decoder.
//!
//! Computed at compile time from the starts of the symbols.

/// The frequencies of an alphabet add up to two to this power.
pub(crate) const TOTAL_BITS: u32 = 12;

/// The start of each symbol's parts, and for each stretch of parts the symbols near its first part.
#[derive(Clone, Debug)]
pub(crate) struct Alphabet {
    /// After the last symbol, the end of all parts, repeated.
    starts: [u16; STARTS],
    near: [NearSymbols; STRETCHES],
}

/// The symbol that covers the first part of a stretch, in the highest sixteen bits. Below are the start of the second
/// symbol after it, that of the next one, and its own. One load gives all of them.
#[derive(Clone, Copy, Debug)]
struct NearSymbols(u64);

/// A symbol and the parts that it covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SymbolSpan {
    pub(crate) symbol: usize,
    /// The first part.
    pub(crate) start: u32,
    /// Number of parts.
    pub(crate) size: u32,
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
        let mut near = [NearSymbols(0); STRETCHES];
        let (mut stretch, mut symbol) = (0, 0);
        while stretch < STRETCHES {
            while starts[symbol + 1] as usize <= stretch << STRETCH_BITS {
                symbol += 1;
            }
            let (first, second) = (starts[symbol] as u64, starts[symbol + 1] as u64);
            let third = starts[symbol + 2] as u64;
            near[stretch] = NearSymbols(first | second << 16 | third << 32 | (symbol as u64) << 48);
            stretch += 1;
        }
        Self { starts, near }
    }

    /// The symbol that covers a part, one of 2^[`TOTAL_BITS`].
    #[inline(always)]
    pub(crate) fn at(&self, part: u32) -> SymbolSpan {
        let stretch = (part >> STRETCH_BITS) as usize % STRETCHES;
        let NearSymbols(near) = self.near[stretch];
        let sixteen = |place: u32| (near >> (16 * place)) as u16;
        let [first, second, third] = [0, 1, 2].map(|place| u32::from(sixteen(place)));
        let symbol = usize::from(sixteen(3));
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
    use super::*;

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
