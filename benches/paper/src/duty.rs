//! A helper process that stops and continues its parent.
//!
//! The helper ends and lets its parent run once its standard input is closed, so the parent never stays stopped.

use std::io;
use std::process::{Child, Command, ExitCode, Stdio};

use clap::Args;

/// Arguments of the helper.
#[derive(Clone, Debug, Args)]
pub(crate) struct DutyArguments {
    /// Percentage of the time that the parent may run.
    #[arg(long, value_parser = clap::value_parser!(u32).range(10..=99))]
    percent: u32,
}

/// A running helper; on drop it ends, and the process runs freely again.
#[derive(Debug)]
pub(crate) struct Duty {
    helper: Child,
}

impl Duty {
    /// Starts a helper for this process.
    pub(crate) fn start(percent: u32) -> io::Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["duty", "--percent", &percent.to_string()]);
        let helper = command
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn()?;
        Ok(Self { helper })
    }
}

impl Drop for Duty {
    fn drop(&mut self) {
        drop(self.helper.stdin.take());
        // Closing its input ends the helper; it may also have ended before.
        let _ = self.helper.wait();
    }
}

/// Runs as the helper until standard input is closed.
#[cfg(target_os = "linux")]
pub(crate) fn serve_duty(arguments: &DutyArguments) -> ExitCode {
    use std::io::Read;
    use std::sync::mpsc::{RecvTimeoutError, channel};
    use std::time::Duration;

    use rustix::process::{Signal, getppid, kill_process};

    /// Length of one cycle, milliseconds.
    const TURN_MS: u32 = 20;

    let Some(parent) = getppid() else {
        return ExitCode::FAILURE;
    };
    let (closed, over) = channel();
    std::thread::spawn(move || {
        // Any result means that the input is closed.
        let _ = io::stdin().read(&mut [0]);
        drop(closed);
    });
    let spans = [
        (Signal::STOP, TURN_MS * (100 - arguments.percent) / 100),
        (Signal::CONT, TURN_MS * arguments.percent / 100),
    ];
    let mut done = ExitCode::SUCCESS;
    'turns: loop {
        for (signal, span_ms) in spans {
            if kill_process(parent, signal).is_err() {
                done = ExitCode::FAILURE;
                break 'turns;
            }
            let pause = Duration::from_millis(u64::from(span_ms));
            let waited: Result<(), _> = over.recv_timeout(pause);
            if waited == Err(RecvTimeoutError::Disconnected) {
                break 'turns;
            }
        }
    }
    // The parent may have ended.
    let _ = kill_process(parent, Signal::CONT);
    done
}

/// Not available on this system.
#[cfg(not(target_os = "linux"))]
pub(crate) fn serve_duty(_: &DutyArguments) -> ExitCode {
    ExitCode::FAILURE
}
