//! How fast a client of the paper's protocol is spoken to.
//!
//! The published one reads TCP each 30 ms, 64 KiB at most, and loses a message that a read cuts; its UDP buffer holds 277
//! datagrams. What is sent in spans keeps within both.

use std::time::Duration;

use tokio::time::{Instant, sleep_until};

/// So much in each span of time, and no more.
#[derive(Debug)]
pub(super) struct Pace {
    span: Duration,
    most: usize,
    until: Instant,
    spent: usize,
}

/// Of a TCP connection: a read takes it whole, with three quarters of room to spare.
pub(super) fn of_bytes() -> Pace {
    Pace::new(Duration::from_millis(35), 16 << 10)
}

/// Of datagrams: so many in about a millisecond, none of them held back if there is no such number.
pub(super) fn of_datagrams(per_millisecond: Option<u32>) -> Option<Pace> {
    let most = per_millisecond? as usize;
    Some(Pace::new(Duration::from_millis(1), most.max(1)))
}

impl Pace {
    fn new(span: Duration, most: usize) -> Self {
        Self {
            span,
            most,
            until: Instant::now(),
            spent: 0,
        }
    }

    /// Waits until so much more may be sent.
    pub(super) async fn spend(&mut self, amount: usize) {
        if self.spent + amount > self.most && self.spent > 0 {
            sleep_until(self.until).await;
        }
        let now = Instant::now();
        if now >= self.until {
            self.until = now + self.span;
            self.spent = 0;
        }
        self.spent += amount;
    }
}
