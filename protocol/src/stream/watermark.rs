//! The schedule of a silent stream's watermarks.
//!
//! Counted in ticks of the scene alone, so it is the same in a lockstep scene. One rule for every stream: after the
//! shortest silence, then each time the silence has doubled, and at most the longest pause apart.

use core::num::NonZeroU32;

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::limits::{SILENCE_MS_MAX, UPSTREAM_WATERMARK_MS};

/// The bounds of the silence between two watermarks of one stream, in ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WatermarkPolicy {
    shortest: u64,
    longest: u64,
}

impl WatermarkPolicy {
    /// Every silent published tick, because members wait for it.
    pub const LOCKSTEP: Self = Self {
        shortest: 1,
        longest: 1,
    };

    /// The first silent tick, then at growing intervals; for a scene that publishes at multiples of `publish_interval`.
    #[must_use]
    pub fn free_running(rate: Rate, publish_interval: NonZeroU32) -> Self {
        let publish_interval = u64::from(publish_interval.get());
        let publications = (whole_ticks(rate, SILENCE_MS_MAX) / publish_interval).max(1);
        Self {
            shortest: 1,
            longest: publications * publish_interval,
        }
    }

    /// The policy of an upstream: a watermark a few ticks later often saves a datagram.
    #[must_use]
    pub fn upstream(rate: Rate) -> Self {
        Self {
            shortest: whole_ticks(rate, UPSTREAM_WATERMARK_MS),
            longest: whole_ticks(rate, SILENCE_MS_MAX),
        }
    }

    /// The pause, in ticks, after the watermark that ended a silence of `silence` ticks.
    pub(crate) fn pause_after(&self, silence: u64) -> u64 {
        silence.clamp(self.shortest, self.longest)
    }
}

/// The present silence of one stream.
#[derive(Debug)]
pub(super) struct Silence {
    policy: WatermarkPolicy,
    /// The tick of the newest packet.
    since: Tick,
    /// The silence at which the next watermark is due, in ticks.
    watermark_at: u64,
}

impl Silence {
    /// A silence that starts at this tick.
    pub(super) fn new(policy: WatermarkPolicy, since: Tick) -> Self {
        Self {
            policy,
            since,
            watermark_at: policy.pause_after(0),
        }
    }

    /// Ends the silence with a packet sent at this tick.
    pub(super) fn end(&mut self, tick: Tick) {
        *self = Self::new(self.policy, tick);
    }

    /// True if a watermark is due at a silent tick.
    pub(super) fn is_watermark_due(&self, tick: Tick) -> bool {
        tick.value() - self.since.value() >= self.watermark_at
    }

    /// Starts the next pause with a watermark sent at a silent tick.
    pub(super) fn pause(&mut self, tick: Tick) {
        let silence = tick.value() - self.since.value();
        self.watermark_at = silence + self.policy.pause_after(silence);
    }
}

/// Whole ticks in this many milliseconds, at least one.
pub(crate) fn whole_ticks(rate: Rate, milliseconds: u32) -> u64 {
    let (ticks, seconds) = (u64::from(rate.ticks()), u64::from(rate.seconds()));
    (ticks * u64::from(milliseconds) / (1_000 * seconds)).max(1)
}

/// Whole ticks in a second, at least one.
pub(crate) fn second(rate: Rate) -> Ticks {
    Ticks::new(whole_ticks(rate, 1_000) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    fn silences(policy: WatermarkPolicy) -> Vec<u64> {
        let mut silence = 0;
        let next = |_| {
            silence += policy.pause_after(silence);
            silence
        };
        (0..11).map(next).collect()
    }

    #[test]
    fn watermarks_of_a_silence_grow_rarer_within_bounds() {
        let every = |ticks| NonZeroU32::new(ticks).unwrap();
        assert_eq!(
            silences(WatermarkPolicy::upstream(Rate::HZ_60)),
            [4, 8, 16, 32, 64, 128, 256, 406, 556, 706, 856]
        );
        assert_eq!(
            silences(WatermarkPolicy::free_running(Rate::HZ_60, every(1))),
            [1, 2, 4, 8, 16, 32, 64, 128, 256, 406, 556]
        );
        let rare = WatermarkPolicy::free_running(Rate::HZ_60, every(400));
        assert_eq!(rare.longest, 400);
        let lockstep = silences(WatermarkPolicy::LOCKSTEP);
        assert!(lockstep.into_iter().eq(1..=11));
    }
}
