//! What a stream with a budget said of how far it exceeds its tolerances
//!
//! A statement covers the ticks since the packet before it. If that one was missed, it covers its own tick alone; of
//! what nothing covers, nothing is known.

use alloc::collections::VecDeque;

use rhumb_reckoning::Tick;

use crate::packet::ErrorScale;

/// The newest statements of one stream.
#[derive(Clone, Debug)]
pub(crate) struct ErrorScaleLog {
    /// First tick, last tick, and what holds in between.
    said: VecDeque<(Tick, Tick, ErrorScale)>,
    /// The number of the next packet, if none was missed, and from which tick on a statement before that one holds.
    next: u64,
    from: Tick,
}

/// ErrorScaleLog that are kept: a view shows ticks that are a second old at most.
const KEPT: usize = 256;

impl ErrorScaleLog {
    /// None yet; the snapshot shows a tick before the packet of this number.
    pub(crate) const fn new(next: u64, snapshot: Tick) -> Self {
        Self {
            said: VecDeque::new(),
            next,
            from: snapshot,
        }
    }

    /// A packet was heard; `error_scale`: what it says if it ends its tick.
    pub(crate) fn packet(&mut self, number: u64, tick: Tick, error_scale: Option<ErrorScale>) {
        let from = if number == self.next { self.from } else { tick };
        if let Some(error_scale) = error_scale {
            self.add(from, tick, error_scale);
        }
        if number >= self.next {
            self.next = number + 1;
            self.from = if error_scale.is_some() {
                tick.next()
            } else {
                from
            };
        }
    }

    /// A watermark was heard.
    pub(crate) fn watermark(&mut self, next: u64, tick: Tick, error_scale: ErrorScale) {
        let from = if next == self.next { self.from } else { tick };
        self.add(from, tick, error_scale);
    }

    fn add(&mut self, from: Tick, to: Tick, error_scale: ErrorScale) {
        if from > to {
            return;
        }
        if let Some(last) = self.said.back_mut()
            && last.0 == from
            && last.2 == error_scale
        {
            last.1 = last.1.max(to);
            return;
        }
        if self.said.len() == KEPT {
            self.said.pop_front();
        }
        self.said.push_back((from, to, error_scale));
    }

    /// The factor that holds at a tick, if one is known.
    pub(crate) fn at(&self, tick: Tick) -> Option<f64> {
        let covering = self
            .said
            .iter()
            .filter(|(from, to, _)| (*from..=*to).contains(&tick));
        covering
            .map(|(_, _, error_scale)| *error_scale)
            .min()?
            .factor()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DOUBLE: u8 = 8;

    fn double() -> ErrorScale {
        let double = ErrorScale::covering(2.0);
        assert_eq!(double.factor(), Some(f64::from(DOUBLE) / 4.0));
        double
    }

    #[test]
    fn a_statement_holds_since_the_packet_before() {
        let mut heard = ErrorScaleLog::new(7, Tick::new(100));
        assert_eq!(heard.at(Tick::new(100)), None);
        heard.watermark(7, Tick::new(104), double());
        assert_eq!(heard.at(Tick::new(100)), Some(2.0));
        heard.packet(7, Tick::new(106), Some(ErrorScale::NONE));
        // Every tick up to the packet is within tolerance: the packet says so of them all.
        assert_eq!(heard.at(Tick::new(101)), Some(1.0));
        assert_eq!(heard.at(Tick::new(106)), Some(1.0));
        assert_eq!(heard.at(Tick::new(107)), None);
        heard.packet(8, Tick::new(107), None);
        heard.packet(9, Tick::new(107), Some(double()));
        assert_eq!(heard.at(Tick::new(107)), Some(2.0));
    }

    #[test]
    fn behind_a_missed_packet_a_statement_holds_at_its_own_tick_alone() {
        let mut heard = ErrorScaleLog::new(0, Tick::new(0));
        heard.packet(0, Tick::new(5), Some(ErrorScale::NONE));
        heard.packet(2, Tick::new(9), Some(double()));
        assert_eq!(heard.at(Tick::new(8)), None);
        assert_eq!(heard.at(Tick::new(9)), Some(2.0));
        heard.packet(1, Tick::new(7), Some(ErrorScale::NONE));
        assert_eq!(heard.at(Tick::new(7)), Some(1.0));
        assert_eq!(heard.at(Tick::new(6)), None);
        heard.watermark(5, Tick::new(12), ErrorScale::UNBOUNDED);
        assert_eq!(heard.at(Tick::new(12)), None);
        heard.packet(3, Tick::new(11), Some(double()));
        assert_eq!(heard.at(Tick::new(10)), Some(2.0));
    }

    #[test]
    fn memory_is_bounded() {
        let mut heard = ErrorScaleLog::new(0, Tick::new(0));
        for number in 0..10_000 {
            let error_scale = if number % 2 == 0 {
                double()
            } else {
                ErrorScale::NONE
            };
            heard.packet(number, Tick::new(number + 1), Some(error_scale));
        }
        assert!(heard.said.len() <= KEPT);
        assert_eq!(heard.at(Tick::new(10_000)), Some(1.0));
    }
}
