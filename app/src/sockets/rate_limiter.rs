//! Rate limit of TCP to APP clients.
//!
//! The published client reads TCP every 30 ms, 64 KiB at most, and loses a message that a read cuts. Sending in spans keeps
//! within that, with one limiter for each connection.

use std::time::Duration;

use tokio::time::{Instant, sleep_until};

/// A budget for each span of time.
#[derive(Clone, Debug)]
pub(super) struct RateLimiter {
    span: Duration,
    most: usize,
    /// End of the span in which budget was last spent.
    until: Option<Instant>,
    spent: usize,
}

/// Limit of a TCP connection: one read takes a whole span, which fills a quarter of it.
pub(super) const fn limiter_of_bytes() -> RateLimiter {
    RateLimiter::new(Duration::from_millis(35), 16 << 10)
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

    /// Spends an amount at a moment.
    ///
    /// # Errors
    ///
    /// The moment from which on it can be spent. An amount above the budget of a span gets a span of its own.
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

    /// Waits until the amount can be spent, and spends it.
    pub(super) async fn spend(&mut self, amount: usize) {
        while let Err(at) = self.try_spend(Instant::now(), amount) {
            sleep_until(at).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn each_span_has_the_full_budget() {
        let begun = Instant::now();
        let mut rate_limiter = limiter_of_bytes();
        let mut moments = Vec::new();
        for _ in 0..25 {
            rate_limiter.spend(1_400).await;
            moments.push(begun.elapsed().as_millis());
        }
        let expected = [vec![0; 11], vec![35; 11], vec![70; 3]];
        assert_eq!(moments, expected.concat());
    }

    #[tokio::test(start_paused = true)]
    async fn an_amount_above_the_budget_gets_its_own_span() {
        let begun = Instant::now();
        let mut rate_limiter = limiter_of_bytes();
        rate_limiter.spend(1).await;
        rate_limiter.spend(1 << 20).await;
        assert_eq!(begun.elapsed().as_millis(), 35);
        rate_limiter.spend(1).await;
        assert_eq!(begun.elapsed().as_millis(), 70);
    }
}
