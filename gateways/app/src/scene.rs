//! The scene of one APP client, which the gateway joins as any client does.
//!
//! Commands leave together with the next tick. Until its answer comes, the copy shows what they change as if they were
//! applied; the answer names those that the server refused. The copy has the exact states of all bodies. Which of them
//! are awake is known from events, and contacts from queries that wait for their tick.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use glam::Vec3;
use rhumb_client::{
    Client, ClientError, JoinMode, JoinOptions, OpenError, QueryResult, Refusals, Replica,
    ServerConnection, StreamChoice,
};
use rhumb_protocol::limits::{HITS_MAX, QUERY_COST_MAX};
use rhumb_protocol::scene::{
    ActiveEvents, Answer, BodyDesc, BodyEvent, BodyKind, Command, CommandError, Hit, JointId,
    Query, SceneConfig, SceneName, Shape, ShapeId,
};
use rhumb_protocol::session::{Event, Misuse};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{Anchor, BodyId, BodyState, Tick};

/// A scene that exists for one APP client.
pub(super) struct OwnScene {
    client: Client,
    /// Commands that the copy does not show before the next tick.
    pending: Pending,
    /// Commands without an answer, by their numbers.
    sent: BTreeMap<u64, Sent>,
    /// The actor that the next commands are about, and the index of the last message about it.
    pub(super) about: Option<(u32, u32)>,
    refused: Vec<(Sent, CommandError)>,
    /// Bodies of this client that can move.
    moving: BTreeSet<BodyId>,
    /// The moving bodies that the engine steps.
    awake: BTreeSet<BodyId>,
    observations: Vec<Observation>,
    /// Ids of bodies that the scene refused.
    spare: Vec<BodyId>,
    /// Events that came before an answer.
    unread: Vec<Event>,
}

/// Changes since the last tick; `None` for what was removed.
#[derive(Default)]
struct Pending {
    gravity: Option<Vec3>,
    shapes: BTreeMap<ShapeId, Option<Shape>>,
    bodies: BTreeMap<BodyId, Option<(BodyDesc, Observation)>>,
    joints: BTreeMap<JointId, bool>,
    /// Fixed bodies that were put elsewhere.
    moved: BTreeSet<BodyId>,
}

/// A command on its way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sent {
    pub(super) subject: CommandSubject,
    /// The actor, and the index of the last message about it.
    pub(super) about: Option<(u32, u32)>,
}

/// The subject of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CommandSubject {
    Shape(ShapeId),
    Body(BodyId),
    Joint(JointId),
    /// A pose or a velocity.
    Motion,
    /// A removal, a push, gravity.
    Other,
}

/// The events of a step, beside the states of bodies.
pub(super) struct FrameStep {
    /// The bodies that the engine observed, in the order of ids.
    pub(super) observed: Vec<BodyId>,
    /// Bodies that were asked about, and the deepest contact with each body that touches them; in the order of ids.
    contacts: Vec<(BodyId, Vec<Hit>)>,
}

impl FrameStep {
    /// The deepest contact with each body that touches a body; `None` if it was not asked about.
    pub(super) fn contacts(&self, id: BodyId) -> Option<&[Hit]> {
        let place = self.contacts.binary_search_by_key(&id, |(id, _)| *id);
        place.ok().map(|place| &self.contacts[place].1[..])
    }
}

/// Steps that are asked for at once: the longest frame at the usual rate.
const TICKS_MAX: u32 = 60;
/// Most sleeping bodies that are asked about too, so that several steps need no answer between them. With more, the
/// questions take as long as an answer to each step.
const ASLEEP_MAX: usize = 64;
/// Questions for contacts that wait for their answers.
const QUERIES_AT_ONCE: usize = 4_096;
/// Time for an answer: the watchdog of the server ends a scene that takes longer for one step.
const TIMEOUT: Duration = Duration::from_secs(30);
/// Queries of contacts in one message.
const QUERIES_MAX: usize = QUERY_COST_MAX as usize / HITS_MAX as usize;
/// Events of every body that can move.
const EVENTS: ActiveEvents = ActiveEvents {
    contacts: false,
    force: None,
    sensors: false,
    sleep: true,
};

