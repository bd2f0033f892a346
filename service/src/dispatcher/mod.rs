//! The dispatcher: connections on one side, scene workers on the other.
//!
//! Reads a connection's first message, which names its scene, and carries everything else between the connection and
//! the worker of that scene. It steps no scene, so that no scene delays it. Invariants: it never waits for a worker; a
//! worker's transmission reaches only connections of that worker; what waits for a worker is bounded for each
//! connection.

mod accounts;
mod message;
mod placement;
#[cfg(target_os = "linux")]
mod process;
#[cfg(not(target_os = "linux"))]
#[path = "no_process.rs"]
mod process;
mod recorders;
mod settings;
mod watchdog;
mod worker;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::mpsc::Receiver;

use bytes::Bytes;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake, WakeReason};
use rhumb_scene::{CheckpointError, Greeted, Greeting, Heartbeat, Permit, SharedClock};

use self::accounts::{
    Account, OwnedScenes, Quarantined, counted, may_create, with_scenes_left,
    without_quota_of_scenes,
};
use self::message::{
    Duty, FromProcess, FromWorker, ProcessId, ToProcess, WorkerId, WorkerInput, WorkerOutput,
    WorkerReport,
};
use self::process::Processes;
use self::worker::{ThreadWorker, Threads};
use crate::access::{Admitted, TokenError};
use crate::directory::Keeper;
use crate::durable::{DataDir, DataError, LogTail};

pub use self::message::Checkpoints;
pub(crate) use self::message::Question;
pub(crate) use self::process::{ProcessOptions, run_worker};
pub use self::settings::DispatcherSettings;

/// Connections, and the workers of their scenes.
pub struct Dispatcher {
    connections: BTreeMap<Peer, Connection>,
    /// Connections that must say hello by then.
    greeting_until: BTreeSet<(Instant, Peer)>,
    /// Shows that the dispatcher makes progress.
    heartbeat: Heartbeat,
    expiry: Expiry,
    workers: BTreeMap<WorkerId, Worker>,
    by_scene: BTreeMap<SceneName, WorkerId>,
    next_worker: u32,
    out: VecDeque<Transmit>,
    threads: Threads,
    /// The worker processes, if scenes have them.
    processes: Option<Processes>,
    watchdog: Quarantined,
    /// Says which scenes are this server's, if there are others.
    directory: Option<Keeper>,
    owned: OwnedScenes,
    /// The workers that follow scenes of other servers.
    standbys: BTreeMap<SceneName, WorkerId>,
    /// Questions for checkpoints, if they may be asked.
    questions: Option<Receiver<Question>>,
    settings: DispatcherSettings,
}

struct Worker {
    scene: SceneName,
    /// The account that the scene counts for, if it is known.
    account: Option<Account>,
    place: Place,
    connections: usize,
    /// Inputs sent to it, and those that it has taken.
    sent: u64,
    taken: u64,
    has_scene: bool,
    /// The connections of clients that may create its scene.
    creators: BTreeSet<Peer>,
    duty: Duty,
}

impl Worker {
    /// Forgets for which client the scene counts, if there is none and no one is there who may create it.
    fn release_account(&mut self) {
        let is_of_client = matches!(self.account, Some(Account::Client(_)));
        if is_of_client && !self.has_scene && self.creators.is_empty() {
            self.account = None;
        }
    }
}

/// The thread or process in which a worker runs.
enum Place {
    Thread(ThreadWorker),
    Process(ProcessId),
}

enum Connection {
    /// It must say hello by then.
    Greeting(Box<Greeting>, Instant),
    /// It has named a scene, and the directory is asked where that is.
    Asking(Box<NamedScene>),
    /// Its control bytes that the worker has not handled.
    Bound(WorkerId, usize),
    /// Closed by the dispatcher: only its end is still awaited.
    Closed,
}

/// A connection that has named its scene, and may join it.
struct NamedScene {
    greeting: Greeting,
    scene: SceneName,
    admission: Admitted,
    /// All control bytes so far.
    received: Vec<u8>,
}

