//! Signals of the system to this process, on a thread of their own.

use std::{io, thread};

use rhumb_transport::io_runtime;

/// A request of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Signal {
    /// SIGINT or SIGTERM, or Ctrl-C where there are no such signals: to end.
    Stop,
    /// SIGHUP: to read files again, or to end, where there is nothing to read.
    Reload,
}

/// Calls a function for each signal from now on; no signal ends the process by itself any more.
///
/// # Errors
///
/// The system's error, where it has no thread or no handler left.
pub(crate) fn watch(mut on_signal: impl FnMut(Signal) + Send + 'static) -> io::Result<()> {
    let runtime = io_runtime()?;
    let mut signals = {
        let _inside = runtime.enter();
        Signals::new()?
    };
    thread::Builder::new()
        .name("rhumb-signals".into())
        .spawn(move || {
            while let Some(signal) = runtime.block_on(signals.next()) {
                on_signal(signal);
            }
        })?;
    Ok(())
}

struct Signals {
    #[cfg(unix)]
    interrupt: tokio::signal::unix::Signal,
    #[cfg(unix)]
    terminate: tokio::signal::unix::Signal,
    #[cfg(unix)]
    hang_up: tokio::signal::unix::Signal,
    #[cfg(windows)]
    control_c: tokio::signal::windows::CtrlC,
}

#[cfg(unix)]
impl Signals {
    fn new() -> io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            interrupt: signal(SignalKind::interrupt())?,
            terminate: signal(SignalKind::terminate())?,
            hang_up: signal(SignalKind::hangup())?,
        })
    }

    async fn next(&mut self) -> Option<Signal> {
        tokio::select! {
            signal = self.interrupt.recv() => signal.map(|()| Signal::Stop),
            signal = self.terminate.recv() => signal.map(|()| Signal::Stop),
            signal = self.hang_up.recv() => signal.map(|()| Signal::Reload),
        }
    }
}

#[cfg(windows)]
impl Signals {
    fn new() -> io::Result<Self> {
        let control_c = tokio::signal::windows::ctrl_c()?;
        Ok(Self { control_c })
    }

    async fn next(&mut self) -> Option<Signal> {
        self.control_c.recv().await.map(|()| Signal::Stop)
    }
}
