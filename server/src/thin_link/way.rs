//! How long the way to a member is, apart from what waits on it.
//!
//! A round trip is longer because something waits on the way, or because the way is another. What waits grows, or is
//! lost where no more may wait, or waits at this end too; another way does none of that, and counts as the way itself soon.

use rhumb_protocol::packet::Low16;
use rhumb_protocol::{Instant, Span};

/// How long the way itself is to a member and back.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way {
    /// What counts as the way itself; none before the first report.
    usual_ns: Option<u64>,
    second: Option<Second>,
    /// The least round trip of the second before, if that was calm: nothing stood here all the time, and nothing was lost.
    calm_ns: Option<u64>,
    /// Packets that did not come to the member, and whether more of them since the second began.
    gone: Low16,
    loses: bool,
}

/// The least that was seen in the second that runs.
#[derive(Clone, Copy, Debug)]
struct Second {
    began: Instant,
    round_trip_ns: u64,
    waits: Span,
}

/// How long the way is looked at before it is compared.
const SECOND: Span = Span::from_millis(1_000);
/// What never waits less than this in a second stands here.
const STANDING: Span = Span::from_millis(80);
/// A round trip that grows faster than this in a second has not come to its end.
const STEADY_NS: u64 = 10_000_000;

impl Way {
    /// One that was not looked at yet.
    pub(super) const fn new() -> Self {
        Self {
            usual_ns: None,
            second: None,
            calm_ns: None,
            gone: Low16(0),
            loses: false,
        }
    }

    /// The member says how many packets did not come so far.
    pub(super) fn hear_gone(&mut self, gone: Low16) {
        self.loses |= self.gone != gone;
        self.gone = gone;
    }

    /// By how much a round trip is longer than the way itself, while what is handed over waits so long at this end.
    pub(super) fn longer(&mut self, now: Instant, round_trip: Span, waits: Span) -> Span {
        let round_trip_ns = round_trip.as_nanos();
        // It grows slowly by itself, so that another way that is never calm is not taken for a full queue for ever.
        let usual = self.usual_ns.get_or_insert(round_trip_ns);
        *usual = round_trip_ns.min(*usual + round_trip_ns.saturating_sub(*usual) / 512);
        let second = self.second.get_or_insert(Second {
            began: now,
            round_trip_ns,
            waits,
        });
        second.round_trip_ns = second.round_trip_ns.min(round_trip_ns);
        second.waits = second.waits.min(waits);
        if let Some(over) = self
            .second
            .take_if(|second| now.since(second.began) >= SECOND)
        {
            self.look_back(over);
        }
        let usual = self.usual_ns.unwrap_or(round_trip_ns);
        Span::from_nanos(round_trip_ns.saturating_sub(usual))
    }

    /// After two calm seconds, of which the later one was no slower, their round trip is the way itself.
    fn look_back(&mut self, over: Second) {
        let loses = std::mem::take(&mut self.loses);
        let calm_ns = (over.waits <= STANDING && !loses).then_some(over.round_trip_ns);
        if let (Some(before), Some(last)) = (self.calm_ns, calm_ns)
            && last <= before + STEADY_NS
        {
            self.usual_ns = self.usual_ns.max(Some(last));
        }
        self.calm_ns = calm_ns;
    }
}
