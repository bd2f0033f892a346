//! Configuration of a simulated link, and its text form.
//!
//! Carries nothing. Invariant: no probability exceeds one, and the burst length allows the loss. A probability is a
//! whole number of millionths, so that parsing, printing and decisions are equal on every platform.

use std::fmt;
use std::str::FromStr;

use rhumb_protocol::Span;

/// Configuration of one direction of a link.
///
/// Written as a list, `rtt=100ms,loss=5%,burst=3,jitter=10ms,dup=1%,reorder=2%,rate=1mbit,queue=64kB`, in any order.
/// Omitted parameters are perfect, and the empty text is a perfect link. Times need `s`, `ms` or `us`; shares `%`;
/// rates `bit`, `kbit`, `mbit` or `gbit` (per second); sizes `B`, `kB` or `MB` (powers of 1000); `burst` is a plain
/// count of packets. `rtt` covers both directions: the delay of one is half of it. `delay` sets one direction and may
/// be used instead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkConfig {
    /// Delay of every packet.
    pub delay: Span,
    /// Additional delay of a packet, uniform in [0, jitter]; order is kept.
    pub jitter: Span,
    /// Share of packets that are lost.
    pub loss: Probability,
    /// Mean length of a run of losses, in packets; below 2, losses are independent.
    pub burst: u32,
    /// Share of packets that arrive twice.
    pub duplicates: Probability,
    /// Share of packets that are delayed by up to 20 ms while later ones pass.
    pub reorder: Probability,
    /// Rate limit, bytes per second; `None` for no limit.
    pub rate_bytes: Option<u64>,
    /// Capacity of the queue before the rate limit, in bytes; packets beyond it are lost.
    pub queue_bytes: u64,
}

/// Error of a written configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum LinkConfigError {
    /// This part is not of the form `name=value`.
    NoValue(String),
    /// No parameter has this name.
    UnknownName(String),
    /// The value is not a number with one of the units of its name.
    BadValue {
        /// The name.
        name: String,
        /// The value.
        value: String,
        /// The allowed units.
        units: &'static str,
    },
    /// Bursts of this length cannot cause so much loss: loss ≤ burst / (burst + 1).
    BurstTooShort {
        /// The loss.
        loss: Probability,
        /// The burst.
        burst: u32,
    },
}

impl LinkConfig {
    /// A link without delay, loss or limit.
    pub const PERFECT: Self = Self {
        delay: Span::ZERO,
        jitter: Span::ZERO,
        loss: Probability::NONE,
        burst: 1,
        duplicates: Probability::NONE,
        reorder: Probability::NONE,
        rate_bytes: None,
        queue_bytes: 128_000,
    };

    /// A delay of half a round trip and nothing else.
    #[must_use]
    pub const fn round_trip(rtt: Span) -> Self {
        Self {
            delay: Span::from_nanos(rtt.as_nanos() / 2),
            ..Self::PERFECT
        }
    }

    /// This configuration with another loss.
    #[must_use]
    pub const fn with_loss(self, loss: Probability) -> Self {
        Self { loss, ..self }
    }

    fn read(&mut self, name: &str, value: &str) -> Result<(), LinkConfigError> {
        let bad = |units| LinkConfigError::BadValue {
            name: name.into(),
            value: value.into(),
            units,
        };
        let time = || {
            number(value, TIMES_NS)
                .map(Span::from_nanos)
                .ok_or_else(|| bad("s, ms or us"))
        };
        let share = || {
            let millionths =
                number(value, SHARES_MILLIONTHS).filter(|&millionths| millionths <= 1_000_000);
            let millionths = millionths.and_then(|millionths| u32::try_from(millionths).ok());
            millionths
                .map(Probability::from_millionths)
                .ok_or_else(|| bad("%, at most 100"))
        };
        match name {
            "rtt" => self.delay = Span::from_nanos(time()?.as_nanos() / 2),
            "delay" => self.delay = time()?,
            "jitter" => self.jitter = time()?,
            "loss" => self.loss = share()?,
            "dup" => self.duplicates = share()?,
            "reorder" => self.reorder = share()?,
            "burst" => {
                self.burst = value
                    .parse()
                    .ok()
                    .filter(|&count| count > 0)
                    .ok_or_else(|| bad("no unit, at least 1"))?;
            }
            "rate" => {
                let bits = number(value, RATES_BITS).filter(|&bits| bits >= 8);
                self.rate_bytes = Some(
                    bits.ok_or_else(|| bad("bit, kbit, mbit or gbit per second, at least 8 bit"))?
                        / 8,
                );
            }
            "queue" => {
                self.queue_bytes = number(value, SIZES_BYTES).ok_or_else(|| bad("B, kB or MB"))?;
            }
            _ => return Err(LinkConfigError::UnknownName(name.into())),
        }
        Ok(())
    }

