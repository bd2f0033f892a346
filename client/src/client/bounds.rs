//! How far what a client shows may be off.

use rhumb_protocol::session::Replica;
use rhumb_protocol::stream::ErrorBound;
use rhumb_reckoning::{BodyId, Tick};

use super::Client;

impl Client {
    /// Bound on the error of the pose that the view shows: how far any point of the body may be from its true place at the
    /// moment of the view. `None` for a body that is not in the view.
    ///
    /// It is the body's tolerance where everything up to the moment of the view has arrived, plus what a smoothed
    /// correction has still to cover, or what updates that were read since the view was computed would change. Between two
    /// ticks, the truth is the interpolation of the two true poses.
    ///
    /// It is [`ErrorBound::Unknown`] as long as anything is missing: a packet, or the news of a moment that the view
    /// shows ahead of them. Without a delay, a free-running view always predicts the last moments, and nothing finite is
    /// certain of them: a command may have put a body anywhere. [`JoinOptions::delay_ticks`](crate::JoinOptions) of the
    /// network's delay and a little more gives a finite bound.
    #[must_use]
    pub fn error_bound(&self, id: BodyId) -> Option<ErrorBound> {
        self.view().error_bound(self.replica()?.stream(), id)
    }

    /// The bound of each body of the view, in its order: see [`Self::error_bound`].
    pub fn error_bounds(&self) -> impl Iterator<Item = ErrorBound> {
        let stream = self.replica().map(Replica::stream);
        let bounds = stream.map(|stream| self.view().error_bounds(stream));
        bounds.into_iter().flatten()
    }

    /// Bound on the error of what is known of a body at a tick, whatever the view shows: that of its track. `None` for a
    /// body that the copy does not have.
    #[must_use]
    pub fn tick_error_bound(&self, id: BodyId, tick: Tick) -> Option<ErrorBound> {
        self.replica()?.stream().bound_at(id, tick)
    }
}
