//! The age of a track, in published ticks of its stream.
//!
//! A stream that publishes every few ticks has no other ages, so an age is not given in ticks (PROTOCOL 5.6).

use core::num::NonZeroU32;

use rhumb_reckoning::Tick;

/// The number of published ticks since the origin of a track. The published tick that carries the track counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Age(u32);

impl Age {
    /// An age of `count` published ticks.
    #[must_use]
    pub const fn new(count: u32) -> Self {
        Self(count)
    }

    /// The age at `tick` of a track with this origin, in a stream that publishes every `publish_interval` ticks. `None`
    /// if the origin is later.
    ///
    /// An origin between two published ticks counts as the earlier of them.
    #[must_use]
    pub fn of(origin: Tick, tick: Tick, publish_interval: NonZeroU32) -> Option<Self> {
        let published = |tick: Tick| tick.value() / u64::from(publish_interval.get());
        let age = published(tick).checked_sub(published(origin))?;
        u32::try_from(age).ok().filter(|_| origin <= tick).map(Self)
    }

    /// The number of published ticks.
    #[must_use]
    pub const fn count(self) -> u32 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_age_counts_published_ticks() {
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
