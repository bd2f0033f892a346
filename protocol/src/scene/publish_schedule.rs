//! When the streams of a scene are said: which ticks, and how late.
//!
//! Nothing but the config; who keeps them is the observation_history of a scene. Commands and scene_events act at every tick whatever the
//! publish_schedule.

use core::num::NonZeroU32;

use rhumb_reckoning::{Rate, Tick, Ticks};

use super::checks::{Invalid, Quantity};
use crate::limits::{LOOKAHEAD_TICKS_MAX, PUBLISH_SECONDS_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// At which ticks the streams of a scene are said, and how many ticks later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublishSchedule {
    /// The ticks that are spoken of are the multiples of this number.
    pub publish_interval: NonZeroU32,
    /// Each is spoken of when the scene has taken so many steps more: what came of it is known then, and what is said
    /// stays true for longer. All copies are so much later.
    pub lookahead: Ticks,
}

impl PublishSchedule {
    /// Each tick, at once.
    pub const EACH_TICK: Self = Self {
        publish_interval: NonZeroU32::MIN,
        lookahead: Ticks::ZERO,
    };

    /// Whether a tick is spoken of.
    #[must_use]
    pub const fn publishes(&self, tick: Tick) -> bool {
        tick.value()
            .is_multiple_of(self.publish_interval.get() as u64)
    }

    /// Checks both numbers for a scene of this rate.
    pub(super) fn check(self, rate: Rate) -> Result<(), Invalid> {
        let seconds = u64::from(self.publish_interval.get()) * u64::from(rate.seconds());
        let rare = seconds > u64::from(rate.ticks()) * u64::from(PUBLISH_SECONDS_MAX);
        if rare && self.publish_interval > NonZeroU32::MIN {
            return Err(Invalid::OutOfRange(Quantity::PublishInterval));
        }
        if self.lookahead.count() > LOOKAHEAD_TICKS_MAX {
            return Err(Invalid::OutOfRange(Quantity::Lookahead));
        }
        Ok(())
    }

    /// The first tick after another that is spoken of.
    #[must_use]
    pub fn next_published(self, after: Tick) -> Tick {
        let publish_interval = u64::from(self.publish_interval.get());
        Tick::new((after.value() / publish_interval + 1) * publish_interval)
    }

    /// Checks that members who wait for a tick get it before they ask for another.
    pub(super) fn check_lockstep(self) -> Result<(), Invalid> {
        if self.lookahead == Ticks::ZERO {
            Ok(())
        } else {
            Err(Invalid::OutOfRange(Quantity::LockstepPublishing))
        }
    }
}

impl Wire for PublishSchedule {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.publish_interval.get()));
        to.varint(u64::from(self.lookahead.count()));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(Self {
            publish_interval: NonZeroU32::new(from.varint32()?).ok_or(Malformed::OutOfRange)?,
            lookahead: Ticks::new(from.varint32()?),
        })
    }
}