impl OwnScene {
    /// Creates the scene.
    pub(super) fn begin(
        connection: ServerConnection,
        name: &SceneName,
        config: SceneConfig,
    ) -> Result<Self, OpenError> {
        let options = JoinOptions {
            mode: JoinMode::Create(config),
            stream: StreamChoice::Changed,
            refusals: Refusals::Events,
            resume_within: Some(Duration::ZERO),
            ..JoinOptions::default()
        };
        let client = connection
            .timeout(TIMEOUT)
            .join_with(name.as_str(), options)?;
        Ok(Self {
            client,
            pending: Pending::default(),
            sent: BTreeMap::new(),
            about: None,
            refused: Vec::new(),
            moving: BTreeSet::new(),
            awake: BTreeSet::new(),
            observations: Vec::new(),
            spare: Vec::new(),
            unread: Vec::new(),
        })
    }

    /// Ends the scene. One that is gone already needs no end.
    pub(super) fn end(mut self) {
        if let Err(cause) = self.client.delete() {
            tracing::debug!(%cause, "the scene of an app client has ended before");
        }
    }

    /// Reads what has arrived.
    pub(super) fn poll(&mut self) -> Result<(), ClientError> {
        self.client.idle(Duration::ZERO)
    }

    /// An id that no body has: one of a refused body, if there is one.
    pub(super) fn new_id(&mut self) -> Result<BodyId, ClientError> {
        if let Some(id) = self.spare.pop() {
            return Ok(id);
        }
        let ids = self.client.new_ids(1)?;
        ids.first()
            .copied()
            .ok_or(ClientError::Misuse(Misuse::Indices(1)))
    }

    /// Takes back the id of a body that was refused.
    pub(super) fn take_back(&mut self, id: BodyId) {
        self.forget(id);
        self.spare.push(id);
    }

    /// Queues a command.
    ///
    /// # Errors
    ///
    /// [`CommandError`] for a command that the server would refuse, because of its numbers or otherwise.
    pub(super) fn command(&mut self, command: &Command) -> Result<(), CommandError> {
        let number = match self.client.command(command.clone()) {
            Ok(number) => number,
            Err(ClientError::Misuse(Misuse::Invalid(invalid))) => {
                return Err(CommandError::Invalid(invalid));
            }
            Err(ClientError::Misuse(Misuse::JoinedToItself(id))) => {
                return Err(CommandError::JoinedToItself(id));
            }
            Err(error) => return not_queued(command, &error),
        };
        let subject = match *command {
            Command::AddShape { id, .. } => CommandSubject::Shape(id),
            Command::AddBody { desc, .. } => CommandSubject::Body(desc.id),
            Command::AddJoint { id, .. } => CommandSubject::Joint(id),
            Command::SetPose { .. } | Command::SetVelocity { .. } => CommandSubject::Motion,
            _ => CommandSubject::Other,
        };
        let about = self.about;
        self.sent.insert(number, Sent { subject, about });
        self.note(command);
        if let Command::AddBody { desc, .. } = command
            && desc.kind == BodyKind::Dynamic
        {
            let (id, events) = (desc.id, EVENTS);
            return self.command(&Command::SetEvents { id, events });
        }
        Ok(())
    }

    /// Shows a command in the copy until the next tick.
    fn note(&mut self, command: &Command) {
        match *command {
            Command::SetGravity { gravity } => self.pending.gravity = Some(gravity),
            Command::AddShape { id, ref shape } => {
                self.pending.shapes.insert(id, Some(shape.clone()));
            }
            Command::RemoveShape { id } => {
                self.pending.shapes.insert(id, None);
            }
            Command::AddBody { desc, motion } => {
                let (id, activity) = (desc.id, Activity::Awake);
                let observation = Observation {
                    id,
                    motion,
                    activity,
                };
                self.pending.bodies.insert(id, Some((desc, observation)));
                if desc.kind == BodyKind::Dynamic {
                    self.moving.insert(id);
                    self.awake.insert(id);
                }
            }
            Command::RemoveBody { id } => {
                self.pending.bodies.insert(id, None);
                self.forget(id);
            }
            Command::SetPose {
                id,
                position,
                rotation,
            } => self.note_motion(id, |[_, _, _, _, _, _, _, velocities @ ..]| {
                (position.to_array(), rotation.to_array(), velocities)
            }),
            Command::SetVelocity {
                id,
                linear,
                angular,
            } => self.note_motion(id, |[x, y, z, i, j, k, w, ..]| {
                let [vx, vy, vz] = linear.to_array();
                let [wx, wy, wz] = angular.to_array();
                ([x, y, z], [i, j, k, w], [vx, vy, vz, wx, wy, wz])
            }),
            Command::AddJoint { id, .. } => {
                self.pending.joints.insert(id, true);
            }
            Command::RemoveJoint { id } => {
                self.pending.joints.insert(id, false);
            }
            _ => {}
        }
    }

