//! Steps that ignore the client's reports; only the final state is checked.

use std::time::Duration;

use super::super::stream_history::is_alike;
use super::Interceptor;
use crate::outcome::CaseResult;

impl Interceptor {
    /// As [`Self::enter`], without a check of the client's copy.
    ///
    /// # Errors
    ///
    /// As [`Self::enter`].
    pub fn enter_unjudged(&mut self) -> CaseResult {
        self.enter()?;
        self.stream_history.pass_over(&self.reported);
        Ok(())
    }

    /// Steps this number of ticks, without a check of the client's reports.
    ///
    /// # Errors
    ///
    /// As [`Self::step`].
    pub fn step_unjudged(&mut self, ticks: u64) -> CaseResult {
        self.step(ticks)?;
        self.stream_history.pass_over(&self.reported);
        Ok(())
    }

    /// Steps until both mirror and client have reached the new stream, and this number of ticks more.
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

    /// Waits until the client's copy equals the mirror's at the last tick; earlier reports are ignored.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`](crate::outcome::Stop::Fail) when this does not happen in time.
    pub fn must_end_alike(&mut self) -> CaseResult {
        let mut tries = 0;
        self.until("copy equal to the stream at the end", |interceptor| {
            tries += 1;
            let Ok(copy) = interceptor.mirror() else {
                return false;
            };
            let alike = is_alike(copy, &interceptor.reported);
            alike || (tries % 10 == 0 && interceptor.step_unjudged(2).is_err())
        })
    }
}