/// Control bytes of a connection that a worker may have unhandled; beyond them the driver holds them back.
const UNHANDLED_BYTES_MAX: usize = 128 << 10;
/// Inputs that a worker may have unhandled before datagrams and link reports to it are dropped.
const INPUTS_WAITING_MAX: u64 = 8_192;

impl Dispatcher {
    /// A dispatcher with a thread for each scene, by the clock of the settings. `wake` is called when one of them has output,
    /// and must have the driver drain the dispatcher.
    pub fn new(settings: DispatcherSettings, wake: impl Fn() + Send + Sync + 'static) -> Self {
        let mut settings = settings;
        settings.scenes.observers = Arc::new(settings.recorders.clone());
        let clock = SharedClock::clone(&settings.scenes.clock);
        let threads = Threads::new(SharedClock::clone(&clock), wake);
        let heartbeat = Heartbeat::new(move || clock());
        settings.recorders.metrics.set_dispatcher(
            heartbeat.clone(),
            settings.scenes.admission.load.clone(),
            &settings.scenes.limits,
        );
        settings.recorders.metrics.set_data(settings.data.clone());
        Self {
            connections: BTreeMap::new(),
            greeting_until: BTreeSet::new(),
            heartbeat,
            expiry: Expiry::default(),
            workers: BTreeMap::new(),
            by_scene: BTreeMap::new(),
            next_worker: 0,
            out: VecDeque::new(),
            threads,
            processes: settings.processes.take().map(Processes::new),
            watchdog: Quarantined::default(),
            directory: None,
            owned: OwnedScenes::default(),
            standbys: BTreeMap::new(),
            questions: None,
            settings,
        }
    }

    /// Gives an input to a worker.
    fn route(&mut self, id: WorkerId, input: WorkerInput) {
        let Some(worker) = self.workers.get_mut(&id) else {
            return;
        };
        worker.sent += 1;
        match &mut worker.place {
            Place::Thread(thread) => thread.send(input),
            Place::Process(process) => {
                if let Some(processes) = &mut self.processes {
                    processes.send(*process, &ToProcess::Input(id, input));
                }
            }
        }
    }

    /// The worker of a connection.
    fn bound(&self, peer: Peer) -> Option<WorkerId> {
        match self.connections.get(&peer)? {
            Connection::Bound(id, _) => Some(*id),
            Connection::Greeting(..) | Connection::Asking(_) | Connection::Closed => None,
        }
    }

    /// The worker of a connection, unless so much waits for it that what may be lost is dropped.
    fn bound_and_quick(&self, peer: Peer) -> Option<WorkerId> {
        let id = self.bound(peer)?;
        let worker = self.workers.get(&id)?;
        (worker.sent - worker.taken < INPUTS_WAITING_MAX).then_some(id)
    }

    fn greet(&mut self, now: Instant, peer: Peer, bytes: &[u8]) {
        let Some(Connection::Greeting(greeting, until)) = self.connections.get_mut(&peer) else {
            return;
        };
        let until = *until;
        let (scene, token, received) = match greeting.handle_control(bytes) {
            Greeted::NotYet => return,
            Greeted::Broken(code) => return self.close(peer, code),
            Greeted::Names(scene, token, received) => (scene, token, received),
        };
        self.greeting_until.remove(&(until, peer));
        let greeting = std::mem::take(&mut **greeting);
        let admission = match self.admit(peer, token.as_deref(), &scene) {
            Ok(admission) => admission,
            Err(cause) => {
                let code = cause.code();
                tracing::info!(peer = peer.0, %scene, %code, %cause, "a client is not admitted");
                return self.close(peer, code);
            }
        };
        let named = NamedScene {
            greeting,
            scene,
            admission,
            received: received.into(),
        };
        if let Some(place) = self.goes_to(&named.scene) {
            self.connections
                .insert(peer, Connection::Asking(Box::new(named)));
            return self.send_on(peer, &place);
        }
        if !self.must_ask(&named.scene) {
            return self.bind(now, peer, named);
        }
        self.ask_for(peer, named);
    }

