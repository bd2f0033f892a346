//! The measure of all benches, and their sizes.

use std::env;
use std::time::Duration;

use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{BenchmarkGroup, Criterion};
use rhumb_bench::machine::ThreadMoment;

/// Processor time of the calling thread: other programs hardly change it.
pub(crate) struct ProcessorTime;

impl Measurement for ProcessorTime {
    type Intermediate = ThreadMoment;
    type Value = Duration;

    fn start(&self) -> ThreadMoment {
        ThreadMoment::now()
    }

    fn end(&self, begun: ThreadMoment) -> Duration {
        begun.elapsed()
    }

    fn add(&self, one: &Duration, other: &Duration) -> Duration {
        *one + *other
    }

    fn zero(&self) -> Duration {
        Duration::ZERO
    }

    fn to_f64(&self, value: &Duration) -> f64 {
        value.as_nanos() as f64
    }

    fn formatter(&self) -> &dyn ValueFormatter {
        WallTime.formatter()
    }
}

/// A group of benches.
pub(crate) type Group<'c> = BenchmarkGroup<'c, ProcessorTime>;

/// Criterion with this measure, and the flags of the command line.
pub(crate) fn criterion() -> Criterion<ProcessorTime> {
    Criterion::default()
        .without_plots()
        .with_measurement(ProcessorTime)
        .configure_from_args()
}

/// A group of quick work: thirty samples in a second and a half.
pub(crate) fn quick<'c>(criterion: &'c mut Criterion<ProcessorTime>, name: &str) -> Group<'c> {
    let mut group = criterion.benchmark_group(name);
    group
        .sample_size(30)
        .warm_up_time(Duration::from_millis(500))
        .measurement_time(Duration::from_millis(1_000));
    group
}

/// Bodies of a setup: 10,000, or a few where each bench runs once, to see that it works.
pub(crate) fn bodies() -> u32 {
    if is_measured() { 10_000 } else { 200 }
}

/// Cargo says `--bench` where it measures; `--test` takes that back.
fn is_measured() -> bool {
    let has = |flag: &str| env::args().any(|argument| argument == flag);
    has("--bench") && !has("--test")
}
