//! Tenants: whose process a scene is in, and which of these died lately.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Instant, Span};
use rhumb_scene::tenant_of;

/// A tenant, as tokens name it by the scenes that they are for.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Tenant {
    /// The scenes whose names begin so, up to a slash.
    Named(String),
    /// All scenes without a tenant.
    Shared,
    /// One scene without a tenant.
    Scene(SceneName),
}

impl Tenant {
    /// The tenant of a scene. `share`: scenes without one share a process.
    pub(super) fn of(scene: &SceneName, share: bool) -> Self {
        match tenant_of(scene) {
            Some(tenant) => Self::Named(tenant.to_owned()),
            None if share => Self::Shared,
            None => Self::Scene(scene.clone()),
        }
    }
}

impl fmt::Display for Tenant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Named(tenant) => write!(f, "{tenant}/"),
            Self::Shared => f.write_str("all scenes without a tenant"),
            Self::Scene(scene) => scene.fmt(f),
        }
    }
}

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
    fn the_first_part_of_a_scenes_name_is_its_tenant() {
        let of = |name: &str, share| Tenant::of(&name.parse().unwrap(), share);
        assert_eq!(of("team/7", false), of("team/8/x", true));
        assert_ne!(of("team/7", false), of("teams/7", false));
        assert_ne!(of("team", false), of("team/7", false));
        assert_ne!(of("a", false), of("b", false));
        assert_eq!(of("a", true), of("b", true));
        assert_ne!(of("a", true), of("/a", true));
    }

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
