//! Runs many cases, in parallel where they do not disturb each other.
//!
//! Results are in order of id, independent of which case ends first.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use super::case::Case;
use super::conditions::Conditions;
use super::outcome::{CaseOutcome, Closing, Verdict};
use super::schedule::Schedule;
use super::suite::Selection;
use super::trial::Trial;

/// A case with its outcome.
#[derive(Debug)]
pub struct Tried {
    /// The case.
    pub case: Case,
    /// The outcome.
    pub outcome: CaseOutcome,
}

/// Runs the selected cases, `side_by_side` at a time, and reports each finished case to `progress`.
#[must_use]
pub fn run(
    cases: Vec<Case>,
    selection: &Selection,
    conditions: &Conditions,
    side_by_side: usize,
    progress: &mut (dyn Write + Send),
) -> Vec<Tried> {
    let mut wanted: Vec<_> = cases
        .into_iter()
        .filter(|case| selection.wants(case))
        .filter(|case| case.only_over.is_none_or(|only| only == conditions.carrier))
        .collect();
    let places: BTreeMap<_, _> = (wanted.iter().enumerate())
        .map(|(place, case)| (case.id.clone(), place))
        .collect();
    wanted.sort_by_key(|case| case.turn);
    let alone = wanted.partition_point(|case| case.turn != Schedule::Alone);
    let outcomes = Mutex::new(Vec::new());
    let progress = Mutex::new(progress);
    let play = |case: &Case| {
        let outcome = match selection.lacks(case) {
            Some(feature) => unsupported(&format!("the peer is declared to lack {feature:?}")),
            None => Trial::run(conditions, &case.id, |trial| case.run(trial)),
        };
        report_progress(case, &outcome, &progress);
        let mut outcomes = outcomes.lock().unwrap_or_else(PoisonError::into_inner);
        outcomes.push((case.id.clone(), outcome));
    };
    let next = AtomicUsize::new(0);
    thread::scope(|scope| {
        for _ in 0..side_by_side.max(1) {
            scope.spawn(|| {
                while let Some(case) = wanted[..alone].get(next.fetch_add(1, Ordering::Relaxed)) {
                    play(case);
                }
            });
        }
    });
    wanted[alone..].iter().for_each(play);
    let outcomes = outcomes
        .into_inner()
        .unwrap_or_else(PoisonError::into_inner);
    let mut outcomes: BTreeMap<_, _> = outcomes.into_iter().collect();
    wanted.sort_by_key(|case| places[&case.id]);
    let results = wanted.into_iter().map(|case| {
        let outcome = outcomes.remove(&case.id);
        let outcome = outcome.unwrap_or_else(|| CaseOutcome {
            verdict: Verdict::Inconclusive,
            why: "it did not run to its end".into(),
            ..unsupported("")
        });
        Tried { case, outcome }
    });
    results.collect()
}

fn unsupported(why: &str) -> CaseOutcome {
    CaseOutcome {
        verdict: Verdict::Unsupported,
        why: why.to_owned(),
        closing: Closing::NotJudged,
        took: std::time::Duration::ZERO,
        trace: Vec::new(),
    }
}

/// Reports a case as soon as it is over, unless it is good.
fn report_progress(case: &Case, outcome: &CaseOutcome, progress: &Mutex<&mut (dyn Write + Send)>) {
    if outcome.verdict == Verdict::Pass && outcome.closing.is_good() {
        return;
    }
    let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
    let (word, closing) = (outcome.verdict.word(), &outcome.closing);
    // A closed output is ignored: the report contains the same text.
    let _ = writeln!(progress, "{word:12} {case:?}: {} {closing}", outcome.why);
}
