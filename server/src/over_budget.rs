//! Logs the streams whose budget does not suffice.

use rhumb_protocol::stream::{OverBudget, Publisher};
use rhumb_reckoning::Tick;
use tracing::Level;

/// Last logged state of a stream's budget.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct OverBudgetLog {
    /// True if bodies waited then.
    waited: bool,
    /// Tick of the last line; `None` before the first.
    logged_at: Option<Tick>,
}

impl OverBudgetLog {
    /// Logs when a budget does not suffice, with its worst body, and when it suffices again: at most one line a
    /// second. At trace level every affected body is logged.
    pub(crate) fn log_once_a_second(&mut self, publisher: &Publisher) {
        let (stream, tick) = (publisher.stream(), publisher.tick());
        let waits = |since: Tick| tick.since(since).unwrap_or_default().count();
        if tracing::enabled!(Level::TRACE) {
            for OverBudget { body, share, since } in publisher.over_budget() {
                if share > 1.0 {
                    let ticks = waits(since);
                    tracing::trace!(
                        %stream, %tick, %body, share, ticks, cause = "budget",
                        "a body exceeds its tolerance"
                    );
                }
            }
        }
        let waiting = publisher.waiting();
        let since_logged = self.logged_at.and_then(|logged_at| tick.since(logged_at));
        let quiet = since_logged.is_some_and(|ticks| ticks < publisher.second());
        if quiet || (waiting == 0 && !self.waited) {
            return;
        }
        *self = Self {
            waited: waiting > 0,
            logged_at: Some(tick),
        };
        let Some(worst) = publisher.worst_waiting() else {
            let over_budget = publisher.statistics().over_budget;
            tracing::info!(%stream, over_budget, "the budget suffices again");
            return;
        };
        let OverBudget { body, share, since } = worst;
        let ticks = waits(since);
        tracing::info!(%stream, waiting, %body, share, ticks, cause = "budget", "bodies wait for an update");
    }
}
