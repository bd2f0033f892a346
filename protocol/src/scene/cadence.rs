//! When the streams of a scene are said: which ticks, and how late.
//!
//! Nothing but the terms; who keeps them is the witness of a scene. Commands and notices act at every tick whatever the
//! cadence.

use core::num::NonZeroU32;

use rhumb_reckoning::{Rate, Tick, Ticks};

use super::checks::{Invalid, Quantity};
use crate::limits::{HINDSIGHT_TICKS_MAX, PUBLISH_SECONDS_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// At which ticks the streams of a scene are said, and how many ticks later.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cadence {
    /// The ticks that are spoken of are the multiples of this number.
    pub every: NonZeroU32,
    /// Each is spoken of when the scene has taken so many steps more: what came of it is known then, and what is said
    /// stays true for longer. All copies are so much later.
    pub hindsight: Ticks,
}

impl Cadence {
    /// Each tick, at once.
    pub const EACH_TICK: Self = Self {
        every: NonZeroU32::MIN,
        hindsight: Ticks::ZERO,
    };

    /// Whether a tick is spoken of.
    #[must_use]
    pub const fn speaks_of(&self, tick: Tick) -> bool {
        tick.value().is_multiple_of(self.every.get() as u64)
    }

    /// Checks both numbers for a scene of this rate.
    pub(super) fn check(self, rate: Rate) -> Result<(), Invalid> {
        let seconds = u64::from(self.every.get()) * u64::from(rate.seconds());
        let rare = seconds > u64::from(rate.ticks()) * u64::from(PUBLISH_SECONDS_MAX);
        if rare && self.every > NonZeroU32::MIN {
            return Err(Invalid::OutOfRange(Quantity::PublishedEvery));
        }
        if self.hindsight.count() > HINDSIGHT_TICKS_MAX {
            return Err(Invalid::OutOfRange(Quantity::Hindsight));
        }
        Ok(())
    }

    /// The first tick after another that is spoken of.
    #[must_use]
    pub fn next_spoken(self, after: Tick) -> Tick {
        let every = u64::from(self.every.get());
        Tick::new((after.value() / every + 1) * every)
    }

    /// Checks that members who wait for a tick get it before they ask for another.
    pub(super) fn check_lockstep(self) -> Result<(), Invalid> {
        if self.hindsight == Ticks::ZERO {
            Ok(())
        } else {
            Err(Invalid::OutOfRange(Quantity::LockstepCadence))
        }
    }
}

impl Wire for Cadence {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.every.get()));
        to.varint(u64::from(self.hindsight.count()));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(Self {
            every: NonZeroU32::new(from.varint32()?).ok_or(Malformed::OutOfRange)?,
            hindsight: Ticks::new(from.varint32()?),
        })
    }
}
