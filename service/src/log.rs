//! The log of a server process, on standard error.
//!
//! A log line costs no thread of the server more than a place in a bounded queue. A thread of its own writes; lines
//! that do not fit, or that cannot be written, are lost. Invariants: logging neither blocks nor panics; one cause, the
//! place in the source that logs, writes a limited number of lines in a second, except at level trace.

use std::collections::BTreeMap;
use std::io::{self, IsTerminal, Write};
use std::panic;
use std::sync::{Mutex, PoisonError};

use rhumb_protocol::{Instant, Span};
use rhumb_transport::Clock;
use tracing::level_filters::LevelFilter;
use tracing::{Event, Level, Metadata, Subscriber};
use tracing_appender::non_blocking::{NonBlocking, NonBlockingBuilder, WorkerGuard};
use tracing_subscriber::layer::{Context, Filter, Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;

/// Lines that wait to be written, at most.
const LINES_WAITING_MAX: usize = 8_192;
/// Window of the limit of lines.
const SECOND: Span = Span::from_millis(1_000);

/// The form of a log.
#[derive(Clone, Copy, Debug)]
struct Destination {
    ansi: bool,
    level: LevelFilter,
    /// Lines of one cause.
    lines_per_second: u64,
}

/// Starts the log of this process; the last lines are written, if they can be, when the guard is dropped.
///
/// Panics are logged too, instead of being printed: printing blocks on a pipe without a reader.
pub(crate) fn start(level: LevelFilter, lines_per_second: u64) -> WorkerGuard {
    let clock = Clock::start();
    let to = Destination {
        ansi: io::stderr().is_terminal(),
        level,
        lines_per_second,
    };
    let (subscriber, guard) = log_to(io::stderr(), to, move || clock.now());
    subscriber.init();
    panic::set_hook(Box::new(|panic| tracing::error!("{panic}")));
    guard
}

/// A subscriber that writes to `out`, through the queue and within the limits.
fn log_to(
    out: impl Write + Send + 'static,
    to: Destination,
    clock: impl Fn() -> Instant + Send + Sync + 'static,
) -> (impl Subscriber + Send + Sync, WorkerGuard) {
    let (writer, guard) = NonBlockingBuilder::default()
        .lossy(true)
        .buffered_lines_limit(LINES_WAITING_MAX)
        .thread_name("rhumb-server-log")
        .finish(out);
    let limit = CauseLimit {
        clock: Box::new(clock),
        causes: Mutex::new(BTreeMap::new()),
        notices: writer.clone(),
        lines_per_second: u32::try_from(to.lines_per_second).unwrap_or(u32::MAX),
    };
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(writer)
        .with_ansi(to.ansi)
        .with_target(false)
        .log_internal_errors(false)
        .with_filter(limit);
    (
        tracing_subscriber::registry().with(to.level).with(lines),
        guard,
    )
}

/// Counts the lines of each cause, and leaves out those beyond its limit.
struct CauseLimit {
    clock: Box<dyn Fn() -> Instant + Send + Sync>,
    /// By file and line: as many as the source has places that log.
    causes: Mutex<BTreeMap<(&'static str, u32), Cause>>,
    notices: NonBlocking,
    lines_per_second: u32,
}

/// The lines of one cause in the present second.
#[derive(Clone, Copy, Debug)]
struct Cause {
    since: Instant,
    lines: u32,
}

impl CauseLimit {
    /// Returns true if the cause may write another line, and the number of lines left out before.
    fn count(&self, metadata: &Metadata<'static>) -> (bool, u32) {
        let now = (self.clock)();
        let place = (
            metadata.file().unwrap_or(metadata.target()),
            metadata.line().unwrap_or(0),
        );
        let mut causes = self.causes.lock().unwrap_or_else(PoisonError::into_inner);
        let fresh = Cause {
            since: now,
            lines: 0,
        };
        let cause = causes.entry(place).or_insert(fresh);
        let mut left_out = 0;
        if now.since(cause.since) >= SECOND {
            left_out = cause.lines.saturating_sub(self.lines_per_second);
            *cause = fresh;
        }
        cause.lines = cause.lines.saturating_add(1);
        (cause.lines <= self.lines_per_second, left_out)
    }
}

impl<S: Subscriber> Filter<S> for CauseLimit {
    fn enabled(&self, _: &Metadata<'_>, _: &Context<'_, S>) -> bool {
        true
    }

    fn event_enabled(&self, event: &Event<'_>, _: &Context<'_, S>) -> bool {
        let metadata = event.metadata();
        if *metadata.level() == Level::TRACE {
            return true;
        }
        let (enabled, left_out) = self.count(metadata);
        if left_out > 0 {
            let line = format!("     {left_out} lines like the next one were left out\n");
            // The queue takes the line or loses it, and never fails.
            let _ = self.notices.clone().write(line.as_bytes());
        }
        enabled
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINES_PER_SECOND: u32 = 10;

    fn plain(level: LevelFilter) -> Destination {
        Destination {
            ansi: false,
            level,
            lines_per_second: u64::from(LINES_PER_SECOND),
        }
    }
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::{Arc, mpsc};

    /// A pipe without a reader: blocks until the test drops the other end.
    struct Blocked(mpsc::Receiver<()>);

    impl Write for Blocked {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            // Fails at the end of the test.
            let _ = self.0.recv();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// A full disk.
    struct Full;

    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(io::ErrorKind::StorageFull.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Err(io::ErrorKind::StorageFull.into())
        }
    }

    /// Collects what is written.
    #[derive(Clone, Default)]
    struct Lines(Arc<Mutex<Vec<u8>>>);

    impl Write for Lines {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().expect("no thread panics").write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// Logs at trace level, which no limit thins out.
    fn flood(lines: usize) {
        for line in 0..lines {
            tracing::trace!(line, "a line");
        }
    }

    #[test]
    fn a_pipe_without_a_reader_costs_lines_and_nothing_else() {
        let (reader, blocked) = mpsc::channel();
        let (subscriber, guard) = log_to(Blocked(blocked), plain(LevelFilter::TRACE), || {
            Instant::ZERO
        });
        tracing::subscriber::with_default(subscriber, || flood(3 * LINES_WAITING_MAX));
        drop(reader);
        drop(guard);
    }

    #[test]
    fn a_full_disk_costs_lines_and_nothing_else() {
        let (subscriber, guard) = log_to(Full, plain(LevelFilter::TRACE), || Instant::ZERO);
        tracing::subscriber::with_default(subscriber, || flood(1_000));
        drop(guard);
    }

    #[test]
    fn a_cause_writes_ten_lines_a_second_and_says_how_many_it_left_out() {
        let lines = Lines::default();
        let now = Arc::new(AtomicU64::new(0));
        let clock = Arc::clone(&now);
        let (subscriber, guard) = log_to(lines.clone(), plain(LevelFilter::INFO), move || {
            Instant::from_nanos(clock.load(Ordering::Relaxed))
        });
        tracing::subscriber::with_default(subscriber, || {
            let often = |line: u32| tracing::info!(line, "often");
            for line in 0..1_000 {
                often(line);
            }
            tracing::info!("another cause");
            now.store(1_000_000_000, Ordering::Relaxed);
            often(1_000);
        });
        drop(guard);
        let text = lines.0.lock().expect("no thread panics").clone();
        let text = String::from_utf8(text).expect("a log is text");
        let count = |words: &str| text.lines().filter(|line| line.contains(words)).count();
        assert_eq!(count("often"), 11, "{text}");
        assert_eq!(count("another cause"), 1, "{text}");
        assert_eq!(count("990 lines like the next one"), 1, "{text}");
    }
}
