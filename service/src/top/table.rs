//! The table as plain text.

use super::change::SceneChange;
use super::columns::{COLUMNS, NAME_TITLE, SortOrder};
use super::format::{count, number, percent};
use super::reading::Reading;

/// One line about the server as a whole.
pub(super) fn summary(now: &Reading) -> String {
    let health = if now.is_healthy {
        "healthy"
    } else {
        "not healthy: connections are not served"
    };
    let load = now.value("rhumb_load").zip(now.value("rhumb_load_limit"));
    let load = load.map(|(load, most)| load / most);
    let restored: f64 = sum(now, "restorations_total");
    let faulted: f64 = sum(now, "faulted");
    format!(
        "{health}, {}, {} so far, {}, {} quarantined, {} faulted, {}, load {} %",
        count(now.value("rhumb_connections"), "connection"),
        number(now.value("rhumb_connections_total"), 0),
        count(now.value("rhumb_scenes"), "scene"),
        number(now.value("rhumb_scenes_quarantined"), 0),
        number(Some(faulted), 0),
        count(Some(restored), "restoration"),
        percent(load),
    )
}

fn sum(now: &Reading, figure: &str) -> f64 {
    let scenes = now.scenes.values();
    let sum: f64 = scenes.filter_map(|scene| scene.value(figure)).sum();
    // The sum of nothing is -0.
    sum + 0.0
}

/// The whole table: a line about the server, titles, and a line for each scene.
pub(super) fn plain(url: &str, now: &Reading, before: Option<&Reading>) -> String {
    let mut rows: Vec<_> = SceneChange::all(now, before).collect();
    SortOrder::default().sort(&mut rows);
    let mut lines = vec![titles()];
    lines.extend(rows.iter().map(cells));
    let widths: Vec<usize> = (0..lines[0].len())
        .map(|at| lines.iter().map(|line| line[at].len()).max().unwrap_or(0))
        .collect();
    let mut text = format!("{url}: {}\n", summary(now));
    for line in lines {
        let mut padded = format!("{:<1$}", line[0], widths[0]);
        for (cell, width) in line.iter().zip(&widths).skip(1) {
            padded += &format!("  {cell:>width$}");
        }
        text += padded.trim_end();
        text.push('\n');
    }
    text
}

fn titles() -> Vec<String> {
    let titles = COLUMNS.iter().map(|column| column.title);
    [NAME_TITLE]
        .into_iter()
        .chain(titles)
        .map(str::to_owned)
        .collect()
}

fn cells(scene: &SceneChange<'_>) -> Vec<String> {
    let cells = COLUMNS.iter().map(|column| column.cell(scene));
    std::iter::once(scene.name.to_owned())
        .chain(cells)
        .collect()
}
