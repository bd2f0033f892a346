//! The analysis: which trials count, its statistics, and its intervals.

use super::*;
use crate::settings::LoadOutcome;
use crate::settings::tests::settings;

/// A trial with these frame rates of integrated and naive at 500 and 1,000 balls.
pub(crate) fn trial(number: u32, fps: [[f64; 2]; 2]) -> ExperimentTrial {
    let outcome = |mode: &str, fps: f64| ModeOutcome {
        mode: mode.to_owned(),
        frames: 10,
        sim_fps: fps,
        sustained_fps: fps / 2.0,
        phys_ft_ms: 1e3 / fps,
        bytes_down: 1_000,
        ..ModeOutcome::default()
    };
    let load = |load, fps: [f64; 2]| LoadOutcome {
        load,
        modes: vec![outcome("integrated", fps[0]), outcome("naive", fps[1])],
    };
    ExperimentTrial {
        number,
        seed: u64::from(number),
        wall_s: 1.0,
        loads: vec![load(500, fps[0]), load(1_000, fps[1])],
    }
}

#[test]
fn degradation_begins_at_the_smallest_load_with_a_mean_below_nine() {
    let trials = [
        trial(1, [[11.0, 9.5], [9.2, 8.0]]),
        trial(2, [[11.0, 8.5], [8.8, 7.0]]),
    ];
    let analysis = Analysis::of(&settings(), &trials);
    let mdl = |mode: &str| {
        let found = analysis.degradation.iter().find(|found| found.mode == mode);
        found.map(|found| (found.mdl, found.sustained_mdl)).unwrap()
    };
    // Integrated: means 11 and exactly 9, which is not below. Naive: exactly 9 at 500, 7.5 at 1,000.
    assert_eq!(mdl("integrated"), (None, Some(500)));
    assert_eq!(mdl("naive"), (Some(1_000), Some(500)));
    assert_eq!(mdl("rhumb"), (None, None));
    let naive = analysis.mode(1_000, "naive").unwrap();
    assert_eq!((naive.sim_fps.count, naive.sim_fps.mean), (2, 7.5));
    let against = naive.against_integrated.unwrap();
    assert!((against.sim_fps.difference + 1.5).abs() < 1e-12);
    // Frames of 1/8 and 1/7 s beside 1/9.2 and 1/8.8 s: √(9.2/8 · 8.8/7).
    let paired = against.paired.unwrap();
    assert_eq!(paired.pairs, 2);
    assert!((paired.ratio - (1.15_f64 * 8.8 / 7.0).sqrt()).abs() < 1e-12);
    assert_eq!(
        analysis.mode(500, "integrated").unwrap().against_integrated,
        None
    );
    assert_eq!(naive.bytes_down.mean, 100.0);
}

#[test]
fn a_void_outcome_is_excluded_and_listed() {
    let mut trials = [
        trial(1, [[11.0, 10.0], [10.0, 10.0]]),
        trial(2, [[11.0, 1.0], [10.0, 10.0]]),
    ];
    trials[1].loads[0].modes[1].void = true;
    let analysis = Analysis::of(&settings(), &trials);
    let naive = analysis.mode(500, "naive").unwrap();
    assert_eq!((naive.sim_fps.count, naive.sim_fps.mean), (1, 10.0));
    let named = Void {
        trial: 2,
        seed: 2,
        load: 500,
        mode: "naive".to_owned(),
    };
    assert_eq!(analysis.void, [named]);
    trials[0].loads[0].modes[1].void = true;
    assert_eq!(Analysis::of(&settings(), &trials).mode(500, "naive"), None);
}

fn near(found: f64, expected: f64, within: f64) {
    assert!((found - expected).abs() <= within, "{found} for {expected}");
}

fn sample(count: usize, mean: f64, deviation: f64) -> Sample {
    Sample {
        count,
        mean,
        deviation: Some(deviation),
    }
}

#[test]
fn a_sample_has_the_mean_and_deviation_of_the_textbook_example() {
    // 2, 4, 4, 4, 5, 5, 7, 9: mean 5, squares sum to 32; 32 / 7 = 4.571428..., whose root is 2.138089935.
    let sample = Sample::of(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]).unwrap();
    assert_eq!((sample.count, sample.mean), (8, 5.0));
    near(sample.deviation.unwrap(), 2.138_089_935, 1e-9);
    assert_eq!(Sample::of(&[3.0]).unwrap().deviation, None);
    assert_eq!(Sample::of(&[]), None);
}

#[test]
fn the_z_test_reads_the_normal_table() {
    // (52 − 50) / √(36/36 + 64/64·…): errors 3²/36 + 4²/64 = 0.25 + 0.25, so z = 2 / √0.5 = 2.828427; from the
    // table of the normal distribution 2·(1 − Φ(2.83)) = 0.0047.
    let test = z_test(&sample(36, 52.0, 3.0), &sample(64, 50.0, 4.0)).unwrap();
    near(test.statistic.unwrap(), 2.828_427, 1e-6);
    near(test.p, 0.0047, 5e-5);
    // The critical value of α = 0.05: z = 1.96 has p = 0.0500.
    let test = z_test(&sample(100, 1.96, 1.0), &sample(100, 0.0, 0.0)).unwrap();
    near(test.statistic.unwrap(), 19.6, 1e-9);
    let test = z_test(&sample(100, 0.0, 1.0), &sample(100, 0.196, 0.0)).unwrap();
    near(test.statistic.unwrap(), -1.96, 1e-9);
    near(test.p, 0.0500, 5e-5);
}

