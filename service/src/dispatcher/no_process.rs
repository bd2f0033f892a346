//! No worker processes, where the system does not provide what they need.

use std::convert::Infallible;
use std::error::Error;

use rhumb_protocol::Instant;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_scene::Hooks;

use super::message::{FromProcess, FromWorker, ProcessId, ToProcess, WorkerId};
use super::settings::DispatcherSettings;
use super::worker::Threads;

/// The start of worker processes: there is none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ProcessOptions(pub(crate) Infallible);

/// No worker processes.
pub(super) struct Processes(Infallible);

/// No end of a process.
pub(super) struct Death {
    pub(super) stuck: Option<WorkerId>,
}

/// Refuses to be a worker process.
///
/// # Errors
///
/// Always.
pub(crate) fn run_worker(_: Option<Hooks>, _: fn() -> i64) -> Result<(), Box<dyn Error>> {
    Err("this system has no worker processes".into())
}

impl Processes {
    pub(super) fn new(options: ProcessOptions) -> Self {
        Self(options.0)
    }

    pub(super) fn begin(
        &mut self,
        _: WorkerId,
        _: &SceneName,
        _: &Threads,
        _: &DispatcherSettings,
    ) -> Result<ProcessId, CloseCode> {
        match self.0 {}
    }

    pub(super) fn send(&mut self, _: ProcessId, _: &ToProcess) {
        match self.0 {}
    }

    pub(super) fn flush(&mut self) {
        match self.0 {}
    }

    pub(super) fn note_worker_over(&mut self, _: ProcessId, _: &DispatcherSettings) {
        match self.0 {}
    }

    pub(super) fn take(
        &mut self,
        _: ProcessId,
        _: FromProcess,
        _: &DispatcherSettings,
    ) -> Option<(WorkerId, FromWorker)> {
        match self.0 {}
    }

    pub(super) fn look(&mut self, _: u32) {
        match self.0 {}
    }

    pub(super) fn note_over(
        &mut self,
        _: Instant,
        _: (ProcessId, &str),
        _: &DispatcherSettings,
    ) -> Option<Death> {
        match self.0 {}
    }

    pub(super) fn end_all(&mut self) -> usize {
        match self.0 {}
    }

    pub(super) fn kill_all(&mut self) {
        match self.0 {}
    }

    pub(super) fn is_empty(&self) -> bool {
        match self.0 {}
    }
}