    /// Gives a connection to the worker of its scene.
    fn bind(&mut self, now: Instant, peer: Peer, named: NamedScene) {
        let (scene, admission) = (named.scene, named.admission);
        let (paced, received) = (named.greeting.paced, Bytes::from(named.received));
        let account = Account::of(&scene, admission.permit.client.as_ref());
        let permit = self.permit_within(admission.permit, &scene, account.as_ref());
        let id = match self.worker_of(scene, account.as_ref()) {
            Ok(id) => id,
            Err(code) => return self.close(peer, code),
        };
        if let Some(worker) = self.workers.get_mut(&id) {
            worker.connections += 1;
            if may_create(&permit) {
                worker.creators.insert(peer);
                worker.account = worker.account.take().or(account);
            }
        }
        let bound = Connection::Bound(id, received.len());
        self.connections.insert(peer, bound);
        if let Some(valid_for) = admission.valid_for {
            self.expiry.set(peer, now + valid_for);
        }
        self.route(id, WorkerInput::Opened(peer, permit));
        if paced {
            self.route(id, WorkerInput::ControlTaken(peer, 0));
        }
        self.route(id, WorkerInput::Control(peer, received));
    }

    /// Decides what a connection may do in a scene. Gateways are in this process, and show no token.
    fn admit(
        &self,
        peer: Peer,
        token: Option<&[u8]>,
        scene: &SceneName,
    ) -> Result<Admitted, TokenError> {
        #[cfg(feature = "app")]
        if rhumb_client::is_local_peer(peer) {
            return Ok(Admitted::gateway());
        }
        let _ = peer;
        self.settings.authenticator.admit(token, scene)
    }

    /// The permit of a connection that names a scene, with the scenes that its account may still have.
    fn permit_within(
        &self,
        permit: Arc<Permit>,
        scene: &SceneName,
        account: Option<&Account>,
    ) -> Arc<Permit> {
        let Some(account) = account else {
            return permit;
        };
        let there = self.by_scene.get(scene).and_then(|id| self.workers.get(id));
        if there.is_some_and(|worker| worker.has_scene) {
            // It has its place: whether there is one for another scene does not matter.
            return without_quota_of_scenes(permit);
        }
        let of_account = |worker: &&Worker| {
            // A client that only watches takes no place.
            let may_restore = self.settings.data.is_some() && worker.taken == 0;
            let counts = worker.has_scene || !worker.creators.is_empty() || may_restore;
            counts && worker.account.as_ref() == Some(account) && worker.scene != *scene
        };
        let others = self.workers.values().filter(of_account).count();
        let permit = with_scenes_left(permit, others, &self.settings.scenes.limits);
        if permit.quotas.scenes == Some(0) {
            tracing::info!(%scene, ?account, others, "an account has as many scenes as it may");
            self.settings.recorders.metrics.count_full_account();
        }
        permit
    }

    /// Closes a connection of the dispatcher.
    fn close(&mut self, peer: Peer, code: CloseCode) {
        if let Some(Connection::Greeting(_, until)) =
            self.connections.insert(peer, Connection::Closed)
        {
            self.greeting_until.remove(&(until, peer));
        }
        tracing::debug!(peer = peer.0, %code, "closing a connection");
        let code = code.0;
        self.settings.recorders.metrics.count_closed(code);
        self.out.push_back(Transmit::Close { to: peer, code });
    }

    /// Closes a connection of a worker, which learns of it.
    fn expire(&mut self, peer: Peer) {
        let code = CloseCode::TOKEN_EXPIRED;
        self.end_binding(peer, Ending::Closed(code.0));
        self.close(peer, code);
    }

    /// Tells the worker of a connection that it has ended.
    fn end_binding(&mut self, peer: Peer, ending: Ending) {
        self.expiry.forget(peer);
        if let Some(id) = self.bound(peer) {
            self.route(id, WorkerInput::Ended(peer, ending));
            if let Some(worker) = self.workers.get_mut(&id) {
                worker.connections -= 1;
                worker.creators.remove(&peer);
                worker.release_account();
            }
        }
    }

