//! The timeout after which a silent upstream is stale.
//!
//! Counted in ticks of the scene alone, so that it is the same in a lockstep scene (PROTOCOL 6.14).

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::limits::UPSTREAM_GRACE_MS;
use crate::stream::{WatermarkPolicy, whole_ticks};

/// The timeout of an upstream, in ticks of its scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UpstreamTimeout {
    policy: WatermarkPolicy,
    /// The allowed delay of a watermark.
    grace: Ticks,
}

impl UpstreamTimeout {
    pub(crate) fn of(rate: Rate) -> Self {
        Self {
            policy: WatermarkPolicy::upstream(rate),
            grace: Ticks::new(whole_ticks(rate, UPSTREAM_GRACE_MS) as u32),
        }
    }

    /// The tick at which the watermark after `watermark_tick` is due. `silence`: the ticks of silence that ended there.
    pub(crate) fn due(&self, watermark_tick: Tick, silence: u64) -> Tick {
        watermark_tick + Ticks::new(self.policy.pause_after(silence) as u32)
    }

    /// The tick from which the server requests the overdue watermark.
    pub(crate) fn request_from(&self, watermark_tick: Tick, silence: u64) -> Tick {
        self.due(watermark_tick, silence) + Ticks::new(self.grace.count() / 4)
    }

    /// The last tick that the server predicts without that watermark.
    pub(crate) fn last_predicted(&self, watermark_tick: Tick, silence: u64) -> Tick {
        self.due(watermark_tick, silence) + self.grace
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_upstream_is_predicted_until_a_second_after_its_watermark_was_due() {
        let timeout = UpstreamTimeout::of(Rate::HZ_60);
        assert_eq!(timeout.last_predicted(Tick::new(10), 0), Tick::new(74));
        assert_eq!(
            timeout.last_predicted(Tick::new(900), 700),
            Tick::new(1_110)
        );
    }
}
