//! Shares of a processor: quotas, a caller's other work, and pinned cores.
//!
//! A quota is a control group's where the system allows one, otherwise that of a helper that stops and continues this
//! process. Either ends on drop. The method used is reported, because the two are not equivalent. The helper ends and
//! lets its parent run once its standard input is closed, so the parent never stays stopped.

use std::hint::spin_loop;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::{fs, io};

use clap::Args;
use rhumb_protocol::Span;
use rhumb_server::usable_cores;
use rhumb_transport::Clock;

use crate::settings::PaperError;

/// Period of the quota, microseconds: short, so that short and long frames are slowed alike.
const PERIOD_US: u64 = 10_000;

/// A limit on this process; ends on drop.
#[derive(Debug)]
pub(crate) struct Weakness {
    description: String,
    _group: Option<Group>,
    _duty: Option<Duty>,
}

impl Weakness {
    /// Limits this process to a percentage of one processor.
    pub(crate) fn enter(percent: u32) -> Result<Self, PaperError> {
        let group_failed = match Group::enter(percent) {
            Ok(group) => {
                return Ok(Self {
                    description: format!("{percent} % by a control group's quota"),
                    _group: Some(group),
                    _duty: None,
                });
            }
            Err(why) => why,
        };
        match Duty::start(percent) {
            Ok(duty) => Ok(Self {
                description: format!("{percent} % by stopping and continuing the process"),
                _group: None,
                _duty: Some(duty),
            }),
            Err(why) => Err(PaperError::Quota {
                why: format!("no control group ({group_failed}), no helper ({why})"),
            }),
        }
    }

    /// The method used, as text.
    pub(crate) fn describe(&self) -> String {
        self.description.clone()
    }
}

/// A control group that this process has joined temporarily.
#[derive(Debug)]
struct Group {
    folder: PathBuf,
    /// Folder of its original group.
    home: PathBuf,
}

impl Group {
    fn enter(percent: u32) -> io::Result<Self> {
        let groups = fs::read_to_string("/proc/self/cgroup")?;
        let home = home(&groups).ok_or(io::ErrorKind::NotFound)?;
        let folder = home.join(format!("rhumb-bench-{}", std::process::id()));
        fs::create_dir(&folder)?;
        let group = Self { folder, home };
        let quota_us = PERIOD_US * u64::from(percent) / 100;
        if group.folder.join("cpu.cfs_quota_us").exists() {
            write(
                &group.folder.join("cpu.cfs_period_us"),
                &PERIOD_US.to_string(),
            )?;
            write(
                &group.folder.join("cpu.cfs_quota_us"),
                &quota_us.to_string(),
            )?;
        } else {
            write(
                &group.folder.join("cpu.max"),
                &format!("{quota_us} {PERIOD_US}"),
            )?;
        }
        // If this fails, dropping `group` restores the original group.
        write(
            &group.folder.join("cgroup.procs"),
            &std::process::id().to_string(),
        )?;
        Ok(group)
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        // A process that cannot return stays limited; the next attempt to limit it will fail.
        let _ = write(
            &self.home.join("cgroup.procs"),
            &std::process::id().to_string(),
        );
        let _ = fs::remove_dir(&self.folder);
    }
}

/// Folder of this process's group, from the contents of `/proc/self/cgroup`.
fn home(groups: &str) -> Option<PathBuf> {
    let root = Path::new("/sys/fs/cgroup");
    let line = |wanted: fn(&str) -> bool| {
        groups.lines().find_map(|line| {
            let (_, rest) = line.split_once(':')?;
            let (controllers, path) = rest.split_once(':')?;
            let within = path.trim_start_matches('/').to_owned();
            wanted(controllers).then(|| (controllers.to_owned(), within))
        })
    };
    if let Some((controllers, within)) = line(|names| names.split(',').any(|name| name == "cpu")) {
        return Some(root.join(controllers).join(within));
    }
    let (_, within) = line(str::is_empty)?;
    Some(root.join(within))
}

/// Writes to an existing file.
fn write(path: &Path, text: &str) -> io::Result<()> {
    use std::io::Write as _;
    fs::OpenOptions::new()
        .write(true)
        .open(path)?
        .write_all(text.as_bytes())
}

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

/// Spins for a span of wall-clock time: occupies the core, but not caches or memory.
pub(crate) fn work(clock: &Clock, span: Span) {
    let end = clock.now() + span;
    while clock.now() < end {
        spin_loop();
    }
}

/// Leaves all cores to the servers for a span.
pub(crate) fn pause(clock: &Clock, span: Span) {
    let end = clock.now() + span;
    // A parked thread may wake early.
    while clock.now() < end {
        std::thread::park_timeout(clock.until(end));
    }
}

/// Cores of the caller and the servers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct CoreAssignment {
    pub(crate) caller: Vec<usize>,
    pub(crate) servers: Vec<usize>,
}

impl CoreAssignment {
    /// The caller on the first core, the servers on the others, if there are at least two.
    pub(crate) fn apart() -> Self {
        match usable_cores().split_first() {
            Some((caller, servers)) if !servers.is_empty() => Self {
                caller: vec![*caller],
                servers: servers.to_vec(),
            },
            _ => Self::default(),
        }
    }

    /// The assignment as text, such as `caller 0, servers 1`.
    pub(crate) fn describe(&self) -> String {
        let list = |cores: &[usize]| {
            let cores: Vec<_> = cores.iter().map(usize::to_string).collect();
            cores.join("+")
        };
        match (self.caller.is_empty(), self.servers.is_empty()) {
            (true, true) => "not pinned".to_owned(),
            (true, false) => format!("caller anywhere, servers {}", list(&self.servers)),
            (false, true) => format!("caller {}, servers anywhere", list(&self.caller)),
            (false, false) => format!(
                "caller {}, servers {}",
                list(&self.caller),
                list(&self.servers)
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_group_is_found_in_both_cgroup_versions() {
        let first = "9:name=systemd:/\n4:memory:/a\n1:cpu:/b/c\n0::/\n";
        assert_eq!(home(first), Some("/sys/fs/cgroup/cpu/b/c".into()));
        let joined = "3:cpu,cpuacct:/\n";
        assert_eq!(home(joined), Some("/sys/fs/cgroup/cpu,cpuacct/".into()));
        let second = "0::/user.slice/me\n";
        assert_eq!(home(second), Some("/sys/fs/cgroup/user.slice/me".into()));
        assert_eq!(home(""), None);
    }
}
