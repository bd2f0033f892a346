//! Several replays of one recording that differ in one setting.

use std::str::FromStr;

use rhumb_netsim::LinkConfig;

use super::source::ReplayOptions;

/// A setting's name and its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sweep {
    name: String,
    values: Vec<String>,
}

impl FromStr for Sweep {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, values) = text.split_once('=').ok_or("must be name=value,value,...")?;
        let values: Vec<_> = values.split(',').map(|v| v.trim().to_owned()).collect();
        if values.iter().any(String::is_empty) {
            return Err("a value is missing".to_owned());
        }
        let name = name.trim().to_owned();
        Ok(Self { name, values })
    }
}

impl Sweep {
    /// The options for each value.
    pub(super) fn over(&self, base: &ReplayOptions) -> Result<Vec<ReplayOptions>, String> {
        let with = |value: &String| change(base, &self.name, value);
        self.values.iter().map(with).collect()
    }
}

/// The options with one setting changed.
fn change(base: &ReplayOptions, name: &str, value: &str) -> Result<ReplayOptions, String> {
    let mut options = *base;
    let wrong = || format!("{name}={value}: not a number");
    match name {
        "tolerance" => options.tolerance_options.tolerance = value.parse().map_err(|_| wrong())?,
        "turn" => options.tolerance_options.turn = Some(value.parse().map_err(|_| wrong())?),
        "publish-interval" => options.publish_interval = value.parse().map_err(|_| wrong())?,
        "seed" => options.seed = value.parse().map_err(|_| wrong())?,
        "budget" if value == "none" => options.budget = None,
        "budget" => {
            let read = super::source::budget(value);
            options.budget = Some(read.map_err(|why| format!("budget={value}: {why}"))?);
        }
        _ => options.link = with_link(base.link, &format!("{name}={value}"))?,
    }
    Ok(options)
}

/// The link with some parts changed.
fn with_link(link: LinkConfig, parts: &str) -> Result<LinkConfig, String> {
    let text = format!("{link},{parts}");
    text.parse()
        .map_err(|error: rhumb_netsim::LinkConfigError| error.to_string())
}

/// Losses in percent, even and in bursts of four, at each round trip; zero loss has no bursts.
pub(super) fn matrix(base: &ReplayOptions) -> Result<Vec<ReplayOptions>, String> {
    let mut all = Vec::new();
    for rtt_ms in [0, 50, 100, 300] {
        for (loss, burst) in [(0, 1), (1, 1), (5, 1), (20, 1), (1, 4), (5, 4), (20, 4)] {
            let parts = format!("rtt={rtt_ms}ms,loss={loss}%,burst={burst}");
            let link = with_link(base.link, &parts)?;
            all.push(ReplayOptions { link, ..*base });
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU32;

    use rhumb_protocol::packet::LargestPacket;

    use super::*;
    use crate::replay::source::ToleranceOptions;

    fn base() -> ReplayOptions {
        ReplayOptions {
            tolerance_options: ToleranceOptions {
                tolerance: 0.01,
                turn: None,
            },
            link: "jitter=3ms".parse().unwrap(),
            publish_interval: NonZeroU32::MIN,
            seed: 1,
            lookahead: 0,
            budget: None,
            largest_packet: LargestPacket::DEFAULT,
        }
    }

    #[test]
    fn a_sweep_changes_one_setting_and_keeps_the_others() {
        let sweep: Sweep = "loss=1%,5%".parse().unwrap();
        let all = sweep.over(&base()).unwrap();
        let links: Vec<_> = all.iter().map(|options| options.link).collect();
        let expected = ["jitter=3ms,loss=1%", "jitter=3ms,loss=5%"].map(|t| t.parse().unwrap());
        assert_eq!(links, expected);
        let sweep: Sweep = "tolerance=0.02".parse().unwrap();
        assert!((sweep.over(&base()).unwrap()[0].tolerance_options.tolerance - 0.02).abs() < 1e-12);
        let sweep: Sweep = "budget=none,4000".parse().unwrap();
        let budgets = sweep
            .over(&base())
            .unwrap()
            .into_iter()
            .map(|options| options.budget);
        assert!(budgets.eq([None, rhumb_protocol::stream::Budget::per_second(4_000)]));
        let sweep: Sweep = "seed=1,12".parse().unwrap();
        let seeds = sweep.over(&base()).unwrap().into_iter();
        assert!(seeds.map(|options| options.seed).eq([1, 12]));
        assert_eq!(matrix(&base()).unwrap().len(), 28);
    }

    #[test]
    fn an_unknown_setting_is_refused() {
        assert!("tolerance".parse::<Sweep>().is_err());
        assert!("tolerance=1,".parse::<Sweep>().is_err());
        for wrong in [
            "tolerance=x",
            "publish-interval=0",
            "seed=-1",
            "budget=9",
            "colour=red",
        ] {
            let sweep: Sweep = wrong.parse().unwrap();
            assert!(sweep.over(&base()).is_err(), "{wrong}");
        }
    }
}
