//! The tables of where remote wins.

use super::{RemoteResults, crossings, integrated};
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
            "uncapped, engines alike",
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
    table.note = "Between measured points by straight lines; to no end, if none is said. From the first: at the least that was \
                  measured already, and perhaps before. Where both reach 11.33 frames a second neither beats the \
                  other. Nowhere: within what was measured. Engines alike: beside an integrated engine whose steps take \
                  what they took at the server, so that what one machine did to the one or the other decides nothing."
        .to_owned();
    table
}

/// On which stretch remote beats.
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
        "{LOAD} bodies, {AWAKE_PERCENT} % on the move: observe and publish at most {MOST} of the engine's step"
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
        "frame, engines alike",
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
    table.note = "Of a caller that is ahead, engine, observe and publish are averages over the frames before those that are \
                  counted, too. Frame, engines alike: of what it would take beside an integrated engine with the same steps. \
                  Void: the engine did not do what the integrated one did; left out of the crossovers."
        .to_owned();
    table
}