    /// Changes the state of a body until the next tick.
    fn note_motion(
        &mut self,
        id: BodyId,
        change: impl FnOnce([f32; 13]) -> ([f32; 3], [f32; 4], [f32; 6]),
    ) {
        let (Some(desc), Some(before)) = (self.body(id), self.observation(id)) else {
            return;
        };
        let (position, rotation, [vx, vy, vz, wx, wy, wz]) = change(before.motion.parts());
        let state = BodyState::new(position, rotation, [vx, vy, vz], [wx, wy, wz]);
        // The command was checked: its numbers make a state.
        if let Ok(motion) = state {
            let after = Observation { motion, ..before };
            self.pending.bodies.insert(id, Some((desc, after)));
        }
        if desc.kind == BodyKind::Fixed {
            self.pending.moved.insert(id);
        }
    }

    /// Steps `ticks` times, with these pushes before each step. `contacts`: whether those of the observed bodies are wanted.
    ///
    /// # Errors
    ///
    /// [`ClientError`] if the scene has ended or its engine has failed.
    pub(super) fn advance(
        &mut self,
        ticks: u32,
        pushes: &[Command],
        contacts: bool,
    ) -> Result<Vec<FrameStep>, ClientError> {
        let mut steps = Vec::new();
        while let Some(left) = ticks
            .checked_sub(steps.len() as u32)
            .filter(|left| *left > 0)
        {
            let (at_once, asked) = match contacts {
                true => self.plan(left, pushes),
                false => (TICKS_MAX, None),
            };
            steps.extend(self.run(left.min(at_once), pushes, asked)?);
        }
        Ok(steps)
    }

    /// Number of steps of these that are requested at once, and the bodies whose contacts are asked for with each.
    ///
    /// All is asked before the first of the steps, when it is not known which bodies wake. So either every body is asked
    /// about, or there is one step. Where all sleep and nothing was commanded none wakes, except by another member's
    /// command: its contacts are known from the last of the steps on.
    fn plan(&self, left: u32, pushes: &[Command]) -> (u32, Option<Vec<BodyId>>) {
        let rests = self.awake.is_empty() && self.sent.is_empty() && pushes.is_empty();
        let asleep = self.moving.len() - self.awake.len();
        let ticks = match asleep {
            _ if rests => TICKS_MAX,
            ..=ASLEEP_MAX => (QUERIES_AT_ONCE / self.moving.len().max(1)) as u32,
            _ => 1,
        };
        let ticks = ticks.clamp(1, TICKS_MAX.min(left));
        let may_touch = if ticks > 1 && !rests {
            &self.moving
        } else {
            &self.awake
        };
        (ticks, Some(may_touch.iter().copied().collect()))
    }

    /// Runs some steps. `asked`: the bodies whose contacts are asked for with each, if contacts are wanted.
    fn run(
        &mut self,
        ticks: u32,
        pushes: &[Command],
        asked: Option<Vec<BodyId>>,
    ) -> Result<Vec<FrameStep>, ClientError> {
        let moved = std::mem::take(&mut self.pending.moved);
        let contacts = asked.is_some();
        let mut asked = asked.unwrap_or_default();
        if contacts && !moved.is_empty() {
            asked.extend(&moved);
            asked.sort_unstable();
        }
        let mut unanswered = Vec::new();
        let mut first = None;
        for tick in 0..ticks {
            for push in pushes {
                // A push that is refused has no answer in this protocol.
                let _ = self.command(push);
            }
            let requested = self.client.queue_tick()?;
            first.get_or_insert(requested);
            if tick + 1 < ticks {
                self.query(&asked, &mut unanswered)?;
            }
        }
        let results = self.ask(&asked, unanswered)?;
        self.client.wait_for_replica()?;
        self.pending = Pending::default();
        let (changes, missed) = self.read_events();
        let mut steps = self.replay(first.unwrap_or_default(), ticks, &changes, &moved);
        let mut results = results.into_iter();
        for step in &mut steps {
            let hits = asked.iter().copied().zip(results.by_ref());
            step.contacts.extend(hits.take(asked.len()));
        }
        if let Some(last) = steps.last_mut() {
            if missed {
                self.find_awake();
                last.observed.extend(&self.awake);
                last.observed.sort_unstable();
                last.observed.dedup();
            }
            let is_unasked = |id: &&BodyId| contacts && asked.binary_search(id).is_err();
            let unasked: Vec<BodyId> = last.observed.iter().filter(is_unasked).copied().collect();
            if !unasked.is_empty() {
                let results = self.ask(&unasked, Vec::new())?;
                last.contacts.extend(unasked.into_iter().zip(results));
                last.contacts.sort_unstable_by_key(|(id, _)| *id);
            }
            self.observe(&last.observed);
        }
        Ok(steps)
    }

