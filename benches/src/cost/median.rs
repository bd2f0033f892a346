//! The median of repeated measurements.

use std::time::Duration;

use crate::quantile;

/// Median of several durations; zero if there are none.
pub(super) fn median(values: impl Iterator<Item = Duration>) -> Duration {
    let mut all: Vec<u64> = values.map(|value| value.as_nanos() as u64).collect();
    Duration::from_nanos(quantile::of_nanoseconds(&mut all, 50).unwrap_or(0))
}
