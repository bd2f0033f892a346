//! Worker processes: one for the scenes of a tenant.
//!
//! A process can be killed, and what it breaks is its own memory. The dispatcher keeps the connections, looks after the
//! processes, and starts another one in the place of one that died. Invariant: a process that may still write a scene's
//! files is waited for before another one serves that scene.

mod child;
mod codec;
#[cfg(test)]
mod codec_tests;
mod running;
mod system;
mod tenant;

use std::collections::BTreeMap;

use rhumb_protocol::Instant;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;

pub(crate) use self::child::run as run_worker;
pub(crate) use self::codec::ProcessOptions;
use self::codec::WorkerSetup;
use self::running::{ProcessState, RunningProcess};
use self::tenant::Deaths;
use self::tenant::Tenant;
use super::message::{FromProcess, FromWorker, ProcessId, ToProcess, Vitals, WorkerId};
use super::settings::DispatcherSettings;
use crate::dispatcher::worker::Threads;
use crate::flight::FlightCause;

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
    pub(super) fn note_worker_over(&mut self, id: ProcessId) {
        let Some(process) = self.running.get_mut(&id) else {
            return;
        };
        process.workers = process.workers.saturating_sub(1);
        if process.workers == 0 && process.state == ProcessState::Serving {
            process.end();
            self.by_tenant.remove(&process.tenant);
        }
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
    fn share_out(&mut self, settings: &DispatcherSettings) {
        let of_processes = self.running.values();
        let (scenes, load) = of_processes.fold((0_u64, 0_u64), |(scenes, load), process| {
            (
                scenes.saturating_add(process.scenes),
                load.saturating_add(process.load),
            )
        });
        let scenes_here = usize::try_from(scenes).unwrap_or(usize::MAX);
        settings.scenes.admission.slots.set_elsewhere(scenes_here);
        settings.scenes.admission.load.set_elsewhere(load);
        let here = (
            settings.scenes.admission.slots.here() as u64,
            settings.scenes.admission.load.here(),
        );
        for process in self.running.values_mut() {
            let elsewhere = (
                scenes.saturating_add(here.0) - process.scenes,
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
