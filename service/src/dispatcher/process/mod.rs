//! Worker processes: one for the scenes of a tenant.
//!
//! A process can be killed, and what it breaks is its own memory. The dispatcher keeps the connections, looks after the
//! processes, and starts another one in the place of one that died. Invariant: a process that may still write a scene's
//! files is waited for before another one serves that scene.

mod child;
mod codec;

use std::collections::{BTreeMap, VecDeque};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::{fmt, io, thread};

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Span};
use rhumb_scene::tenant_of;
use rhumb_transport::{ChildSender, FrameReceiver, child_stream};
use rustix::process::{
    Pid, PidfdFlags, Resource, Rlimit, Signal, getppid, pidfd_open, pidfd_send_signal,
    set_parent_process_death_signal, setrlimit,
};

use self::codec::{WorkerSetup, decode_from, encode_to};
use super::message::{
    FromProcess, FromWorker, ProcessId, ToProcess, Vitals, WorkerId, WorkerReport,
};
use super::settings::DispatcherSettings;
use crate::dispatcher::worker::{ReportSender, Threads};
use crate::durable::DataDir;
use crate::flight::{FlightCause, FlightRecorder};
use crate::metrics::{SceneMeter, SceneValues};

pub(crate) use self::child::run as run_worker;
pub(crate) use self::codec::ProcessOptions;

/// The worker processes of a dispatcher.
pub(super) struct Processes {
    options: ProcessOptions,
    running: BTreeMap<ProcessId, RunningProcess>,
    by_tenant: BTreeMap<Tenant, ProcessId>,
    deaths: Deaths,
    next: u32,
}

/// The end of a process that the dispatcher did not ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Death {
    /// The worker that did not answer, if it was killed for that.
    pub(super) stuck: Option<WorkerId>,
}

impl Processes {
    pub(super) fn new(options: ProcessOptions) -> Self {
        Self {
            options,
            running: BTreeMap::new(),
            by_tenant: BTreeMap::new(),
            deaths: Deaths::default(),
            next: 0,
        }
    }

    /// Begins a worker for a scene, in the process of its tenant, which is started if there is none.
    ///
    /// # Errors
    ///
    /// The code for a client that named the scene.
    pub(super) fn begin(
        &mut self,
        worker: WorkerId,
        scene: &SceneName,
        threads: &Threads,
        settings: &DispatcherSettings,
    ) -> Result<ProcessId, CloseCode> {
        let tenant = Tenant::of(scene, self.options.share);
        let id = match self.by_tenant.get(&tenant) {
            Some(id) => *id,
            None => self.start(tenant, threads, settings)?,
        };
        let process = self.running.get_mut(&id).ok_or(CloseCode::BUSY)?;
        if process.state != ProcessState::Serving {
            // It is killed, but its end is not known yet.
            return Err(CloseCode::SCENE_RESTORING);
        }
        process.workers += 1;
        process.newest = worker;
        // All processes learn of the scene before any of them may create another one.
        self.share_out(settings);
        let process = self.running.get_mut(&id).ok_or(CloseCode::BUSY)?;
        process.send(&ToProcess::Begin(worker, scene.clone()));
        Ok(id)
    }

    fn start(
        &mut self,
        tenant: Tenant,
        threads: &Threads,
        settings: &DispatcherSettings,
    ) -> Result<ProcessId, CloseCode> {
        let now = (threads.workers.clock)();
        let limits = &settings.scenes.limits;
        if self.deaths.count(now, &tenant) > limits.worker_restarts {
            return Err(CloseCode::SCENE_QUARANTINED);
        }
        let setup = WorkerSetup {
            dispatcher: std::process::id(),
            now_ns: now.as_nanos(),
            limits: *limits,
            largest_packet: settings.scenes.largest_packet.bytes() as u32,
            cells: settings.scenes.cells.map(|grid| grid.edges()),
            engine: settings.engine,
            threads: self.options.threads,
            data: (settings.data.as_ref()).map(|data| data.path().to_owned()),
            log: self.options.log.to_string(),
            records_flights: settings.recorders.flights.is_on(),
            record: self.options.record.clone(),
        };
        let id = ProcessId(self.next);
        self.next += 1;
        let reports = threads.reports.clone();
        let setup = (&setup, settings.data.as_ref());
        match RunningProcess::start(id, tenant.clone(), setup, reports) {
            Ok(process) => {
                self.running.insert(id, process);
                self.by_tenant.insert(tenant, id);
                settings.recorders.metrics.set_workers(self.running.len());
                self.share_out(settings);
                Ok(id)
            }
            Err(cause) => {
                tracing::error!(%tenant, %cause, "no worker process for a tenant");
                Err(CloseCode::BUSY)
            }
        }
    }

