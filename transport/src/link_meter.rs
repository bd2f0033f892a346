//! Recent throughput of a connection's link: bytes handed over minus queued.
//!
//! Arithmetic only; the owner of the connection reads its counters and its clock.

use rhumb_protocol::{Instant, LinkReport, Span};

/// Measurements of one connection's link.
#[derive(Clone, Copy, Debug)]
pub struct LinkMeter {
    read_at: Instant,
    handed_bytes: u64,
    waiting_bytes: u64,
}

/// Time between two readings.
const INTERVAL: Span = Span::from_millis(100);

impl LinkMeter {
    /// A meter of a link that has carried nothing yet.
    pub const fn new(now: Instant) -> Self {
        Self {
            read_at: now,
            handed_bytes: 0,
            waiting_bytes: 0,
        }
    }

    /// True if it is time for another reading.
    pub fn is_due(&self, now: Instant) -> bool {
        now >= self.read_at + INTERVAL
    }

    /// Takes a reading: total bytes handed over, and how many of them still wait.
    pub fn read(
        &mut self,
        now: Instant,
        handed_bytes: u64,
        waiting_bytes: u64,
        round_trip: Span,
    ) -> LinkReport {
        let handed = handed_bytes.saturating_sub(self.handed_bytes);
        let report = LinkReport {
            waiting_bytes,
            sent_bytes: (self.waiting_bytes + handed).saturating_sub(waiting_bytes),
            over: now.since(self.read_at),
            round_trip,
        };
        *self = Self {
            read_at: now,
            handed_bytes,
            waiting_bytes,
        };
        report
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sent_bytes_are_handed_over_bytes_minus_queued_ones() {
        let at = |ms| Instant::ZERO + Span::from_millis(ms);
        let mut link_meter = LinkMeter::new(at(0));
        assert!(!link_meter.is_due(at(99)) && link_meter.is_due(at(100)));
        let first = link_meter.read(at(100), 5_000, 2_000, Span::ZERO);
        assert_eq!((first.sent_bytes, first.waiting_bytes), (3_000, 2_000));
        let second = link_meter.read(at(250), 6_000, 500, Span::ZERO);
        assert_eq!(
            (second.sent_bytes, second.over),
            (2_500, Span::from_millis(150))
        );
    }
}
