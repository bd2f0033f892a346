//! Statistics of repeated trials of two modes, and tests of their difference.
//!
//! Works on plain numbers. Distributions come from `statrs`; resampling is seeded.

use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// Number of resamples for an interval.
const RESAMPLES: usize = 10_000;

/// Count, mean and spread of values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Sample {
    /// Number of values.
    pub(crate) count: usize,
    /// Arithmetic mean.
    pub(crate) mean: f64,
    /// Standard deviation with count − 1 in the denominator; `None` for a single value.
    pub(crate) deviation: Option<f64>,
}

impl Sample {
    /// `None` without values.
    #[must_use]
    pub(crate) fn of(values: &[f64]) -> Option<Self> {
        let count = values.len();
        if count == 0 {
            return None;
        }
        let mean = values.iter().sum::<f64>() / count as f64;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        Some(Self {
            count,
            mean,
            deviation: (count > 1).then(|| (squares / (count - 1) as f64).sqrt()),
        })
    }

    /// Square of the mean's standard error.
    fn error_squared(&self) -> Option<f64> {
        Some(self.deviation?.powi(2) / self.count as f64)
    }
}

/// A test of the hypothesis that two means are equal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Test {
    /// Difference of the means in standard errors, first minus second; `None` without any spread.
    pub(crate) statistic: Option<f64>,
    /// Two-tailed probability of such a difference or a greater one if the means are equal.
    pub(crate) p: f64,
}

/// An interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Interval {
    /// Lower end.
    pub(crate) from: f64,
    /// Upper end.
    pub(crate) to: f64,
}

/// Comparison of two samples; differences are first minus second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Comparison {
    /// Mean of the first minus mean of the second.
    pub(crate) difference: f64,
    /// Mean of the first over mean of the second.
    pub(crate) ratio: f64,
    /// The paper's test, with the samples' deviations in place of the populations'. `None` with a single trial.
    pub(crate) z: Option<Test>,
    /// Welch's test: Student's distribution, unequal variances. `None` with a single trial.
    pub(crate) welch: Option<Test>,
    /// Cohen's d: the difference in pooled standard deviations. `None` with a single trial or without any spread.
    pub(crate) effect: Option<f64>,
    /// Central 95 % of the differences of resampled means. `None` with a single trial.
    pub(crate) interval: Option<Interval>,
}

/// Ratio of paired values, such as two modes of one trial with the same seed and machine conditions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Paired {
    /// Number of pairs.
    pub(crate) pairs: usize,
    /// Geometric mean of first over second.
    pub(crate) ratio: f64,
    /// 95 % interval of the ratio, by Student's distribution of the mean logarithm. `None` for a single pair.
    pub(crate) interval: Option<Interval>,
    /// Student's test of the hypothesis that the mean logarithm is zero. `None` for a single pair.
    pub(crate) test: Option<Test>,
}

impl Paired {
    /// `None` without pairs, or if a value is not above zero.
    #[must_use]
    pub(crate) fn of(pairs: &[(f64, f64)]) -> Option<Self> {
        let logs = pairs.iter().map(|(first, second)| {
            let sound = *first > 0.0 && *second > 0.0;
            sound.then(|| (first / second).ln())
        });
        let logs: Vec<f64> = logs.collect::<Option<_>>()?;
        let sample = Sample::of(&logs)?;
        let error = sample.error_squared().map(f64::sqrt);
        let student = StudentsT::new(0.0, 1.0, (sample.count - 1) as f64);
        let student = error.zip(student.ok());
        Some(Self {
            pairs: sample.count,
            ratio: sample.mean.exp(),
            interval: student.map(|(error, student)| {
                let half = error * student.inverse_cdf(0.975);
                Interval {
                    from: (sample.mean - half).exp(),
                    to: (sample.mean + half).exp(),
                }
            }),
            test: student.map(|(error, student)| {
                let statistic = (error > 0.0).then(|| sample.mean / error);
                Test {
                    statistic,
                    p: statistic.map_or_else(
                        || p_without_spread(sample.mean),
                        |t| 2.0 * student.cdf(-t.abs()),
                    ),
                }
            }),
        })
    }
}

/// Hypotheses rejected at a family-wise level (Holm's step-down method).
#[must_use]
pub(crate) fn rejected(p: &[f64], level: f64) -> Vec<bool> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|one, other| p[*one].total_cmp(&p[*other]));
    let mut rejected = vec![false; p.len()];
    for (before, place) in order.into_iter().enumerate() {
        let left = (p.len() - before) as f64;
        // In this form NaN rejects nothing.
        let small = p[place] * left < level;
        if !small {
            break;
        }
        rejected[place] = true;
    }
    rejected
}