    /// Sends questions for the contacts of bodies, and notes the number of each message and of its questions.
    fn query(
        &mut self,
        bodies: &[BodyId],
        unanswered: &mut Vec<(u64, usize)>,
    ) -> Result<(), ClientError> {
        for message in bodies.chunks(QUERIES_MAX) {
            let queries = message.iter().copied().map(Query::contacts).collect();
            unanswered.push((self.client.query(queries)?, message.len()));
        }
        Ok(())
    }

    /// Asks for the contacts of bodies, and waits for the answers, also to the messages before. An answer comes after the
    /// events of its step. Without bodies, one question is sent all the same, so that its answer shows that the events are
    /// here.
    fn ask(
        &mut self,
        bodies: &[BodyId],
        mut unanswered: Vec<(u64, usize)>,
    ) -> Result<Vec<Vec<Hit>>, ClientError> {
        let asked = if bodies.is_empty() {
            &[NO_BODY]
        } else {
            bodies
        };
        let last = asked.len() - (asked.len() - 1) % QUERIES_MAX - 1;
        self.query(&asked[..last], &mut unanswered)?;
        let queries = asked[last..].iter().copied().map(Query::contacts);
        let answer = self.client.ask(queries.collect())?;
        let mut answers = Vec::new();
        // The answers come in order: those to the messages before are here.
        while let Some((_, event)) = self.client.poll_event() {
            match event {
                Event::QueryResult(result) => answers.push(result),
                other => self.unread.push(other),
            }
        }
        unanswered.push((answer.number, asked.len() - last));
        answers.push(answer);
        Ok(hits_in_order(&unanswered, answers))
    }

    /// Reads the events of some steps; returns the bodies that fell asleep or woke, and whether events are missing.
    fn read_events(&mut self) -> (Vec<(Tick, BodyEvent)>, bool) {
        let mut changes = Vec::new();
        let mut events = std::mem::take(&mut self.unread);
        events.extend(std::iter::from_fn(|| self.client.poll_event()).map(|(_, event)| event));
        let mut missed = false;
        for event in events {
            match event {
                Event::Refused { number, error } => {
                    let sent = self.sent.remove(&number);
                    self.refused.extend(sent.map(|sent| (sent, error)));
                }
                Event::Body { tick, event } => changes.push((tick, event)),
                Event::BodyRemoved { id, .. } => self.forget(id),
                Event::EventsMissed { .. } | Event::SceneRestored(_) => missed = true,
                _ => {}
            }
        }
        self.sent.clear();
        (changes, missed)
    }

    /// The observed bodies of each step: those that are awake, have just fallen asleep, or are fixed and were put
    /// elsewhere.
    fn replay(
        &mut self,
        first: Tick,
        ticks: u32,
        changes: &[(Tick, BodyEvent)],
        moved: &BTreeSet<BodyId>,
    ) -> Vec<FrameStep> {
        let mut steps = Vec::new();
        let mut tick = first;
        for place in 0..ticks {
            let mut fell_asleep = Vec::new();
            for (_, event) in changes.iter().filter(|(at, _)| *at == tick) {
                match *event {
                    BodyEvent::FellAsleep(id) if self.awake.remove(&id) => fell_asleep.push(id),
                    BodyEvent::Woke(id) if self.moving.contains(&id) => {
                        self.awake.insert(id);
                    }
                    _ => {}
                }
            }
            let mut observed: Vec<BodyId> = self.awake.iter().copied().collect();
            if place == 0 {
                fell_asleep.extend(moved);
            }
            if !fell_asleep.is_empty() {
                observed.extend(fell_asleep);
                observed.sort_unstable();
            }
            let contacts = Vec::new();
            steps.push(FrameStep { observed, contacts });
            tick = tick.next();
        }
        steps
    }

