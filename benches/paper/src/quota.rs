//! Limits this process to a share of a processor.
//!
//! Uses a control group's quota where the system allows one, otherwise a helper that stops and continues this process.
//! Either ends on drop. The method used is reported, because the two are not equivalent.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::duty::Duty;
use super::error::PaperError;

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
