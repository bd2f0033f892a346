//! When the worker processes of each tenant died lately.

use std::collections::{BTreeMap, VecDeque};

use rhumb_protocol::{Instant, Span};

use super::tenant::Tenant;

/// The time in which a process may be started again [`rhumb_scene::Limits::worker_restarts`] times.
const PERIOD: Span = Span::from_millis(600_000);

/// The deaths of the last [`PERIOD`].
#[derive(Debug, Default)]
pub(super) struct Deaths(BTreeMap<Tenant, VecDeque<Instant>>);

impl Deaths {
    pub(super) fn note(&mut self, now: Instant, tenant: Tenant) {
        self.0.entry(tenant).or_default().push_back(now);
    }

    /// Number of deaths of a tenant's processes in the period.
    pub(super) fn count(&mut self, now: Instant, tenant: &Tenant) -> u64 {
        self.0.retain(|_, deaths| {
            while deaths
                .front()
                .is_some_and(|death| now.since(*death) >= PERIOD)
            {
                deaths.pop_front();
            }
            !deaths.is_empty()
        });
        self.0.get(tenant).map_or(0, |deaths| deaths.len() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deaths_are_forgotten_after_the_period() {
        let (mut deaths, start) = (Deaths::default(), Instant::ZERO);
        let tenant = || Tenant::Named("team".to_owned());
        for seconds in 0..5 {
            deaths.note(start + Span::from_millis(seconds * 1_000), tenant());
        }
        let later = |seconds: u64| start + Span::from_millis(seconds * 1_000);
        assert_eq!(deaths.count(later(5), &tenant()), 5);
        assert_eq!(deaths.count(later(602), &tenant()), 2);
        assert_eq!(deaths.count(later(602), &Tenant::Shared), 0);
        assert_eq!(deaths.count(later(700), &tenant()), 0);
    }
}
