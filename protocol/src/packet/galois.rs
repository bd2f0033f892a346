//! Arithmetic in GF(256), the field of the repair symbols.
//!
//! Bytes are elements. Addition is exclusive or; multiplication is that of polynomials over one bit modulo x⁸ + x⁴ + x³
//! + x² + 1 (PROTOCOL 5.16). Invariant: every non-zero element has an inverse.

/// x⁸ + x⁴ + x³ + x² + 1, of which x is a generator. Source: PROTOCOL 5.16.
const POLYNOMIAL: u16 = 0x11d;

/// Powers of x, twice over so that a sum of two logarithms needs no reduction, and logarithms to base x.
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

/// The product of two elements.
pub(crate) const fn times(a: u8, b: u8) -> u8 {
    if a == 0 || b == 0 {
        return 0;
    }
    let exponent = POWERS.log[a as usize] as usize + POWERS.log[b as usize] as usize;
    POWERS.of[exponent]
}

/// The inverse of a non-zero element; zero for zero.
pub(crate) const fn inverse(a: u8) -> u8 {
    if a == 0 {
        return 0;
    }
    POWERS.of[255 - POWERS.log[a as usize] as usize]
}

/// Adds `factor` times each term to the sum at the same position. Terms beyond the sums are ignored.
pub(crate) fn add_times(sums: &mut [u8], factor: u8, terms: &[u8]) {
    if factor == 0 {
        return;
    }
    let log = usize::from(POWERS.log[usize::from(factor)]);
    for (sum, term) in sums.iter_mut().zip(terms) {
        if *term != 0 {
            *sum ^= POWERS.of[log + usize::from(POWERS.log[usize::from(*term)])];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Multiplication by shifts and reduction, as the specification defines it.
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
    fn terms_beyond_the_sums_are_ignored() {
        let mut sums = [1, 2, 3];
        add_times(&mut sums, 7, &[0, 9]);
        assert_eq!(sums, [1, 2 ^ times(7, 9), 3]);
        add_times(&mut sums, 0, &[5; 3]);
        add_times(&mut sums, 1, &[1, 2 ^ times(7, 9), 3, 4, 5]);
        assert_eq!(sums, [0; 3]);
    }
}
