//! How fast a client of the paper's protocol is spoken to.
//!
//! The published one reads TCP each 30 ms, 64 KiB at most, and loses a message that a read cuts; its UDP buffer holds 277
//! datagrams. What is sent in spans keeps within both, if each connection and each address has a rate_limiter of its own.

use std::time::Duration;

use tokio::time::{Instant, sleep_until};

/// So much in each span of time, and no more.
#[derive(Clone, Debug)]
pub(super) struct RateLimiter {
    span: Duration,
    most: usize,
    /// When the span ends in which something was spent last.
    until: Option<Instant>,
    spent: usize,
}

/// Of a TCP connection: a read takes it whole, with three quarters of room to spare.
pub(super) const fn of_bytes() -> RateLimiter {
    RateLimiter::new(Duration::from_millis(35), 16 << 10)
}

/// Of one address: so many datagrams in about a millisecond.
pub(super) fn of_datagrams(per_millisecond: u32) -> RateLimiter {
    RateLimiter::new(Duration::from_millis(1), (per_millisecond as usize).max(1))
}

impl RateLimiter {
    const fn new(span: Duration, most: usize) -> Self {
        Self {
            span,
            most,
            until: None,
            spent: 0,
        }
    }

    /// Spends so much at a moment.
    ///
    /// # Errors
    ///
    /// The moment from which on it can be spent. What is more than a span takes has a span for itself.
    pub(super) fn try_spend(&mut self, now: Instant, amount: usize) -> Result<(), Instant> {
        match self.until {
            Some(until) if now < until => {
                if self.spent + amount > self.most {
                    return Err(until);
                }
            }
            _ => {
                self.until = Some(now + self.span);
                self.spent = 0;
            }
        }
        self.spent += amount;
        Ok(())
    }

    /// Waits until so much may be spent, and spends it.
    pub(super) async fn spend(&mut self, amount: usize) {
        while let Err(at) = self.try_spend(Instant::now(), amount) {
            sleep_until(at).await;
        }
    }

    /// Whether nothing that was spent counts any more.
    pub(super) fn is_over(&self, now: Instant) -> bool {
        self.until.is_none_or(|until| now >= until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_span_takes_so_much_and_the_next_one_as_much_again() {
        let begun = Instant::now();
        let mut rate_limiter = of_bytes();
        let mut moments = Vec::new();
        for _ in 0..25 {
            rate_limiter.spend(1_400).await;
            moments.push(begun.elapsed().as_millis());
        }
        let expected = [vec![0; 11], vec![35; 11], vec![70; 3]];
        assert_eq!(moments, expected.concat());
    }

    #[tokio::test(start_paused = true)]
    async fn what_is_more_than_a_span_takes_has_one_for_itself() {
        let begun = Instant::now();
        let mut rate_limiter = of_bytes();
        rate_limiter.spend(1).await;
        rate_limiter.spend(1 << 20).await;
        assert_eq!(begun.elapsed().as_millis(), 35);
        rate_limiter.spend(1).await;
        assert_eq!(begun.elapsed().as_millis(), 70);
        assert!(!rate_limiter.is_over(Instant::now()));
        assert!(rate_limiter.is_over(Instant::now() + Duration::from_millis(35)));
    }
}
