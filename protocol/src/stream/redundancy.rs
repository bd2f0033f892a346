//! The redundancy of a stream: how many repair symbols go with its packets.

/// A tick of at least this many bytes is split into two packets. With a lower value, packets take more bytes and fewer
/// bodies are off.
const HALVED: usize = 180;

/// The least loss rate assumed for answers to a receiver that lost packets.
const ANSWERED: f64 = 0.01;

/// The share of a stream's packets that was lost, in millionths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct LossRate(pub(super) u32);

impl LossRate {
    /// A loss rate in percent.
    #[must_use]
    const fn percent(count: u32) -> Self {
        Self(count * 10_000)
    }
}

/// The rate of a stream's repair symbols.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Redundancy {
    /// Never: a lost packet is answered on request.
    #[default]
    Off,
    /// After every third tick.
    Thin,
    /// After every second tick: the next tick recovers a packet of the tick before.
    Plain,
    /// After every tick.
    Thick,
}

impl Redundancy {
    const ALL: [Self; 4] = [Self::Off, Self::Thin, Self::Plain, Self::Thick];

    /// The loss rate from which on this redundancy is used.
    #[must_use]
    pub(super) const fn from(self) -> LossRate {
        match self {
            Self::Off => LossRate(0),
            Self::Thin => LossRate::percent(1),
            Self::Plain => LossRate::percent(3),
            Self::Thick => LossRate::percent(10),
        }
    }

    /// The redundancy for a loss rate, given the present one. It rises at once and falls only after the loss is clearly
    /// less.
    #[must_use]
    pub(crate) fn for_loss(self, loss: LossRate) -> Self {
        let served = |eased: bool| {
            let enough = |level: &&Self| {
                let from = level.from().0;
                loss.0 >= if eased { from / 5 * 3 } else { from }
            };
            Self::ALL.iter().rfind(enough).copied().unwrap_or_default()
        };
        served(false).max(self.min(served(true)))
    }

    /// The number of ticks between repair symbols; none without repair symbols.
    pub(crate) const fn ticks(self) -> Option<u32> {
        match self {
            Self::Off => None,
            Self::Thin => Some(3),
            Self::Plain => Some(2),
            Self::Thick => Some(1),
        }
    }

    /// True if a tick of this many bytes is sent in two packets followed by repair symbols of half the length. One lost
    /// datagram of the three is then recovered before the tick is displayed.
    pub(crate) const fn halves(self, bytes: usize) -> bool {
        matches!(self, Self::Plain | Self::Thick) && bytes >= HALVED
    }

    /// The number of repair symbols for this many new packets. It fails to cover the losses in about one of a hundred
    /// cases, and never exceeds the number of packets.
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

    /// The number of repair symbols that answer a request for `wanted`, of which `in_flight` are in flight. Too few
    /// arrive in about one of a hundred cases. Answers are rare, and the receiver has already waited for a round trip.
    pub(crate) fn answers(self, wanted: usize, in_flight: usize) -> usize {
        let least = wanted.saturating_sub(in_flight);
        let most = (3 * wanted).saturating_sub(in_flight);
        let loss = self.loss().max(ANSWERED);
        let enough = |sent: &usize| {
            let all = sent + in_flight;
            beyond(all as u64, (all - wanted) as u64, loss) < 0.01
        };
        (least..most).find(enough).unwrap_or(most)
    }

    /// The loss rate that this redundancy is made for.
    const fn loss(self) -> f64 {
        match self {
            Self::Off => 0.0,
            Self::Thin => 0.02,
            Self::Plain => 0.05,
            Self::Thick => 0.1,
        }
    }
}

/// The probability that more than `most` of `count` packets are lost, each with probability `loss`.
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
    fn redundancy_rises_at_once_and_falls_only_after_clearly_less_loss() {
        let percent = LossRate::percent;
        assert_eq!(Redundancy::Off.for_loss(percent(5)), Redundancy::Plain);
        assert_eq!(Redundancy::Plain.for_loss(percent(2)), Redundancy::Plain);
        assert_eq!(Redundancy::Thin.for_loss(percent(2)), Redundancy::Thin);
        assert_eq!(Redundancy::Plain.for_loss(percent(1)), Redundancy::Thin);
        assert_eq!(Redundancy::Plain.for_loss(LossRate(0)), Redundancy::Off);
        assert_eq!(Redundancy::Off.for_loss(LossRate(9_999)), Redundancy::Off);
    }

    #[test]
    fn repair_symbols_grow_more_slowly_than_packets() {
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
        // Symbols in flight may be lost too.
        let beside = |in_flight| Redundancy::Plain.answers(2, in_flight);
        assert_eq!([0, 1, 2, 3, 4].map(beside), [3, 2, 1, 0, 0]);
    }

    #[test]
    fn long_ticks_are_halved_under_much_loss() {
        assert!(Redundancy::Plain.halves(HALVED) && !Redundancy::Plain.halves(HALVED - 1));
        assert!(!Redundancy::Off.halves(1_000) && !Redundancy::Thin.halves(1_000));
    }
}
