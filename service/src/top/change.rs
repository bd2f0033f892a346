//! Rates of a scene: the difference of two readings.

use super::reading::{Reading, SceneReading};

/// A scene's figures, and how they changed since the reading before.
#[derive(Clone, Copy, Debug)]
pub(super) struct SceneChange<'a> {
    pub(super) name: &'a str,
    now: &'a SceneReading,
    before: Option<&'a SceneReading>,
    /// Seconds between the readings.
    seconds: f64,
}

impl<'a> SceneChange<'a> {
    /// All scenes of a reading, in the order of names.
    pub(super) fn all(
        now: &'a Reading,
        before: Option<&'a Reading>,
    ) -> impl Iterator<Item = SceneChange<'a>> {
        let nanos = before.map_or(0, |before| now.at.since(before.at).as_nanos());
        now.scenes.iter().map(move |(name, scene)| SceneChange {
            name,
            now: scene,
            before: before.and_then(|before| before.scenes.get(name)),
            seconds: nanos as f64 / 1e9,
        })
    }

    /// A figure of the newest reading.
    pub(super) fn value(&self, figure: &str) -> Option<f64> {
        self.now.value(figure)
    }

    /// Growth of a count in a second. `None` without a reading before, and for a count that began anew.
    pub(super) fn rate(&self, figure: &str) -> Option<f64> {
        let grown = self.growth(figure)?;
        (self.seconds > 0.0).then(|| grown / self.seconds)
    }

    fn growth(&self, figure: &str) -> Option<f64> {
        let grown = self.now.value(figure)? - self.before?.value(figure)?;
        (grown >= 0.0).then_some(grown)
    }

    /// Duration within which this share of the steps was done since the reading before, seconds, interpolated within the
    /// buckets of the histogram; infinite beyond the last. Without such steps: of all steps so far.
    pub(super) fn step_quantile(&self, share: f64) -> Option<f64> {
        let before = self.before.map_or(&[][..], |before| &before.steps_within);
        let fits = before.len() == self.now.steps_within.len();
        let recent = self.now.steps_within.iter().enumerate().map(|(at, now)| {
            let earlier = if fits { before[at].1 } else { 0.0 };
            (now.0, now.1 - earlier)
        });
        quantile(recent, share).or_else(|| quantile(self.now.steps_within.iter().copied(), share))
    }

    /// Time on the scene's thread for steps and publishing, as a share of the time of a second.
    pub(super) fn busy(&self) -> Option<f64> {
        let publish = self.rate("publish_seconds_total")?;
        Some(self.rate("step_seconds_sum")? + publish)
    }

    /// Mean time of publishing a tick, seconds.
    pub(super) fn publish_mean(&self) -> Option<f64> {
        let steps = self.growth("step_seconds_count")?;
        let publish = self.growth("publish_seconds_total")?;
        (steps > 0.0).then(|| publish / steps)
    }
}

/// A quantile of a histogram of cumulative counts.
fn quantile(within: impl Iterator<Item = (f64, f64)> + Clone, share: f64) -> Option<f64> {
    let total = within.clone().last()?.1;
    if total <= 0.0 {
        return None;
    }
    let rank = total * share;
    let (mut start, mut below) = (0.0, 0.0);
    for (end, count) in within {
        if count >= rank && count > below {
            let part = (rank - below) / (count - below);
            return Some(if end.is_finite() {
                start + (end - start) * part
            } else {
                end
            });
        }
        (start, below) = (end, count);
    }
    None
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::{Instant, Span};

    use super::*;

    fn reading(seconds: u64, tick: u64, steps: [u64; 3]) -> Reading {
        let [first, second, all] = steps;
        let bucket = |end: &str, count| {
            format!("rhumb_scene_step_seconds_bucket{{scene=\"pit\",le=\"{end}\"}} {count}\n")
        };
        let text = format!(
            "rhumb_scenes 1\nrhumb_scene_tick{{scene=\"pit\"}} {tick}\n{}{}{}",
            bucket("0.001", first),
            bucket("0.002", second),
            bucket("+Inf", all)
        );
        let at = Instant::ZERO + Span::from_millis(seconds * 1_000);
        Reading::parse(at, true, &text).unwrap()
    }

    fn of<'a>(now: &'a Reading, before: Option<&'a Reading>) -> SceneChange<'a> {
        SceneChange::all(now, before).next().unwrap()
    }

    #[test]
    fn a_rate_is_growth_over_time_and_unknown_without_two_readings() {
        let (before, now) = (reading(1, 100, [0; 3]), reading(3, 220, [0; 3]));
        assert_eq!(of(&now, Some(&before)).rate("tick"), Some(60.0));
        assert_eq!(of(&now, None).rate("tick"), None);
        assert_eq!(of(&before, Some(&now)).rate("tick"), None, "it began anew");
    }

    #[test]
    fn quantiles_are_of_the_steps_since_the_reading_before() {
        let before = reading(1, 0, [1_000, 1_000, 1_000]);
        let now = reading(2, 60, [1_000, 1_080, 1_100]);
        let change = of(&now, Some(&before));
        let median = change.step_quantile(0.5).unwrap();
        assert!((median - 0.001_625).abs() < 1e-12, "{median}");
        assert_eq!(change.step_quantile(0.99), Some(f64::INFINITY));
        let idle = of(&before, Some(&before));
        assert_eq!(idle.step_quantile(0.5), Some(0.000_5), "of all steps");
        let none = reading(1, 0, [0; 3]);
        assert_eq!(of(&none, None).step_quantile(0.5), None);
    }
}