    pub(super) fn send(&mut self, id: ProcessId, message: &ToProcess) {
        if let Some(process) = self.running.get_mut(&id) {
            process.send(message);
        }
    }

    /// Sends what the streams did not take before.
    pub(super) fn flush(&mut self) {
        self.running.values_mut().for_each(RunningProcess::flush);
    }

    /// A worker of a process has ended; a process without workers ends too. Its files are closed by then.
    pub(super) fn note_worker_over(&mut self, id: ProcessId, settings: &DispatcherSettings) {
        let Some(process) = self.running.get_mut(&id) else {
            return;
        };
        process.workers = process.workers.saturating_sub(1);
        if process.workers == 0 && process.state == ProcessState::Serving {
            process.end();
            self.by_tenant.remove(&process.tenant);
        }
        self.share_out(settings);
    }

    /// Takes a message of a process; returns that of a worker of it.
    pub(super) fn take(
        &mut self,
        id: ProcessId,
        message: FromProcess,
        settings: &DispatcherSettings,
    ) -> Option<(WorkerId, FromWorker)> {
        let process = self.running.get_mut(&id)?;
        match message {
            FromProcess::Worker(worker, message) => return Some((worker, message)),
            FromProcess::Alive(vitals) => self.note_alive(id, vitals, settings),
            FromProcess::Metrics(metrics) => process.show(&metrics, settings),
            FromProcess::Flight(scene, entries) => {
                process.flight(&scene, settings).append(&entries);
            }
            FromProcess::WriteFlight(scene, cause) => process.flight(&scene, settings).write(cause),
        }
        None
    }

    fn note_alive(&mut self, id: ProcessId, vitals: Vitals, settings: &DispatcherSettings) {
        let Some(process) = self.running.get_mut(&id) else {
            return;
        };
        process.silent_looks = 0;
        if let Some((worker, busy)) = vitals.busiest
            && busy > settings.scenes.limits.stuck()
        {
            tracing::error!(tenant = %process.tenant, worker = worker.0, "a scene does not answer, and its worker process is killed");
            process.kill(Some(worker));
        }
        let changed = (process.scenes, process.load) != (vitals.scenes, vitals.load);
        (process.scenes, process.load) = (vitals.scenes, vitals.load);
        if changed {
            self.share_out(settings);
        }
    }

    /// Gives each process, and the dispatcher, the numbers of the rest of the server.
    ///
    /// A worker has a place from its begin on, as it may create its scene before it reports it: places go by the order of
    /// begins, so that many that begin at once neither exceed the limit nor keep one another from the last place.
    fn share_out(&mut self, settings: &DispatcherSettings) {
        let admission = &settings.scenes.admission;
        let taken: Vec<_> = (self.running.iter())
            .map(|(id, process)| (*id, process.newest, process.places(), process.scenes))
            .collect();
        let loads = self.running.values().map(|process| process.load);
        let load = loads.fold(0, u64::saturating_add);
        let places: u64 = taken.iter().map(|(.., places, _)| *places).sum();
        let places = usize::try_from(places).unwrap_or(usize::MAX);
        admission.slots.set_elsewhere(places);
        admission.load.set_elsewhere(load);
        let here = (admission.slots.here() as u64, admission.load.here());
        for (id, process) in &mut self.running {
            let others = taken.iter().filter(|(other, ..)| other != id);
            let taken = others.map(|(_, newest, places, scenes)| {
                if *newest < process.newest {
                    *places
                } else {
                    *scenes
                }
            });
            let elsewhere = (
                taken.fold(here.0, u64::saturating_add),
                load.saturating_add(here.1) - process.load,
            );
            if elsewhere != process.elsewhere {
                process.elsewhere = elsewhere;
                let (scenes, load) = elsewhere;
                process.send(&ToProcess::Elsewhere { scenes, load });
            }
        }
    }

    /// Looks after the processes: one that gave no sign of life in so many looks, or that does not end, is killed.
    pub(super) fn look(&mut self, looks_max: u32) {
        for (id, process) in &mut self.running {
            process.flush();
            process.silent_looks += 1;
            if process.silent_looks > looks_max && !matches!(process.state, ProcessState::Killed(_))
            {
                tracing::error!(tenant = %process.tenant, worker = id.0, "a worker process does not answer, and is killed");
                process.kill(None);
            }
        }
    }

