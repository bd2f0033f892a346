//! How old a track is, by the ticks that its stream speaks of.
//!
//! A stream that is published every few ticks could emit no other age, so that none is said in ticks (PROTOCOL 5.6).

use core::num::NonZeroU32;

use rhumb_reckoning::Tick;

/// How many ticks were spoken of since the origin of a track, the one at which that is said included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Age(u32);

impl Age {
    /// So many ticks that were spoken of.
    #[must_use]
    pub const fn new(count: u32) -> Self {
        Self(count)
    }

    /// Of a track of this origin, at a tick of a stream that speaks of every so many; `None` if the origin is later.
    ///
    /// One that begins between two ticks that are spoken of counts as begun at the earlier.
    #[must_use]
    pub fn of(origin: Tick, tick: Tick, publish_interval: NonZeroU32) -> Option<Self> {
        let spoken = |tick: Tick| tick.value() / u64::from(publish_interval.get());
        let age = spoken(tick).checked_sub(spoken(origin))?;
        u32::try_from(age).ok().filter(|_| origin <= tick).map(Self)
    }

    /// How many.
    #[must_use]
    pub const fn count(self) -> u32 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_age_counts_the_ticks_that_are_spoken_of() {
        let third = NonZeroU32::new(3).unwrap();
        let age = |origin, tick, publish_interval| {
            let age = Age::of(Tick::new(origin), Tick::new(tick), publish_interval);
            age.map(Age::count)
        };
        for (origin, tick, counted) in [(6, 9, 1), (8, 9, 1), (9, 9, 0), (0, 12, 4), (5, 12, 3)] {
            assert_eq!(age(origin, tick, third), Some(counted));
            assert_eq!(
                age(origin, tick, NonZeroU32::MIN),
                Some((tick - origin) as u32)
            );
        }
        assert_eq!(age(10, 9, third), None);
        assert_eq!(age(0, 1 << 40, NonZeroU32::MIN), None);
    }
}