    /// Finds the bodies that are awake by their velocities, where events are missing.
    fn find_awake(&mut self) {
        let Some(copy) = self.client.replica() else {
            return;
        };
        let moves = |id: &&BodyId| {
            let parts = state_of(copy, **id).map(|state| state.parts());
            parts.is_some_and(|parts| parts[7..].iter().any(|part| *part != 0.0))
        };
        self.awake = self.moving.iter().filter(moves).copied().collect();
    }

    /// Observes bodies as of the last step.
    fn observe(&mut self, ids: &[BodyId]) {
        self.observations.clear();
        let Some(copy) = self.client.replica() else {
            return;
        };
        let observed = ids.iter().filter_map(|id| {
            let (id, motion) = (*id, state_of(copy, *id)?);
            let activity = self.activity(id);
            Some(Observation {
                id,
                motion,
                activity,
            })
        });
        let observed: Vec<_> = observed.collect();
        self.observations = observed;
    }

    fn activity(&self, id: BodyId) -> Activity {
        match self.awake.contains(&id) {
            true => Activity::Awake,
            false => Activity::Asleep,
        }
    }

    /// Forgets a body that is gone.
    fn forget(&mut self, id: BodyId) {
        self.awake.remove(&id);
        self.moving.remove(&id);
    }

    /// The commands that the server refused since the last call.
    pub(super) fn take_refused(&mut self) -> Vec<(Sent, CommandError)> {
        std::mem::take(&mut self.refused)
    }

    /// Gravity, m/s².
    pub(super) fn gravity(&self) -> Vec3 {
        let copied = self.client.replica().map(Replica::gravity);
        let gravity = self.pending.gravity.or(copied);
        gravity.unwrap_or_default()
    }

    /// The shape of this id.
    pub(super) fn shape(&self, id: ShapeId) -> Option<&Shape> {
        match self.pending.shapes.get(&id) {
            Some(pending) => pending.as_ref(),
            None => self.client.replica()?.shape(id),
        }
    }

    /// True if the scene has a joint of this id.
    pub(super) fn has_joint(&self, id: JointId) -> bool {
        let copied = || {
            let joint = self.client.replica()?.joints().get(id)?;
            let is_removed = |id: &BodyId| matches!(self.pending.bodies.get(id), Some(None));
            Some(!joint.bodies.iter().any(is_removed))
        };
        let pending = self.pending.joints.get(&id).copied();
        pending.or_else(copied).unwrap_or_default()
    }

    /// The description of a body that exists.
    pub(super) fn body(&self, id: BodyId) -> Option<BodyDesc> {
        match self.pending.bodies.get(&id) {
            Some(pending) => pending.map(|(desc, _)| desc),
            None => self.client.replica()?.body(id),
        }
    }

    /// Bodies that moved in the last step, or came to rest, in the order of ids.
    pub(super) fn observations(&self) -> &[Observation] {
        &self.observations
    }

    /// The present observation of a body.
    pub(super) fn observation(&self, id: BodyId) -> Option<Observation> {
        if let Some(pending) = self.pending.bodies.get(&id) {
            return pending.map(|(_, observation)| observation);
        }
        let motion = state_of(self.client.replica()?, id)?;
        let activity = self.activity(id);
        Some(Observation {
            id,
            motion,
            activity,
        })
    }
}

/// A body that no scene has.
const NO_BODY: BodyId = BodyId::new(0, u16::MAX);

/// The state of a body in a copy of exact states.
fn state_of(copy: &Replica, id: BodyId) -> Option<BodyState> {
    match copy.stream().track(id)?.anchor {
        Anchor::Exact(state) => Some(state),
        Anchor::Quantised(_) => None,
    }
}

/// The answer to a command that the client did not queue.
fn not_queued(command: &Command, error: &ClientError) -> Result<(), CommandError> {
    match (error, command) {
        // The scene has ended, which the next tick reports.
        (
            ClientError::Ended(_)
            | ClientError::SceneDeleted
            | ClientError::SceneFaulted(_)
            | ClientError::Misuse(Misuse::NotNow),
            _,
        ) => Ok(()),
        (ClientError::Misuse(Misuse::NoInside), Command::AddBody { desc, .. }) => {
            Err(CommandError::NoInside(desc.shape))
        }
        _ => {
            tracing::error!(%error, ?command, "a command of an app client is none of a scene");
            Err(CommandError::UnknownCommand)
        }
    }
}

