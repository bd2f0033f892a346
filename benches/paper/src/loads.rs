//! Parser of loads such as `500,1000,1500` or `500..10000`.

use std::str::FromStr;

/// Balls in the pit, stage by stage: consecutive multiples of the first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Loads(Vec<u32>);

/// Largest load; more would not fit into a scene beside the walls.
const LOAD_MAX: u32 = 100_000;

impl Loads {
    /// The first `count` multiples of `first`.
    pub(crate) fn multiples(first: u32, count: u32) -> Self {
        Self((1..=count).map(|stage| first * stage).collect())
    }

    pub(crate) fn as_slice(&self) -> &[u32] {
        &self.0
    }
}

impl FromStr for Loads {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| -> Result<u32, String> {
            let failed = |_| format!("{text:?} is not a number of balls");
            let load = text.trim().parse().map_err(failed)?;
            if (1..=LOAD_MAX).contains(&load) {
                Ok(load)
            } else {
                Err(format!("a load must lie between 1 and {LOAD_MAX} balls"))
            }
        };
        let loads = match text.split_once("..") {
            Some((first, last)) => {
                let (first, last) = (number(first)?, number(last)?);
                if !last.is_multiple_of(first) {
                    return Err(format!("{last} is not a multiple of {first}"));
                }
                Self::multiples(first, last / first).0
            }
            None => text.split(',').map(number).collect::<Result<_, _>>()?,
        };
        let first = loads[0];
        let fits =
            |(stage, load): (u32, &u32)| u64::from(*load) == u64::from(first) * u64::from(stage);
        if (1..).zip(&loads).all(fits) {
            Ok(Self(loads))
        } else {
            Err(format!(
                "loads must be consecutive multiples of the first, since each stage adds as many balls: {}",
                Self::multiples(first, loads.len() as u32)
                    .0
                    .iter()
                    .map(u32::to_string)
                    .collect::<Vec<_>>()
                    .join(",")
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loads_are_multiples_in_every_notation() {
        let read = |text: &str| text.parse::<Loads>().map(|loads| loads.0);
        assert_eq!(read("500"), Ok(vec![500]));
        assert_eq!(read("500..2000"), Ok(vec![500, 1_000, 1_500, 2_000]));
        assert_eq!(read("10, 20,30"), Ok(vec![10, 20, 30]));
        for wrong in [
            "",
            "0",
            "500,1500",
            "1000,500",
            "500..1200",
            "5..x",
            "200000",
            "70000,140000",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
        assert!(read("500,1500").unwrap_err().ends_with("500,1000"));
    }
}
