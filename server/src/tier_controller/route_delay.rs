//! Delay of the route to a member, apart from queueing on it.
//!
//! A round trip grows because data is queued on the route, or because the route has changed. A queue grows, loses
//! packets when full, or backs up to this end; another route does none of these and soon becomes the base.

use rhumb_protocol::packet::Low16;
use rhumb_protocol::{Instant, Span};

/// Estimate of the route's own round trip.
#[derive(Clone, Copy, Debug)]
pub(super) struct RouteDelay {
    /// The base round trip; `None` before the first report.
    base_ns: Option<u64>,
    second: Option<Second>,
    /// Least round trip of the last second, if it was calm: no standing queue at this end, and no loss.
    quiet_ns: Option<u64>,
    /// Count of lost packets, and whether it grew in the present second.
    lost: Low16,
    loses: bool,
}

/// Minima of the present second.
#[derive(Clone, Copy, Debug)]
struct Second {
    began: Instant,
    round_trip_ns: u64,
    queue_delay: Span,
}

/// Length of one observation.
const SECOND: Span = Span::from_millis(1_000);
/// A queue at this end whose least delay in a second exceeds this is standing.
const STANDING: Span = Span::from_millis(80);
/// A round trip that grows faster than this in a second is not steady.
const STEADY_NS: u64 = 10_000_000;

impl RouteDelay {
    /// An estimate before the first report.
    pub(super) const fn new() -> Self {
        Self {
            base_ns: None,
            second: None,
            quiet_ns: None,
            lost: Low16(0),
            loses: false,
        }
    }

    /// Takes the member's count of lost packets.
    pub(super) fn handle_lost_count(&mut self, lost: Low16) {
        self.loses |= self.lost != lost;
        self.lost = lost;
    }

    /// Delay of a round trip beyond the route's own, with this queue delay at this end.
    pub(super) fn excess_delay(
        &mut self,
        now: Instant,
        round_trip: Span,
        queue_delay: Span,
    ) -> Span {
        let round_trip_ns = round_trip.as_nanos();
        // The base grows slowly by itself: a changed route that is never calm does not count as a full queue for ever.
        let usual = self.base_ns.get_or_insert(round_trip_ns);
        *usual = round_trip_ns.min(*usual + round_trip_ns.saturating_sub(*usual) / 512);
        let second = self.second.get_or_insert(Second {
            began: now,
            round_trip_ns,
            queue_delay,
        });
        second.round_trip_ns = second.round_trip_ns.min(round_trip_ns);
        second.queue_delay = second.queue_delay.min(queue_delay);
        if let Some(over) = self
            .second
            .take_if(|second| now.since(second.began) >= SECOND)
        {
            self.scan_back(over);
        }
        let usual = self.base_ns.unwrap_or(round_trip_ns);
        Span::from_nanos(round_trip_ns.saturating_sub(usual))
    }

    /// After two calm seconds, the later no slower, their round trip becomes the base.
    fn scan_back(&mut self, over: Second) {
        let loses = std::mem::take(&mut self.loses);
        let quiet_ns = (over.queue_delay <= STANDING && !loses).then_some(over.round_trip_ns);
        if let (Some(before), Some(last)) = (self.quiet_ns, quiet_ns)
            && last <= before + STEADY_NS
        {
            self.base_ns = self.base_ns.max(Some(last));
        }
        self.quiet_ns = quiet_ns;
    }
}
