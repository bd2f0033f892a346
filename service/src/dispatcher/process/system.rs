//! The system's part of worker processes: end, memory, death.

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::process::Child;

use rustix::process::{
    Pid, PidfdFlags, Resource, Rlimit, Signal, getppid, pidfd_open, pidfd_send_signal,
    set_parent_process_death_signal, setrlimit,
};

/// A process that can be killed, also when another thread waits for its end.
#[derive(Debug)]
pub(super) struct ProcessHandle(OwnedFd);

impl ProcessHandle {
    /// The handle of a child that nothing has waited for yet.
    pub(super) fn of(child: &Child) -> io::Result<Self> {
        let handle = pidfd_open(Pid::from_child(child), PidfdFlags::empty())?;
        Ok(Self(handle))
    }

    /// Ends the process at once. One that has ended already stays so.
    pub(super) fn kill(&self) {
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
pub(super) fn end_with_dispatcher(dispatcher: u32) -> io::Result<()> {
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
pub(super) fn limit_memory(mib: u64) -> io::Result<()> {
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