/// The hits of each query of these messages, of which each has a number and a count of queries. Those without an answer
/// have none, so that the hits of later ones stay theirs.
fn hits_in_order(messages: &[(u64, usize)], answers: Vec<QueryResult>) -> Vec<Vec<Hit>> {
    let mut by_number: BTreeMap<u64, QueryResult> = answers
        .into_iter()
        .map(|answer| (answer.number, answer))
        .collect();
    let hits = messages.iter().flat_map(|(number, count)| {
        let mut hits = by_number.remove(number).map(hits_of).unwrap_or_default();
        hits.resize(*count, Vec::new());
        hits
    });
    hits.collect()
}

/// The hits of each query of a message; none if the scene did not answer.
fn hits_of(result: QueryResult) -> Vec<Vec<Hit>> {
    let answers = result.answers.unwrap_or_else(|cause| {
        tracing::warn!(%cause, "contacts are missing");
        Vec::new()
    });
    let hits = answers.into_iter().map(|answer| match answer {
        Answer::Hits(hits) => hits,
        Answer::Bodies(_) => Vec::new(),
    });
    hits.collect()
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::message::QueryError;
    use rhumb_protocol::scene::{BodyBuilder, Shape};

    use super::*;

    /// The answer to a message, with as many hits for each query.
    fn answer(number: u64, hits: &[usize]) -> QueryResult {
        let one = |count: &usize| {
            let hit = Hit {
                body: BodyId::new(*count as u32, 0),
                distance: 0.0,
                point: Vec3::ZERO,
                normal: Vec3::Y,
            };
            Answer::Hits(vec![hit; *count])
        };
        QueryResult {
            number,
            tick: Tick::ZERO,
            answers: Ok(hits.iter().map(one).collect()),
        }
    }

    #[test]
    fn contacts_stay_those_of_their_bodies_when_an_answer_is_missing() {
        let messages = [(4, 2), (5, 3), (6, 1), (7, 2)];
        let counts = |answers| -> Vec<usize> {
            let hits = hits_in_order(&messages, answers);
            hits.iter().map(Vec::len).collect()
        };
        let all = [
            answer(4, &[1, 2]),
            answer(5, &[3, 0, 4]),
            answer(6, &[5]),
            answer(7, &[6, 7]),
        ];
        assert_eq!(counts(all.to_vec()), [1, 2, 3, 0, 4, 5, 6, 7]);
        let [first, second, third, last] = all;
        let gap = vec![first.clone(), third.clone(), last.clone()];
        assert_eq!(counts(gap), [1, 2, 0, 0, 0, 5, 6, 7]);
        let refused = QueryResult {
            answers: Err(QueryError::Overloaded),
            ..second
        };
        let late = vec![refused, third, first, answer(99, &[9])];
        assert_eq!(counts(late), [1, 2, 0, 0, 0, 5, 0, 0]);
        let short = vec![answer(5, &[8]), last];
        assert_eq!(counts(short), [0, 0, 8, 0, 0, 0, 6, 7]);
    }

    #[test]
    fn a_command_that_is_not_queued_is_refused_unless_the_scene_has_ended() {
        let id = BodyId::new(1, 0);
        let shape = ShapeId(7);
        let body = BodyBuilder::of(
            BodyDesc::plain(id, BodyKind::Dynamic, shape),
            Shape::ball(0.5),
        );
        let motion = body.state().expect("sound");
        let desc = body.desc(id, shape);
        let add = Command::AddBody { desc, motion };
        let said = |error| not_queued(&add, &error);
        assert_eq!(said(ClientError::SceneDeleted), Ok(()));
        assert_eq!(said(ClientError::Misuse(Misuse::NotNow)), Ok(()));
        assert_eq!(
            said(ClientError::Misuse(Misuse::NoInside)),
            Err(CommandError::NoInside(shape))
        );
        assert_eq!(
            said(ClientError::Misuse(Misuse::Indices(3))),
            Err(CommandError::UnknownCommand)
        );
    }
}
