//! Accounts: the tenant of a scene, or the client that named it first.
//!
//! Where tokens are asked for, each account has a part of the server's scenes, and of the places of quarantined ones.

use std::collections::BTreeMap;
use std::sync::Arc;

use rhumb_protocol::scene::SceneName;
use rhumb_scene::{ClientName, Limits, Permit, tenant_of};

/// Who has a scene.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Account {
    /// The tenant of its name.
    Tenant(String),
    /// A client, for scenes without a tenant.
    Client(ClientName),
}

impl Account {
    /// The account of a scene that a client names; `None` without a tenant and without a token.
    pub(super) fn of(scene: &SceneName, client: Option<&ClientName>) -> Option<Self> {
        let tenant = tenant_of(scene).map(|tenant| Self::Tenant(tenant.to_owned()));
        tenant.or_else(|| client.cloned().map(Self::Client))
    }
}

/// The permit of a connection whose account has so many other scenes. Without tokens it stays as it is.
pub(super) fn with_scenes_left(permit: Arc<Permit>, others: usize, limits: &Limits) -> Arc<Permit> {
    if permit.client.is_none() {
        return permit;
    }
    let default = u32::try_from(limits.tenant_scenes).unwrap_or(u32::MAX);
    let most = permit.quotas.scenes.unwrap_or(default);
    let mut permit = permit;
    let left = most.saturating_sub(u32::try_from(others).unwrap_or(u32::MAX));
    Arc::make_mut(&mut permit).quotas.scenes = Some(left);
    permit
}

/// The permit of a connection to a scene that exists.
pub(super) fn without_quota_of_scenes(permit: Arc<Permit>) -> Arc<Permit> {
    let mut permit = permit;
    if permit.quotas.scenes.is_some() {
        Arc::make_mut(&mut permit).quotas.scenes = None;
    }
    permit
}

/// The quarantined scenes that count: of each account no more than its part.
pub(super) fn counted<'a>(
    quarantined: impl Iterator<Item = &'a Option<Account>>,
    part: u64,
) -> u64 {
    let mut counts: BTreeMap<&Account, u64> = BTreeMap::new();
    let mut without = 0;
    for account in quarantined {
        match account {
            Some(account) => *counts.entry(account).or_default() += 1,
            None => without += 1,
        }
    }
    let parts = counts.values().map(|count| (*count).min(part));
    without + parts.sum::<u64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_counts_for_its_tenant_or_else_for_the_client() {
        let anna: ClientName = "anna".into();
        let of = |scene: &str, client| Account::of(&scene.parse().unwrap(), client);
        let tenant = Some(Account::Tenant("team".to_owned()));
        assert_eq!(of("team/7", Some(&anna)), tenant);
        assert_eq!(of("team/8/x", None), tenant);
        assert_eq!(
            of("team-7", Some(&anna)),
            Some(Account::Client(anna.clone()))
        );
        assert_eq!(of("team-7", None), None);
    }

    #[test]
    fn a_permit_says_how_many_scenes_its_account_may_still_have() {
        let limits = Limits {
            tenant_scenes: 2,
            ..Limits::default()
        };
        let mut permit = Permit {
            client: Some("anna".into()),
            ..Permit::OPEN
        };
        let left = |permit: &Permit, others| {
            let permit = with_scenes_left(Arc::new(permit.clone()), others, &limits);
            permit.quotas.scenes
        };
        assert_eq!(
            [0, 1, 2, 3].map(|others| left(&permit, others)),
            [2, 1, 0, 0].map(Some)
        );
        permit.quotas.scenes = Some(5);
        assert_eq!(left(&permit, 3), Some(2), "its token says otherwise");
        assert_eq!(left(&Permit::OPEN, 300), None);
    }

    #[test]
    fn one_account_takes_only_its_part_of_the_places_of_quarantined_scenes() {
        let account = |name: &str| Some(Account::Tenant(name.to_owned()));
        let many = [
            account("a"),
            account("a"),
            account("a"),
            account("b"),
            None,
            None,
        ];
        assert_eq!(counted(many.iter(), 2), 2 + 1 + 2);
        assert_eq!(counted(many.iter(), 9), 6);
    }
}
