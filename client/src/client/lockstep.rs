//! Steps of a lockstep scene for a caller that does not wait.
//!
//! A frame requests a tick, and a later frame shows it. The calls that wait are built on the same parts.

use rhumb_protocol::Instant;
use rhumb_reckoning::Tick;
use rhumb_view::PipelineDepth;

use super::Client;
use crate::error::ClientError;

impl Client {
    /// Requests the next published tick of a lockstep scene at once, does not wait, and returns the tick.
    ///
    /// [`Self::try_wait`] shows it once it is complete; [`Self::wait`] waits for it. [`Self::advance`] requests and
    /// waits.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn request_tick(&mut self) -> Result<Tick, ClientError> {
        self.check_open()?;
        self.denied_advance = None;
        let newest = self.ids.last_command();
        self.unanswered = newest.filter(|number| Some(*number) > self.answered);
        let publish_schedule = self.config().publish_schedule;
        self.requested = publish_schedule.next_published(self.requested);
        let now = self.pump.now();
        self.pump.session.advance(now, self.requested)?;
        self.pump.flush();
        Ok(self.requested)
    }

    /// Handles received data, and computes the view as [`Self::wait`] if its tick is complete. Does not wait: returns
    /// `None` while the tick is not complete, and leaves the view as it is.
    ///
    /// # Errors
    ///
    /// As [`Self::wait`], except that it never times out.
    pub fn try_wait(&mut self, depth: PipelineDepth) -> Result<Option<Tick>, ClientError> {
        self.pump.turn(Instant::ZERO);
        self.take_events();
        let tick = self.complete();
        if tick >= self.awaited(depth) {
            self.show(tick);
            self.report_refusals()?;
            return Ok(Some(tick));
        }
        self.check_open()?;
        self.report_refusals()?;
        match self.take_refusal() {
            Some(refusal) => Err(refusal),
            None => Ok(None),
        }
    }

    /// The tick that a view at this depth shows, after the last request.
    pub(super) fn awaited(&self, depth: PipelineDepth) -> Tick {
        let span = self.published_ticks(depth);
        self.requested.before(span).unwrap_or_default()
    }

    /// The server's denial of the last request; the next request then begins at the newest complete tick.
    pub(super) fn take_refusal(&mut self) -> Option<ClientError> {
        let denial = self.denied_advance.take()?;
        self.requested = self.complete();
        Some(ClientError::Denied(denial))
    }
}
