//! Reproducible random numbers.
//!
//! Every random run prints its seed; `SEED=n` in the environment replays it.

/// The seed of a run: `SEED` of the environment, or else this default. It is printed, and shown when the test fails.
#[must_use]
pub fn seed(otherwise: u64) -> u64 {
    let requested_authority = std::env::var("SEED").ok();
    let seed = requested_authority
        .and_then(|text| text.parse().ok())
        .unwrap_or(otherwise);
    eprintln!("seed {seed}: SEED={seed} replays this run");
    seed
}

/// A small generator with integer arithmetic only, equal on every platform. Source: Knuth's MMIX, TAOCP 2, section
/// 3.3.4.
#[derive(Clone, Debug)]
pub struct Dice(u64);

impl Dice {
    /// A generator with this seed.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// A number below `most`, which must be positive.
    pub fn below(&mut self, most: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % most
    }
}