    /// A process has ended; returns its death if the dispatcher did not ask for its end.
    pub(super) fn note_over(
        &mut self,
        now: Instant,
        (id, status): (ProcessId, &str),
        settings: &DispatcherSettings,
    ) -> Option<Death> {
        let process = self.running.remove(&id)?;
        settings.recorders.metrics.set_workers(self.running.len());
        self.share_out(settings);
        if process.state == ProcessState::Ending {
            return None;
        }
        if self.by_tenant.get(&process.tenant) == Some(&id) {
            self.by_tenant.remove(&process.tenant);
        }
        self.deaths.note(now, process.tenant.clone());
        settings.recorders.metrics.count_worker_death();
        let tenant = &process.tenant;
        tracing::error!(%tenant, worker = id.0, status, "a worker process has died");
        let (cause, stuck) = match process.state {
            ProcessState::Killed(stuck) => (FlightCause::Killed, stuck),
            ProcessState::Serving | ProcessState::Ending => (FlightCause::ProcessEnded, None),
        };
        process
            .flights
            .values()
            .for_each(|flight| flight.write(cause));
        Some(Death { stuck })
    }

    /// Asks all processes to end; returns their number.
    pub(super) fn end_all(&mut self) -> usize {
        self.running.values_mut().for_each(RunningProcess::end);
        self.running.len()
    }

    /// Ends all processes at once.
    pub(super) fn kill_all(&mut self) {
        (self.running.values_mut()).for_each(|process| process.kill(None));
    }

    pub(super) fn is_empty(&self) -> bool {
        self.running.is_empty()
    }
}

/// This program, also after its file was replaced: both ends of a stream must be of one build.
const PROGRAM: &str = "/proc/self/exe";

/// State of a worker process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ProcessState {
    Serving,
    /// It has no worker any more, and ends by itself.
    Ending,
    /// It did not answer; so did this worker of it, if one is known.
    Killed(Option<WorkerId>),
}

/// A worker process; nothing here waits for it.
struct RunningProcess {
    tenant: Tenant,
    state: ProcessState,
    handle: ProcessHandle,
    /// `None` once the process is to end.
    sender: Option<ChildSender>,
    /// Looks at it since its last sign of life.
    silent_looks: u32,
    /// Its workers, and the one that began last.
    workers: usize,
    newest: WorkerId,
    /// Its scenes and their load, as it reported them last.
    scenes: u64,
    load: u64,
    /// The last numbers that it was given of the rest of the server.
    elsewhere: (u64, u64),
    meters: BTreeMap<SceneName, SceneMeter>,
    flights: BTreeMap<SceneName, FlightRecorder>,
}

impl RunningProcess {
    /// The places of its scenes: each worker has one from its begin on, as it may create its scene before it reports it.
    fn places(&self) -> u64 {
        self.scenes.max(self.workers as u64)
    }

    /// Starts the process, and the thread that reads what it sends and waits for its end.
    ///
    /// # Errors
    ///
    /// The system's, if it has no process, thread or descriptor left.
    fn start(
        id: ProcessId,
        tenant: Tenant,
        (setup, data): (&WorkerSetup, Option<&DataDir>),
        reports: ReportSender,
    ) -> io::Result<Self> {
        let (mut sender, receiver, input) = child_stream()?;
        let lock = data.map(DataDir::lock_to_inherit).transpose()?.flatten();
        let mut command = Command::new(PROGRAM);
        command
            .arg0("rhumb-server")
            .args(["worker", &tenant.to_string()])
            .stdin(input)
            .stdout(lock.map_or_else(Stdio::null, Stdio::from));
        let child = command.spawn()?;
        // It holds the child's end of the stream.
        drop(command);
        let handle = ProcessHandle::of(&child)?;
        let setup = postcard::to_allocvec(setup);
        sender.send(&setup.map_err(|_| io::ErrorKind::InvalidInput)?);
        let started = thread::Builder::new()
            .name(format!("rhumb-worker-{}", id.0))
            .spawn(move || attend(id, child, receiver, &reports));
        if let Err(cause) = started {
            handle.kill();
            return Err(cause);
        }
        Ok(Self {
            tenant,
            state: ProcessState::Serving,
            handle,
            sender: Some(sender),
            silent_looks: 0,
            workers: 0,
            scenes: 0,
            load: 0,
            elsewhere: (0, 0),
            newest: WorkerId(0),
            meters: BTreeMap::new(),
            flights: BTreeMap::new(),
        })
    }

    fn send(&mut self, message: &ToProcess) {
        if let Some(sender) = &mut self.sender {
            sender.send(&encode_to(message));
        }
    }

    /// Sends what the stream did not take before.
    fn flush(&mut self) {
        if let Some(sender) = &mut self.sender {
            sender.flush();
        }
    }

    /// Asks the process to end.
    fn end(&mut self) {
        self.state = ProcessState::Ending;
        self.silent_looks = 0;
        self.sender = None;
    }

    /// Ends the process at once. `stuck`: the worker that did not answer, if one is known.
    fn kill(&mut self, stuck: Option<WorkerId>) {
        // A process that is to end has no scenes to restore.
        if self.state == ProcessState::Serving {
            self.state = ProcessState::Killed(stuck);
        }
        self.silent_looks = 0;
        self.sender = None;
        self.handle.kill();
    }
}

