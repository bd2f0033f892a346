//! Publication times of a scene's streams: which ticks, with what delay.
//!
//! Configuration only; the observation history of a scene keeps the ticks. Commands and scene events act at every
//! tick, whatever the schedule.

use core::num::NonZeroU32;

use rhumb_reckoning::{Rate, Tick, Ticks};

use super::checks::{Invalid, LOOKAHEAD_IN_LOCKSTEP, Quantity, Rule, count, outside};
use crate::limits::{LOOKAHEAD_TICKS_MAX, PUBLISH_SECONDS_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Published ticks of a scene's streams, and the delay of their publication.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PublishSchedule {
    /// Published ticks are the multiples of this number.
    pub publish_interval: NonZeroU32,
    /// Steps that the scene takes before a tick is published. The publisher knows what follows the tick, so that
    /// updates stay valid for longer. All copies are later by these ticks.
    pub lookahead: Ticks,
}

impl PublishSchedule {
    /// Every tick, at once.
    pub const EACH_TICK: Self = Self {
        publish_interval: NonZeroU32::MIN,
        lookahead: Ticks::ZERO,
    };

    /// True if a tick is published.
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
            let most = rate.ticks() / rate.seconds() * PUBLISH_SECONDS_MAX;
            let numbers = [self.publish_interval.get(), 1, most.max(1)].map(f64::from);
            return Err(outside(
                Rule::OutOfRange,
                Quantity::PublishInterval,
                numbers,
            ));
        }
        let lookahead = self.lookahead.count() as usize;
        count(
            lookahead,
            0,
            LOOKAHEAD_TICKS_MAX as usize,
            Quantity::Lookahead,
        )
    }

    /// The first published tick after another tick.
    #[must_use]
    pub fn next_published(self, after: Tick) -> Tick {
        let publish_interval = u64::from(self.publish_interval.get());
        Tick::new((after.value() / publish_interval + 1) * publish_interval)
    }

    /// Checks that members of a lockstep scene get each tick before they advance further.
    pub(super) fn check_lockstep(self) -> Result<(), Invalid> {
        if self.lookahead == Ticks::ZERO {
            Ok(())
        } else {
            Err(Invalid::because(
                Quantity::LockstepPublishing,
                LOOKAHEAD_IN_LOCKSTEP,
            ))
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