#[test]
fn welchs_test_gives_the_published_p_values() {
    // Two examples widely used to check implementations. Two samples of 15.
    let first = [
        27.5, 21.0, 19.0, 23.6, 17.0, 17.9, 16.9, 20.1, 21.9, 22.6, 23.1, 19.6, 19.0, 21.7, 21.4,
    ];
    let second = [
        27.1, 22.0, 20.8, 23.4, 23.4, 23.5, 25.8, 22.0, 24.8, 20.2, 21.9, 22.1, 22.9, 20.5, 24.4,
    ];
    let test = Comparison::of(&first, &second, 1).unwrap().welch.unwrap();
    near(test.p, 0.021_378_001, 1e-8);
    // Counts 10 and 20.
    let first = [17.2, 20.9, 22.6, 18.1, 21.7, 21.4, 23.5, 24.2, 14.7, 21.8];
    let second = [
        21.5, 22.8, 21.0, 23.0, 21.6, 23.6, 22.5, 20.7, 23.4, 21.8, 20.7, 21.7, 21.5, 22.5, 23.6,
        21.5, 22.5, 23.5, 21.5, 21.8,
    ];
    let test = Comparison::of(&first, &second, 1).unwrap().welch.unwrap();
    near(test.p, 0.148_841_696, 1e-8);
}

#[test]
fn pairs_are_compared_by_the_mean_of_their_logarithms() {
    // Logarithms of 1.1, 1.2 and 1.3: mean 0.179999, deviation 0.083551, error 0.048238, t = 3.731444 with two degrees
    // of freedom; its 97.5th percentile is 4.302653, and p = 1 - t / √(2 + t²) = 0.064906.
    let found = Paired::of(&[(1.1, 1.0), (2.4, 2.0), (3.9, 3.0)]).unwrap();
    assert_eq!(found.pairs, 3);
    near(found.ratio, 1.197_216, 1e-6);
    let (interval, test) = (found.interval.unwrap(), found.test.unwrap());
    near(test.statistic.unwrap(), 3.731_444, 1e-6);
    near(test.p, 0.064_906, 1e-6);
    near(interval.from, 0.972_822, 1e-5);
    near(interval.to, 1.473_369, 1e-5);
    // A common scale cancels: the ratio is the same at any scale.
    let same = Paired::of(&[(2.0, 1.0), (60.0, 30.0)]).unwrap();
    assert_eq!((same.ratio, same.test.unwrap().p), (2.0, 0.0));
    let one = Paired::of(&[(3.0, 2.0)]).unwrap();
    assert_eq!((one.interval, one.test), (None, None));
    assert_eq!(Paired::of(&[]), None);
    assert_eq!(Paired::of(&[(1.0, 0.0)]), None);
}

#[test]
fn holms_method_stops_at_the_first_hypothesis_it_keeps() {
    // Holm: 0.01 · 4 and 0.013 · 3 are below 0.05; 0.03 · 2 is not and stops the method.
    let p = [0.03, 0.01, 0.04, 0.013];
    assert_eq!(rejected(&p, 0.05), [false, true, false, true]);
    assert_eq!(rejected(&[0.01, f64::NAN], 0.05), [true, false]);
    assert_eq!(rejected(&[], 0.05), [false; 0]);
}

#[test]
fn an_effect_is_the_difference_in_pooled_deviations() {
    // Pooled by hand: √((9·4 + 19·1) / 28) = √(55 / 28) = 1.401530; (12 − 10) / 1.401530 = 1.427011.
    let found = cohens_d(&sample(10, 12.0, 2.0), &sample(20, 10.0, 1.0)).unwrap();
    near(found, 1.427_012, 2e-6);
}

#[test]
fn samples_without_spread_are_either_equal_or_certainly_different() {
    let capped = [11.33; 5];
    let same = Comparison::of(&capped, &capped, 1).unwrap();
    assert_eq!((same.z.unwrap().p, same.welch.unwrap().p), (1.0, 1.0));
    assert_eq!((same.effect, same.z.unwrap().statistic), (None, None));
    let other = Comparison::of(&capped, &[3.0; 5], 1).unwrap();
    assert_eq!((other.z.unwrap().p, other.welch.unwrap().p), (0.0, 0.0));
    let interval = other.interval.unwrap();
    near(interval.from, 8.33, 1e-12);
    near(interval.to, 8.33, 1e-12);
}

#[test]
fn a_single_trial_is_compared_but_not_tested() {
    let one = Comparison::of(&[4.0], &[2.0], 1).unwrap();
    assert_eq!((one.difference, one.ratio), (2.0, 2.0));
    assert_eq!((one.z, one.welch, one.effect), (None, None, None));
    assert_eq!(one.interval, None);
    assert_eq!(Comparison::of(&[], &[2.0], 1), None);
}

#[test]
fn an_interval_has_about_the_theoretical_width_and_depends_only_on_the_seed() {
    // The standard error of the mean of 0, 1, ..., 99 is √(833.25 / 100) = 2.8866; of the difference of two such
    // means 4.0823. The interval spans 1.96 of these each way.
    let values: Vec<f64> = (0..100).map(f64::from).collect();
    let shifted: Vec<f64> = values.iter().map(|value| value + 10.0).collect();
    let interval = bootstrap(&shifted, &values, 7);
    near(interval.from, 10.0 - 1.96 * 4.0823, 0.4);
    near(interval.to, 10.0 + 1.96 * 4.0823, 0.4);
    assert_eq!(interval, bootstrap(&shifted, &values, 7));
    assert_ne!(interval, bootstrap(&shifted, &values, 8));
}
