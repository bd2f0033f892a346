//! The queues between a scene whose engine is elsewhere and its owner.
//!
//! The owner hands states over and answers requests by [`Feed`]; the scene's end is [`FedScene`], which takes a step for each
//! tick of it. Neither end waits for the other: an owner that is ahead by four keeps its states. Invariants: ticks rise; the
//! states of a tick are in the order of ids, each body once; a request has one answer.

use core::fmt;
use std::collections::{BTreeMap, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use rhumb_protocol::limits::AUTHORITY_BODIES_MAX;
use rhumb_protocol::message::SceneEvent;
use rhumb_protocol::scene::{Command, CommandError, SceneName, Stepping};
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::{BodyId, BodyState, Tick};

use crate::permit::ClientName;
use crate::record::SessionNumber;
use crate::sessions::REFUSALS_KEPT;

/// Ticks that wait for the scene.
const WAITING_TICKS_MAX: usize = 4;
/// Ticks from the states of one to those of the next: the scene steps through all of them.
pub const TICKS_APART_MAX: u64 = 600;
/// Requests that wait for the owner; a further one is refused as `Overloaded`. Derived: far more than an owner leaves unread
/// between two ticks, and some 20 MB.
const REQUESTS_MAX: usize = 65_536;

/// The source of the velocities of fed states.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FedVelocities {
    /// They are the engine's.
    Given,
    /// The engine has none, or wrong ones: they follow from the poses of this tick and the one before.
    FromPoses,
}

/// States of one tick.
#[derive(Debug)]
pub(crate) struct FedTick {
    pub(crate) tick: Tick,
    /// Number of the owner's commands that come before.
    pub(crate) commands: u64,
    pub(crate) velocities: FedVelocities,
    /// In the order of ids.
    pub(crate) states: Vec<(BodyId, BodyState)>,
}

/// A command of a member that does not own the scene. The scene has not changed by it: the owner decides.
///
/// A command that moves a body is the owner's to carry out: what it feeds is the answer. One that adds, changes or removes
/// something changes the scene once the owner accepts it.
#[derive(Clone, Debug, PartialEq)]
pub struct FedRequest {
    /// The client of the member's token, if it has one.
    pub client: Option<ClientName>,
    /// The member.
    pub member: Peer,
    /// The number of its command, which a refusal names.
    pub number: u64,
    /// The command to carry out.
    pub command: Command,
    /// Its member's session, which may continue over another connection.
    pub(crate) session: Option<SessionNumber>,
    answered: AnswerFlag,
}

impl FedRequest {
    /// A request without an answer. `client` and `member` gave the command of this number.
    #[must_use]
    pub fn new(
        client: Option<ClientName>,
        member: Peer,
        (number, command): (u64, Command),
    ) -> Self {
        Self {
            client,
            member,
            number,
            command,
            session: None,
            answered: AnswerFlag::default(),
        }
    }

    pub(crate) fn of_session(self, session: Option<SessionNumber>) -> Self {
        Self { session, ..self }
    }
}

/// True once a request has its answer; the clones of a request share it.
#[derive(Clone, Debug, Default)]
struct AnswerFlag(Arc<AtomicBool>);

impl PartialEq for AnswerFlag {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

/// Error: a request has an answer already, and keeps it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AnsweredBefore;

impl fmt::Display for AnsweredBefore {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the request has an answer already: answer each once")
    }
}

impl core::error::Error for AnsweredBefore {}

/// The owner's answer to a request.
#[derive(Debug)]
pub(crate) enum FedAnswer {
    Accepted(FedRequest),
    Refused(FedRequest, CommandError),
}

/// Both ends' queues.
#[derive(Debug, Default)]
struct FeedQueues {
    ticks: VecDeque<FedTick>,
    /// Memory of states that were taken.
    spare: Vec<Vec<(BodyId, BodyState)>>,
    requests: VecDeque<FedRequest>,
    answers: VecDeque<FedAnswer>,
    /// Accepted requests that the scene refused.
    failures: VecDeque<(FedRequest, CommandError)>,
}

/// The state that the owner and its scene share.
#[derive(Debug)]
pub(crate) struct SharedFeed {
    owner: Peer,
    queues: Mutex<FeedQueues>,
}

impl SharedFeed {
    /// The connection of the owner.
    pub(crate) const fn owner(&self) -> Peer {
        self.owner
    }

    /// The tick of the oldest states, and the commands before it.
    pub(crate) fn next(&self) -> Option<(Tick, u64)> {
        let queues = self.lock();
        queues.ticks.front().map(|fed| (fed.tick, fed.commands))
    }

