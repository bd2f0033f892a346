//! The scene of one APP client, which the gateway joins as any client does.
//!
//! Commands leave together with the next tick. Until its answer comes, the copy shows what they change as if they were
//! applied; the answer names those that the server refused. The copy has the exact states of all bodies. Which of them
//! are awake is known from events, and contacts are queried after each tick.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use glam::Vec3;
use rhumb_client::{
    Client, ClientError, JoinMode, JoinOptions, OpenError, PipelineDepth, QueryResult, Refusals,
    Replica, ServerConnection, StreamChoice,
};
use rhumb_protocol::limits::{HITS_MAX, QUERY_COST_MAX};
use rhumb_protocol::scene::{
    ActiveEvents, Answer, BodyDesc, BodyEvent, BodyKind, Command, CommandError, Hit, JointId,
    Query, SceneConfig, SceneName, Shape, ShapeId,
};
use rhumb_protocol::session::{Event, Misuse};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{Anchor, BodyId, BodyState};

/// A scene that exists for one APP client.
pub(super) struct OwnScene {
    client: Client,
    /// What the copy does not show before the next tick.
    pending: Pending,
    /// Commands without an answer, by their numbers.
    sent: BTreeMap<u64, Sent>,
    /// The actor that the next commands are about, and the index of the last message about it.
    pub(super) about: Option<(u32, u32)>,
    refused: Vec<(Sent, CommandError)>,
    /// Bodies of this client that the engine steps.
    awake: BTreeSet<BodyId>,
    observations: Vec<Observation>,
    contacts: BTreeMap<BodyId, Vec<Hit>>,
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

/// What a command adds or changes.
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
            stream: StreamChoice::Full,
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
            awake: BTreeSet::new(),
            observations: Vec::new(),
            contacts: BTreeMap::new(),
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

