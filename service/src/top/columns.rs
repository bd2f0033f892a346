//! The columns of the table of scenes, and changes between two readings.

use std::cmp::Ordering;

use super::reading::{Reading, SceneReading};

/// One column.
#[derive(Clone, Copy, Debug)]
pub(super) struct Column {
    pub(super) title: &'static str,
    /// Width on a screen, characters.
    pub(super) width: u16,
    /// On a narrow screen the columns of the lowest ranks are left out.
    rank: u8,
    value: fn(&SceneChange<'_>) -> Option<f64>,
    text: fn(Option<f64>) -> String,
}

/// The column of names stands before all others.
pub(super) const NAME_TITLE: &str = "SCENE";

/// All columns but that of the name.
pub(super) const COLUMNS: [Column; 12] = [
    column("CLIENTS", 7, 8, |of| of.value("members"), whole),
    column("BODIES", 7, 9, |of| of.value("bodies"), whole),
    column("AWAKE", 7, 4, |of| of.value("bodies_awake"), whole),
    column("TICK", 9, 6, |of| of.value("tick"), whole),
    column(
        "TICKS/s",
        7,
        10,
        |of| of.rate("tick"),
        |rate| number(rate, 1),
    ),
    column("p50ms", 6, 2, |of| of.step_quantile(0.5), milliseconds),
    column("p99ms", 6, 7, |of| of.step_quantile(0.99), milliseconds),
    column("BUSY%", 6, 12, busy, percent),
    column("LATE", 6, 3, |of| of.value("late_total"), whole),
    column(
        "INkB/s",
        7,
        5,
        |of| of.rate("received_bytes_total"),
        kilobytes,
    ),
    column(
        "OUTkB/s",
        8,
        11,
        |of| of.rate("sent_bytes_total"),
        kilobytes,
    ),
    column("WAIT", 5, 1, |of| of.value("bodies_waiting"), whole),
];

const fn column(
    title: &'static str,
    width: u16,
    rank: u8,
    value: fn(&SceneChange<'_>) -> Option<f64>,
    text: fn(Option<f64>) -> String,
) -> Column {
    Column {
        title,
        width,
        rank,
        value,
        text,
    }
}

/// Width of the column of names, characters; more if there is room.
pub(super) const NAME_WIDTH: u16 = 12;

/// Places of the columns that a screen of this width has room for whole, in their order. The sorted column stays longest.
pub(super) fn fitting(width: u16, sorted: Option<usize>) -> Vec<usize> {
    let mut places: Vec<usize> = (0..COLUMNS.len()).collect();
    let needed = |places: &[usize]| {
        let widths = places.iter().map(|place| COLUMNS[*place].width + 1);
        NAME_WIDTH + widths.sum::<u16>()
    };
    while needed(&places) > width {
        let rank = |place: &usize| (sorted == Some(*place), COLUMNS[*place].rank);
        let Some(least) = places.iter().copied().min_by_key(rank) else {
            break;
        };
        places.retain(|place| *place != least);
    }
    places
}

fn whole(value: Option<f64>) -> String {
    number(value, 0)
}

impl Column {
    /// The text of a cell.
    pub(super) fn cell(&self, scene: &SceneChange<'_>) -> String {
        (self.text)((self.value)(scene))
    }
}

/// The order of rows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct SortOrder {
    /// `None` sorts by name.
    pub(super) column: Option<usize>,
    pub(super) is_reversed: bool,
}

impl SortOrder {
    /// The order after this one: by name, then by each column, greatest first.
    pub(super) fn next(self) -> Self {
        let column = match self.column {
            None => Some(0),
            Some(last) if last + 1 == COLUMNS.len() => None,
            Some(column) => Some(column + 1),
        };
        Self {
            column,
            is_reversed: column.is_some(),
        }
    }

    pub(super) const fn reversed(self) -> Self {
        Self {
            is_reversed: !self.is_reversed,
            ..self
        }
    }

    /// Sorts rows; those without the metric come last, and equal ones by name.
    pub(super) fn sort(self, rows: &mut [SceneChange<'_>]) {
        rows.sort_by(|a, b| {
            let by_column = self.column.and_then(|column| COLUMNS.get(column));
            let order = by_column.map_or(Ordering::Equal, |column| {
                let (a, b) = ((column.value)(a), (column.value)(b));
                match (a, b) {
                    (Some(a), Some(b)) if self.is_reversed => b.total_cmp(&a),
                    (Some(a), Some(b)) => a.total_cmp(&b),
                    (a, b) => b.is_some().cmp(&a.is_some()),
                }
            });
            let by_name = a.name.cmp(b.name);
            order.then(if self.is_reversed && by_column.is_none() {
                by_name.reverse()
            } else {
                by_name
            })
        });
    }
}

/// The share of the time that a scene's steps take, percent.
fn busy(of: &SceneChange<'_>) -> Option<f64> {
    of.busy()
}

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
fn kilobytes(bytes: Option<f64>) -> String {
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

/// A scene's metrics, and how they changed since the reading before.
#[derive(Clone, Copy, Debug)]
pub(super) struct SceneChange<'a> {
    pub(super) name: &'a str,
    now: &'a SceneReading,
    before: Option<&'a SceneReading>,
    /// Seconds between the readings.
    seconds: f64,
}

impl<'a> SceneChange<'a> {
    /// All scenes of a reading, in the order of names.
    pub(super) fn all(
        now: &'a Reading,
        before: Option<&'a Reading>,
    ) -> impl Iterator<Item = SceneChange<'a>> {
        let nanos = before.map_or(0, |before| now.at.since(before.at).as_nanos());
        now.scenes.iter().map(move |(name, scene)| SceneChange {
            name,
            now: scene,
            before: before.and_then(|before| before.scenes.get(name)),
            seconds: nanos as f64 / 1e9,
        })
    }

