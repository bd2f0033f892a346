//! Converts an APP client's frames into ticks of its scene.
//!
//! A frame is a binary32 of seconds; a scene's tick is a ratio. The first frame decides: its simplest ratio, cut into
//! as few ticks as keep each at a sixtieth of a second or less. Later frames of another length yield whole ticks; the
//! remainder is carried over.

use rhumb_reckoning::Rate;

/// Ticks for frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameClock {
    rate: Rate,
    /// Seconds of frames that are not yet converted to ticks.
    carried: f64,
}

/// The longest frame, seconds.
const FRAME_MAX: f32 = 1.0;
/// The shortest frame, seconds: a tick of a thousand a second.
const FRAME_MIN: f32 = 1e-3;
/// Least tick rate that a frame is cut into.
const TICKS_PER_SECOND: f64 = 60.0;
/// Share of a tick that rounding may leave.
const SLACK: f64 = 1e-3;

impl FrameClock {
    /// A clock for a client with this first frame; `None` if its time is zero, too long, or not a ratio of small
    /// numbers.
    pub(super) fn of_frame(seconds: f32) -> Option<Self> {
        if !(FRAME_MIN..=FRAME_MAX).contains(&seconds) {
            return None;
        }
        let (over, under) = simplest(seconds)?;
        let length = f64::from(over) / f64::from(under);
        let ticks = (length * TICKS_PER_SECOND - SLACK).ceil().max(1.0) as u32;
        let common = gcd(ticks.checked_mul(under)?, over);
        let rate = Rate::new(ticks * under / common, over / common)?;
        Some(Self { rate, carried: 0.0 })
    }

    /// Tick rate of the scene.
    pub(super) const fn rate(&self) -> Rate {
        self.rate
    }

    /// The ticks of a frame; `None` for a frame of zero time or too long.
    pub(super) fn ticks(&mut self, seconds: f32) -> Option<u32> {
        if !(0.0..=FRAME_MAX).contains(&seconds) {
            return None;
        }
        let tick = self.rate.step().seconds();
        let carried = self.carried + f64::from(seconds);
        let ticks = (carried / tick + SLACK).floor();
        self.carried = carried - ticks * tick;
        Some(ticks as u32)
    }
}

/// The simplest ratio that rounds to a binary32, if its numbers are small.
fn simplest(value: f32) -> Option<(u32, u32)> {
    // The convergents of its continued fraction, one after the other.
    let mut rest = f64::from(value);
    let (mut before, mut now) = ((0_u64, 1_u64), (1_u64, 0_u64));
    for _ in 0..32 {
        let integer = rest.floor();
        let next = |before: u64, now: u64| (integer as u64).checked_mul(now)?.checked_add(before);
        let convergent = (next(before.0, now.0)?, next(before.1, now.1)?);
        if convergent.1 > 1_000_000 {
            return None;
        }
        if convergent.0 > 0 && (convergent.0 as f64 / convergent.1 as f64) as f32 == value {
            return Some((convergent.0 as u32, convergent.1 as u32));
        }
        (before, now) = (now, convergent);
        let fraction = rest - integer;
        if fraction <= 0.0 {
            return None;
        }
        rest = 1.0 / fraction;
    }
    None
}

const fn gcd(mut a: u32, mut b: u32) -> u32 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame_clock(seconds: f32) -> FrameClock {
        FrameClock::of_frame(seconds).expect("a frame")
    }

    #[test]
    fn common_frames_get_their_intended_ratios() {
        for (seconds, ticks, over) in [
            (1.0 / 60.0, 60, 1),
            (0.089, 6_000, 89),
            (0.0909, 20_000, 303),
            (1.0 / 11.33, 3_399, 50),
            (0.5, 60, 1),
            (1.0 / 120.0, 120, 1),
        ] {
            assert_eq!(
                frame_clock(seconds).rate(),
                Rate::new(ticks, over).unwrap(),
                "{seconds}"
            );
        }
    }

    #[test]
    fn every_frame_of_the_same_length_has_as_many_ticks() {
        for (seconds, ticks) in [(1.0 / 60.0, 1), (0.089, 6), (1.0 / 11.33, 6), (0.5, 30)] {
            let mut frame_clock = frame_clock(seconds);
            for _ in 0..10_000 {
                assert_eq!(frame_clock.ticks(seconds), Some(ticks));
            }
        }
    }

    #[test]
    fn the_remainder_of_other_frames_is_carried_over() {
        let mut frame_clock = frame_clock(0.089);
        let sum: u32 = (0..1_000).map(|_| frame_clock.ticks(0.1).unwrap()).sum();
        assert_eq!(sum, 6_741);
    }

    #[test]
    fn zero_and_excessive_times_are_refused() {
        for seconds in [0.0, -1.0, 1.5, f32::NAN, f32::INFINITY, 1e-9] {
            assert!(FrameClock::of_frame(seconds).is_none(), "{seconds}");
        }
        assert_eq!(frame_clock(0.1).ticks(f32::NAN), None);
        assert_eq!(frame_clock(0.1).ticks(2.0), None);
        assert_eq!(frame_clock(0.1).ticks(0.0), Some(0));
    }
}
