//! What the experiment says in sentences, each computed from the results.

use super::analysis::{ALPHA, ModeAnalysis};
use super::experiment::PaperResults;
use super::tables;
use crate::record::Mode;
use crate::summary::number;

/// From so many balls on the paper found its distributed engine slower at every load.
const FROM: u32 = 1_000;

/// A sentence on each mode but integrated, one on how it was run, and those on what is void.
pub(super) fn sentences(results: &PaperResults) -> Vec<String> {
    let settings = &results.settings;
    let mut said = vec![format!(
        "{} trials of {} to {} balls, {} frames a stage, seeds {} to {}, on {} ({}; {} build).",
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
    said.extend(others.filter_map(|mode| of_mode(results, mode)));
    said.extend(tables::void(results));
    said
}

/// How a mode's frame stands to the integrated one over the loads from a thousand on, or over all if there are none.
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
        .filter_map(|(_, own)| Some(own.against_integrated?.phys_ft_ms.ratio))
        .collect();
    let (best, worst) = (
        ratios.iter().copied().reduce(f64::min)?,
        ratios.iter().copied().reduce(f64::max)?,
    );
    let slower: Vec<String> = found
        .iter()
        .filter(|(_, own)| {
            own.against_integrated.is_some_and(|against| {
                let fps = against.sim_fps;
                fps.difference < 0.0 && fps.z.is_some_and(|test| test.p < ALPHA)
            })
        })
        .map(|(load, _)| load.to_string())
        .collect();
    let range = if reaches {
        format!("from {FROM} balls on")
    } else {
        "at these loads".to_owned()
    };
    let spoken = if slower.is_empty() {
        "nowhere is its SimFPS lower than integrated by the Z-test".to_owned()
    } else {
        format!(
            "its SimFPS is lower than integrated by the Z-test at {} balls",
            slower.join(", ")
        )
    };
    Some(format!(
        "{mode}: a frame takes {} to {} times the integrated one {range}; {spoken}.",
        number(Some(best)),
        number(Some(worst)),
    ))
}
