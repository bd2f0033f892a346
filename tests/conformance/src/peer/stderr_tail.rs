//! The last lines that a process under test wrote to standard error.
//!
//! For readers of the report; no verdict depends on them.

use std::collections::VecDeque;
use std::io::{BufRead, BufReader};
use std::process::ChildStderr;
use std::sync::mpsc::{self, Receiver};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// Number of lines kept: enough for a traceback, or a panic with its message.
const LINES_MAX: usize = 20;
/// The longest wait for the end of the output after the process has ended: its own child processes may live on.
const TIME_LIMIT: Duration = Duration::from_millis(200);

/// The tail of a process's standard error.
#[derive(Debug)]
pub struct StderrTail {
    lines: Arc<Mutex<VecDeque<String>>>,
    /// Disconnected at the end of the output.
    over: Receiver<()>,
}

impl StderrTail {
    /// Starts a thread that reads until the end of the output.
    pub(super) fn of(written: ChildStderr) -> Self {
        let lines = Arc::new(Mutex::new(VecDeque::new()));
        let (reading, over) = mpsc::channel();
        let kept = Arc::clone(&lines);
        thread::spawn(move || {
            for line in BufReader::new(written).split(b'\n').map_while(Result::ok) {
                let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                if kept.len() >= LINES_MAX {
                    kept.pop_front();
                }
                kept.push_back(String::from_utf8_lossy(&line).into_owned());
            }
            drop(reading);
        });
        Self { lines, over }
    }

    /// The last lines of a process that has ended.
    pub(super) fn last(&self) -> Vec<String> {
        // Nothing is ever sent on this channel; its disconnect marks the end of the output.
        let _ = self.over.recv_timeout(TIME_LIMIT);
        let lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        lines.iter().map(|line| format!("stderr: {line}")).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::process::{Command, Stdio};

    use super::*;

    #[test]
    fn the_last_lines_are_kept() {
        let mut child = Command::new("sh")
            .args(["-c", "for n in $(seq 30); do echo line $n >&2; done"])
            .stderr(Stdio::piped())
            .spawn()
            .expect("a shell");
        let stderr_tail = StderrTail::of(child.stderr.take().expect("standard error is piped"));
        child.wait().expect("it ends");
        let last = stderr_tail.last();
        assert_eq!(last.len(), LINES_MAX);
        assert_eq!(last.last().map(String::as_str), Some("stderr: line 30"));
    }
}
