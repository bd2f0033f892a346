//! A member's share of the time that a scene has for queries.
//!
//! Costs are those of the protocol: one is a body that a ray finds, some 2 µs in a scene of 10,000 bodies.

use rhumb_protocol::Instant;
use rhumb_protocol::limits::QUERY_COST_MAX;

/// Cost of all queries of a scene in a second: about a fifth of a core.
const COST_PER_SECOND: u64 = 100_000;
/// Cost that a member may have answered at once: two of the largest messages.
const BURST: u64 = 2 * QUERY_COST_MAX as u64;
/// Parts of a unit of cost, so that short times earn something.
const PARTS: u64 = 1_000_000;

/// The rest of a member's share of query time.
#[derive(Debug)]
pub(crate) struct QueryBudget {
    left: u64,
    earned_at: Instant,
}

impl QueryBudget {
    /// A full budget.
    pub(crate) const fn new() -> Self {
        Self {
            left: BURST * PARTS,
            earned_at: Instant::ZERO,
        }
    }

    /// Takes the cost of a message, unless too little is left. The members of a scene share its time equally.
    pub(crate) fn spend(&mut self, now: Instant, cost: u32, members: usize) -> bool {
        let micros = now.since(self.earned_at).as_nanos() / 1_000;
        let earned = micros.saturating_mul(COST_PER_SECOND) / members.max(1) as u64;
        if earned > 0 {
            self.earned_at = now;
            self.left = self.left.saturating_add(earned).min(BURST * PARTS);
        }
        let rest = self.left.checked_sub(u64::from(cost) * PARTS);
        self.left = rest.unwrap_or(self.left);
        rest.is_some()
    }
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::Span;

    use super::*;

    #[test]
    fn members_share_the_time_of_a_scene() {
        for members in [1, 4] {
            let mut budgets: Vec<_> = (0..members).map(|_| QueryBudget::new()).collect();
            let mut answered = 0_u64;
            for millis in 0..10_000 {
                let now = Instant::ZERO + Span::from_millis(millis);
                for budget in &mut budgets {
                    answered += u64::from(budget.spend(now, 1_000, members)) * 1_000;
                }
            }
            let most = 10 * COST_PER_SECOND + members as u64 * BURST;
            assert!((most - 10_000..=most).contains(&answered), "{answered}");
        }
    }
}
