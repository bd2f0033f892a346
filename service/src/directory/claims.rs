//! A server's claims of scenes, held by one lease of a directory.
//!
//! Asks the directory nothing itself: requests go out, answers and the time come in. Invariants: it says that a scene may be
//! published only while no other server can have claimed it, as long as clocks differ by [`DRIFT_PERCENT`] at most; a
//! request that is late, lost or done twice never breaks this.
//!
//! The proof. A claim is a key of the directory that exists only with the lease of its server, and is made only where there is
//! none. The directory ends a lease no earlier than its time after it took the last renewal, which is after that was sent. So
//! a server counts from the sending, takes the drift and [`MARGIN`] off, and publishes only before. A claim that is given up
//! names the key's epoch, so that a late copy of that request removes no newer claim; until it is answered, the server does
//! not claim the scene again. A lease that was lost is ended by request, so that it does not stand in the way of the next one,
//! but no sooner than [`MARGIN`] after nothing was published any more.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::str::FromStr;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Instant, Span};

/// The place at which clients reach a server, as an address in text (PROTOCOL 12) without a scene.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct ServerPlace(pub(crate) String);

/// The number of a claim, which rises with each claim of any scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct Epoch(pub(crate) u64);

/// The directory's number of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct LeaseId(pub(crate) u64);

/// The number of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct RequestId(u64);

/// A question to the directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum DirectoryRequest {
    /// A lease of some seconds.
    Grant { seconds: u64 },
    /// The lease has its whole time again.
    Renew(LeaseId),
    /// The lease and all its claims end.
    Revoke(LeaseId),
    /// The scene belongs to the lease, unless it belongs to one already.
    Claim(LeaseId, SceneName),
    /// The scene belongs to no lease any more, if it has this epoch.
    Release(Epoch, SceneName),
}

/// An answer of the directory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum DirectoryAnswer {
    /// A lease of so many seconds, which the directory may have made longer.
    Granted(LeaseId, u64),
    /// The lease has so many seconds again.
    Renewed(u64),
    /// The lease has ended.
    NoLease,
    Revoked,
    /// The scene belongs to this lease, of the server at this place.
    Owner {
        lease: LeaseId,
        epoch: Epoch,
        place: ServerPlace,
    },
    Released,
    /// None came in time: the request may have been done, or may be later.
    Failed,
}

/// The result of a claim, or its end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum ClaimEvent {
    /// The scene is this server's.
    Owned(SceneName, Epoch),
    /// Another server has it.
    Elsewhere(SceneName, ServerPlace),
    /// The directory does not say.
    Unknown(SceneName),
    /// The lease is over, and all that the server owned.
    Lost,
}

/// Time of a lease, seconds: from [`Self::MIN`] to [`Self::MAX`].
///
/// A scene of a killed server is free after that time, and a server without its directory publishes for about that time. In the
/// shortest one there is time for one renewal that gets no answer; clients try for twice the longest one to resume.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LeaseSeconds(u64);

impl LeaseSeconds {
    const MIN: u64 = 3;
    const MAX: u64 = 30;

    /// Time between two renewals: a third of that in which one may publish.
    fn renewal(self) -> Span {
        let usable = until(Instant::ZERO, self.0).since(Instant::ZERO);
        Span::from_nanos(usable.as_nanos() / 3)
    }
}

impl Default for LeaseSeconds {
    fn default() -> Self {
        Self(5)
    }
}

/// A text that is no time of a lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct InvalidLease;

impl fmt::Display for InvalidLease {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (min, max) = (LeaseSeconds::MIN, LeaseSeconds::MAX);
        write!(f, "must be whole seconds, from {min} to {max}")
    }
}

impl std::error::Error for InvalidLease {}

impl FromStr for LeaseSeconds {
    type Err = InvalidLease;

    fn from_str(text: &str) -> Result<Self, InvalidLease> {
        let seconds = text.parse().ok();
        let seconds = seconds.filter(|seconds| (Self::MIN..=Self::MAX).contains(seconds));
        seconds.map(Self).ok_or(InvalidLease)
    }
}