    /// Takes the outputs of all workers.
    fn collect(&mut self) {
        while let Ok(report) = self.threads.received.try_recv() {
            match report {
                WorkerReport::Worker(id, message) => self.take_message(id, message),
                WorkerReport::Process(id, message) => self.take_process_message(id, message),
                WorkerReport::ProcessOver(id, status) => self.note_process_over(id, &status),
            }
        }
        self.take_questions();
        if let Some(processes) = &mut self.processes {
            processes.flush();
        }
    }

    fn take_message(&mut self, id: WorkerId, message: FromWorker) {
        match message {
            FromWorker::Output(output) => self.absorb(id, output),
            FromWorker::Over => self.note_over(id),
        }
    }

    fn absorb(&mut self, id: WorkerId, output: WorkerOutput) {
        // A quarantined worker's late output concerns no connection.
        let Some(worker) = self.workers.get_mut(&id) else {
            return;
        };
        worker.taken = output.inputs;
        worker.has_scene = output.has_scene;
        worker.release_account();
        for transmit in output.transmits {
            let (Transmit::Control { to, .. }
            | Transmit::State { to, .. }
            | Transmit::Close { to, .. }) = &transmit;
            if self.bound(*to) == Some(id) {
                if let Transmit::Close { code, .. } = &transmit {
                    self.settings.recorders.metrics.count_closed(*code);
                }
                self.out.push_back(transmit);
            }
        }
        for (peer, bytes) in output.handled {
            if let Some(Connection::Bound(_, unhandled)) = self.connections.get_mut(&peer) {
                *unhandled = unhandled.saturating_sub(bytes);
            }
        }
        self.note_handover(id, (output.inputs, output.is_ready));
        self.retire_if_idle(id);
    }

    /// Ends a worker that has neither a connection nor a scene.
    fn retire_if_idle(&mut self, id: WorkerId) {
        let is_idle = |worker: &Worker| {
            let serves = matches!(worker.duty, Duty::Serve);
            serves && worker.connections == 0 && !worker.has_scene && worker.sent == worker.taken
        };
        if let Some(worker) = self.workers.get(&id).filter(|worker| is_idle(worker)) {
            let scene = worker.scene.clone();
            self.release(&scene);
            self.drop_worker(id);
        }
    }

    /// Forgets a worker; its thread ends as soon as it can.
    fn drop_worker(&mut self, id: WorkerId) {
        if let Some(worker) = self.workers.remove(&id) {
            match worker.duty {
                Duty::StandBy => self.standbys.remove(&worker.scene),
                Duty::Serve | Duty::Leave(..) => self.by_scene.remove(&worker.scene),
            };
            if let (Place::Process(process), Some(processes)) = (worker.place, &mut self.processes)
            {
                processes.send(process, &ToProcess::Input(id, WorkerInput::End));
            }
        }
    }

    /// Closes all connections of a worker.
    fn close_connections_of(&mut self, id: WorkerId, code: CloseCode) {
        let bound = self.connections.iter();
        let bound = bound
            .filter(|(_, connection)| matches!(connection, Connection::Bound(of, _) if *of == id));
        let peers: Vec<Peer> = bound.map(|(peer, _)| *peer).collect();
        for peer in peers {
            self.close(peer, code);
        }
    }
}

