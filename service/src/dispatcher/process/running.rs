//! One worker process, as the dispatcher has it.

use std::collections::BTreeMap;
use std::io;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use std::thread;

use rhumb_protocol::scene::SceneName;
use rhumb_transport::{ChildSender, FrameReceiver, child_stream};

use super::super::message::{ProcessId, ToProcess, WorkerId, WorkerReport};
use super::super::settings::DispatcherSettings;
use super::codec::WorkerSetup;
use super::codec::{decode_from, encode_to};
use super::system::ProcessHandle;
use super::tenant::Tenant;
use crate::dispatcher::worker::ReportSender;
use crate::durable::DataDir;
use crate::flight::FlightRecorder;
use crate::metrics::{SceneMeter, SceneValues};

/// This program, also after its file was replaced: both ends of a stream must be of one build.
const PROGRAM: &str = "/proc/self/exe";

/// State of a worker process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ProcessState {
    Serving,
    /// It has no worker any more, and ends by itself.
    Ending,
    /// It did not answer; so did this worker of it, if one is known.
    Killed(Option<WorkerId>),
}

/// A worker process; nothing here waits for it.
pub(super) struct RunningProcess {
    pub(super) tenant: Tenant,
    pub(super) state: ProcessState,
    handle: ProcessHandle,
    /// `None` once the process is to end.
    sender: Option<ChildSender>,
    /// Looks at it since its last sign of life.
    pub(super) silent_looks: u32,
    /// Its workers.
    pub(super) workers: usize,
    /// Its scenes and their load, as it reported them last.
    pub(super) scenes: u64,
    pub(super) load: u64,
    /// The last numbers that it was given of the rest of the server.
    pub(super) elsewhere: (u64, u64),
    meters: BTreeMap<SceneName, SceneMeter>,
    pub(super) flights: BTreeMap<SceneName, FlightRecorder>,
}

impl RunningProcess {
    /// Starts the process, and the thread that reads what it sends and waits for its end.
    ///
    /// # Errors
    ///
    /// The system's, if it has no process, thread or descriptor left.
    pub(super) fn start(
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
            meters: BTreeMap::new(),
            flights: BTreeMap::new(),
        })
    }

    pub(super) fn send(&mut self, message: &ToProcess) {
        if let Some(sender) = &mut self.sender {
            sender.send(&encode_to(message));
        }
    }

    /// Sends what the stream did not take before.
    pub(super) fn flush(&mut self) {
        if let Some(sender) = &mut self.sender {
            sender.flush();
        }
    }

    /// Asks the process to end.
    pub(super) fn end(&mut self) {
        self.state = ProcessState::Ending;
        self.silent_looks = 0;
        self.sender = None;
    }

    /// Ends the process at once. `stuck`: the worker that did not answer, if one is known.
    pub(super) fn kill(&mut self, stuck: Option<WorkerId>) {
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
    pub(super) fn show(
        &mut self,
        metrics: &[(SceneName, SceneValues)],
        settings: &DispatcherSettings,
    ) {
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
    pub(super) fn flight(
        &mut self,
        scene: &SceneName,
        settings: &DispatcherSettings,
    ) -> &FlightRecorder {
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
