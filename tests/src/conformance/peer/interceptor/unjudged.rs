//! A case goes on whatever the client tells, and judges the end alone.

use std::time::Duration;

use super::super::stream_history::is_alike;
use super::Interceptor;
use crate::conformance::outcome::CaseResult;

impl Interceptor {
    /// As [`Self::enter`], whatever the client's copy is.
    ///
    /// # Errors
    ///
    /// As [`Self::enter`].
    pub fn enter_unjudged(&mut self) -> CaseResult {
        self.enter()?;
        self.stream_history.pass_over(&self.reported);
        Ok(())
    }

    /// So many ticks, whatever the client tells of them.
    ///
    /// # Errors
    ///
    /// As [`Self::step`].
    pub fn step_unjudged(&mut self, ticks: u64) -> CaseResult {
        self.step(ticks)?;
        self.stream_history.pass_over(&self.reported);
        Ok(())
    }

    /// Ticks until session and client both have come to the new stream, and some more.
    ///
    /// # Errors
    ///
    /// As [`Self::step`].
    pub fn follow_unjudged(&mut self, ticks: u64) -> CaseResult {
        for _ in 0..ticks {
            self.step_unjudged(1)?;
            self.run(Duration::from_millis(5))?;
        }
        Ok(())
    }

    /// That the client's copy comes to be as ours at the last tick, whatever it was before.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`](crate::conformance::outcome::Stop::Fail) when it does not in time.
    pub fn must_end_alike(&mut self) -> CaseResult {
        let mut tries = 0;
        self.until("copy that ends as the stream has it", |feed| {
            tries += 1;
            let Ok(copy) = feed.mirror() else {
                return false;
            };
            let alike = is_alike(copy, &feed.reported);
            alike || (tries % 10 == 0 && feed.step_unjudged(2).is_err())
        })
    }
}
