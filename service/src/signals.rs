//! Signals of the system to this process: to stop, or to read keys again.
//!
//! A thread of its own awaits them.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use std::{io, thread};

use rhumb_transport::{Stop, io_runtime};

use crate::access::TokenKeys;

/// A server that has not stopped so long after a signal is ended: two seconds are promised.
const STOP_WITHIN: Duration = Duration::from_millis(1_500);

/// Exit code of a server that was ended so.
const EXIT_NOT_STOPPED: i32 = 3;

/// A request of the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Signal {
    /// SIGINT or SIGTERM, or Ctrl-C where there are no such signals: to end.
    Stop,
    /// SIGHUP: to read files again, or to end, where there is nothing to read.
    Reload,
}

/// Stops at SIGINT and SIGTERM. At SIGHUP it reads the keys of tokens again, or stops if there are none. The result is to
/// be set to false when the server has stopped.
pub(crate) fn obey(stop: &Stop, keys: Option<TokenKeys>) -> Arc<AtomicBool> {
    let running = Arc::new(AtomicBool::new(true));
    let (requested, still_running) = (stop.clone(), Arc::clone(&running));
    let on_signal = move |signal| {
        if let (Signal::Reload, Some(keys)) = (signal, &keys) {
            match keys.read_again() {
                Ok(()) => tracing::info!("the keys of tokens are read again"),
                Err(cause) => tracing::error!(%cause, "the keys of tokens stay as they were"),
            }
            return;
        }
        requested.stop();
        thread::sleep(STOP_WITHIN);
        if still_running.load(Ordering::Relaxed) {
            tracing::error!("the server did not stop in time");
            std::process::exit(EXIT_NOT_STOPPED);
        }
    };
    if let Err(cause) = watch(on_signal) {
        tracing::warn!(%cause, "signals do not stop this server");
    }
    running
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
