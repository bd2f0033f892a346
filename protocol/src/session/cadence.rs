//! When the driver of bodies vouches for silence, and how far it is trusted.
//!
//! Counted in the scene's ticks alone, so that it is the same in a scene that its members lead (PROTOCOL 6.14).

use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::limits::{DRIVE_GRACE_MS, DRIVE_VOUCH_MS, SILENCE_MS_MAX};

/// What follows from the rate of a scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cadence {
    /// The shortest and the longest silence between two vouches, in ticks.
    least: u64,
    most: u64,
    /// How late a vouch may be.
    grace: Ticks,
    /// Ticks in a second, at least one.
    pub(crate) second: Ticks,
}

impl Cadence {
    pub(crate) fn of(rate: Rate) -> Self {
        let ticks = |milliseconds: u32| {
            let (ticks, seconds) = (u64::from(rate.ticks()), u64::from(rate.seconds()));
            (ticks * u64::from(milliseconds) / (1_000 * seconds)).max(1)
        };
        Self {
            least: ticks(DRIVE_VOUCH_MS),
            most: ticks(SILENCE_MS_MAX),
            grace: Ticks::new(ticks(DRIVE_GRACE_MS) as u32),
            second: Ticks::new(ticks(1_000) as u32),
        }
    }

    /// The silence, in ticks, that is vouched for after one of `silence` ticks was: twice as long, within bounds.
    pub(crate) fn vouch_after(&self, silence: u64) -> u64 {
        silence + silence.clamp(self.least, self.most)
    }

    /// The tick at which a driver that is vouched for up to `vouched`, `silence` ticks of them silent, vouches again.
    pub(crate) fn due(&self, vouched: Tick, silence: u64) -> Tick {
        vouched + Ticks::new(silence.clamp(self.least, self.most) as u32)
    }

    /// The tick from which it is asked.
    pub(crate) fn asked(&self, vouched: Tick, silence: u64) -> Tick {
        self.due(vouched, silence) + Ticks::new(self.grace.count() / 4)
    }

    /// The last tick that is predicted.
    pub(crate) fn trusted(&self, vouched: Tick, silence: u64) -> Tick {
        self.due(vouched, silence) + self.grace
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    #[test]
    fn a_silence_is_vouched_for_ever_more_rarely_and_trusted_until_a_second_after_it_was_due() {
        let cadence = Cadence::of(Rate::HZ_60);
        let mut silence = 0;
        let vouches: Vec<u64> = (0..11)
            .map(|_| {
                silence = cadence.vouch_after(silence);
                silence
            })
            .collect();
        assert_eq!(vouches, [4, 8, 16, 32, 64, 128, 256, 406, 556, 706, 856]);
        for pair in vouches.windows(2) {
            let due = cadence.due(Tick::new(1_000 + pair[0]), pair[0]);
            assert_eq!(due, Tick::new(1_000 + pair[1]));
        }
        assert_eq!(cadence.trusted(Tick::new(10), 0), Tick::new(74));
        assert_eq!(cadence.trusted(Tick::new(900), 700), Tick::new(1_110));
    }
}
