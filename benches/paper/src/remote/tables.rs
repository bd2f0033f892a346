//! Tables of the remote task.

use rhumb_bench::numbers::number;

use super::results::{Crossover, RemoteResults, crossings, integrated};
use crate::page::Table;

/// The crossovers, a row each.
pub(crate) fn crossings_table(results: &RemoteResults) -> Table {
    let mut table = Table::new(
        "Where remote beats integrated",
        [
            "depth",
            "in motion, %",
            "searched over",
            "in SimFPS",
            "uncapped",
            "uncapped, equal engines",
        ],
    );
    for found in crossings(&results.points) {
        let over = match (found.load, found.other_work_ms) {
            (Some(load), _) => format!("other work, at {load} bodies"),
            (_, Some(work)) => format!("bodies, at {work} ms of other work"),
            _ => String::new(),
        };
        let unit = if found.load.is_some() { "ms" } else { "bodies" };
        let cell = |stretches: &[Crossover]| {
            let stretches = stretches.iter().map(|stretch| stretch_text(*stretch, unit));
            let stretches: Vec<_> = stretches.collect();
            match &stretches[..] {
                [] => "nowhere".to_owned(),
                some => some.join("; "),
            }
        };
        table.rows.push(vec![
            found.depth.to_string(),
            found.awake_percent.to_string(),
            over,
            cell(&found.capped),
            cell(&found.uncapped),
            cell(&found.engines_alike),
        ]);
    }
    table.note = "Interpolated linearly between measured points; without an end, the interval is open. From the \
                  first: already at the smallest measured value, and perhaps below. Where both reach 11.33 frames \
                  per second neither beats the other. Nowhere: not within the measured range. Equal engines: \
                  compared with an integrated engine whose steps take as long as at the server, so noise of one \
                  engine decides nothing."
        .to_owned();
    table
}

/// An interval in which remote beats integrated, as text.
fn stretch_text(stretch: Crossover, unit: &str) -> String {
    let from = number(Some(stretch.from));
    let from = match stretch.from_the_first {
        true => format!("from the first, {from}"),
        false => format!("from {from}"),
    };
    match stretch.to {
        None => format!("{from} {unit}"),
        Some(to) => format!("{from} to {} {unit}", number(Some(to))),
    }
}

/// Targets and results.
pub(crate) fn aims_table(results: &RemoteResults) -> Table {
    /// Largest allowed share of the engine's step where most bodies sleep.
    const MOST: f64 = 0.05;
    const LOAD: u32 = 50_000;
    const AWAKE_PERCENT: u32 = 5;
    let mut table = Table::new("Targets", ["target", "found", "where", "met"]);
    let there = results.points.iter().filter(|point| {
        !point.void
            && point.depth.is_some()
            && point.load == LOAD
            && point.awake_percent == AWAKE_PERCENT
    });
    let there: Vec<_> = there.collect();
    let worst = there
        .iter()
        .max_by(|one, other| one.beside().total_cmp(&other.beside()));
    let Some(worst) = worst else {
        return table;
    };
    let mean = there.iter().map(|point| point.beside()).sum::<f64>() / there.len() as f64;
    let (work, depth) = (worst.other_work_ms, worst.depth.unwrap_or_default());
    let aim = format!(
        "{LOAD} bodies, {AWAKE_PERCENT} % in motion: observe and publish at most {MOST} of the engine's step"
    );
    for (found, place) in [
        (mean, format!("on average of {} points", there.len())),
        (
            worst.beside(),
            format!("worst, at {work} ms of other work, depth {depth}"),
        ),
    ] {
        table.rows.push(vec![
            aim.clone(),
            number(Some(found)),
            place,
            if found <= MOST { "yes" } else { "no" }.to_owned(),
        ]);
    }
    table
}

/// The points, a row each.
pub(crate) fn points_table(results: &RemoteResults) -> Table {
    let columns = [
        "bodies",
        "in motion, %",
        "awake",
        "other work, ms",
        "depth",
        "SimFPS",
        "uncapped",
        "frame, ms",
        "call, ms",
        "caller's work, ms",
        "caller waits, ms",
        "engine, ms",
        "observe, ms",
        "publish, ms",
        "rest of server, of engine",
        "frame, equal engines",
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
            integrated(results.points.iter(), point)
                .filter(|own| !own.void && !point.void)
                .map(|own| point.frame_ms / point.frame_of(own)),
        ];
        row.extend(values.map(number));
        table.rows.push(row);
    }
    table.note = "For pipelined callers, engine, observe and publish are averages that include the uncounted frames. \
                  Frame, equal engines: relative to an integrated engine with the same steps. Void: the engine \
                  diverged from the integrated one; excluded from the crossovers."
        .to_owned();
    table
}