    /// Takes the oldest states.
    pub(crate) fn take(&self) -> Option<FedTick> {
        self.lock().ticks.pop_front()
    }

    /// Puts states back: the scene is not at their tick yet.
    pub(crate) fn put_back(&self, fed: FedTick) {
        self.lock().ticks.push_front(fed);
    }

    /// Gives the memory of states back.
    pub(crate) fn recycle(&self, mut states: Vec<(BodyId, BodyState)>) {
        states.clear();
        let mut queues = self.lock();
        if queues.spare.len() < WAITING_TICKS_MAX {
            queues.spare.push(states);
        }
    }

    /// Hands a request to the owner; false if too many wait.
    pub(crate) fn request(&self, request: FedRequest) -> bool {
        let mut queues = self.lock();
        let has_room = queues.requests.len() < REQUESTS_MAX;
        if has_room {
            queues.requests.push_back(request);
        }
        has_room
    }

    /// Takes the owner's answers.
    pub(crate) fn take_answers(&self) -> VecDeque<FedAnswer> {
        std::mem::take(&mut self.lock().answers)
    }

    /// Informs the owner that the scene has refused what it accepted.
    pub(crate) fn fail(&self, request: FedRequest, error: CommandError) {
        let mut queues = self.lock();
        if queues.failures.len() == REQUESTS_MAX {
            queues.failures.pop_front();
        }
        queues.failures.push_back((request, error));
    }

    pub(crate) fn has_answers(&self) -> bool {
        !self.lock().answers.is_empty()
    }

    fn lock(&self) -> MutexGuard<'_, FeedQueues> {
        // Each change is one call.
        self.queues.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The feeds of a server's scenes, by name; all clones are one.
#[derive(Clone, Debug, Default)]
pub struct Feeds(Arc<Mutex<BTreeMap<SceneName, Weak<SharedFeed>>>>);

impl Feeds {
    /// The next scene of a name is fed, by the member that is behind this connection. It alone can create the scene,
    /// which ends with it.
    ///
    /// # Errors
    ///
    /// [`FeedTaken`] if another one feeds a scene of the name.
    pub fn open(&self, name: &SceneName, owner: Peer) -> Result<Feed, FeedTaken> {
        let mut feeds = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        feeds.retain(|_, feed| feed.strong_count() > 0);
        if feeds.contains_key(name) {
            return Err(FeedTaken(name.clone()));
        }
        let shared = Arc::new(SharedFeed {
            owner,
            queues: Mutex::default(),
        });
        feeds.insert(name.clone(), Arc::downgrade(&shared));
        Ok(Feed {
            name: name.clone(),
            shared,
            newest: Tick::ZERO,
        })
    }

    pub(crate) fn of(&self, name: &SceneName) -> Option<Arc<SharedFeed>> {
        let feeds = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        feeds.get(name)?.upgrade()
    }
}

/// The owner's end of a scene that it feeds.
#[derive(Debug)]
pub struct Feed {
    name: SceneName,
    shared: Arc<SharedFeed>,
    newest: Tick,
}

impl Feed {
    /// The scene.
    #[must_use]
    pub const fn name(&self) -> &SceneName {
        &self.name
    }

    /// The tick of the newest states that were handed over.
    #[must_use]
    pub const fn newest(&self) -> Tick {
        self.newest
    }

    /// True if as many ticks wait as may.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.shared.lock().ticks.len() >= WAITING_TICKS_MAX
    }

    /// True if the scene has taken everything.
    #[must_use]
    pub fn is_taken(&self) -> bool {
        let queues = self.shared.lock();
        queues.ticks.is_empty() && queues.answers.is_empty()
    }

    /// Hands over the states of a tick: later than the newest one, by [`TICKS_APART_MAX`] at most. Each body has one
    /// state, in any order; a body that is not in the scene is left out.
    ///
    /// `commands`: the number of the owner's commands that come before.
    pub fn push(
        &mut self,
        tick: Tick,
        states: &[(BodyId, BodyState)],
        velocities: FedVelocities,
        commands: u64,
    ) {
        self.newest = tick;
        let mut kept = self.shared.lock().spare.pop().unwrap_or_default();
        kept.extend_from_slice(states);
        if !kept.is_sorted_by_key(|(id, _)| *id) {
            kept.sort_unstable_by_key(|(id, _)| *id);
        }
        self.shared.lock().ticks.push_back(FedTick {
            tick,
            commands,
            velocities,
            states: kept,
        });
    }

