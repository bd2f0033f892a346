//! The columns of the table of scenes.

use std::cmp::Ordering;

use super::change::SceneChange;

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

    /// Sorts rows; those without the figure come last, and equal ones by name.
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
