//! Metrics of the program and its process, by the names Prometheus gives them.
//!
//! They are those of the process that answers: worker processes have their own. A system without `/proc` has none but the
//! program's.

use super::scene::{MetricKind, Text};

/// Writes the version, and what the system says of the process.
pub(super) fn write(text: &mut Text) {
    let name = "rhumb_build_info";
    text.describe(
        name,
        MetricKind::Gauge,
        "1, with the version of the program.",
    );
    let profile = if cfg!(debug_assertions) {
        "debug"
    } else {
        "release"
    };
    let labels = [("version", env!("CARGO_PKG_VERSION")), ("profile", profile)];
    text.sample(name, &labels, 1);
    #[cfg(target_os = "linux")]
    if let Some(metrics) = system::ProcessMetrics::read() {
        metrics.write(text);
    }
}

#[cfg(target_os = "linux")]
mod system {
    use std::fs;

    use super::super::scene::{MetricKind, Text};

    /// Units of processor time in a second, which Linux has fixed for programs.
    const TICKS_PER_SECOND: f64 = 100.0;

    /// The entries of `/proc` about this process.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub(super) struct ProcessMetrics {
        cpu_s: f64,
        start_s: f64,
        resident_bytes: u64,
        virtual_bytes: u64,
        open_files: u64,
        files_max: Option<u64>,
    }

    impl ProcessMetrics {
        pub(super) fn read() -> Option<Self> {
            let read = |name: &str| fs::read_to_string(format!("/proc/{name}")).ok();
            let open_files = fs::read_dir("/proc/self/fd").ok()?.count() as u64;
            let (stat, status) = (read("self/stat")?, read("self/status")?);
            let (system, limits) = (read("stat")?, read("self/limits")?);
            Self::of(&stat, &status, &system, &limits).map(|metrics| Self {
                // The folder that is read is one of them.
                open_files: open_files.saturating_sub(1),
                ..metrics
            })
        }

        /// From the texts of `stat`, `status` and `limits` of the process, and the system's `stat` (proc(5)).
        fn of(stat: &str, status: &str, system: &str, limits: &str) -> Option<Self> {
            // The name of the program, in brackets, may hold anything.
            let (_, fields) = stat.rsplit_once(')')?;
            let fields: Vec<&str> = fields.split_whitespace().collect();
            // The state is field 3.
            let field = |number: usize| fields.get(number - 3)?.parse::<u64>().ok();
            let kilobytes = |name: &str| {
                let line = status.lines().find_map(|line| line.strip_prefix(name))?;
                line.trim().strip_suffix(" kB")?.parse::<u64>().ok()
            };
            let booted = system
                .lines()
                .find_map(|line| line.strip_prefix("btime "))?;
            let booted_s: f64 = booted.trim().parse().ok()?;
            let files_max = limits
                .lines()
                .find_map(|line| line.strip_prefix("Max open files"));
            Some(Self {
                cpu_s: (field(14)? + field(15)?) as f64 / TICKS_PER_SECOND,
                start_s: booted_s + field(22)? as f64 / TICKS_PER_SECOND,
                virtual_bytes: kilobytes("VmSize:")? * 1_024,
                resident_bytes: kilobytes("VmRSS:")? * 1_024,
                open_files: 0,
                files_max: files_max.and_then(|line| line.split_whitespace().next()?.parse().ok()),
            })
        }

        pub(super) fn write(&self, text: &mut Text) {
            use MetricKind::{Counter, Gauge};
            let mut put = |name: &str, kind, help: &str, value: f64| {
                text.describe(name, kind, help);
                text.sample(name, &[], value);
            };
            put(
                "process_cpu_seconds_total",
                Counter,
                "Processor time of the process.",
                self.cpu_s,
            );
            put(
                "process_start_time_seconds",
                Gauge,
                "Start of the process, seconds since 1970.",
                self.start_s,
            );
            put(
                "process_resident_memory_bytes",
                Gauge,
                "Memory in use.",
                self.resident_bytes as f64,
            );
            put(
                "process_virtual_memory_bytes",
                Gauge,
                "Address space in use.",
                self.virtual_bytes as f64,
            );
            put(
                "process_open_fds",
                Gauge,
                "Open files and sockets.",
                self.open_files as f64,
            );
            if let Some(files_max) = self.files_max {
                put(
                    "process_max_fds",
                    Gauge,
                    "Most open files and sockets.",
                    files_max as f64,
                );
            }
        }
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        #[test]
        fn metrics_are_those_of_the_fields_whatever_the_program_is_called() {
            let stat =
                "7 (a) b (c) S 1 7 7 0 -1 4194304 100 0 0 0 250 150 0 0 20 0 9 0 1234 4096000 25";
            let status = "Name:\ta) b (c\nVmSize:\t    4000 kB\nVmRSS:\t     100 kB\n";
            let system = "cpu  1 2 3\nbtime 1700000000\nprocesses 5\n";
            let limits = "Limit  Soft Limit  Hard Limit  Units\nMax open files            1024    4096    files\n";
            let metrics = ProcessMetrics::of(stat, status, system, limits).unwrap();
            assert_eq!((metrics.cpu_s, metrics.start_s), (4.0, 1_700_000_012.34));
            assert_eq!(
                (metrics.virtual_bytes, metrics.resident_bytes),
                (4_096_000, 102_400)
            );
            assert_eq!(metrics.files_max, Some(1_024));
            assert_eq!(
                ProcessMetrics::of("7 (a) S 1", status, system, limits),
                None
            );
        }

        #[test]
        fn this_process_has_metrics() {
            let metrics = ProcessMetrics::read().unwrap();
            assert!(metrics.resident_bytes > 0 && metrics.open_files > 0 && metrics.start_s > 1e9);
        }
    }
}