    /// The oldest unread request of another member.
    #[must_use]
    pub fn poll_request(&self) -> Option<FedRequest> {
        self.shared.lock().requests.pop_front()
    }

    /// Changes the scene as a member asked. If the scene cannot, the member's command is refused after all, and
    /// [`Self::poll_failure`] says so.
    ///
    /// # Errors
    ///
    /// [`AnsweredBefore`] for a request that was accepted or refused before.
    pub fn accept(&self, request: FedRequest) -> Result<(), AnsweredBefore> {
        self.answer(&request.answered.clone(), FedAnswer::Accepted(request))
    }

    /// Refuses a request.
    ///
    /// # Errors
    ///
    /// As [`Self::accept`].
    pub fn refuse(&self, request: FedRequest, error: CommandError) -> Result<(), AnsweredBefore> {
        self.answer(
            &request.answered.clone(),
            FedAnswer::Refused(request, error),
        )
    }

    fn answer(&self, answered: &AnswerFlag, answer: FedAnswer) -> Result<(), AnsweredBefore> {
        if answered.0.swap(true, Ordering::Relaxed) {
            return Err(AnsweredBefore);
        }
        self.shared.lock().answers.push_back(answer);
        Ok(())
    }

    /// The oldest request that was accepted and that the scene refused, with its reason, once.
    #[must_use]
    pub fn poll_failure(&self) -> Option<(FedRequest, CommandError)> {
        self.shared.lock().failures.pop_front()
    }
}

/// Time without states after which a free-running scene informs its members that the owner is silent: that of a silent
/// upstream (decision 73).
const SILENT_AFTER: Span = Span::from_millis(250);

/// The scene's end of its feed.
pub(crate) struct FedScene {
    feed: Arc<SharedFeed>,
    /// The owner's commands that were applied or refused.
    commands: u64,
    /// When states were taken last; before the first ones, when the scene got a member.
    fed: Option<Instant>,
    /// While the owner is silent: the first tick without states, and the bodies that members know to be concerned.
    silence: Option<(Tick, Vec<BodyId>)>,
    /// Refusals of requests whose member was away, by its session.
    unsent: BTreeMap<SessionNumber, VecDeque<(u64, CommandError)>>,
}

impl FedScene {
    pub(crate) const fn new(feed: Arc<SharedFeed>) -> Self {
        Self {
            feed,
            commands: 0,
            fed: None,
            silence: None,
            unsent: BTreeMap::new(),
        }
    }

    /// Keeps the refusal of a request whose member is away.
    pub(crate) fn keep_refusal(&mut self, session: SessionNumber, refusal: (u64, CommandError)) {
        let kept = self.unsent.entry(session).or_default();
        if kept.len() == REFUSALS_KEPT {
            kept.pop_front();
        }
        kept.push_back(refusal);
    }

    /// Takes the refusals that a session's member has not received.
    pub(crate) fn take_refusals(
        &mut self,
        session: SessionNumber,
    ) -> VecDeque<(u64, CommandError)> {
        self.unsent.remove(&session).unwrap_or_default()
    }

    /// Drops the refusals of sessions that are over.
    pub(crate) fn keep_sessions(&mut self, exists: impl Fn(SessionNumber) -> bool) {
        self.unsent.retain(|session, _| exists(*session));
    }

    /// Informs the owner that the scene has refused what it accepted.
    pub(crate) fn fail(&self, request: FedRequest, error: CommandError) {
        self.feed.fail(request, error);
    }

    /// The connection of the owner.
    pub(crate) fn owner(&self) -> Peer {
        self.feed.owner()
    }

    /// Hands a request to the owner; false if too many wait.
    pub(crate) fn request(&self, request: FedRequest) -> bool {
        self.feed.request(request)
    }

    /// Takes the owner's answers.
    pub(crate) fn take_answers(&self) -> VecDeque<FedAnswer> {
        self.feed.take_answers()
    }

    /// True if states wait, and the commands before them were handled.
    pub(crate) fn is_due(&self) -> bool {
        let next = self.feed.next();
        next.is_some_and(|(_, commands)| commands <= self.commands)
    }

    /// The next moment at which there is something to do.
    pub(crate) fn next_wake(&self, stepping: Stepping) -> Option<Instant> {
        if self.is_due() || self.feed.has_answers() {
            return Some(Instant::ZERO);
        }
        self.silent_at(stepping)
    }