    fn check(self) -> Result<Self, LinkConfigError> {
        let (lost, kept) = (self.loss.as_millionths(), self.loss.rest().as_millionths());
        let possible = self.burst < 2
            || kept == 0
            || u64::from(lost) <= u64::from(self.burst) * u64::from(kept);
        if possible {
            Ok(self)
        } else {
            Err(LinkConfigError::BurstTooShort {
                loss: self.loss,
                burst: self.burst,
            })
        }
    }
}

/// UnitTable with their size in the smallest one; `ms` stands before its suffix `s`, because the first match counts.
struct UnitTable(&'static [(&'static str, u64)]);
const TIMES_NS: UnitTable = UnitTable(&[("ms", 1_000_000), ("us", 1_000), ("s", 1_000_000_000)]);
const SHARES_MILLIONTHS: UnitTable = UnitTable(&[("%", 10_000)]);
const RATES_BITS: UnitTable = UnitTable(&[
    ("kbit", 1_000),
    ("mbit", 1_000_000),
    ("gbit", 1_000_000_000),
    ("bit", 1),
]);
const SIZES_BYTES: UnitTable = UnitTable(&[("kB", 1_000), ("MB", 1_000_000), ("B", 1)]);

/// A decimal number with a unit, in the smallest unit; `None` if the text is malformed, negative or too large.
fn number(text: &str, units: UnitTable) -> Option<u64> {
    let (digits, size) = units
        .0
        .iter()
        .find_map(|&(unit, size)| Some((text.strip_suffix(unit)?, size)))?;
    let (whole, part) = digits.split_once('.').unwrap_or((digits, "0"));
    let plain =
        |digits: &str| !digits.is_empty() && digits.bytes().all(|digit| digit.is_ascii_digit());
    if !plain(whole) || !plain(part) || part.len() > 9 {
        return None;
    }
    let scale = 10_u128.pow(u32::try_from(part.len()).ok()?);
    let whole: u64 = whole.parse().ok()?;
    let part: u64 = part.parse().ok()?;
    let parts = u128::from(part) * u128::from(size) / scale;
    u64::try_from(u128::from(whole) * u128::from(size) + parts).ok()
}

impl FromStr for LinkConfig {
    type Err = LinkConfigError;

    fn from_str(text: &str) -> Result<Self, LinkConfigError> {
        let mut config = Self::PERFECT;
        for part in text
            .split(',')
            .map(str::trim)
            .filter(|part| !part.is_empty())
        {
            let (name, value) = part
                .split_once('=')
                .ok_or_else(|| LinkConfigError::NoValue(part.into()))?;
            config.read(name.trim(), value.trim())?;
        }
        config.check()
    }
}

impl fmt::Display for LinkConfig {
    /// The shortest text that parses as this configuration: every parameter that is not perfect.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let perfect = Self::PERFECT;
        let mut parts = Vec::new();
        let mut write = |differs: bool, part: String| {
            if differs {
                parts.push(part);
            }
        };
        write(
            self.delay != perfect.delay,
            format!("delay={}", time(self.delay)),
        );
        write(
            self.jitter != perfect.jitter,
            format!("jitter={}", time(self.jitter)),
        );
        write(self.loss != perfect.loss, format!("loss={}", self.loss));
        write(self.burst != perfect.burst, format!("burst={}", self.burst));
        write(
            self.duplicates != perfect.duplicates,
            format!("dup={}", self.duplicates),
        );
        write(
            self.reorder != perfect.reorder,
            format!("reorder={}", self.reorder),
        );
        let rate_bits = u128::from(self.rate_bytes.unwrap_or(0)) * 8;
        write(self.rate_bytes.is_some(), format!("rate={rate_bits}bit"));
        write(
            self.queue_bytes != perfect.queue_bytes,
            format!("queue={}B", self.queue_bytes),
        );
        f.write_str(&parts.join(","))
    }
}

/// A span in milliseconds, to the nanosecond.
fn time(span: Span) -> String {
    let (ms, ns) = (span.as_nanos() / 1_000_000, span.as_nanos() % 1_000_000);
    if ns == 0 {
        return format!("{ms}ms");
    }
    format!("{ms}.{}ms", format!("{ns:06}").trim_end_matches('0'))
}

