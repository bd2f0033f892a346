//! One line about the traffic of a gateway, every few seconds.

use std::io;
use std::time::Duration;

use crate::gateway::GatewayStatistics;
use crate::pdu::Malformed;

/// Counts between two lines.
#[derive(Debug)]
pub struct Report {
    /// Seconds between two lines; zero for none.
    period: u64,
    since: Duration,
    before: GatewayStatistics,
    sent: Traffic,
    received: Traffic,
    unsent: u64,
    /// The last error of sending, and the last PDU that is none.
    error: Option<String>,
}

#[derive(Debug, Default)]
struct Traffic {
    datagrams: u64,
    bytes: usize,
}

impl Traffic {
    const fn add(&mut self, bytes: usize) {
        self.datagrams += 1;
        self.bytes += bytes;
    }
}

impl Report {
    /// Lines every `period` seconds; none for zero.
    #[must_use]
    pub fn new(period: u64, now: Duration) -> Self {
        Self {
            period,
            since: now,
            before: GatewayStatistics::default(),
            sent: Traffic::default(),
            received: Traffic::default(),
            unsent: 0,
            error: None,
        }
    }

    /// Counts a datagram of this many bytes, and whether it left.
    pub fn sent(&mut self, bytes: usize, outcome: io::Result<()>) {
        self.sent.add(bytes);
        if let Err(error) = outcome {
            self.unsent += 1;
            self.error = Some(format!("sending: {error}"));
        }
    }

    /// Counts a datagram of this many bytes that arrived.
    pub const fn received(&mut self, bytes: usize) {
        self.received.add(bytes);
    }

    /// Keeps the reason why bytes are no PDU.
    pub fn malformed(&mut self, malformed: &Malformed) {
        self.error = Some(format!("received: {malformed}"));
    }

    /// The line about the time since the last one, if it is due: who is there, a second's traffic, and what went wrong.
    pub fn line(&mut self, now: Duration, statistics: &GatewayStatistics) -> Option<String> {
        let passed = now.saturating_sub(self.since);
        if self.period == 0 || passed < Duration::from_secs(self.period) {
            return None;
        }
        let (new, old) = (statistics, self.before);
        let seconds = passed.as_secs_f64();
        let rate = |count: u64| count as f64 / seconds;
        let kilobytes = |bytes: usize| bytes as f64 / 1000.0 / seconds;
        let states =
            new.sent.updates + new.sent.heartbeats - old.sent.updates - old.sent.heartbeats;
        let mut line = format!(
            "{} bodies out, {:.1} states/s, {:.2} kB/s; {} entities in, {:.1} PDUs/s, {:.2} kB/s",
            new.bodies,
            rate(states),
            kilobytes(self.sent.bytes),
            new.entities,
            rate(new.received.used - old.received.used),
            kilobytes(self.received.bytes),
        );
        let faults = [
            ("delayed", new.sent.delayed - old.sent.delayed),
            ("without a number", new.sent.unnamed - old.sent.unnamed),
            ("not finite", new.sent.not_finite - old.sent.not_finite),
            ("unsent", self.unsent),
            ("malformed", new.received.malformed - old.received.malformed),
            ("stale", new.received.stale - old.received.stale),
            ("too many", new.received.too_many - old.received.too_many),
            (
                "without place",
                new.received.no_place - old.received.no_place,
            ),
            ("beyond reach", new.beyond as u64),
            ("unfit for a body", new.unfit as u64),
            ("refused", new.refused - old.refused),
            ("denied", new.denied - old.denied),
        ];
        for (name, count) in faults.into_iter().filter(|(_, count)| *count > 0) {
            line += &format!(", {count} {name}");
        }
        if let Some(error) = self.error.take() {
            line += &format!(" ({error})");
        }
        (self.before, self.since) = (*statistics, now);
        (self.sent, self.received, self.unsent) = (Traffic::default(), Traffic::default(), 0);
        Some(line)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::published::PublisherStatistics;

    #[test]
    fn a_line_has_a_seconds_traffic_and_only_faults_that_were() {
        let at = Duration::from_secs;
        let mut report = Report::new(10, at(100));
        assert_eq!(report.line(at(109), &GatewayStatistics::default()), None);
        let mut statistics = GatewayStatistics {
            bodies: 3,
            sent: PublisherStatistics {
                updates: 20,
                heartbeats: 10,
                ..PublisherStatistics::default()
            },
            ..GatewayStatistics::default()
        };
        report.sent(4_320, Ok(()));
        let line = report.line(at(110), &statistics).expect("it is due");
        let calm = "3 bodies out, 3.0 states/s, 0.43 kB/s; 0 entities in, 0.0 PDUs/s, 0.00 kB/s";
        assert_eq!(line, calm);
        statistics.received.malformed = 2;
        report.received(5);
        report.malformed(&Malformed::CutHeader {
            offset: 0,
            available: 5,
        });
        let line = report.line(at(120), &statistics).expect("it is due");
        let end =
            ", 2 malformed (received: pdu at byte 0 is cut: 5 bytes are left, its header has 12)";
        assert!(line.ends_with(end), "{line}");
    }
}