    /// When the owner counts as silent, unless it does already.
    fn silent_at(&self, stepping: Stepping) -> Option<Instant> {
        let can_fall_silent = stepping == Stepping::FreeRunning && self.silence.is_none();
        Some(self.fed.filter(|_| can_fall_silent)? + SILENT_AFTER)
    }

    /// True if the owner counts as silent from now on.
    pub(crate) fn is_overdue(&self, now: Instant, stepping: Stepping) -> bool {
        self.silent_at(stepping).is_some_and(|at| at <= now)
    }

    /// Notes that the scene has its first member: silence counts from now on.
    pub(crate) fn begin(&mut self, now: Instant) {
        self.fed.get_or_insert(now);
    }

    /// Notes a body that comes; returns its scene event if the owner is silent.
    pub(crate) fn include(&mut self, id: BodyId) -> Option<SceneEvent> {
        let (since, bodies) = self.silence.as_mut()?;
        bodies.push(id);
        Some(SceneEvent::PublisherSilent {
            since: *since,
            bodies: vec![id],
        })
    }

    /// Notes a command that is applied or refused now.
    pub(crate) fn note_command(&mut self, peer: Peer) {
        self.commands += u64::from(peer == self.feed.owner());
    }

    /// Notes that states are taken for a tick; returns the scene events of an owner that was silent.
    pub(crate) fn note_active(&mut self, now: Instant, tick: Tick) -> Vec<SceneEvent> {
        self.fed = Some(now);
        let silence = self.silence.take();
        let bodies = silence.map(|(_, bodies)| bodies).unwrap_or_default();
        let active = |bodies| SceneEvent::PublisherActive { tick, bodies };
        in_parts(&bodies, active).collect()
    }

    /// Notes that the owner is silent from a tick on; returns its scene events.
    pub(crate) fn note_silent(&mut self, since: Tick, bodies: Vec<BodyId>) -> Vec<SceneEvent> {
        self.silence = Some((since, bodies));
        self.silences().collect()
    }

    /// The scene events of a silent owner.
    pub(crate) fn silences(&self) -> impl Iterator<Item = SceneEvent> {
        let silence = self.silence.iter();
        silence.flat_map(|(since, bodies)| {
            let since = *since;
            in_parts(bodies, move |bodies| SceneEvent::PublisherSilent {
                since,
                bodies,
            })
        })
    }

    /// Notes that a body has left the scene: no member knows it any more.
    pub(crate) fn forget(&mut self, id: BodyId) {
        if let Some((_, bodies)) = &mut self.silence {
            bodies.retain(|silent| *silent != id);
        }
    }
}

/// Scene events of bodies, as many in each as one may have.
fn in_parts<'a>(
    bodies: &'a [BodyId],
    event: impl Fn(Vec<BodyId>) -> SceneEvent + 'a,
) -> impl Iterator<Item = SceneEvent> + 'a {
    let parts = bodies.chunks(AUTHORITY_BODIES_MAX);
    parts.map(move |bodies| event(bodies.to_vec()))
}

/// Error: another client feeds a scene of this name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FeedTaken(pub SceneName);

impl fmt::Display for FeedTaken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "another client feeds the scene {}", self.0)
    }
}

impl core::error::Error for FeedTaken {}

#[cfg(test)]
mod tests {
    use super::*;

    const OWNER: Peer = Peer(1);

    fn feed() -> Feed {
        let feeds = Feeds::default();
        feeds.open(&"fed".parse().unwrap(), OWNER).unwrap()
    }

    fn at(x: f32) -> BodyState {
        BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).unwrap()
    }

    #[test]
    fn a_name_is_fed_by_one_client_until_that_is_gone() {
        let (feeds, name) = (Feeds::default(), "fed".parse().unwrap());
        let first = feeds.open(&name, OWNER).unwrap();
        assert_eq!(
            feeds.open(&name, Peer(2)).err(),
            Some(FeedTaken(name.clone()))
        );
        drop(first);
        assert!(feeds.of(&name).is_none());
        assert!(feeds.open(&name, Peer(2)).is_ok());
    }

    #[test]
    fn states_reach_the_scene_in_the_order_of_ids() {
        let mut feed = feed();
        let states = [(BodyId::new(5, 0), at(5.0)), (BodyId::new(1, 0), at(1.0))];
        feed.push(Tick::new(1), &states, FedVelocities::Given, 0);
        let taken = feed.shared.take().unwrap();
        assert_eq!(taken.states, [states[1], states[0]]);
        assert!(feed.is_taken());
    }
}