    /// An id that no body has: one without a body so far while there is one.
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
        self.awake.remove(&id);
        self.spare.push(id);
    }

    /// Queues a command.
    ///
    /// # Errors
    ///
    /// [`CommandError`] for a command that the server would refuse because of its numbers.
    pub(super) fn command(&mut self, command: &Command) -> Result<(), CommandError> {
        let number = match self.client.command(command.clone()) {
            Ok(number) => number,
            Err(ClientError::Misuse(Misuse::Invalid(invalid))) => {
                return Err(CommandError::Invalid(invalid));
            }
            Err(ClientError::Misuse(Misuse::JoinedToItself(id))) => {
                return Err(CommandError::JoinedToItself(id));
            }
            // The scene has ended, which the next tick reports.
            Err(_) => return Ok(()),
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

    /// Has the copy show a command.
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
                    self.awake.insert(id);
                }
            }
            Command::RemoveBody { id } => {
                self.pending.bodies.insert(id, None);
                self.awake.remove(&id);
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

    /// Steps once. `contacts`: whether those of the observed bodies are wanted.
    ///
    /// # Errors
    ///
    /// [`ClientError`] if the scene has ended or its engine has failed.
    pub(super) fn tick(&mut self, contacts: bool) -> Result<(), ClientError> {
        let moved = std::mem::take(&mut self.pending.moved);
        self.client.request_tick()?;
        self.contacts.clear();
        let mut asked: Vec<BodyId> = Vec::new();
        if contacts {
            asked.extend(self.awake.iter().chain(&moved));
        }
        // The answer comes after the events of the step: without contacts, a question shows that these are here.
        let results = self.ask(if contacts && !asked.is_empty() {
            &asked
        } else {
            &[NO_BODY]
        })?;
        self.client.wait(PipelineDepth::LOCKSTEP)?;
        let (fell_asleep, woke) = self.read_events();
        self.pending = Pending::default();
        self.note_contacts(&asked, results);
        if contacts && !woke.is_empty() {
            let results = self.ask(&woke)?;
            self.note_contacts(&woke, results);
        }
        self.observe(&fell_asleep, &moved);
        Ok(())
    }

    /// Asks for the contacts of bodies, and waits for the answers.
    fn ask(&mut self, bodies: &[BodyId]) -> Result<Vec<Vec<Hit>>, ClientError> {
        let mut messages = bodies.chunks(QUERIES_MAX).peekable();
        let mut first = Vec::new();
        let mut results = Vec::new();
        while let Some(message) = messages.next() {
            let queries = message.iter().copied().map(Query::contacts).collect();
            if messages.peek().is_some() {
                first.push(self.client.query(queries)?);
                continue;
            }
            let last = self.client.ask(queries)?;
            // The answers come in order: those to the messages before are here.
            while let Some((_, event)) = self.client.poll_event() {
                match event {
                    Event::QueryResult(result) if first.contains(&result.number) => {
                        results.extend(hits_of(result));
                    }
                    other => self.unread.push(other),
                }
            }
            results.extend(hits_of(last));
        }
        Ok(results)
    }

    fn note_contacts(&mut self, asked: &[BodyId], results: Vec<Vec<Hit>>) {
        let answered = asked.iter().copied().zip(results);
        self.contacts
            .extend(answered.filter(|(_, hits)| !hits.is_empty()));
    }

    /// Reads the events of a tick; returns the bodies that fell asleep and those that woke.
    fn read_events(&mut self) -> (Vec<BodyId>, Vec<BodyId>) {
        let (mut fell_asleep, mut woke) = (Vec::new(), Vec::new());
        let mut events = std::mem::take(&mut self.unread);
        events.extend(std::iter::from_fn(|| self.client.poll_event()).map(|(_, event)| event));
        let mut missed = false;
        for event in events {
            match event {
                Event::Refused { number, error } => {
                    let sent = self.sent.remove(&number);
                    self.refused.extend(sent.map(|sent| (sent, error)));
                }
                Event::Body { event, .. } => match event {
                    BodyEvent::FellAsleep(id) if self.awake.remove(&id) => fell_asleep.push(id),
                    BodyEvent::Woke(id) if self.awake.insert(id) => woke.push(id),
                    _ => {}
                },
                Event::BodyRemoved { id, .. } => {
                    self.awake.remove(&id);
                }
                Event::EventsMissed { .. } | Event::SceneRestored(_) => missed = true,
                _ => {}
            }
        }
        self.sent.clear();
        if missed {
            woke.extend(self.find_awake());
        }
        (fell_asleep, woke)
    }

    /// Finds the bodies that are awake by their velocities, where events are missing; returns those that have woken.
    fn find_awake(&mut self) -> Vec<BodyId> {
        let Some(copy) = self.client.replica() else {
            return Vec::new();
        };
        let moves = |id: BodyId| {
            let parts = state_of(copy, id).map(|state| state.parts());
            parts.is_some_and(|parts| parts[7..].iter().any(|part| *part != 0.0))
        };
        let dynamic = copy.bodies().filter(|desc| desc.kind == BodyKind::Dynamic);
        let awake: BTreeSet<BodyId> = dynamic
            .map(|desc| desc.id)
            .filter(|id| moves(*id))
            .collect();
        let woken = awake.difference(&self.awake).copied().collect();
        self.awake = awake;
        woken
    }

    /// Observes the bodies that are awake, have just fallen asleep, or are fixed and were put elsewhere.
    fn observe(&mut self, fell_asleep: &[BodyId], moved: &BTreeSet<BodyId>) {
        self.observations.clear();
        let Some(copy) = self.client.replica() else {
            return;
        };
        let mut ids = self.awake.clone();
        ids.extend(fell_asleep.iter().chain(moved));
        let observed = ids.into_iter().filter_map(|id| {
            let activity = match self.awake.contains(&id) {
                true => Activity::Awake,
                false => Activity::Asleep,
            };
            let motion = state_of(copy, id)?;
            Some(Observation {
                id,
                motion,
                activity,
            })
        });
        self.observations.extend(observed);
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
        let activity = match self.awake.contains(&id) {
            true => Activity::Awake,
            false => Activity::Asleep,
        };
        Some(Observation {
            id,
            motion,
            activity,
        })
    }

    /// The deepest contact with each body that touches an observed one after the last step.
    pub(super) fn contacts(&self, id: BodyId) -> &[Hit] {
        self.contacts.get(&id).map_or(&[], Vec::as_slice)
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

/// The hits of each query; none if the scene did not answer.
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
