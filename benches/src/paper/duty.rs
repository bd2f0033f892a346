//! A helper process that stops and continues the one that started it.
//!
//! It ends, and lets the other go on, when its standard input is closed: so that nobody stays stopped.

use std::io;
use std::process::{Child, Command, ExitCode, Stdio};

use clap::Args;

/// How the helper is called.
#[derive(Clone, Debug, Args)]
pub(super) struct DutyArguments {
    /// How many hundredths of the time the parent may run.
    #[arg(long, value_parser = clap::value_parser!(u32).range(10..=99))]
    percent: u32,
}

/// A running helper; the process runs on freely when it is dropped.
#[derive(Debug)]
pub(super) struct Duty {
    helper: Child,
}

impl Duty {
    /// Starts a helper for this process.
    pub(super) fn start(percent: u32) -> io::Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["paper", "duty", "--percent", &percent.to_string()]);
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
        // It ends by itself; if it is gone already, so much the better.
        let _ = self.helper.wait();
    }
}

/// Is the helper until its standard input is closed.
#[cfg(target_os = "linux")]
pub(super) fn serve(arguments: &DutyArguments) -> ExitCode {
    use std::io::Read;
    use std::sync::mpsc::{RecvTimeoutError, channel};
    use std::time::Duration;

    use rustix::process::{Signal, getppid, kill_process};

    /// Length of one turn, milliseconds.
    const TURN_MS: u32 = 20;

    let Some(parent) = getppid() else {
        return ExitCode::FAILURE;
    };
    let (closed, over) = channel();
    std::thread::spawn(move || {
        // However it ends, it has ended.
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
    // It may be gone.
    let _ = kill_process(parent, Signal::CONT);
    done
}

/// Is the helper until its standard input is closed: not on this system.
#[cfg(not(target_os = "linux"))]
pub(super) fn serve(_: &DutyArguments) -> ExitCode {
    ExitCode::FAILURE
}
