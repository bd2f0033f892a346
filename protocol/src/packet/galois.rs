//! The field of 256 elements, in which repair_symbols are summed.
//!
//! Bytes are elements: addition is exclusive or, multiplication is that of polynomials over one bit modulo
//! x⁸ + x⁴ + x³ + x² + 1 (PROTOCOL 5.16). Invariant: every non-zero element has an inverse.

/// x⁸ + x⁴ + x³ + x² + 1, of which x is a generator. Source: PROTOCOL 5.16.
const POLYNOMIAL: u16 = 0x11d;

/// GaloisTables of x, twice over so that a sum of two logarithms needs no reduction, and logarithms to that base.
struct GaloisTables {
    of: [u8; 510],
    log: [u8; 256],
}

const POWERS: GaloisTables = powers();

const fn powers() -> GaloisTables {
    let mut powers = GaloisTables {
        of: [0; 510],
        log: [0; 256],
    };
    let mut value = 1_u16;
    let mut exponent = 0;
    while exponent < 255 {
        powers.of[exponent] = value as u8;
        powers.of[exponent + 255] = value as u8;
        powers.log[value as usize] = exponent as u8;
        value <<= 1;
        if value > 0xff {
            value ^= POLYNOMIAL;
        }
        exponent += 1;
    }
    powers
}

/// A product.
pub(crate) const fn times(a: u8, b: u8) -> u8 {
    if a == 0 || b == 0 {
        return 0;
    }
    let exponent = POWERS.log[a as usize] as usize + POWERS.log[b as usize] as usize;
    POWERS.of[exponent]
}

/// The inverse of an element that is not zero; of zero, zero.
pub(crate) const fn inverse(a: u8) -> u8 {
    if a == 0 {
        return 0;
    }
    POWERS.of[255 - POWERS.log[a as usize] as usize]
}

/// Adds `factor` times each of `config` to the sum in the same place; config beyond the sums are left out.
pub(crate) fn add_times(sums: &mut [u8], factor: u8, config: &[u8]) {
    if factor == 0 {
        return;
    }
    let log = usize::from(POWERS.log[usize::from(factor)]);
    for (sum, term) in sums.iter_mut().zip(config) {
        if *term != 0 {
            *sum ^= POWERS.of[log + usize::from(POWERS.log[usize::from(*term)])];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Multiplication as the document says it: shifted sums, reduced.
    fn by_shifts(a: u8, b: u8) -> u8 {
        let mut sum = 0_u16;
        for bit in 0..8 {
            if b >> bit & 1 == 1 {
                sum ^= u16::from(a) << bit;
            }
        }
        for bit in (8..16).rev() {
            if sum >> bit & 1 == 1 {
                sum ^= POLYNOMIAL << (bit - 8);
            }
        }
        sum as u8
    }

    #[test]
    fn products_are_those_of_polynomials_and_every_element_has_an_inverse() {
        for a in 0..=255 {
            for b in 0..=255 {
                assert_eq!(times(a, b), by_shifts(a, b), "{a} {b}");
            }
            let one = u8::from(a != 0);
            assert_eq!(times(a, inverse(a)), one, "{a}");
        }
    }

    #[test]
    fn sums_take_in_as_much_as_they_hold() {
        let mut sums = [1, 2, 3];
        add_times(&mut sums, 7, &[0, 9]);
        assert_eq!(sums, [1, 2 ^ times(7, 9), 3]);
        add_times(&mut sums, 0, &[5; 3]);
        add_times(&mut sums, 1, &[1, 2 ^ times(7, 9), 3, 4, 5]);
        assert_eq!(sums, [0; 3]);
    }
}