impl Endpoint for Dispatcher {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        let until = now + self.settings.scenes.limits.hello();
        self.greeting_until.insert((until, peer));
        let greeting = Connection::Greeting(Box::default(), until);
        self.connections.insert(peer, greeting);
        self.settings.recorders.metrics.count_opened();
        (self.settings.recorders.metrics).set_connections(self.connections.len());
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.heartbeat.beat();
        match self.connections.get_mut(&from) {
            Some(Connection::Greeting(..)) => self.greet(now, from, bytes),
            Some(Connection::Bound(id, unhandled)) => {
                *unhandled += bytes.len();
                let (id, bytes) = (*id, Bytes::copy_from_slice(bytes));
                self.route(id, WorkerInput::Control(from, bytes));
            }
            Some(Connection::Asking(named)) => named.received.extend_from_slice(bytes),
            Some(Connection::Closed) | None => {}
        }
    }

    fn handle_control_taken(&mut self, _: Instant, peer: Peer, bytes: usize) {
        match self.connections.get_mut(&peer) {
            Some(Connection::Greeting(greeting, _)) => greeting.paced = true,
            Some(Connection::Asking(named)) => named.greeting.paced = true,
            Some(Connection::Bound(id, _)) => {
                let id = *id;
                self.route(id, WorkerInput::ControlTaken(peer, bytes));
            }
            Some(Connection::Closed) | None => {}
        }
    }

    fn wants_control(&self, from: Peer) -> bool {
        match self.connections.get(&from) {
            Some(Connection::Bound(_, unhandled)) => *unhandled < UNHANDLED_BYTES_MAX,
            Some(Connection::Asking(named)) => named.received.len() < UNHANDLED_BYTES_MAX,
            _ => true,
        }
    }

    fn handle_datagram(&mut self, _: Instant, from: Peer, bytes: &[u8]) {
        if let Some(id) = self.bound_and_quick(from) {
            let bytes = Bytes::copy_from_slice(bytes);
            self.route(id, WorkerInput::Datagram(from, bytes));
        }
    }

    fn handle_link(&mut self, _: Instant, peer: Peer, report: &LinkReport) {
        if let Some(id) = self.bound_and_quick(peer) {
            self.route(id, WorkerInput::Link(peer, *report));
        }
    }

    fn handle_ended(&mut self, _: Instant, peer: Peer, ending: Ending) {
        self.end_binding(peer, ending);
        if let Some(Connection::Greeting(_, until)) = self.connections.remove(&peer) {
            self.greeting_until.remove(&(until, peer));
        }
        (self.settings.recorders.metrics).set_connections(self.connections.len());
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.heartbeat.beat();
        while let Some((until, peer)) = self.greeting_until.first().copied()
            && until <= now
        {
            self.close(peer, CloseCode::HELLO_LATE);
        }
        while let Some(peer) = self.expiry.pop(now) {
            self.expire(peer);
        }
        self.watch(now);
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        let until = self.take_places();
        if self.out.is_empty() {
            self.collect();
        }
        self.keep_fence(until);
        self.out.pop_front()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        // The driver waits next.
        self.heartbeat.rest();
        let deadline = |at| Wake {
            at,
            reason: WakeReason::Deadline,
        };
        let greeting = self
            .greeting_until
            .first()
            .map(|(until, _)| deadline(*until));
        let expiry = self.expiry.next().map(deadline);
        let watch = self.next_watch().map(deadline);
        let wakes = [greeting, expiry, watch].into_iter().flatten();
        wakes.min_by_key(|wake| wake.at)
    }
}

impl Dispatcher {
    /// The worker of a scene, started if there is none.
    fn worker_of(
        &mut self,
        scene: SceneName,
        account: Option<&Account>,
    ) -> Result<WorkerId, CloseCode> {
        if let Some(id) = self.by_scene.get(&scene).copied() {
            if self.watchdog.is_quarantined(id) {
                return Err(CloseCode::SCENE_QUARANTINED);
            }
            return Ok(id);
        }
        let limits = &self.settings.scenes.limits;
        let part = limits.tenant_quarantined_scenes;
        let quarantined = || self.watchdog.accounts();
        let own = quarantined().filter(|of| account.is_some() && of.as_ref() == account);
        if own.count() as u64 >= part || counted(quarantined(), part) >= limits.quarantined_scenes {
            return Err(CloseCode::BUSY);
        }
        // A scene without a tenant has no account before a client names it that may create it.
        let account = Account::of(&scene, None);
        self.start_worker((scene, account), LogTail::Kept)
    }

