//! Tries many cases, side by side where they do not disturb each other.
//!
//! Results are in order of id, whatever ended first.

use std::collections::BTreeMap;
use std::io::Write;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;

use super::case::{Case, Schedule};
use super::outcome::{CaseOutcome, Closing, Verdict};
use super::suite::Selection;
use super::trial::{Conditions, Trial};

/// A case with what came of it.
#[derive(Debug)]
pub struct Tried {
    /// The case.
    pub case: Case,
    /// What came of it.
    pub outcome: CaseOutcome,
}

/// Tries what is wanted of these cases, `side_by_side` at a time, and tells each that ends to `progress`.
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
            Some(feature) => unsupported(&format!("the peer is sent to have no {feature:?}")),
            None => Trial::run(conditions, case),
        };
        tell(case, &outcome, &progress);
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
            why: "it was not tried to its end".into(),
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

/// Tells of a case as soon as it is over.
fn tell(case: &Case, outcome: &CaseOutcome, progress: &Mutex<&mut (dyn Write + Send)>) {
    if outcome.verdict == Verdict::Pass && outcome.closing.is_good() {
        return;
    }
    let mut progress = progress.lock().unwrap_or_else(PoisonError::into_inner);
    let (word, closing) = (outcome.verdict.word(), &outcome.closing);
    // Nobody may be listening any more; the report has it too.
    let _ = writeln!(progress, "{word:12} {case:?}: {} {closing}", outcome.why);
}