impl RunningProcess {
    /// Shows the metrics of the process's scenes.
    fn show(&mut self, metrics: &[(SceneName, SceneValues)], settings: &DispatcherSettings) {
        let is_gone = |scene: &SceneName| metrics.iter().all(|(name, _)| name != scene);
        let shown = self.meters.keys().cloned();
        for scene in shown.filter(is_gone).collect::<Vec<_>>() {
            self.meters.remove(&scene);
            self.flights.remove(&scene);
        }
        for (scene, values) in metrics {
            let meter = self.meters.entry(scene.clone());
            let meter = meter.or_insert_with(|| settings.recorders.metrics.begin_scene(scene));
            meter.show(values);
        }
    }

    /// The flight recorder of a scene.
    fn flight(&mut self, scene: &SceneName, settings: &DispatcherSettings) -> &FlightRecorder {
        let flight = self.flights.entry(scene.clone());
        flight.or_insert_with(|| settings.recorders.flights.begin(scene))
    }
}

/// Hands over what a process sends, until it ends. A process that sends no messages is broken, and ends.
fn attend(id: ProcessId, mut child: Child, mut receiver: FrameReceiver, reports: &ReportSender) {
    let broken = loop {
        match receiver.receive() {
            Ok(Some(frame)) => match decode_from(&frame) {
                Ok(message) => {
                    if !reports.send(WorkerReport::Process(id, message)) {
                        break false;
                    }
                }
                Err(_) => break true,
            },
            Ok(None) => break false,
            // A stream with unread input breaks at the other end's death.
            Err(cause) => break cause.kind() == io::ErrorKind::InvalidData,
        }
    };
    if broken {
        tracing::error!(worker = id.0, "a worker process sends what is no message");
        // One that has ended already stays so.
        let _ = child.kill();
    }
    drop(receiver);
    let status = match child.wait() {
        Ok(status) => status.to_string(),
        Err(cause) => format!("unknown: {cause}"),
    };
    reports.send(WorkerReport::ProcessOver(id, status));
}

/// A tenant, as tokens name it by the scenes that they are for.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Tenant {
    /// The scenes whose names begin so, up to a slash.
    Named(String),
    /// All scenes without a tenant.
    Shared,
    /// One scene without a tenant.
    Scene(SceneName),
}

impl Tenant {
    /// The tenant of a scene. `share`: scenes without one share a process.
    fn of(scene: &SceneName, share: bool) -> Self {
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
struct Deaths(BTreeMap<Tenant, VecDeque<Instant>>);

impl Deaths {
    fn note(&mut self, now: Instant, tenant: Tenant) {
        self.0.entry(tenant).or_default().push_back(now);
    }

    /// Number of deaths of a tenant's processes in the period.
    fn count(&mut self, now: Instant, tenant: &Tenant) -> u64 {
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

/// A process that can be killed, also when another thread waits for its end.
#[derive(Debug)]
struct ProcessHandle(OwnedFd);

impl ProcessHandle {
    /// The handle of a child that nothing has waited for yet.
    fn of(child: &Child) -> io::Result<Self> {
        let handle = pidfd_open(Pid::from_child(child), PidfdFlags::empty())?;
        Ok(Self(handle))
    }

    /// Ends the process at once. One that has ended already stays so.
    fn kill(&self) {
        if let Err(cause) = pidfd_send_signal(self.0.as_fd(), Signal::KILL)
            && cause != rustix::io::Errno::SRCH
        {
            tracing::error!(%cause, "cannot kill a worker process");
        }
    }
}

/// Makes the system kill this process when the thread that started it ends.
///
/// # Errors
///
/// The system's; and [`io::ErrorKind::NotConnected`] if the dispatcher has ended already.
fn end_with_dispatcher(dispatcher: u32) -> io::Result<()> {
    set_parent_process_death_signal(Some(Signal::KILL))?;
    let parent = getppid().map(|parent| parent.as_raw_nonzero().get());
    if parent.and_then(|parent| u32::try_from(parent).ok()) == Some(dispatcher) {
        Ok(())
    } else {
        Err(io::ErrorKind::NotConnected.into())
    }
}

/// Bounds the private memory of this process; zero sets no bound. The system counts what may be written: thread stacks
/// as a whole, and nothing that is only reserved.
///
/// # Errors
///
/// The system's, if a lower bound is set already.
fn limit_memory(mib: u64) -> io::Result<()> {
    if mib == 0 {
        return Ok(());
    }
    let bytes = Some(mib << 20);
    let limit = Rlimit {
        current: bytes,
        maximum: bytes,
    };
    Ok(setrlimit(Resource::Data, limit)?)
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

#[cfg(test)]
mod codec_tests;
