//! How long the server predicts a silent upstream of a client.
//!
//! Counted in ticks of the scene alone, so that it is the same in a lockstep scene (PROTOCOL 6.14).

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::limits::UPSTREAM_GRACE_MS;
use crate::stream::{WatermarkPolicy, whole_ticks};

/// How long an upstream is predicted without a watermark, in ticks of its scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WatermarkSchedule {
    policy: WatermarkPolicy,
    /// The allowed delay of a watermark.
    grace: Ticks,
}

impl WatermarkSchedule {
    pub(crate) fn of(rate: Rate) -> Self {
        Self {
            policy: WatermarkPolicy::upstream(rate),
            grace: Ticks::new(whole_ticks(rate, UPSTREAM_GRACE_MS) as u32),
        }
    }

    /// When the watermark after `watermark_tick` is due, given the ticks of silence that `watermark_tick` ended.
    pub(crate) fn due(&self, watermark_tick: Tick, silence: u64) -> Tick {
        watermark_tick + Ticks::new(self.policy.pause_after(silence) as u32)
    }

    /// The tick from which the server requests the overdue watermark.
    pub(crate) fn requested(&self, watermark_tick: Tick, silence: u64) -> Tick {
        self.due(watermark_tick, silence) + Ticks::new(self.grace.count() / 4)
    }

    /// The last tick that the server predicts without it.
    pub(crate) fn trusted(&self, watermark_tick: Tick, silence: u64) -> Tick {
        self.due(watermark_tick, silence) + self.grace
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upstream_is_trusted_until_a_second_after_its_watermark_was_due() {
        let schedule = WatermarkSchedule::of(Rate::HZ_60);
        assert_eq!(schedule.trusted(Tick::new(10), 0), Tick::new(74));
        assert_eq!(schedule.trusted(Tick::new(900), 700), Tick::new(1_110));
    }
}
