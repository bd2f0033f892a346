//! How far the silent upstream of a client is trusted.
//!
//! Counted in the scene's ticks alone, so that it is the same in a scene that its members lead (PROTOCOL 6.14).

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::limits::UPSTREAM_GRACE_MS;
use crate::stream::{WatermarkPolicy, whole_ticks};

/// How long an upstream is predicted without a watermark, in ticks of its scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WatermarkSchedule {
    policy: WatermarkPolicy,
    /// How late a watermark may be.
    grace: Ticks,
}

impl WatermarkSchedule {
    pub(crate) fn of(rate: Rate) -> Self {
        Self {
            policy: WatermarkPolicy::upstream(rate),
            grace: Ticks::new(whole_ticks(rate, UPSTREAM_GRACE_MS) as u32),
        }
    }

    /// The tick at which the next watermark is due after one of `watermark_tick` that ends a silence of `silence` ticks.
    pub(crate) fn due(&self, watermark_tick: Tick, silence: u64) -> Tick {
        watermark_tick + Ticks::new(self.policy.pause_after(silence) as u32)
    }

    /// The tick from which the server asks for the overdue watermark.
    pub(crate) fn asked(&self, watermark_tick: Tick, silence: u64) -> Tick {
        self.due(watermark_tick, silence) + Ticks::new(self.grace.count() / 4)
    }

    /// The last tick that is predicted.
    pub(crate) fn trusted(&self, watermark_tick: Tick, silence: u64) -> Tick {
        self.due(watermark_tick, silence) + self.grace
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upstream_is_trusted_until_a_second_after_its_watermark_was_due() {
        let publish_schedule = WatermarkSchedule::of(Rate::HZ_60);
        assert_eq!(publish_schedule.trusted(Tick::new(10), 0), Tick::new(74));
        assert_eq!(
            publish_schedule.trusted(Tick::new(900), 700),
            Tick::new(1_110)
        );
    }
}
