//! The tables of where remote wins.

use super::RemoteResults;
use crate::paper::crossover::Crossover;
use crate::paper::table::Table;
use crate::summary::number;

/// The crossovers, a row each.
pub(in crate::paper) fn crossings_table(results: &RemoteResults) -> Table {
    let mut table = Table::new(
        "From where on remote beats integrated",
        [
            "depth",
            "on the move, %",
            "sought over",
            "in SimFPS",
            "uncapped",
        ],
    );
    for found in &results.crossings {
        let over = match (found.load, found.other_work_ms) {
            (Some(load), _) => format!("other work, at {load} bodies"),
            (_, Some(work)) => format!("bodies, at {work} ms of other work"),
            _ => String::new(),
        };
        let unit = if found.load.is_some() { "ms" } else { "bodies" };
        let cell = |crossover: Option<Crossover>| match crossover {
            None => "nowhere".to_owned(),
            Some(found) => {
                let from = if found.from_the_first {
                    "from the first, "
                } else {
                    "from "
                };
                let to = found
                    .to
                    .map_or_else(String::new, |to| format!(" to {}", number(Some(to))));
                format!("{from}{}{to} {unit}", number(Some(found.from)))
            }
        };
        table.rows.push(vec![
            found.depth.to_string(),
            found.awake_percent.to_string(),
            over,
            cell(found.capped),
            cell(found.uncapped),
        ]);
    }
    table.note = "Between measured points by straight lines. Where both reach 11.33 frames a second neither beats the \
                  other. Nowhere: within what was measured."
        .to_owned();
    table
}

/// What was aimed at, and what was found.
pub(in crate::paper) fn aims_table(results: &RemoteResults) -> Table {
    /// Of the engine's step, beside it, where most bodies sleep.
    const MOST: f64 = 0.05;
    const LOAD: u32 = 50_000;
    const AWAKE_PERCENT: u32 = 5;
    let mut table = Table::new("What was aimed at", ["aim", "found", "where", "met"]);
    let there = results.points.iter().filter(|point| {
        !point.void
            && point.depth.is_some()
            && point.load == LOAD
            && point.awake_percent == AWAKE_PERCENT
    });
    let beside = there.map(|point| (point.other_work_ms, point.depth, point.beside()));
    let Some((work, depth, worst)) = beside.max_by(|one, other| one.2.total_cmp(&other.2)) else {
        return table;
    };
    let depth = depth.unwrap_or_default();
    table.rows.push(vec![
        format!("{LOAD} bodies, {AWAKE_PERCENT} % on the move: observe and publish at most {MOST} of the engine's step"),
        number(Some(worst)),
        format!("worst, at {work} ms of other work, depth {depth}"),
        if worst <= MOST { "yes" } else { "no" }.to_owned(),
    ]);
    table
}

/// The points, a row each.
pub(in crate::paper) fn points_table(results: &RemoteResults) -> Table {
    let columns = [
        "bodies",
        "on the move, %",
        "awake",
        "other work, ms",
        "depth",
        "SimFPS",
        "uncapped",
        "frame, ms",
        "call, ms",
        "caller's own work, ms",
        "caller waits, ms",
        "engine, ms",
        "observe, ms",
        "publish, ms",
        "beside of engine",
    ];
    let mut table = Table::new("Frames, and where their time goes", columns);
    for point in &results.points {
        let depth = point
            .depth
            .map_or_else(|| "integrated".to_owned(), |depth| depth.to_string());
        let mut row = vec![
            point.load.to_string(),
            point.awake_percent.to_string(),
            point.awake.to_string(),
            point.other_work_ms.to_string(),
            if point.void {
                format!("{depth}, void")
            } else {
                depth
            },
        ];
        let waits = point.work_ms.map(|work| (point.call_ms - work).max(0.0));
        let values = [
            Some(point.sim_fps),
            Some(point.uncapped_fps),
            Some(point.frame_ms),
            Some(point.call_ms),
            point.work_ms,
            waits,
            Some(point.step_ms),
            Some(point.observe_ms),
            Some(point.publish_ms),
            Some(point.beside()),
        ];
        row.extend(values.map(number));
        table.rows.push(row);
    }
    table.note = "Of a caller that is ahead, engine, observe and publish are averages over the frames before those that are \
                  counted, too. Void: the engine did not do what the integrated one did; left out of the crossovers."
        .to_owned();
    table
}
