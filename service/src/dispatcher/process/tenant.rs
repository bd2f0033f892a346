//! The tenant of a scene: whose worker process it is in.

use std::fmt;

use rhumb_protocol::scene::SceneName;

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
        match scene.as_str().split_once('/') {
            Some((tenant, _)) => Self::Named(tenant.to_owned()),
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
}
