//! `paper.md` and `paper.html`: sentences, tables and figures of the paper.
//!
//! The sentences are computed from the experiment's results.

use std::fmt::Write as _;

use rhumb_bench::numbers::number;
use rhumb_bench::record::Mode;
use rhumb_bench::report::escape;

use crate::analysis::{ALPHA, ModeAnalysis, PaperResults};
use crate::page::{Table, figure_html, page};
use crate::statistics::rejected;
use crate::{figures, tables};

/// All tables, in order.
fn all_tables(results: &PaperResults) -> Vec<Table> {
    vec![
        tables::aims(results),
        tables::sim_fps(results),
        tables::phys_ft(results),
        tables::degradation(results),
        tables::sustained(results),
        tables::paired(results),
        tables::tests_frame(results),
        tables::tests_fps(results),
        tables::stages(results),
        tables::traffic(results),
    ]
}

/// The text of `paper.md`.
pub(crate) fn markdown(results: &PaperResults) -> String {
    let mut text = format!(
        "# The paper's experiment, run again\n\n`{}`\n\n",
        results.command
    );
    for sentence in sentences(results) {
        let _ = writeln!(text, "- {sentence}");
    }
    for table in all_tables(results) {
        let _ = write!(text, "\n## {}\n\n{}", table.title, table.to_markdown());
    }
    text
}

/// The text of `paper.html`, which is self-contained.
pub(crate) fn html(results: &PaperResults) -> String {
    let mut body = format!("<pre>{}</pre>\n<ul>\n", escape(&results.command));
    for sentence in sentences(results) {
        let _ = writeln!(body, "<li>{}</li>", escape(&sentence));
    }
    body.push_str("</ul>\n");
    for figure in [figures::sim_fps(results), figures::phys_ft(results)] {
        body.push_str(&figure_html(&figure));
    }
    for table in all_tables(results) {
        body.push_str(&table.to_html());
    }
    page("The paper's experiment, run again", &body)
}

/// Smallest load of which the paper states that its distributed engine is always slower.
const FROM: u32 = 1_000;

/// One sentence on the experiment, one per mode except integrated, and one per void outcome.
pub(crate) fn sentences(results: &PaperResults) -> Vec<String> {
    let settings = &results.settings;
    let mut sentences = vec![format!(
        "{} trials of {} to {} balls, {} frames per stage, seeds {} to {}, on {} ({}; {} build).",
        results.trials.len(),
        settings.loads.first().copied().unwrap_or_default(),
        settings.loads.last().copied().unwrap_or_default(),
        settings.frames_per_load,
        settings.seed,
        settings.seed_of(results.trials.len().max(1) as u32),
        settings.machine,
        settings.cores,
        settings.build,
    )];
    let others = settings
        .modes
        .iter()
        .filter(|mode| *mode != Mode::Integrated.name());
    sentences.extend(others.filter_map(|mode| of_mode(results, mode)));
    if results.trials.len() > 1 {
        sentences.push(format!(
            "Significant: by paired t-tests of the trials' ratios, α = {ALPHA} for all these loads of a mode \
             together (Holm)."
        ));
    }
    sentences.extend(tables::void(results));
    sentences
}

/// Compares a mode's frame with the integrated one over the loads from a thousand on, or over all if there are none.
fn of_mode(results: &PaperResults, mode: &str) -> Option<String> {
    let reaches = results.settings.loads.iter().any(|load| *load >= FROM);
    let least = if reaches { FROM } else { 0 };
    let loads = results
        .analysis
        .loads
        .iter()
        .filter(|load| load.load >= least);
    let found: Vec<(u32, &ModeAnalysis)> = loads
        .filter_map(|load| Some((load.load, results.analysis.mode(load.load, mode)?)))
        .collect();
    let ratios: Vec<f64> = found
        .iter()
        .filter_map(|(_, own)| Some(own.against_integrated?.paired?.ratio))
        .collect();
    let (best, worst) = (
        ratios.iter().copied().reduce(f64::min)?,
        ratios.iter().copied().reduce(f64::max)?,
    );
    let tests: Vec<(u32, f64, f64)> = found
        .iter()
        .filter_map(|(load, own)| {
            let paired = own.against_integrated?.paired?;
            Some((*load, paired.ratio, paired.test?.p))
        })
        .collect();
    let p: Vec<f64> = tests.iter().map(|(.., p)| *p).collect();
    let significant = rejected(&p, ALPHA);
    let those = |longer: bool| {
        let selected = tests
            .iter()
            .zip(&significant)
            .filter(|(_, significant)| **significant);
        let these = selected.filter(|((_, ratio, _), _)| (*ratio > 1.0) == longer);
        let loads: Vec<u32> = these.map(|((load, ..), _)| *load).collect();
        at_loads(&loads, found.len())
    };
    let range = if reaches {
        format!("from {FROM} balls on")
    } else {
        "at these loads".to_owned()
    };
    let significance = if tests.is_empty() {
        String::new()
    } else {
        format!(
            "; significantly longer {}, significantly shorter {}",
            those(true),
            those(false)
        )
    };
    Some(format!(
        "{mode}: a frame takes {} to {} times the integrated one {range}{significance}.",
        number(Some(best)),
        number(Some(worst)),
    ))
}

/// Lists the loads, or counts them if there are many.
fn at_loads(loads: &[u32], of: usize) -> String {
    /// Longest list of loads; longer ones are counted.
    const NAMED: usize = 5;
    match loads {
        [] => "nowhere".to_owned(),
        _ if loads.len() == of => "everywhere".to_owned(),
        _ if loads.len() > NAMED => format!("at {} of {of} loads", loads.len()),
        _ => {
            let names: Vec<String> = loads.iter().map(u32::to_string).collect();
            format!("at {}", names.join(", "))
        }
    }
}
