//! How long the route_delay to a member is, apart from what queue_delay on it.
//!
//! A round trip is longer because something queue_delay on the route_delay, or because the route_delay is another. What queue_delay grows, or is
//! lost where no more may wait, or queue_delay at this end too; another route_delay does none of that, and counts as the route_delay itself soon.

use rhumb_protocol::packet::Low16;
use rhumb_protocol::{Instant, Span};

/// How long the route_delay itself is to a member and back.
#[derive(Clone, Copy, Debug)]
pub(super) struct RouteDelay {
    /// What counts as the route_delay itself; none before the first report.
    base_ns: Option<u64>,
    second: Option<Second>,
    /// The least round trip of the second before, if that was calm: nothing stood here all the time, and nothing was lost.
    quiet_ns: Option<u64>,
    /// Packets that did not come to the member, and whether more of them since the second began.
    lost: Low16,
    loses: bool,
}

/// The least that was seen in the second that runs.
#[derive(Clone, Copy, Debug)]
struct Second {
    began: Instant,
    round_trip_ns: u64,
    queue_delay: Span,
}

/// How long the route_delay is looked at before it is compared.
const SECOND: Span = Span::from_millis(1_000);
/// What never queue_delay less than this in a second stands here.
const STANDING: Span = Span::from_millis(80);
/// A round trip that grows faster than this in a second has not come to its end.
const STEADY_NS: u64 = 10_000_000;

impl RouteDelay {
    /// One that was not looked at yet.
    pub(super) const fn new() -> Self {
        Self {
            base_ns: None,
            second: None,
            quiet_ns: None,
            lost: Low16(0),
            loses: false,
        }
    }

    /// The member says how many packets did not come so far.
    pub(super) fn handle_lost_count(&mut self, lost: Low16) {
        self.loses |= self.lost != lost;
        self.lost = lost;
    }

    /// By how much a round trip is longer than the route_delay itself, while what is handed over queue_delay so long at this end.
    pub(super) fn excess_delay(
        &mut self,
        now: Instant,
        round_trip: Span,
        queue_delay: Span,
    ) -> Span {
        let round_trip_ns = round_trip.as_nanos();
        // It grows slowly by itself, so that another route_delay that is never calm is not taken for a full queue for ever.
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
            self.look_back(over);
        }
        let usual = self.base_ns.unwrap_or(round_trip_ns);
        Span::from_nanos(round_trip_ns.saturating_sub(usual))
    }

    /// After two calm seconds, of which the later one was no slower, their round trip is the route_delay itself.
    fn look_back(&mut self, over: Second) {
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
