//! The error scales that a stream with a budget has stated.
//!
//! A statement covers the ticks since the packet before it. If that packet is missing, it covers its own tick alone.
//! For other ticks the error scale is unknown.

use alloc::collections::VecDeque;

use rhumb_reckoning::Tick;

use crate::packet::ErrorScale;

/// The newest statements of one stream.
#[derive(Clone, Debug)]
pub(crate) struct ErrorScaleLog {
    /// First tick, last tick, and the error scale between them.
    statements: VecDeque<(Tick, Tick, ErrorScale)>,
    /// The number of the next packet if none is missing, and the first tick that its statement covers.
    next: u64,
    from: Tick,
}

/// The number of statements kept: a view shows ticks that are at most a second old.
const KEPT: usize = 256;

impl ErrorScaleLog {
    /// An empty log. The snapshot shows a tick before the packet with number `next`.
    pub(crate) const fn new(next: u64, snapshot: Tick) -> Self {
        Self {
            statements: VecDeque::new(),
            next,
            from: snapshot,
        }
    }

    /// Adds a received packet; `error_scale` is its statement, if it ends its tick.
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

    /// Adds a received watermark.
    pub(crate) fn watermark(&mut self, next: u64, tick: Tick, error_scale: ErrorScale) {
        let from = if next == self.next { self.from } else { tick };
        self.add(from, tick, error_scale);
    }

    fn add(&mut self, from: Tick, to: Tick, error_scale: ErrorScale) {
        if from > to {
            return;
        }
        if let Some(last) = self.statements.back_mut()
            && last.0 == from
            && last.2 == error_scale
        {
            last.1 = last.1.max(to);
            return;
        }
        if self.statements.len() == KEPT {
            self.statements.pop_front();
        }
        self.statements.push_back((from, to, error_scale));
    }

    /// The factor on the tolerances at a tick, if it is known.
    pub(crate) fn at(&self, tick: Tick) -> Option<f64> {
        let covering = self
            .statements
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
    fn a_statement_covers_the_ticks_since_the_last_packet() {
        let mut log = ErrorScaleLog::new(7, Tick::new(100));
        assert_eq!(log.at(Tick::new(100)), None);
        log.watermark(7, Tick::new(104), double());
        assert_eq!(log.at(Tick::new(100)), Some(2.0));
        log.packet(7, Tick::new(106), Some(ErrorScale::NONE));
        // The packet's statement covers every tick up to it.
        assert_eq!(log.at(Tick::new(101)), Some(1.0));
        assert_eq!(log.at(Tick::new(106)), Some(1.0));
        assert_eq!(log.at(Tick::new(107)), None);
        log.packet(8, Tick::new(107), None);
        log.packet(9, Tick::new(107), Some(double()));
        assert_eq!(log.at(Tick::new(107)), Some(2.0));
    }

    #[test]
    fn after_a_missing_packet_a_statement_covers_its_own_tick_alone() {
        let mut log = ErrorScaleLog::new(0, Tick::new(0));
        log.packet(0, Tick::new(5), Some(ErrorScale::NONE));
        log.packet(2, Tick::new(9), Some(double()));
        assert_eq!(log.at(Tick::new(8)), None);
        assert_eq!(log.at(Tick::new(9)), Some(2.0));
        log.packet(1, Tick::new(7), Some(ErrorScale::NONE));
        assert_eq!(log.at(Tick::new(7)), Some(1.0));
        assert_eq!(log.at(Tick::new(6)), None);
        log.watermark(5, Tick::new(12), ErrorScale::UNBOUNDED);
        assert_eq!(log.at(Tick::new(12)), None);
        log.packet(3, Tick::new(11), Some(double()));
        assert_eq!(log.at(Tick::new(10)), Some(2.0));
    }

    #[test]
    fn memory_is_bounded() {
        let mut log = ErrorScaleLog::new(0, Tick::new(0));
        for number in 0..10_000 {
            let error_scale = if number % 2 == 0 {
                double()
            } else {
                ErrorScale::NONE
            };
            log.packet(number, Tick::new(number + 1), Some(error_scale));
        }
        assert!(log.statements.len() <= KEPT);
        assert_eq!(log.at(Tick::new(10_000)), Some(1.0));
    }
}