impl Comparison {
    /// Compares two samples; `None` if one is empty.
    #[must_use]
    pub(crate) fn of(first: &[f64], second: &[f64], seed: u64) -> Option<Self> {
        let (one, other) = (Sample::of(first)?, Sample::of(second)?);
        let several = first.len() > 1 && second.len() > 1;
        Some(Self {
            difference: one.mean - other.mean,
            ratio: one.mean / other.mean,
            z: z_test(&one, &other),
            welch: welch_test(&one, &other),
            effect: cohens_d(&one, &other),
            interval: several.then(|| bootstrap(first, second, seed)),
        })
    }
}

/// The difference in standard errors, and the error's square; the statistic is `None` without any spread.
fn standardised(one: &Sample, other: &Sample) -> Option<(Option<f64>, f64)> {
    let squared = one.error_squared()? + other.error_squared()?;
    let difference = one.mean - other.mean;
    let statistic = (squared > 0.0).then(|| difference / squared.sqrt());
    Some((statistic, difference))
}

/// Without any spread, equal means have p = 1 and other means p = 0.
fn p_without_spread(difference: f64) -> f64 {
    if difference == 0.0 { 1.0 } else { 0.0 }
}

/// Two-tailed two-sample Z-test.
fn z_test(one: &Sample, other: &Sample) -> Option<Test> {
    let (statistic, difference) = standardised(one, other)?;
    let p = match statistic {
        Some(z) => 2.0 * Normal::standard().cdf(-z.abs()),
        None => p_without_spread(difference),
    };
    Some(Test { statistic, p })
}

/// Welch's two-tailed t-test, with the degrees of freedom of Welch and Satterthwaite.
fn welch_test(one: &Sample, other: &Sample) -> Option<Test> {
    let (statistic, difference) = standardised(one, other)?;
    let p = match statistic {
        Some(t) => {
            let (a, b) = (one.error_squared()?, other.error_squared()?);
            let parts = a.powi(2) / (one.count - 1) as f64 + b.powi(2) / (other.count - 1) as f64;
            let student = StudentsT::new(0.0, 1.0, (a + b).powi(2) / parts).ok()?;
            2.0 * student.cdf(-t.abs())
        }
        None => p_without_spread(difference),
    };
    Some(Test { statistic, p })
}

/// The difference of the means in pooled standard deviations.
fn cohens_d(one: &Sample, other: &Sample) -> Option<f64> {
    let sum = |sample: &Sample| Some(sample.deviation?.powi(2) * (sample.count - 1) as f64);
    let pooled = (sum(one)? + sum(other)?) / (one.count + other.count - 2) as f64;
    (pooled > 0.0).then(|| (one.mean - other.mean) / pooled.sqrt())
}

/// Central 95 % of differences of means, each side resampled separately (percentile bootstrap).
fn bootstrap(first: &[f64], second: &[f64], seed: u64) -> Interval {
    /// The generator's stream number: PCG's own example.
    const STREAM: u64 = 0x0a02_bdbf_7bb3_c0a7;
    let mut draws = Pcg32::new(seed, STREAM);
    let mut mean_again = |values: &[f64]| {
        let pick = |_| values[((u64::from(draws.next_u32()) * values.len() as u64) >> 32) as usize];
        (0..values.len()).map(pick).sum::<f64>() / values.len() as f64
    };
    let mut differences: Vec<f64> = (0..RESAMPLES)
        .map(|_| mean_again(first) - mean_again(second))
        .collect();
    let mut at = |share: f64| {
        let place = ((RESAMPLES - 1) as f64 * share).round() as usize;
        *differences.select_nth_unstable_by(place, f64::total_cmp).1
    };
    Interval {
        from: at(0.025),
        to: at(0.975),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
            27.5, 21.0, 19.0, 23.6, 17.0, 17.9, 16.9, 20.1, 21.9, 22.6, 23.1, 19.6, 19.0, 21.7,
            21.4,
        ];
        let second = [
            27.1, 22.0, 20.8, 23.4, 23.4, 23.5, 25.8, 22.0, 24.8, 20.2, 21.9, 22.1, 22.9, 20.5,
            24.4,
        ];
        let test = Comparison::of(&first, &second, 1).unwrap().welch.unwrap();
        near(test.p, 0.021_378_001, 1e-8);
        // Counts 10 and 20.
        let first = [17.2, 20.9, 22.6, 18.1, 21.7, 21.4, 23.5, 24.2, 14.7, 21.8];
        let second = [
            21.5, 22.8, 21.0, 23.0, 21.6, 23.6, 22.5, 20.7, 23.4, 21.8, 20.7, 21.7, 21.5, 22.5,
            23.6, 21.5, 22.5, 23.5, 21.5, 21.8,
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
}