/// Parts of a hundred by which the rates of two clocks differ at most. Quartz drifts by 0.02 %, a steered clock by 0.05 %.
pub(crate) const DRIFT_PERCENT: u64 = 2;
/// Time before the end of a lease at which nothing is published any more. A transport that closes lets data leave for half a
/// second.
pub(crate) const MARGIN: Span = Span::from_millis(1_000);
/// Time between a request that failed, and the next.
const RETRY: Span = Span::from_millis(250);
/// Time for an answer.
pub(crate) const ANSWER: Span = Span::from_millis(1_000);

/// The claims of one server.
#[derive(Debug)]
pub(crate) struct SceneClaims {
    /// Of this server.
    place: ServerPlace,
    /// Time of its leases.
    time: LeaseSeconds,
    lease: Option<Lease>,
    /// Leases that are over for this server and that the directory may still have, and when they may be ended.
    over: BTreeMap<LeaseId, Instant>,
    /// When the lease is asked for, or renewed, next; `None` while an answer is awaited.
    next: Option<Instant>,
    scenes: BTreeMap<SceneName, Claim>,
    /// Scenes that are claimed with the next lease, and until when.
    waiting: BTreeMap<SceneName, Instant>,
    /// Scenes whose release is asked for again, and when.
    unreleased: BTreeMap<SceneName, Instant>,
    /// Scenes that an own lease which is over still holds, and when they are claimed again.
    held_back: BTreeMap<SceneName, Instant>,
    /// Requests without an answer: when they were sent.
    asked: BTreeMap<RequestId, (DirectoryRequest, Instant)>,
    requests: u64,
    out: VecDeque<(RequestId, DirectoryRequest)>,
    events: VecDeque<ClaimEvent>,
}

#[derive(Clone, Copy, Debug)]
struct Lease {
    id: LeaseId,
    /// When it is over for this server.
    until: Instant,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Claim {
    Asked,
    Owned(Epoch),
    /// Given up; the directory has not said that it knows. `true` if it is wanted again.
    Releasing(Epoch, bool),
}

impl SceneClaims {
    /// None yet; it asks for a lease at once.
    pub(crate) fn new(now: Instant, place: ServerPlace, time: LeaseSeconds) -> Self {
        Self {
            place,
            time,
            lease: None,
            over: BTreeMap::new(),
            next: Some(now),
            scenes: BTreeMap::new(),
            waiting: BTreeMap::new(),
            unreleased: BTreeMap::new(),
            held_back: BTreeMap::new(),
            asked: BTreeMap::new(),
            requests: 0,
            out: VecDeque::new(),
            events: VecDeque::new(),
        }
    }

    /// Claims a scene; an event says what comes of it.
    pub(crate) fn claim(&mut self, now: Instant, scene: &SceneName) {
        self.expire(now);
        let Some(lease) = self.lease else {
            let until = self.waiting.entry(scene.clone());
            until.or_insert(now + ANSWER);
            return;
        };
        match self.scenes.get_mut(scene) {
            None => {
                self.scenes.insert(scene.clone(), Claim::Asked);
                self.ask(now, DirectoryRequest::Claim(lease.id, scene.clone()));
            }
            Some(Claim::Asked) => {}
            Some(Claim::Owned(epoch)) => {
                let owned = ClaimEvent::Owned(scene.clone(), *epoch);
                self.events.push_back(owned);
            }
            Some(Claim::Releasing(_, is_wanted)) => *is_wanted = true,
        }
    }

    /// True for a scene that is this server's.
    pub(crate) fn owns(&self, scene: &SceneName) -> bool {
        matches!(self.scenes.get(scene), Some(Claim::Owned(_)))
    }

    /// The lease that holds the claims.
    pub(crate) fn lease(&self) -> Option<LeaseId> {
        self.lease.map(|lease| lease.id)
    }

    /// Gives a scene up, of which nothing is published any more.
    pub(crate) fn release(&mut self, now: Instant, scene: &SceneName) {
        if let Some(claim) = self.scenes.get_mut(scene)
            && let Claim::Owned(epoch) = *claim
        {
            *claim = Claim::Releasing(epoch, false);
            self.ask(now, DirectoryRequest::Release(epoch, scene.clone()));
        }
    }

