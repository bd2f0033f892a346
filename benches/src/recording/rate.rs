//! The constant rate of a recording, from its step or from its times.

use rhumb_reckoning::Rate;

/// Rates of recordings, Hz.
const HERTZ: std::ops::RangeInclusive<f64> = 1.0..=1_000.0;
/// Denominators of rates that are neither whole nor NTSC's.
const SECONDS_MAX: u32 = 10_000;

/// The simplest rate whose step is within `share` of this one: a whole one, or 1000/1001 of one as of film and
/// television, or the first of a hundred hertz with the fewest decimals. `None` beyond 1 to 1000 Hz.
pub(super) fn rate_of_step(step_s: f64, share: f64) -> Option<Rate> {
    let hertz = 1.0 / step_s;
    let in_range = (0.999..=1_000.5).contains(&hertz);
    if !in_range {
        return None;
    }
    let rate = |ticks: f64, seconds: u32| {
        let rate = Rate::new(ticks as u32, seconds)?;
        let hertz = f64::from(rate.ticks()) / f64::from(rate.seconds());
        let fits = (hertz * step_s - 1.0).abs() <= share && HERTZ.contains(&hertz);
        fits.then_some(rate)
    };
    let decimals = [10, 100, 1_000].map(|seconds| (hertz * f64::from(seconds), seconds));
    let simple = [(hertz, 1), (hertz * 1.001, 1)];
    let whole = rate(simple[0].0.round(), 1);
    let television = || rate((simple[1].0).round() * 1_000.0, 1_001);
    let decimal = || {
        let mut all = decimals.iter();
        all.find_map(|(ticks, seconds)| rate(ticks.round(), *seconds))
    };
    let finest = || rate((hertz * f64::from(SECONDS_MAX)).round(), SECONDS_MAX);
    let found = whole.or_else(television).or_else(decimal).or_else(finest)?;
    reduced(found)
}

/// The rate in lowest terms.
fn reduced(rate: Rate) -> Option<Rate> {
    let (mut a, mut b) = (rate.ticks(), rate.seconds());
    while b > 0 {
        (a, b) = (b, a % b);
    }
    Rate::new(rate.ticks() / a, rate.seconds() / a)
}

/// The rate of a number of hertz on the command line.
pub(super) fn rate_of_hertz(text: &str) -> Result<Rate, String> {
    let hertz: Option<f64> = text.parse().ok();
    let hertz = hertz.filter(|hertz| HERTZ.contains(hertz));
    let rate = hertz.and_then(|hertz| rate_of_step(1.0 / hertz, 1e-7));
    rate.ok_or_else(|| "must be a number of hertz from 1 to 1000".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_of_cameras_and_engines_are_exact_from_a_step_in_single_precision() {
        for (hertz, ticks, seconds) in [
            (60.0, 60, 1),
            (1.0, 1, 1),
            (1_000.0, 1_000, 1),
            (30_000.0 / 1_001.0, 30_000, 1_001),
            (29.97, 2_997, 100),
            (119.88, 2_997, 25),
            (120_000.0 / 1_001.0, 120_000, 1_001),
            (22.5, 45, 2),
            (11.33, 1_133, 100),
            (59.94, 2_997, 50),
        ] {
            let step_s = f64::from((1.0 / hertz) as f32);
            let rate = rate_of_step(step_s, 1e-7).unwrap();
            assert_eq!((rate.ticks(), rate.seconds()), (ticks, seconds), "{hertz}");
        }
        for step_s in [0.0, -1.0, 2.0, 1e-4, f64::NAN, f64::INFINITY] {
            assert_eq!(rate_of_step(step_s, 1e-7), None, "{step_s}");
        }
    }

    #[test]
    fn a_rate_on_the_command_line_is_exact() {
        assert_eq!(
            rate_of_hertz("29.97").unwrap(),
            Rate::new(2_997, 100).unwrap()
        );
        for wrong in ["", "0", "-60", "1001", "fast", "NaN"] {
            assert!(rate_of_hertz(wrong).is_err(), "{wrong}");
        }
    }
}
