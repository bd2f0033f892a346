//! How a push is said in an update.
//!
//! Once with the course that it is the law of; what goes on by the same push does not say it again (PROTOCOL 5.6).

use rhumb_reckoning::{DOUBLINGS_LIMIT, PUSH_LIMIT, Push};

use super::saying::Tongue;
use super::tables::contexts;
use crate::wire::Malformed;
use crate::wire::range::{RangeReader, RangeWriter};

impl Tongue {
    pub(super) fn write_push(&mut self, push: &Push, to: &mut RangeWriter) {
        numbers_of_push(push, |context, number| {
            self.model.write(context, number.unsigned_abs(), to);
            if number != 0 && context != contexts::DOUBLINGS {
                to.raw(u32::from(number < 0), 1);
            }
        });
    }

    pub(super) fn read_push(&mut self, from: &mut RangeReader<'_>) -> Result<Push, Malformed> {
        let doublings = self.model.read(contexts::DOUBLINGS, from)?;
        let (mut steps, mut sum) = ([0; 3], 0_u64);
        for (part, steps) in steps.iter_mut().enumerate() {
            let size = self.model.read(contexts::push().context(part, sum), from)?;
            if size > PUSH_LIMIT as u32 {
                return Err(Malformed::OutOfRange);
            }
            let negative = size != 0 && from.bit()?;
            *steps = if negative {
                -(size as i16)
            } else {
                size as i16
            };
            sum += u64::from(size);
        }
        if doublings > u32::from(DOUBLINGS_LIMIT) {
            return Err(Malformed::OutOfRange);
        }
        Push::new(steps, doublings as u8).ok_or(Malformed::OutOfRange)
    }
}

/// Walks over its numbers in the order in which they are said, with the context of each; the first has no sign.
pub(super) fn numbers_of_push(push: &Push, mut say: impl FnMut(usize, i32)) {
    say(contexts::DOUBLINGS, i32::from(push.doublings()));
    let mut sum = 0_u64;
    for (part, steps) in push.steps().into_iter().enumerate() {
        say(contexts::push().context(part, sum), i32::from(steps));
        sum += u64::from(steps.unsigned_abs());
    }
}
