//! The byte budget of a stream, and the token bucket that enforces it.
//!
//! The bucket fills as ticks pass. `publisher/update_queue` decides which updates go first. The budget does not depend
//! on links or receivers.

use rhumb_reckoning::{Rate, Ticks};

use crate::limits::{BUDGET_BURST_MAX, BUDGET_MAX, BUDGET_MIN, DATAGRAM_BYTES_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// The bytes that a stream's packets may take: a rate per second of the scene's time, and a burst.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Budget {
    bytes_per_second: u32,
    burst: u32,
}

impl Budget {
    /// A budget of this rate and burst, in bytes; `None` outside the limits (PROTOCOL 7).
    #[must_use]
    pub fn new(bytes_per_second: u32, burst: u32) -> Option<Self> {
        let fits = (BUDGET_MIN..=BUDGET_MAX).contains(&bytes_per_second);
        let bursts = (DATAGRAM_BYTES_MAX as u32..=BUDGET_BURST_MAX).contains(&burst);
        (fits && bursts).then_some(Self {
            bytes_per_second,
            burst,
        })
    }

    /// A budget of this rate with a burst of a quarter of a second, or of a full packet if that is more.
    #[must_use]
    pub fn per_second(bytes: u32) -> Option<Self> {
        let burst = (bytes / 4).clamp(DATAGRAM_BYTES_MAX as u32, BUDGET_BURST_MAX);
        Self::new(bytes, burst)
    }

    /// The rate, bytes per second of the scene's time.
    #[must_use]
    pub const fn bytes_per_second(self) -> u32 {
        self.bytes_per_second
    }

    /// The burst, bytes.
    #[must_use]
    pub const fn burst(self) -> u32 {
        self.burst
    }
}

impl Wire for Budget {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.bytes_per_second));
        to.varint(u64::from(self.burst));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Self::new(from.varint32()?, from.varint32()?).ok_or(Malformed::OutOfRange)
    }
}

/// The unspent part of a budget.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TokenBucket {
    /// Billionths of a byte; negative after packets that had to be sent despite the budget.
    left: i64,
    each_tick: i64,
    most: i64,
}

const BILLION: i64 = 1_000_000_000;

impl TokenBucket {
    /// A full bucket.
    pub(crate) fn new(budget: Budget, rate: Rate) -> Self {
        let most = i64::from(budget.burst) * BILLION;
        Self {
            left: most,
            each_tick: (u64::from(budget.bytes_per_second) * rate.step_ns()) as i64,
            most,
        }
    }

    /// Adds the bytes earned in `passed` ticks.
    pub(crate) fn earn(&mut self, passed: Ticks) {
        let earned = self.each_tick.saturating_mul(i64::from(passed.count()));
        self.left = self.left.saturating_add(earned).min(self.most);
    }

    /// Subtracts bytes that were sent.
    pub(crate) fn spend(&mut self, bytes: usize) {
        self.left = self.left.saturating_sub(bytes as i64 * BILLION);
    }

    /// The unspent whole bytes.
    pub(crate) fn left(&self) -> u64 {
        (self.left.max(0) / BILLION) as u64
    }
}

// The bytes earned in a tick of the slowest scene do not overflow.
const _: () = assert!((BUDGET_MAX as i64) <= i64::MAX / BILLION / 4);

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_bytes_spent_never_exceed_the_burst_plus_the_earned_bytes(
            rate in BUDGET_MIN..1_000_000,
            packet_sizes in proptest::collection::vec(0_usize..3_000, 1..400),
        ) {
            let budget = Budget::per_second(rate).unwrap();
            let mut token_bucket = TokenBucket::new(budget, Rate::HZ_60);
            let (mut spent, mut longest) = (0_u64, 0);
            for (ticks, size) in packet_sizes.iter().enumerate() {
                token_bucket.earn(Ticks::new(1));
                if token_bucket.left() > 0 {
                    token_bucket.spend(*size);
                    spent += *size as u64;
                    longest = longest.max(*size);
                }
                let earned = u64::from(rate) * (ticks as u64 + 1) / 60;
                let allowed = u64::from(budget.burst()) + earned + longest as u64 + 1;
                prop_assert!(spent <= allowed, "{} of {}", spent, allowed);
            }
        }
    }

    #[test]
    fn a_budget_round_trips_and_invalid_ones_are_refused() {
        for (rate, burst, fits) in [
            (BUDGET_MIN, 1_150, true),
            (8_000, 2_000, true),
            (BUDGET_MAX, BUDGET_BURST_MAX, true),
            (BUDGET_MIN - 1, 1_150, false),
            (8_000, 1_149, false),
            (BUDGET_MAX + 1, 2_000, false),
            (8_000, BUDGET_BURST_MAX + 1, false),
        ] {
            let mut writer = Writer::new();
            writer.varint(u64::from(rate));
            writer.varint(u64::from(burst));
            let bytes = writer.into_bytes();
            let read = Budget::decode(&mut Reader::new(&bytes));
            assert_eq!(read.is_ok(), fits, "{rate} {burst}");
            assert_eq!(read.ok(), Budget::new(rate, burst));
            if let Ok(budget) = read {
                let mut writer = Writer::new();
                budget.encode(&mut writer);
                assert_eq!(writer.into_bytes(), bytes);
            }
        }
    }
}
