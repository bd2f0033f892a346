//! A weak caller: this process with a part of a processor.
//!
//! By a control group's quota where the system allows one; otherwise by a helper that stops and continues this process
//! in turn. Either is undone when dropped. Invariant: what was done is told, since the two are not the same.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::PaperError;
use super::duty::Duty;

/// Length of one turn of the quota, microseconds: short, so that a short frame is slowed as a long one is.
const PERIOD_US: u64 = 10_000;

/// A process made weak, for as long as this is kept.
#[derive(Debug)]
pub(super) struct Weakness {
    description: String,
    _group: Option<Group>,
    _duty: Option<Duty>,
}

impl Weakness {
    /// Leaves this process so many hundredths of one processor.
    pub(super) fn enter(percent: u32) -> Result<Self, PaperError> {
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

    /// What was done, in words.
    pub(super) fn describe(&self) -> String {
        self.description.clone()
    }
}

/// A control group that this process is in for a while.
#[derive(Debug)]
struct Group {
    folder: PathBuf,
    /// Where it was before.
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
        // Dropped on the way out, if this fails.
        write(
            &group.folder.join("cgroup.procs"),
            &std::process::id().to_string(),
        )?;
        Ok(group)
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        // A process that cannot go home stays weak: the next one to be made weak will say so.
        let _ = write(
            &self.home.join("cgroup.procs"),
            &std::process::id().to_string(),
        );
        let _ = fs::remove_dir(&self.folder);
    }
}

/// The folder of this process' own group, from what the system says of its groups.
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

/// Writes to a file that must be there already.
fn write(path: &Path, text: &str) -> io::Result<()> {
    use std::io::Write as _;
    fs::OpenOptions::new()
        .write(true)
        .open(path)?
        .write_all(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_finds_its_group_in_both_versions() {
        let first = "9:name=systemd:/\n4:memory:/a\n1:cpu:/b/c\n0::/\n";
        assert_eq!(home(first), Some("/sys/fs/cgroup/cpu/b/c".into()));
        let joined = "3:cpu,cpuacct:/\n";
        assert_eq!(home(joined), Some("/sys/fs/cgroup/cpu,cpuacct/".into()));
        let second = "0::/user.slice/me\n";
        assert_eq!(home(second), Some("/sys/fs/cgroup/user.slice/me".into()));
        assert_eq!(home(""), None);
    }
}
