//! Targets of the experiment, whether they are met, and numbers as text.

use rhumb_bench::numbers::number;
use rhumb_bench::record::Mode;

use crate::analysis::{Degradation, LoadAnalysis, ModeAnalysis, PaperResults};
use crate::page::Table;
use crate::statistics::{Interval, Sample};

const COLUMNS: [&str; 5] = ["target", "found", "95 % interval", "where", "met"];

/// A ratio at a load, and its interval where known.
#[derive(Clone, Copy, Debug)]
struct Ratio {
    load: u32,
    ratio: f64,
    interval: Option<Interval>,
}

/// Frame times and degradation.
pub(crate) fn aims(results: &PaperResults) -> Table {
    let mut table = Table::new("Targets", COLUMNS);
    for (mode, from, most) in [
        (Mode::Rhumb, 1_000, 1.10),
        (Mode::RhumbPipelined, 2_000, 0.05),
    ] {
        let ratios = at_loads(results, mode, from, |own| {
            let paired = own.against_integrated?.paired?;
            Some((paired.ratio, paired.interval))
        });
        let name = mode.name();
        let aim = format!("{name} frame at most {most} × integrated from {from} balls on");
        table
            .rows
            .extend(ratios.and_then(|all| of_worst(aim, &all, most)));
    }
    // The stricter target if the integrated engine steps more slowly than the server's.
    let beside = at_loads(results, Mode::Rhumb, 1_000, |own| {
        Some((own.phys_ft_ms.mean / own.step_ms.mean, None))
    });
    let aim = "rhumb frame at most 1.1 × its own engine's steps from 1000 balls on".to_owned();
    table
        .rows
        .extend(beside.and_then(|all| of_worst(aim, &all, 1.10)));
    table
        .rows
        .extend(of_degradation(results, Mode::Rhumb, |found| found.mdl));
    table
        .rows
        .extend(of_degradation(results, Mode::RhumbPipelined, |found| {
            found.sustained_mdl
        }));
    table.note = "Met: at every load; decided by the interval where known, or by the ratio where the interval spans \
                  the target. Found: at the worst load."
        .to_owned();
    table
}

/// A mode's ratio at each load from `from` on; `None` if one is missing, or there is none.
fn at_loads(
    results: &PaperResults,
    mode: Mode,
    from: u32,
    of: impl Fn(&ModeAnalysis) -> Option<(f64, Option<Interval>)>,
) -> Option<Vec<Ratio>> {
    let loads = results.analysis.loads.iter();
    let loads = loads.filter(|load| load.load >= from);
    let own = |load: &LoadAnalysis| {
        let own = load.modes.iter().find(|found| found.mode == mode.name())?;
        let (ratio, interval) = of(own)?;
        Some(Ratio {
            load: load.load,
            ratio,
            interval,
        })
    };
    let all: Vec<Ratio> = loads.map(own).collect::<Option<_>>()?;
    (!all.is_empty()).then_some(all)
}

/// A row for the worst ratio; `None` without ratios.
fn of_worst(aim: String, ratios: &[Ratio], most: f64) -> Option<Vec<String>> {
    let worst = ratios
        .iter()
        .max_by(|one, other| one.ratio.total_cmp(&other.ratio))?;
    let surely = |is: fn(&Interval, f64) -> bool| {
        move |of: &Ratio| of.interval.is_some_and(|interval| is(&interval, most))
    };
    let within = ratios
        .iter()
        .all(surely(|interval, most| interval.to <= most));
    let beyond = ratios
        .iter()
        .any(surely(|interval, most| interval.from > most));
    let met = match (beyond, within, worst.ratio <= most) {
        (true, ..) => "no",
        (_, true, _) => "yes",
        (_, _, true) => "yes, not significantly",
        (_, _, false) => "no, not significantly",
    };
    Some(vec![
        aim,
        number(Some(worst.ratio)),
        interval(worst.interval),
        format!("worst, at {} balls", worst.load),
        met.to_owned(),
    ])
}