    /// Starts a worker, which restores its scene if a data directory has it.
    fn start_worker(
        &mut self,
        (scene, account): (SceneName, Option<Account>),
        tail: LogTail,
    ) -> Result<WorkerId, CloseCode> {
        let generation = self.generation_of(&scene)?;
        let id = self.place_worker((scene, account), Duty::Serve)?;
        if self.settings.data.is_some() {
            self.route(id, WorkerInput::Restore(tail, generation));
        }
        Ok(id)
    }

    /// Starts a worker on a thread or in a process.
    fn place_worker(
        &mut self,
        (scene, account): (SceneName, Option<Account>),
        duty: Duty,
    ) -> Result<WorkerId, CloseCode> {
        let id = WorkerId(self.next_worker);
        let threads = &self.threads;
        let place = match &mut self.processes {
            Some(processes) => {
                Place::Process(processes.begin(id, &scene, threads, &self.settings)?)
            }
            None => {
                let scenes = (&self.settings.scenes, self.settings.data.as_ref());
                let started = ThreadWorker::start((id, scene.clone()), scenes, &threads.workers);
                Place::Thread(started.map_err(|cause| {
                    tracing::error!(%cause, "no thread for a scene");
                    CloseCode::BUSY
                })?)
            }
        };
        self.add_worker(id, (scene, account), (place, duty));
        Ok(id)
    }

    fn add_worker(
        &mut self,
        id: WorkerId,
        (scene, account): (SceneName, Option<Account>),
        (place, duty): (Place, Duty),
    ) {
        self.next_worker += 1;
        match duty {
            Duty::StandBy => self.standbys.insert(scene.clone(), id),
            Duty::Serve | Duty::Leave(..) => self.by_scene.insert(scene.clone(), id),
        };
        let worker = Worker {
            scene,
            account,
            place,
            connections: 0,
            sent: 0,
            taken: 0,
            has_scene: false,
            creators: BTreeSet::new(),
            duty,
        };
        self.workers.insert(id, worker);
    }
}

impl Dispatcher {
    /// Begins to restore the scenes that the data directory has.
    ///
    /// # Errors
    ///
    /// [`DataError`] if the directory cannot be read.
    ///
    /// With a directory of scenes none begins: each comes when a client names it at the first of the servers.
    pub(crate) fn restore(&mut self) -> Result<(), DataError> {
        if self.directory.is_some() {
            return Ok(());
        }
        let scenes = self
            .settings
            .data
            .as_ref()
            .map(DataDir::scenes)
            .transpose()?;
        for (name, _) in scenes.into_iter().flatten() {
            let account = Account::of(&name, None);
            if let Err(code) = self.worker_of(name.clone(), account.as_ref()) {
                tracing::error!(scene = %name, %code, "cannot restore a scene");
            }
        }
        Ok(())
    }
}

impl Dispatcher {
    fn take_process_message(&mut self, id: ProcessId, message: FromProcess) {
        let Some(processes) = &mut self.processes else {
            return;
        };
        let Some((worker, message)) = processes.take(id, message, &self.settings) else {
            return;
        };
        if message == FromWorker::Over {
            processes.note_worker_over(id, &self.settings);
        }
        // A broken process's words about another one's workers do not count.
        let is_its = |place: &Place| matches!(place, Place::Process(of) if *of == id);
        if (self.workers.get(&worker)).is_some_and(|worker| is_its(&worker.place)) {
            self.take_message(worker, message);
        }
    }

