//! Seeded random decisions in whole numbers.
//!
//! Knows no packets. Integer arithmetic only: the draws are equal on every platform.

use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use rhumb_protocol::Span;

use super::probability::Probability;

/// A generator of decisions that depend on the seed alone.
#[derive(Clone, Debug)]
pub(super) struct SimRng {
    draws: Pcg32,
}

/// A probability as a count of 2⁻³², in [0, 2³²].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Odds(u64);

impl Odds {
    pub(super) fn of(share: Probability) -> Self {
        Self::ratio(share.as_millionths().into(), 1_000_000)
    }

    /// `part / whole`, at most 1; `whole` is not zero.
    pub(super) fn ratio(part: u64, whole: u64) -> Self {
        let ratio = (u128::from(part) << 32) / u128::from(whole);
        Self(u64::try_from(ratio).unwrap_or(u64::MAX).min(1 << 32))
    }
}

impl SimRng {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            draws: Pcg32::new(seed, STREAM),
        }
    }

    pub(super) fn happens(&mut self, odds: Odds) -> bool {
        u64::from(self.draws.next_u32()) < odds.0
    }

    /// A uniform span in [0, `span_max`].
    pub(super) fn span(&mut self, span_max: Span) -> Span {
        let choices = u128::from(span_max.as_nanos()) + 1;
        let ns = (u128::from(self.draws.next_u64()) * choices) >> 64;
        Span::from_nanos(u64::try_from(ns).expect("at most the greatest span"))
    }
}

/// Stream number of the generator. Any odd constant is valid; this one is PCG's example.
const STREAM: u64 = 0x0a02_bdbf_7bb3_c0a7;
