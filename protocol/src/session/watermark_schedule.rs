//! When the driver of bodies watermarks for silence, and how far it is trusted.
//!
//! CountSink in the scene's ticks alone, so that it is the same in a scene that its members lead (PROTOCOL 6.14).

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::limits::{SILENCE_MS_MAX, UPSTREAM_GRACE_MS, UPSTREAM_WATERMARK_MS};

/// What follows from the rate of a scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WatermarkSchedule {
    /// The shortest and the longest silence between two watermarks, in ticks.
    least: u64,
    most: u64,
    /// How late a watermark may be.
    grace: Ticks,
    /// Ticks in a second, at least one.
    pub(crate) second: Ticks,
}

impl WatermarkSchedule {
    pub(crate) fn of(rate: Rate) -> Self {
        let ticks = |milliseconds: u32| {
            let (ticks, seconds) = (u64::from(rate.ticks()), u64::from(rate.seconds()));
            (ticks * u64::from(milliseconds) / (1_000 * seconds)).max(1)
        };
        Self {
            least: ticks(UPSTREAM_WATERMARK_MS),
            most: ticks(SILENCE_MS_MAX),
            grace: Ticks::new(ticks(UPSTREAM_GRACE_MS) as u32),
            second: Ticks::new(ticks(1_000) as u32),
        }
    }

    /// The silence, in ticks, that is watermark_tick for after one of `silence` ticks was: twice as long, within bounds.
    pub(crate) fn watermark_after(&self, silence: u64) -> u64 {
        silence + silence.clamp(self.least, self.most)
    }

    /// The tick at which a driver that is watermark_tick for up to `watermark_tick`, `silence` ticks of them silent, watermarks again.
    pub(crate) fn due(&self, watermark_tick: Tick, silence: u64) -> Tick {
        watermark_tick + Ticks::new(silence.clamp(self.least, self.most) as u32)
    }

    /// The tick from which it is asked.
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
    use alloc::vec::Vec;

    #[test]
    fn watermarks_back_off_in_silence_and_stay_valid_a_second() {
        let publish_schedule = WatermarkSchedule::of(Rate::HZ_60);
        let mut silence = 0;
        let watermarks: Vec<u64> = (0..11)
            .map(|_| {
                silence = publish_schedule.watermark_after(silence);
                silence
            })
            .collect();
        assert_eq!(watermarks, [4, 8, 16, 32, 64, 128, 256, 406, 556, 706, 856]);
        for pair in watermarks.windows(2) {
            let due = publish_schedule.due(Tick::new(1_000 + pair[0]), pair[0]);
            assert_eq!(due, Tick::new(1_000 + pair[1]));
        }
        assert_eq!(publish_schedule.trusted(Tick::new(10), 0), Tick::new(74));
        assert_eq!(
            publish_schedule.trusted(Tick::new(900), 700),
            Tick::new(1_110)
        );
    }
}
