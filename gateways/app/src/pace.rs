//! Paces: how much may leave in some time.
//!
//! Bytes of a connection have a budget for each span of time; datagrams to an address leave one
//! in each interval, after a burst that makes a late timer cost nothing.

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
    fn try_spend(&mut self, now: Instant, amount: usize) -> Result<(), Instant> {
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

/// A pace, and what it has let pass.
#[derive(Clone, Debug)]
pub(super) struct DatagramPace {
    /// Time of one datagram.
    interval: Duration,
    /// Datagrams may be earlier than their moments by this.
    slack: Duration,
    /// The moment of the next datagram, at an even pace.
    due: Option<Instant>,
}

/// Time whose datagrams may leave at once: that of a late timer.
const BURST: Duration = Duration::from_millis(3);

impl DatagramPace {
    /// A pace of this number of datagrams in a millisecond, at least one.
    pub(super) fn new(per_millisecond: u32) -> Self {
        let interval = Duration::from_millis(1) / per_millisecond.max(1);
        Self {
            interval,
            slack: BURST.saturating_sub(interval),
            due: None,
        }
    }

    /// Lets a datagram pass.
    ///
    /// # Errors
    ///
    /// The moment from which on it may pass.
    pub(super) fn try_pass(&mut self, now: Instant) -> Result<(), Instant> {
        let due = self.due.map_or(now, |due| due.max(now));
        if due > now + self.slack {
            return Err(due - self.slack);
        }
        self.due = Some(due + self.interval);
        Ok(())
    }

    /// True if the pace equals a new one.
    pub(super) fn is_over(&self, now: Instant) -> bool {
        self.due.is_none_or(|due| due <= now)
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

    /// Moments at which datagrams pass when as many as may pass do so in each span.
    fn passed(pace: &mut DatagramPace, begun: Instant, spans_ms: &[u64]) -> Vec<u64> {
        let mut moments = Vec::new();
        let mut now = begun;
        for span in spans_ms {
            while pace.try_pass(now).is_ok() {
                moments.push((now - begun).as_millis() as u64);
            }
            now += Duration::from_millis(*span);
        }
        moments
    }

    #[test]
    fn no_ten_milliseconds_have_more_than_the_buffer_of_the_client_holds() {
        // Whenever the timer fires, and however the polls lie to it.
        for spans in [
            vec![1; 200],
            vec![2; 100],
            [1, 3, 1, 7].repeat(25),
            vec![40; 5],
        ] {
            let mut pace = DatagramPace::new(20);
            let moments = passed(&mut pace, Instant::now(), &spans);
            let most = moments.iter().map(|first| {
                let within = moments
                    .iter()
                    .filter(|at| (*first..first + 10).contains(*at));
                within.count()
            });
            assert!(most.max() <= Some(277), "{spans:?}");
        }
    }

    #[test]
    fn a_late_timer_costs_nothing_up_to_three_milliseconds() {
        for (span, spans) in [(1, 300), (2, 150), (3, 100)] {
            let mut pace = DatagramPace::new(20);
            let moments = passed(&mut pace, Instant::now(), &vec![span; spans]);
            assert!(moments.len() >= 299 * 20, "{span}: {}", moments.len());
        }
    }

    #[test]
    fn a_pace_is_as_new_after_its_last_moment() {
        let (mut pace, now) = (DatagramPace::new(1), Instant::now());
        assert!(pace.is_over(now));
        assert_eq!(pace.try_pass(now), Ok(()));
        assert!(!pace.is_over(now));
        assert!(pace.is_over(now + Duration::from_millis(1)));
    }
}
