//! Numbers as the table shows them.

/// A number with this many digits after the point; a dash for one that is unknown.
pub(super) fn number(value: Option<f64>, digits: usize) -> String {
    match value {
        Some(value) if value.is_finite() => format!("{value:.digits$}"),
        _ => "-".to_owned(),
    }
}

/// Seconds as milliseconds.
pub(super) fn milliseconds(seconds: Option<f64>) -> String {
    match seconds {
        // Beyond the last bucket of the histogram.
        Some(seconds) if seconds == f64::INFINITY => ">100".to_owned(),
        seconds => number(seconds.map(|seconds| seconds * 1e3), 2),
    }
}

/// Bytes as kilobytes of a thousand.
pub(super) fn kilobytes(bytes: Option<f64>) -> String {
    number(bytes.map(|bytes| bytes / 1e3), 1)
}

/// A share as percent.
pub(super) fn percent(share: Option<f64>) -> String {
    number(share.map(|share| share * 1e2), 1)
}

/// `1 scene`, `2 scenes`.
pub(super) fn count(value: Option<f64>, one: &str) -> String {
    let plural = if value == Some(1.0) { "" } else { "s" };
    format!("{} {one}{plural}", number(value, 0))
}