    fn note_process_over(&mut self, id: ProcessId, status: &str) {
        let now = (self.settings.scenes.clock)();
        let Some(processes) = &mut self.processes else {
            return;
        };
        let Some(death) = processes.note_over(now, (id, status), &self.settings) else {
            return;
        };
        let code = match self.settings.data {
            Some(_) => CloseCode::SCENE_RESTORING,
            None => CloseCode::SCENE_LOST,
        };
        let workers = self.workers.iter();
        let died: Vec<_> = workers
            .filter(|(_, worker)| matches!(worker.place, Place::Process(of) if of == id))
            .map(|(id, worker)| (*id, (worker.scene.clone(), worker.account.clone())))
            .collect();
        // A scene that was only followed is not this server's to restore.
        let is_followed = |id: &WorkerId| self.standbys.values().any(|standby| standby == id);
        let (followed, died): (Vec<_>, Vec<_>) =
            died.into_iter().partition(|(id, _)| is_followed(id));
        for (worker, _) in followed {
            self.drop_worker(worker);
        }
        for (worker, _) in &died {
            self.close_connections_of(*worker, code);
            self.drop_worker(*worker);
        }
        if self.settings.data.is_none() {
            return;
        }
        for (worker, scene) in died {
            let tail = match death.stuck == Some(worker) {
                true => LogTail::LeftOut,
                false => LogTail::Kept,
            };
            let name = scene.0.clone();
            if let Err(code) = self.start_worker(scene, tail) {
                tracing::error!(scene = %name, %code, "the scene stays in the data directory");
                self.release(&name);
            }
        }
    }
}

impl Dispatcher {
    /// Answers the questions that come from now on.
    pub(crate) fn answer_checkpoints(&mut self, questions: Receiver<Question>) {
        self.questions = Some(questions);
    }

    /// Hands the questions to the workers.
    fn take_questions(&mut self) {
        let asked = self.questions.iter().flat_map(Receiver::try_iter);
        for question in asked.collect::<Vec<_>>() {
            if let Err((question, error)) = self.pass_on(question) {
                question.refuse(error);
            }
        }
    }

    fn pass_on(&mut self, question: Question) -> Result<(), (Question, CheckpointError)> {
        let name = question.scene().clone();
        let found = match (&question, self.by_scene.get(&name)) {
            _ if self.processes.is_some() => Err(CheckpointError::NoServer),
            (Question::Restore(..), _) if self.settings.data.is_some() => {
                let reason = "its data directory would not have the scene";
                Err(CheckpointError::NotAdmitted(reason.to_owned()))
            }
            (_, Some(id)) => Ok(*id),
            (Question::Save(..), None) => Err(CheckpointError::NoSuchScene(name)),
            (Question::Restore(..), None) => self
                .worker_of(name, None)
                .map_err(|code| CheckpointError::NotAdmitted(code.to_string())),
        };
        let id = match found {
            Ok(id) if self.watchdog.is_quarantined(id) => {
                return Err((question, CheckpointError::Faulted));
            }
            Ok(id) => id,
            Err(error) => return Err((question, error)),
        };
        let Some(worker) = self.workers.get_mut(&id) else {
            return Err((question, CheckpointError::NoServer));
        };
        let Place::Thread(thread) = &worker.place else {
            return Err((question, CheckpointError::NoServer));
        };
        worker.sent += 1;
        thread.ask(question);
        Ok(())
    }
}

/// The connections whose permits end, in order of their ends.
#[derive(Debug, Default)]
struct Expiry {
    by_time: BTreeSet<(Instant, Peer)>,
    ends: BTreeMap<Peer, Instant>,
}

impl Expiry {
    fn set(&mut self, peer: Peer, at: Instant) {
        self.ends.insert(peer, at);
        self.by_time.insert((at, peer));
    }

    fn forget(&mut self, peer: Peer) {
        if let Some(at) = self.ends.remove(&peer) {
            self.by_time.remove(&(at, peer));
        }
    }

    /// When the next permit ends.
    fn next(&self) -> Option<Instant> {
        self.by_time.first().map(|(at, _)| *at)
    }

    /// Takes a connection whose permit has ended.
    fn pop(&mut self, now: Instant) -> Option<Peer> {
        let (_, peer) = *self.by_time.first().filter(|(at, _)| *at <= now)?;
        self.forget(peer);
        Some(peer)
    }
}

#[cfg(test)]
pub(super) mod tests;