impl fmt::Display for LinkConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoValue(part) => write!(f, "{part:?} is not of the form name=value"),
            Self::UnknownName(name) => write!(
                f,
                "no link parameter is called {name:?}: \
                there are rtt, delay, jitter, loss, burst, dup, reorder, rate and queue"
            ),
            Self::BadValue { name, value, units } => {
                write!(
                    f,
                    "{value:?} is no value for {name}: it takes a number in {units}"
                )
            }
            Self::BurstTooShort { loss, burst } => {
                write!(
                    f,
                    "bursts of {burst} cannot make a loss of {loss}: make the burst longer or the loss smaller"
                )
            }
        }
    }
}

impl std::error::Error for LinkConfigError {}

/// A share of packets, in [0, 1], in millionths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Probability {
    millionths: u32,
}

impl Probability {
    /// Zero: no packet.
    pub const NONE: Self = Self { millionths: 0 };
    /// One: every packet.
    pub const ALL: Self = Self { millionths: WHOLE };

    /// A share in millionths; greater values count as a million.
    #[must_use]
    pub const fn from_millionths(millionths: u32) -> Self {
        let millionths = if millionths > WHOLE {
            WHOLE
        } else {
            millionths
        };
        Self { millionths }
    }

    /// A share in percent; greater values count as a hundred.
    #[must_use]
    pub const fn from_percent(percent: u32) -> Self {
        Self::from_millionths(percent.saturating_mul(WHOLE / 100))
    }

    /// The share in millionths.
    #[must_use]
    pub const fn as_millionths(self) -> u32 {
        self.millionths
    }

    /// One minus this share.
    #[must_use]
    pub const fn rest(self) -> Self {
        Self {
            millionths: WHOLE - self.millionths,
        }
    }
}

/// Millionths in one.
const WHOLE: u32 = 1_000_000;

impl fmt::Display for Probability {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (percent, rest) = (self.millionths / 10_000, self.millionths % 10_000);
        if rest == 0 {
            return write!(f, "{percent}%");
        }
        let digits = format!("{rest:04}");
        write!(f, "{percent}.{}%", digits.trim_end_matches('0'))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn link_configs_parse_as_documented() {
        let text = "rtt=100ms,loss=5%,burst=3,jitter=10ms,dup=1%,reorder=2%,rate=1mbit,queue=64kB";
        let config: LinkConfig = text.parse().unwrap();
        let expected = LinkConfig {
            delay: Span::from_millis(50),
            jitter: Span::from_millis(10),
            loss: Probability::from_percent(5),
            burst: 3,
            duplicates: Probability::from_percent(1),
            reorder: Probability::from_percent(2),
            rate_bytes: Some(125_000),
            queue_bytes: 64_000,
        };
        assert_eq!(config, expected);
        assert_eq!("".parse(), Ok(LinkConfig::PERFECT));
        assert_eq!(
            "loss=0.25%".parse(),
            Ok(LinkConfig::PERFECT.with_loss(Probability::from_millionths(2_500)))
        );
    }

    #[test]
    fn a_wrong_option_names_its_error() {
        let error = |text: &str| text.parse::<LinkConfig>().unwrap_err();
        assert_eq!(error("loss"), LinkConfigError::NoValue("loss".into()));
        assert_eq!(error("lag=3ms"), LinkConfigError::UnknownName("lag".into()));
        for text in [
            "rtt=100",
            "rtt=-1ms",
            "loss=5",
            "loss=101%",
            "burst=0",
            "rate=1mb",
            "rate=1bit",
            "jitter=.5ms",
            "queue=x",
        ] {
            assert!(
                matches!(error(text), LinkConfigError::BadValue { .. }),
                "{text}"
            );
        }
        assert!(matches!(
            error("loss=90%,burst=3"),
            LinkConfigError::BurstTooShort { .. }
        ));
        assert!("loss=100%,burst=3".parse::<LinkConfig>().is_ok());
    }

    proptest! {
        #[test]
        fn a_displayed_config_parses_back(
            delay in 0_u64..10_000_000_000, jitter in 0_u64..10_000_000_000,
            loss in 0_u32..=700_000, burst in 3_u32..50,
            dup in 0_u32..=1_000_000, reorder in 0_u32..=1_000_000,
            rate in proptest::option::of(1_u64..1 << 40), queue in 0_u64..1 << 40,
        ) {
            let config = LinkConfig {
                delay: Span::from_nanos(delay),
                jitter: Span::from_nanos(jitter),
                loss: Probability::from_millionths(loss),
                burst,
                duplicates: Probability::from_millionths(dup),
                reorder: Probability::from_millionths(reorder),
                rate_bytes: rate,
                queue_bytes: queue,
            };
            prop_assert_eq!(config.to_string().parse(), Ok(config));
        }

        #[test]
        fn no_text_panics(text in ".*") {
            let _ = text.parse::<LinkConfig>();
        }
    }
}