    /// A metric of the newest reading.
    pub(super) fn value(&self, metric: &str) -> Option<f64> {
        self.now.value(metric)
    }

    /// Growth of a count in a second. `None` without a reading before, and for a count that began anew.
    pub(super) fn rate(&self, metric: &str) -> Option<f64> {
        let grown = self.growth(metric)?;
        (self.seconds > 0.0).then(|| grown / self.seconds)
    }

    fn growth(&self, metric: &str) -> Option<f64> {
        let grown = self.now.value(metric)? - self.before?.value(metric)?;
        (grown >= 0.0).then_some(grown)
    }

    /// Duration within which this share of the steps was done since the reading before, seconds, interpolated within the
    /// buckets of the histogram; infinite beyond the last. Without such steps: of all steps so far.
    pub(super) fn step_quantile(&self, share: f64) -> Option<f64> {
        let before = self.before.map_or(&[][..], |before| &before.steps_within);
        let fits = before.len() == self.now.steps_within.len();
        let recent = self.now.steps_within.iter().enumerate().map(|(at, now)| {
            let earlier = if fits { before[at].1 } else { 0.0 };
            (now.0, now.1 - earlier)
        });
        quantile(recent, share).or_else(|| quantile(self.now.steps_within.iter().copied(), share))
    }

    /// Time on the scene's thread for steps and publishing, as a share of the time of a second.
    pub(super) fn busy(&self) -> Option<f64> {
        let publish = self.rate("publish_seconds_total")?;
        Some(self.rate("step_seconds_sum")? + publish)
    }

    /// Mean time of publishing a tick, seconds.
    pub(super) fn publish_mean(&self) -> Option<f64> {
        let steps = self.growth("step_seconds_count")?;
        let publish = self.growth("publish_seconds_total")?;
        (steps > 0.0).then(|| publish / steps)
    }
}

/// A quantile of a histogram of cumulative counts.
fn quantile(within: impl Iterator<Item = (f64, f64)> + Clone, share: f64) -> Option<f64> {
    let total = within.clone().last()?.1;
    if total <= 0.0 {
        return None;
    }
    let rank = total * share;
    let (mut start, mut below) = (0.0, 0.0);
    for (end, count) in within {
        if count >= rank && count > below {
            let part = (rank - below) / (count - below);
            return Some(if end.is_finite() {
                start + (end - start) * part
            } else {
                end
            });
        }
        (start, below) = (end, count);
    }
    None
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::{Instant, Span};

    use super::*;

    fn reading(seconds: u64, tick: u64, steps: [u64; 3]) -> Reading {
        let [first, second, all] = steps;
        let bucket = |end: &str, count| {
            format!("rhumb_scene_step_seconds_bucket{{scene=\"pit\",le=\"{end}\"}} {count}\n")
        };
        let text = format!(
            "rhumb_scenes 1\nrhumb_scene_tick{{scene=\"pit\"}} {tick}\n{}{}{}",
            bucket("0.001", first),
            bucket("0.002", second),
            bucket("+Inf", all)
        );
        let at = Instant::ZERO + Span::from_millis(seconds * 1_000);
        Reading::parse(at, true, &text).unwrap()
    }

    fn of<'a>(now: &'a Reading, before: Option<&'a Reading>) -> SceneChange<'a> {
        SceneChange::all(now, before).next().unwrap()
    }

    #[test]
    fn a_rate_is_growth_over_time_and_unknown_without_two_readings() {
        let (before, now) = (reading(1, 100, [0; 3]), reading(3, 220, [0; 3]));
        assert_eq!(of(&now, Some(&before)).rate("tick"), Some(60.0));
        assert_eq!(of(&now, None).rate("tick"), None);
        assert_eq!(of(&before, Some(&now)).rate("tick"), None, "it began anew");
    }

    #[test]
    fn quantiles_are_of_the_steps_since_the_reading_before() {
        let before = reading(1, 0, [1_000, 1_000, 1_000]);
        let now = reading(2, 60, [1_000, 1_080, 1_100]);
        let change = of(&now, Some(&before));
        let median = change.step_quantile(0.5).unwrap();
        assert!((median - 0.001_625).abs() < 1e-12, "{median}");
        assert_eq!(change.step_quantile(0.99), Some(f64::INFINITY));
        let idle = of(&before, Some(&before));
        assert_eq!(idle.step_quantile(0.5), Some(0.000_5), "of all steps");
        let none = reading(1, 0, [0; 3]);
        assert_eq!(of(&none, None).step_quantile(0.5), None);
    }
}
