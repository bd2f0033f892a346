//! How much of a stream is said again in repair_symbols, by how much of it is lost.

/// From so many bytes on a tick is worth two packets: below, what another head takes is more than half a repair_symbol saves.
const HALVED: usize = 200;

/// The loss that is reckoned with where something was lost, however little is: of every hundredth answer.
const ANSWERED: f64 = 0.01;

/// A share of a stream's packets that was lost, of a million.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct LossRate(pub u32);

impl LossRate {
    /// Of a hundred.
    #[must_use]
    pub const fn percent(count: u32) -> Self {
        Self(count * 10_000)
    }
}

/// How much is said again in repair_symbols.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Redundancy {
    /// Nothing: what is lost is asked for.
    #[default]
    Off,
    /// After every third tick.
    Thin,
    /// After every other tick: what was lost with a tick is had back with the next one.
    Plain,
    /// After every tick.
    Thick,
}

impl Redundancy {
    const ALL: [Self; 4] = [Self::Off, Self::Thin, Self::Plain, Self::Thick];

    /// The loss from which on it is used.
    #[must_use]
    pub const fn from(self) -> LossRate {
        match self {
            Self::Off => LossRate(0),
            Self::Thin => LossRate::percent(1),
            Self::Plain => LossRate::percent(3),
            Self::Thick => LossRate::percent(10),
        }
    }

    /// What serves for a loss where this served so far: at once more if more is lost, less only if clearly less is.
    #[must_use]
    pub fn for_loss(self, loss: LossRate) -> Self {
        let served = |eased: bool| {
            let enough = |level: &&Self| {
                let from = level.from().0;
                loss.0 >= if eased { from / 5 * 3 } else { from }
            };
            Self::ALL.iter().rfind(enough).copied().unwrap_or_default()
        };
        served(false).max(self.min(served(true)))
    }

    /// After how many ticks repair_symbols are said; none if none are.
    pub(crate) const fn ticks(self) -> Option<u32> {
        match self {
            Self::Off => None,
            Self::Thin => Some(3),
            Self::Plain => Some(2),
            Self::Thick => Some(1),
        }
    }

    /// Whether a tick that takes so many bytes is said in two packets, and repair_symbols after it: these are half as long then,
    /// and one of three datagrams that is lost is had back before anything is shown of the tick.
    pub(crate) const fn halves(self, bytes: usize) -> bool {
        matches!(self, Self::Plain | Self::Thick) && bytes >= HALVED
    }

    /// How many repair_symbols go with so many new packets: such that of a hundred times hardly once more is lost than they
    /// give back, and no more than there are packets.
    pub(crate) fn repair_symbols(self, packets: u64) -> u64 {
        if self == Self::Off {
            return 0;
        }
        let packets = packets.min(64);
        (1..packets)
            .find(|repair_symbols| {
                beyond(packets + repair_symbols, *repair_symbols, self.loss()) < 0.015
            })
            .unwrap_or(packets)
    }

    /// How many repair_symbols answer who wants so many, some of which may be under way: such that of a hundred times hardly
    /// once too few arrive. They are rare, and who asks has waited for a round trip.
    pub(crate) fn answers(self, wanted: usize, under_way: usize) -> usize {
        let least = wanted.saturating_sub(under_way);
        let most = (3 * wanted).saturating_sub(under_way);
        let loss = self.loss().max(ANSWERED);
        let enough = |said: &usize| {
            let all = said + under_way;
            beyond(all as u64, (all - wanted) as u64, loss) < 0.01
        };
        (least..most).find(enough).unwrap_or(most)
    }

    /// The loss that it is made for.
    const fn loss(self) -> f64 {
        match self {
            Self::Off => 0.0,
            Self::Thin => 0.02,
            Self::Plain => 0.05,
            Self::Thick => 0.1,
        }
    }
}

/// The probability that of `count` more than `most` are lost, each with probability `loss`.
fn beyond(count: u64, most: u64, loss: f64) -> f64 {
    let mut term = 1.0;
    for _ in 0..count {
        term *= 1.0 - loss;
    }
    let mut within = 0.0;
    for lost in 0..=most {
        within += term;
        term *= (count - lost) as f64 / (lost + 1) as f64 * loss / (1.0 - loss);
    }
    1.0 - within
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn more_comes_at_once_and_less_only_when_clearly_less_is_lost() {
        let percent = LossRate::percent;
        assert_eq!(Redundancy::Off.for_loss(percent(5)), Redundancy::Plain);
        assert_eq!(Redundancy::Plain.for_loss(percent(2)), Redundancy::Plain);
        assert_eq!(Redundancy::Thin.for_loss(percent(2)), Redundancy::Thin);
        assert_eq!(Redundancy::Plain.for_loss(percent(1)), Redundancy::Thin);
        assert_eq!(Redundancy::Plain.for_loss(LossRate(0)), Redundancy::Off);
        assert_eq!(Redundancy::Off.for_loss(LossRate(9_999)), Redundancy::Off);
    }

    #[test]
    fn repair_symbols_grow_with_packets_more_slowly_than_these() {
        let plain = [1, 2, 3, 6, 10, 20].map(|packets| Redundancy::Plain.repair_symbols(packets));
        assert_eq!(plain, [1, 1, 1, 2, 3, 4]);
        assert_eq!(Redundancy::Off.repair_symbols(10), 0);
        assert_eq!(Redundancy::Thick.repair_symbols(1), 1);
    }

    #[test]
    fn answers_carry_enough_repair_symbols() {
        let answers = |level: Redundancy| [0, 1, 2, 5].map(|wanted| level.answers(wanted, 0));
        assert_eq!(answers(Redundancy::Off), [0, 2, 3, 6]);
        assert_eq!(answers(Redundancy::Plain), [0, 2, 3, 7]);
        assert_eq!(answers(Redundancy::Thick), [0, 2, 4, 8]);
        // What is under way may be lost, too.
        let beside = |under_way| Redundancy::Plain.answers(2, under_way);
        assert_eq!([0, 1, 2, 3, 4].map(beside), [3, 2, 1, 0, 0]);
    }

    #[test]
    fn long_ticks_are_halved_where_much_is_lost() {
        assert!(Redundancy::Plain.halves(HALVED) && !Redundancy::Plain.halves(HALVED - 1));
        assert!(!Redundancy::Off.halves(1_000) && !Redundancy::Thin.halves(1_000));
    }
}