    /// Gives everything up, of which nothing is published any more, and asks for nothing again.
    pub(crate) fn end(&mut self, now: Instant) {
        self.next = None;
        self.scenes.clear();
        self.waiting.clear();
        if let Some(lease) = self.lease.take() {
            self.ask(now, DirectoryRequest::Revoke(lease.id));
        }
    }

    /// Takes an answer to a request, or that there is none.
    pub(crate) fn handle_answer(&mut self, now: Instant, to: RequestId, answer: DirectoryAnswer) {
        self.expire(now);
        let Some((request, sent)) = self.asked.remove(&to) else {
            return;
        };
        match request {
            DirectoryRequest::Grant { .. } => self.handle_grant(now, sent, &answer),
            DirectoryRequest::Renew(id) => self.handle_renewal(now, (id, sent), &answer),
            DirectoryRequest::Revoke(id) => {
                if answer == DirectoryAnswer::Failed {
                    self.over.insert(id, now + RETRY);
                }
            }
            DirectoryRequest::Claim(id, scene) => self.handle_claim(now, (id, scene), answer),
            DirectoryRequest::Release(epoch, scene) => {
                self.handle_release(now, (epoch, scene), &answer);
            }
        }
    }

    /// Renews, and ends what is over.
    pub(crate) fn handle_timeout(&mut self, now: Instant) {
        self.expire(now);
        for scene in take_due(&mut self.unreleased, now) {
            if let Some(Claim::Releasing(epoch, _)) = self.scenes.get(&scene).copied() {
                self.ask(now, DirectoryRequest::Release(epoch, scene));
            }
        }
        if let Some(lease) = self.lease {
            for over in take_due(&mut self.over, now) {
                self.ask(now, DirectoryRequest::Revoke(over));
            }
            for scene in take_due(&mut self.held_back, now) {
                if self.scenes.get(&scene) == Some(&Claim::Asked) {
                    self.ask(now, DirectoryRequest::Claim(lease.id, scene));
                }
            }
        }
        let given_up = take_due(&mut self.waiting, now);
        self.events
            .extend(given_up.into_iter().map(ClaimEvent::Unknown));
        if self.next.is_some_and(|next| next <= now) {
            self.next = None;
            let request = match self.lease {
                Some(lease) => DirectoryRequest::Renew(lease.id),
                None => DirectoryRequest::Grant {
                    seconds: self.time.0,
                },
            };
            self.ask(now, request);
        }
    }

    /// The next request to the directory.
    pub(crate) fn poll_request(&mut self) -> Option<(RequestId, DirectoryRequest)> {
        self.out.pop_front()
    }

    /// The next event.
    pub(crate) fn poll_event(&mut self) -> Option<ClaimEvent> {
        self.events.pop_front()
    }

    /// When [`Self::handle_timeout`] has something to do.
    pub(crate) fn poll_timeout(&self) -> Option<Instant> {
        let until = self.lease.map(|lease| lease.until);
        let unreleased = self.unreleased.values().min().copied();
        let waiting = self.waiting.values().min().copied();
        let with_lease = self.over.values().chain(self.held_back.values()).min();
        let with_lease = with_lease.copied().filter(|_| self.lease.is_some());
        [until, self.next, unreleased, waiting, with_lease]
            .into_iter()
            .flatten()
            .min()
    }

    /// The moment from which nothing may be published, unless a renewal moves it.
    pub(crate) fn publishes_until(&self) -> Instant {
        self.lease.map_or(Instant::ZERO, |lease| lease.until)
    }

    fn ask(&mut self, now: Instant, request: DirectoryRequest) {
        let id = RequestId(self.requests);
        self.requests += 1;
        self.asked.insert(id, (request.clone(), now));
        self.out.push_back((id, request));
    }

    fn handle_grant(&mut self, now: Instant, sent: Instant, answer: &DirectoryAnswer) {
        let granted = match *answer {
            DirectoryAnswer::Granted(id, seconds) => Some((id, until(sent, seconds))),
            _ => None,
        };
        match granted {
            Some((id, until)) if now < until => {
                self.lease = Some(Lease { id, until });
                self.next = Some(sent + self.time.renewal());
                for scene in std::mem::take(&mut self.waiting).into_keys() {
                    self.claim(now, &scene);
                }
            }
            // It came so late that it is of no use; it ends by itself.
            _ => self.next = Some(now + RETRY),
        }
    }

