//! Accounts for which scenes count, and the scenes that are this server's.
//!
//! A scene counts for an account: its tenant, or the client that named it first. Where tokens are asked for, each
//! account has a part of the server's scenes, and of the places of quarantined ones.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rhumb_protocol::Instant;
use rhumb_protocol::message::Role;
use rhumb_protocol::scene::SceneName;
use rhumb_scene::{ClientName, Limits, Permit, tenant_of};

use super::message::WorkerId;
use crate::durable::Generation;

/// The holder of a scene.
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

/// True for the permit of a connection that may create the scene that it names.
pub(super) fn may_create(permit: &Permit) -> bool {
    permit.role >= Role::Owner && permit.quotas.scenes != Some(0)
}

/// The permit of a connection to a scene that exists.
pub(super) fn without_quota_of_scenes(permit: Arc<Permit>) -> Arc<Permit> {
    let mut permit = permit;
    if permit.quotas.scenes.is_some() {
        Arc::make_mut(&mut permit).quotas.scenes = None;
    }
    permit
}

/// The quarantined workers, and the next look.
#[derive(Default)]
pub(super) struct Quarantined {
    pub(super) quarantined: BTreeMap<WorkerId, (SceneName, Option<Account>)>,
    pub(super) next: Instant,
}

impl Quarantined {
    /// The account of each.
    pub(super) fn accounts(&self) -> impl Iterator<Item = &Option<Account>> {
        self.quarantined.values().map(|(_, account)| account)
    }

    pub(super) fn is_quarantined(&self, id: WorkerId) -> bool {
        self.quarantined.contains_key(&id)
    }
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

/// The scenes that the directory has given this server, with their files. Asks the directory nothing.
///
/// Invariant: a scene that was given up is this server's again only by a later word of the directory's thread than that it
/// knows of it.
#[derive(Debug, Default)]
pub(super) struct OwnedScenes {
    generations: BTreeMap<SceneName, Generation>,
    /// Scenes that were given up; the directory's thread has not taken that yet, and what it says of them is older.
    releasing: BTreeSet<SceneName>,
}

impl OwnedScenes {
    /// Takes that the directory gives a scene; false if that was said before the scene was given up.
    pub(super) fn give(&mut self, scene: &SceneName, generation: Generation) -> bool {
        let is_new = !self.releasing.contains(scene);
        if is_new {
            self.generations.insert(scene.clone(), generation);
        }
        is_new
    }

    /// Gives a scene up; false if it is not this server's.
    pub(super) fn release(&mut self, scene: &SceneName) -> bool {
        let is_owned = self.generations.remove(scene).is_some();
        if is_owned {
            self.releasing.insert(scene.clone());
        }
        is_owned
    }

    /// Takes that the directory's thread knows that a scene was given up.
    pub(super) fn note_released(&mut self, scene: &SceneName) {
        self.releasing.remove(scene);
    }

    /// Forgets all scenes, which have ended with their lease.
    pub(super) fn lose(&mut self) {
        self.generations.clear();
    }

    /// The number of a scene's files; `None` for a scene that is not this server's.
    pub(super) fn generation(&self, scene: &SceneName) -> Option<Generation> {
        self.generations.get(scene).copied()
    }
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::{Ending, Endpoint, Peer};

    use super::super::tests::hello;
    use super::super::{Dispatcher, DispatcherSettings};
    use super::*;
    use crate::access::tests::Signed;

    /// A dispatcher that asks for tokens; a tenant has two scenes.
    fn guarded(signed: &Signed) -> Dispatcher {
        let mut settings = DispatcherSettings {
            authenticator: signed.authenticator(),
            ..DispatcherSettings::new(|| Instant::ZERO)
        };
        settings.scenes.limits.tenant_scenes = 2;
        Dispatcher::new(settings, || ())
    }

    #[test]
    fn those_who_only_watch_names_take_no_place_of_their_tenant() {
        let signed = Signed::new("account");
        let mut dispatcher = guarded(&signed);
        let mut peers = (1..).map(Peer);
        let mut open = |dispatcher: &mut Dispatcher, role: &str, scene: &str| {
            let peer = peers.next().unwrap();
            dispatcher.handle_opened(Instant::ZERO, peer);
            let hello = hello(&signed.token_as(role), scene);
            dispatcher.handle_control(Instant::ZERO, peer, &hello);
        };
        let left = |dispatcher: &Dispatcher| {
            let permit = Permit {
                client: Some("anna".into()),
                ..Permit::OPEN
            };
            let scene: SceneName = "team/9".parse().unwrap();
            let account = Account::of(&scene, None);
            let permit = dispatcher.permit_within(Arc::new(permit), &scene, account.as_ref());
            permit.quotas.scenes
        };
        for scene in ["team/1", "team/2", "team/3"] {
            open(&mut dispatcher, "observer", scene);
        }
        assert_eq!(dispatcher.workers.len(), 3);
        assert_eq!(left(&dispatcher), Some(2));
        // Each of these may create its scene at any time.
        open(&mut dispatcher, "owner", "team/1");
        assert_eq!(left(&dispatcher), Some(1));
        open(&mut dispatcher, "owner", "team/4");
        assert_eq!(left(&dispatcher), Some(0));
        // This one may not any more.
        open(&mut dispatcher, "owner", "team/5");
        let scene: SceneName = "team/5".parse().unwrap();
        let worker = &dispatcher.workers[&dispatcher.by_scene[&scene]];
        assert!(worker.creators.is_empty());
        // A name counts while one is connected that may create it, and for no observer.
        open(&mut dispatcher, "observer", "team/4");
        dispatcher.handle_ended(Instant::ZERO, Peer(5), Ending::TimedOut);
        assert_eq!(left(&dispatcher), Some(1));
    }

    #[test]
    fn a_scene_without_a_tenant_counts_for_the_first_client_there_that_may_create_it() {
        let signed = Signed::new("first");
        let mut dispatcher = guarded(&signed);
        let scene: SceneName = "pit".parse().unwrap();
        // As a restored one begins, which no client has named.
        let id = dispatcher.worker_of(scene, None).unwrap();
        let come = |dispatcher: &mut Dispatcher, peer, (role, client): (&str, &str)| {
            dispatcher.handle_opened(Instant::ZERO, Peer(peer));
            let hello = hello(&signed.token_of(role, client), "pit");
            dispatcher.handle_control(Instant::ZERO, Peer(peer), &hello);
            dispatcher.workers[&id].account.clone()
        };
        let client = |name: &str| Some(Account::Client(name.into()));
        assert_eq!(come(&mut dispatcher, 1, ("observer", "anna")), None);
        assert_eq!(come(&mut dispatcher, 2, ("owner", "bert")), client("bert"));
        assert_eq!(come(&mut dispatcher, 3, ("owner", "cara")), client("bert"));
        // No scene is there, and the account is free again when those that may create it are gone.
        for peer in [2, 3] {
            dispatcher.handle_ended(Instant::ZERO, Peer(peer), Ending::TimedOut);
        }
        assert_eq!(come(&mut dispatcher, 4, ("owner", "dora")), client("dora"));
    }

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