/// True if a mode degrades no sooner than integrated, by SimFPS or by the sustained rate.
fn of_degradation(
    results: &PaperResults,
    mode: Mode,
    by: fn(&Degradation) -> Option<u32>,
) -> Option<Vec<String>> {
    let of = |mode: Mode| {
        let mut all = results.analysis.degradation.iter();
        let found = all.find(|found| found.mode == mode.name())?;
        Some(by(found))
    };
    let (own, integrated) = (of(mode)?, of(Mode::Integrated)?);
    let text = |mdl: Option<u32>| mdl.map_or_else(|| "nowhere".to_owned(), |mdl| mdl.to_string());
    let later = own.is_none_or(|own| integrated.is_some_and(|integrated| own >= integrated));
    let measure = if mode.is_ahead() {
        ", by sustained rate"
    } else {
        ""
    };
    Some(vec![
        format!(
            "{} degrades at no fewer balls than integrated{measure}",
            mode.name()
        ),
        text(own),
        NONE.to_owned(),
        format!("integrated: {}", text(integrated)),
        yes(later),
    ])
}

fn yes(met: bool) -> String {
    if met { "yes" } else { "no" }.to_owned()
}

/// Bytes. The target is meant for stages of 30 s; shorter stages need more updates per second.
pub(crate) fn aims_of_bytes(results: &PaperResults) -> Table {
    /// Times the bytes of rhumb.
    const LEAST: f64 = 600.0;
    let mut table = Table::new("Targets", COLUMNS);
    let total = |mode: Mode| {
        let bytes = results.analysis.loads.iter().map(|load| {
            let own = load.modes.iter().find(|found| found.mode == mode.name())?;
            Some(own.bytes_down.mean)
        });
        bytes.sum::<Option<f64>>()
    };
    if let Some((theirs, own)) = total(Mode::AppAll).zip(total(Mode::Rhumb)) {
        table.rows.push(vec![
            format!("app-all takes at least {LEAST} × the bytes of rhumb"),
            number(Some(theirs / own)),
            NONE.to_owned(),
            "whole experiment".to_owned(),
            yes(theirs / own >= LEAST),
        ]);
    }
    table
}

/// Cell of a missing value.
pub(super) const NONE: &str = "–";

/// Precision of a displayed figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Digits {
    /// Three significant digits.
    Three,
    /// Two decimals, as the paper prints frames per second.
    TwoPlaces,
}

impl Digits {
    pub(super) fn show(self, value: Option<f64>) -> String {
        match (self, value) {
            (Self::TwoPlaces, Some(value)) => format!("{value:.2}"),
            (_, value) => number(value),
        }
    }

    /// A mean and its standard deviation.
    pub(super) fn spread(self, sample: &Sample) -> String {
        let mean = self.show(Some(sample.mean));
        match sample.deviation {
            Some(deviation) => format!("{mean} ± {}", self.show(Some(deviation))),
            None => mean,
        }
    }
}

pub(super) fn probability(p: f64) -> String {
    if p < 0.0001 {
        "< 0.0001".to_owned()
    } else {
        format!("{p:.4}")
    }
}

