//! Numbers of the tables as text.

use crate::statistics::{Interval, Sample};
use rhumb_bench::summary::number;

/// Cell of a missing value.
pub(super) const NONE: &str = "–";

/// Precision of a displayed figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Digits {
    /// Three significant digits.
    Three,
    /// Two decimals, as the paper prints frames per second.
    TwoPlaces,
}

impl Digits {
    pub(super) fn show(self, value: Option<f64>) -> String {
        match (self, value) {
            (Self::TwoPlaces, Some(value)) => format!("{value:.2}"),
            (_, value) => number(value),
        }
    }

    /// A mean and its standard deviation.
    pub(super) fn spread(self, sample: &Sample) -> String {
        let mean = self.show(Some(sample.mean));
        match sample.deviation {
            Some(deviation) => format!("{mean} ± {}", self.show(Some(deviation))),
            None => mean,
        }
    }
}

pub(super) fn probability(p: f64) -> String {
    if p < 0.0001 {
        "< 0.0001".to_owned()
    } else {
        format!("{p:.4}")
    }
}

pub(super) fn interval(interval: Option<Interval>) -> String {
    interval.map_or_else(
        || NONE.to_owned(),
        |Interval { from, to }| format!("{} to {}", number(Some(from)), number(Some(to))),
    )
}