    fn handle_renewal(
        &mut self,
        now: Instant,
        (id, sent): (LeaseId, Instant),
        answer: &DirectoryAnswer,
    ) {
        let Some(lease) = self.lease.as_mut().filter(|lease| lease.id == id) else {
            return;
        };
        match *answer {
            DirectoryAnswer::Renewed(seconds) => {
                lease.until = lease.until.max(until(sent, seconds));
                self.next = Some(sent + self.time.renewal());
            }
            DirectoryAnswer::NoLease => self.lose(now),
            _ => self.next = Some(now + RETRY),
        }
    }

    fn handle_claim(
        &mut self,
        now: Instant,
        (id, scene): (LeaseId, SceneName),
        answer: DirectoryAnswer,
    ) {
        let is_held = self.lease.is_some_and(|lease| lease.id == id);
        if !is_held || self.scenes.get(&scene) != Some(&Claim::Asked) {
            // It was over with its lease, and that has been reported.
            return;
        }
        let event = match answer {
            DirectoryAnswer::Owner { lease, epoch, .. } if lease == id => {
                self.scenes.insert(scene.clone(), Claim::Owned(epoch));
                return self.events.push_back(ClaimEvent::Owned(scene, epoch));
            }
            DirectoryAnswer::NoLease => return self.lose(now),
            DirectoryAnswer::Owner { place, .. } if place != self.place => {
                ClaimEvent::Elsewhere(scene.clone(), place)
            }
            DirectoryAnswer::Owner { .. } if self.is_any_over() => {
                self.held_back.insert(scene, now + RETRY);
                return;
            }
            // A process before this one had the scene, or the directory is silent.
            _ => ClaimEvent::Unknown(scene.clone()),
        };
        self.scenes.remove(&scene);
        self.events.push_back(event);
    }

    fn handle_release(&mut self, now: Instant, of: (Epoch, SceneName), answer: &DirectoryAnswer) {
        let (epoch, scene) = of;
        let Some(Claim::Releasing(pending, is_wanted)) = self.scenes.get(&scene).copied() else {
            return;
        };
        if pending != epoch {
            return;
        }
        if *answer != DirectoryAnswer::Released {
            self.unreleased.insert(scene, now + RETRY);
            return;
        }
        self.scenes.remove(&scene);
        if is_wanted {
            self.claim(now, &scene);
        }
    }

    /// True while the directory may have an own lease that is over.
    fn is_any_over(&self) -> bool {
        let is_revoked = |(request, _): &(DirectoryRequest, Instant)| {
            matches!(request, DirectoryRequest::Revoke(_))
        };
        !self.over.is_empty() || self.asked.values().any(is_revoked)
    }

    /// Ends a lease whose time is over.
    fn expire(&mut self, now: Instant) {
        if self.lease.is_some_and(|lease| lease.until <= now) {
            self.lose(now);
        }
    }

    /// Forgets the lease and what it held. What was sent before may still be on its way.
    fn lose(&mut self, now: Instant) {
        let Some(lease) = self.lease.take() else {
            return;
        };
        self.over.insert(lease.id, now + MARGIN);
        self.unreleased.clear();
        self.held_back.clear();
        for (scene, claim) in std::mem::take(&mut self.scenes) {
            if matches!(claim, Claim::Asked | Claim::Releasing(_, true)) {
                self.events.push_back(ClaimEvent::Unknown(scene));
            }
        }
        self.events.push_back(ClaimEvent::Lost);
        self.next = Some(now);
    }
}

/// Takes out what is due.
fn take_due<K: Clone + Ord>(of: &mut BTreeMap<K, Instant>, now: Instant) -> Vec<K> {
    let due = of.iter().filter(|(_, at)| **at <= now);
    let due: Vec<_> = due.map(|(key, _)| key.clone()).collect();
    of.retain(|_, at| *at > now);
    due
}

/// The end, for this server, of a lease of so many seconds that was asked for then.
fn until(sent: Instant, seconds: u64) -> Instant {
    let whole = seconds.saturating_mul(1_000_000_000);
    let drifted = whole - whole / 100 * DRIFT_PERCENT;
    sent + Span::from_nanos(drifted.saturating_sub(MARGIN.as_nanos()))
}

#[cfg(test)]
mod tests;