pub(super) fn interval(interval: Option<Interval>) -> String {
    interval.map_or_else(
        || NONE.to_owned(),
        |Interval { from, to }| format!("{} to {}", number(Some(from)), number(Some(to))),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::Analysis;
    use crate::settings::tests::settings;
    use crate::settings::{ExperimentTrial, LoadOutcome, ModeOutcome};

    /// Trials with these frame times of integrated, rhumb and rhumb-pipelined at 500 and 1,000 balls, milliseconds;
    /// engine steps take half the integrated frame.
    fn results(trials: &[[[f64; 3]; 2]]) -> PaperResults {
        let mut settings = settings();
        settings.modes = ["integrated", "rhumb", "rhumb-pipelined"]
            .map(str::to_owned)
            .into();
        let load = |load, frames_ms: [f64; 3]| LoadOutcome {
            load,
            modes: settings
                .modes
                .iter()
                .zip(frames_ms)
                .map(|(mode, phys_ft_ms)| ModeOutcome {
                    mode: mode.clone(),
                    frames: 10,
                    phys_ft_ms,
                    step_ms: frames_ms[0] / 2.0,
                    sim_fps: 1e3 / phys_ft_ms,
                    sustained_fps: 1e3 / frames_ms[0].max(phys_ft_ms),
                    ..ModeOutcome::default()
                })
                .collect(),
        };
        let trials: Vec<ExperimentTrial> = (1..)
            .zip(trials)
            .map(|(number, [few, many])| ExperimentTrial {
                number,
                seed: u64::from(number),
                wall_s: 1.0,
                loads: vec![load(500, *few), load(1_000, *many)],
            })
            .collect();
        PaperResults {
            command: String::new(),
            analysis: Analysis::of(&settings, &trials),
            settings,
            trials,
        }
    }

    fn decisions(results: &PaperResults) -> Vec<(String, String)> {
        let rows = aims(results).rows.into_iter();
        rows.map(|row| (row[1].clone(), row[4].clone())).collect()
    }

    fn expected(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
        let owned = |(one, other): &(&str, &str)| ((*one).to_owned(), (*other).to_owned());
        pairs.iter().map(owned).collect()
    }

    #[test]
    fn only_loads_from_a_thousand_on_count_and_an_interval_decides() {
        // 1.05 and 1.07 of integrated: within 1.1 by their mean, but two trials spread farther.
        let near = results(&[
            [[10.0, 20.0, 1.0], [100.0, 105.0, 1.0]],
            [[10.0, 20.0, 1.0], [100.0, 107.0, 1.0]],
        ]);
        assert_eq!(
            decisions(&near),
            expected(&[
                ("1.06", "yes, not significantly"),
                ("2.12", "no, not significantly"),
                ("nowhere", "yes"),
                ("nowhere", "yes"),
            ])
        );
        let alike = [[10.0, 20.0, 1.0], [100.0, 105.0, 1.0]];
        assert_eq!(
            decisions(&results(&[alike, alike]))[0],
            ("1.05".into(), "yes".into())
        );
        let slow = [[10.0, 10.0, 1.0], [100.0, 125.0, 1.0]];
        let slow = decisions(&results(&[slow, slow]));
        assert_eq!(slow[0], ("1.25".into(), "no".into()));
        // 1/0.125 s is below nine frames a second, 1/0.1 s is not; a caller ahead keeps up what its server does.
        assert_eq!(slow[2..], expected(&[("1000", "no"), ("nowhere", "yes")]));
    }

    #[test]
    fn a_void_load_leaves_the_target_undecided() {
        let mut results = results(&[[[10.0, 10.0, 1.0], [100.0, 105.0, 1.0]]]);
        results.trials[0].loads[1].modes[1].void = true;
        results.analysis = Analysis::of(&results.settings, &results.trials);
        let rows = aims(&results).rows;
        assert!(
            rows.iter().all(|row| !row[0].contains("rhumb frame")),
            "{rows:?}"
        );
    }

    #[test]
    fn bytes_cover_the_whole_experiment() {
        let mut results = results(&[[[10.0, 10.0, 1.0], [100.0, 105.0, 1.0]]]);
        results.settings.modes[0] = "app-all".to_owned();
        for load in &mut results.trials[0].loads {
            load.modes[0].mode = "app-all".to_owned();
            load.modes[0].bytes_down = 6_010_000;
            load.modes[1].bytes_down = 10_000;
        }
        results.analysis = Analysis::of(&results.settings, &results.trials);
        assert_eq!(aims_of_bytes(&results).rows[0][1], "601");
        assert_eq!(aims_of_bytes(&results).rows[0][4], "yes");
    }
}
