//! The queue of a stream with a budget: updates of a tick, and waiting bodies.
//!
//! Urgent bodies go first, then the worst. Every few picks one goes to the body that waited longest, so that no body
//! waits forever. Invariant: every delayed update is counted and reported. The stream states the greatest share of a
//! tolerance that its tracks use. A publisher without a budget has no queue.

use alloc::collections::BTreeMap;
use alloc::vec;
use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, Rate, Tick, Ticks};

use crate::packet::{ErrorScale, Keyframe};
use crate::stream::observation_history::Observation;
use crate::stream::{Budget, TokenBucket};

/// With fewer bytes left no packet is sent, because its head would take more than its updates.
const PACKET_BYTES_MIN: u64 = 96;
/// Bytes of a packet besides its updates.
const HEAD: u64 = 12;
/// More bytes than any update takes.
const UPDATE_BYTES_BOUND: usize = Keyframe::BITS_MAX / 8 + 32;
/// 1/256 bits in a byte.
const BYTE: u64 = 8 * 256;
/// While bodies wait, tolerances are raised by this share of the worst waiting body's excess over its own. Measured on
/// the recorded cubes: 0.05 and 0.6 do as well (`replay --budget 8000`).
const LOOSE: f64 = 0.25;
/// The share of the remaining difference by which tolerances change each tick.
const FOLLOW: f64 = 0.2;
/// The greatest factor on tolerances.
const SLACK_MAX: f64 = 1_000.0;

/// A body whose update waits for the budget.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverBudget {
    /// The body.
    pub body: BodyId,
    /// The share of its tolerance that its track uses: above one if the body is out of tolerance.
    pub share: f64,
    /// The tick since which it waits.
    pub since: Tick,
}

/// A body that waits.
#[derive(Clone, Copy, Debug)]
struct WaitingBody {
    since: Tick,
    /// The share of its tolerance that its track used at the last published tick.
    share: f64,
    /// The newest observation of the body.
    observation: Observation,
    observed_at: Tick,
}

/// The need of a body for an update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Need {
    /// The share of its tolerance that its track uses.
    pub(super) share: f64,
    /// Its track is about to become too old for a correction.
    pub(super) urgent: bool,
}

/// The budget of a stream, and the bodies that wait for it.
#[derive(Debug)]
pub(super) struct UpdateQueue {
    token_bucket: TokenBucket,
    /// Bodies that were due and have had no update since, by index.
    waiting: BTreeMap<u32, WaitingBody>,
    /// The greatest share of a tolerance used by any track since the last packet, or at the ticks that it covers.
    worst: f64,
    /// A packet was sent, so `worst` starts again at the next tick.
    reported: bool,
    pick_order: PickOrder,
    /// The present factor on all tolerances, raised while the budget does not suffice; otherwise one.
    slack: f64,
    /// The number of bodies that were out of tolerance without an update, counted at every tick.
    over_budget: u64,
}

impl UpdateQueue {
    /// A queue without waiting bodies, and a full bucket.
    pub(super) fn new(budget: Budget, rate: Rate) -> Self {
        Self {
            token_bucket: TokenBucket::new(budget, rate),
            waiting: BTreeMap::new(),
            worst: 1.0,
            reported: false,
            pick_order: PickOrder::default(),
            slack: 1.0,
            over_budget: 0,
        }
    }

    /// Begins a tick, `passed` ticks after the one before, and returns the bodies that are due: those with a need among
    /// the observed ones and those that wait.
    pub(super) fn begin_tick(
        &mut self,
        tick: Tick,
        passed: Ticks,
        observations: &[Observation],
        need: impl Fn(&Observation) -> Option<Need>,
    ) -> Vec<DueUpdate> {
        if core::mem::take(&mut self.reported) {
            self.worst = 1.0;
        }
        self.token_bucket.earn(passed);
        for observation in observations {
            if let Some(waiting) = self.waiting.get_mut(&observation.id.index()) {
                (waiting.observation, waiting.observed_at) = (*observation, tick);
            }
        }
        let asleep = self.waiting.values();
        let unseen = asleep
            .filter(|waiting| waiting.observed_at != tick)
            .map(|waiting| waiting.observation);
        let mut due = Vec::new();
        for observation in observations.iter().copied().chain(unseen) {
            let waiting = self.waiting.get(&observation.id.index());
            due.extend(need(&observation).map(|Need { share, urgent }| DueUpdate {
                observation,
                share,
                since: waiting.map_or(tick, |waiting| waiting.since),
                urgent,
            }));
        }
        due
    }

    /// Begins the updates of a tick: an order of the due bodies. All bodies that it does not return wait.
    pub(super) fn spend(&mut self, due: Vec<DueUpdate>, tick: Tick) -> TickUpdates<'_> {
        let allowed = self.token_bucket.left();
        let allowed = if allowed < PACKET_BYTES_MIN {
            0
        } else {
            allowed
        };
        // If the budget suffices for all, the order is that of a stream without a budget.
        let all = (due.len() * UPDATE_BYTES_BOUND) as u64 <= allowed;
        let order = if all {
            self.slack = 1.0;
            due.into_iter().map(|due| (Pick::Worst, due)).collect()
        } else {
            self.pick_order.sorted(due, tick)
        };
        TickUpdates {
            queue: self,
            tick,
            order: order.into_iter(),
            all,
            allowed: allowed * BYTE,
            spent: HEAD * BYTE,
            waiting: BTreeMap::new(),
            worst: 1.0,
            worst_waiting: 1.0,
        }
    }

    /// Spends bytes of the budget on datagrams.
    pub(super) fn pay(&mut self, bytes: usize) {
        self.token_bucket.spend(bytes);
    }

    /// True if no body waits, and half of the burst is unspent: then repair symbols take nothing from updates.
    pub(super) fn spares(&self) -> bool {
        self.waiting.is_empty() && self.token_bucket.is_half_full()
    }

    /// Pays for the packets of a tick, which state the error scale.
    pub(super) fn pay_packets(&mut self, bytes: usize) {
        self.pay(bytes);
        self.reported = true;
    }

    /// See [`super::Publisher::error_scale`].
    pub(super) fn error_scale(&self) -> ErrorScale {
        ErrorScale::covering(self.worst)
    }

    /// The number of bodies that wait.
    pub(super) fn len(&self) -> usize {
        self.waiting.len()
    }

    /// The bodies that wait, in order of index.
    pub(super) fn waiting(&self) -> impl Iterator<Item = OverBudget> {
        self.waiting.values().map(|waiting| OverBudget {
            body: waiting.observation.id,
            share: waiting.share,
            since: waiting.since,
        })
    }

    /// The number of bodies that were out of tolerance without an update, counted at every tick.
    pub(super) const fn over_budget(&self) -> u64 {
        self.over_budget
    }

    /// Raises tolerances while bodies wait, by a share of the worst body's excess. An update that cannot be sent often
    /// then lasts longer.
    fn loosen(&mut self, worst_waiting: f64) {
        let wanted = 1.0 + (worst_waiting - 1.0).max(0.0) * LOOSE;
        self.slack += (wanted.min(SLACK_MAX) - self.slack) * FOLLOW;
    }
}

/// The updates of one tick within a budget. Call [`Self::next`], then [`Self::pass`] for each body, and finally
/// [`Self::end`].
#[derive(Debug)]
pub(super) struct TickUpdates<'q> {
    queue: &'q mut UpdateQueue,
    tick: Tick,
    order: vec::IntoIter<(Pick, DueUpdate)>,
    /// The budget suffices for all.
    all: bool,
    /// The budget of the tick and the approximate cost of its updates so far, in 1/256 bits.
    allowed: u64,
    spent: u64,
    /// The bodies that wait from this tick on, by index.
    waiting: BTreeMap<u32, WaitingBody>,
    /// The greatest share of a tolerance used by a track that was due, and by one of a waiting body.
    worst: f64,
    worst_waiting: f64,
}

impl TickUpdates<'_> {
    /// The factor on all tolerances.
    pub(super) const fn slack(&self) -> f64 {
        self.queue.slack
    }

    /// The next body that gets an update: urgent ones always, others while the budget lasts.
    pub(super) fn next(&mut self) -> Option<Observation> {
        loop {
            let (pick, due) = self.order.next()?;
            if due.urgent || self.all || self.spent < self.allowed {
                self.queue.pick_order.pass(pick);
                return Some(due.observation);
            }
            self.delay(&due);
        }
    }

    /// Counts an update of approximately this cost, in 1/256 bits. `share`: the share of its tolerance that the body
    /// still uses, because tolerances may be raised.
    pub(super) fn pass(&mut self, bits: u64, share: f64) {
        self.spent += bits;
        self.worst = worse(self.worst, share);
    }

    /// Ends the updates of the tick.
    pub(super) fn end(self) {
        self.queue.loosen(self.worst_waiting);
        self.queue.waiting = self.waiting;
        self.queue.worst = worse(self.queue.worst, self.worst);
    }

    /// Leaves a body waiting.
    fn delay(&mut self, due: &DueUpdate) {
        let waiting = WaitingBody {
            since: due.since,
            share: due.share,
            observation: due.observation,
            observed_at: self.tick,
        };
        self.waiting.insert(due.observation.id.index(), waiting);
        self.queue.over_budget += u64::from(due.share > 1.0);
        self.worst = worse(self.worst, due.share);
        self.worst_waiting = self.worst_waiting.max(due.share);
    }
}

/// The greater share; NaN is greater than any number.
fn worse(one: f64, other: f64) -> f64 {
    if other <= one {
        one
    } else if other.is_nan() {
        f64::INFINITY
    } else {
        other
    }
}

/// A waiting body's error counts double after this many ticks, triple after twice as many, and so on.
const AGE: f64 = 60.0;
/// The least weight of an error: for a sleeping body that only lacks its exact rest pose.
const ERROR_LEAST: f64 = 0.25;
/// One pick in this many goes to the body that waited longest, so that no body waits forever.
const PICKS_PER_LONGEST_WAITING: usize = 4;

/// A body that is due for an update.
#[derive(Clone, Copy, Debug)]
pub(super) struct DueUpdate {
    observation: Observation,
    /// The share of its tolerance that its track uses.
    share: f64,
    /// The tick since which it waits.
    since: Tick,
    /// Its track is about to become too old for a correction.
    urgent: bool,
}

impl DueUpdate {
    fn weight(&self, tick: Tick) -> f64 {
        let waited = tick.since(self.since).unwrap_or_default().count();
        self.share.max(ERROR_LEAST) * (1.0 + f64::from(waited) / AGE)
    }

    /// Lower for a body that is picked earlier: urgent ones first, then the heaviest.
    fn rank(&self, tick: Tick) -> u64 {
        // Positive doubles are in the order of their bits, and the highest bit, their sign, is free.
        let weight = self.weight(tick).to_bits();
        (u64::from(!self.urgent) << 63) + ((1 << 63) - 1 - weight)
    }
}

/// The rule by which a body is picked for an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pick {
    Worst,
    LongestWaiting,
}

/// The turn of the longest waiting body. The count continues from tick to tick, so it gets updates even if a tick
/// pays for few.
#[derive(Clone, Copy, Debug, Default)]
struct PickOrder {
    /// Picks since the last longest-waiting one, at most the interval.
    since_longest_waiting: usize,
}

impl PickOrder {
    /// Counts a pick.
    fn pass(&mut self, pick: Pick) {
        self.since_longest_waiting = match pick {
            Pick::Worst => (self.since_longest_waiting + 1).min(PICKS_PER_LONGEST_WAITING - 1),
            Pick::LongestWaiting => 0,
        };
    }

    /// The due updates in the order of picks, if all are picked from now on.
    fn sorted(mut self, due: Vec<DueUpdate>, tick: Tick) -> Vec<(Pick, DueUpdate)> {
        let ranks = due.iter().map(|due| due.rank(tick));
        let mut ranked: Vec<(u64, usize)> = ranks.zip(0..).collect();
        ranked.sort_unstable();
        let due: Vec<DueUpdate> = ranked.into_iter().map(|(_, place)| due[place]).collect();
        let since = due.iter().map(|due| due.since.value());
        let mut eldest: Vec<(u64, usize)> = since.zip(0..).collect();
        eldest.sort_unstable();
        let mut taken = alloc::vec![false; due.len()];
        let mut order = Vec::with_capacity(due.len());
        let (mut worst, mut eldest) = (0..due.len(), eldest.into_iter().map(|(_, place)| place));
        while order.len() < due.len() {
            let is_free = |place: &usize| !taken[*place];
            let pick = self.next();
            let place = match pick {
                Pick::LongestWaiting => eldest.find(is_free),
                Pick::Worst => worst.find(is_free),
            };
            let Some(place) = place else { break };
            taken[place] = true;
            self.pass(pick);
            order.push((pick, due[place]));
        }
        order
    }

    const fn next(self) -> Pick {
        if self.since_longest_waiting < PICKS_PER_LONGEST_WAITING - 1 {
            Pick::Worst
        } else {
            Pick::LongestWaiting
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rhumb_reckoning::{BodyId, BodyState};

    use super::*;
    use crate::stream::observation_history::Activity;

    const BODIES: u32 = 40;

    fn observation(index: u32) -> Observation {
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        Observation {
            id: BodyId::new(index, 0),
            motion: still.expect("it is finite"),
            activity: Activity::Awake,
        }
    }

    fn queue(bytes_per_second: u32) -> UpdateQueue {
        let budget = Budget::per_second(bytes_per_second).expect("it is within the limits");
        UpdateQueue::new(budget, Rate::HZ_60)
    }

    /// Runs a tick in which each body uses this share of its tolerance and each update takes this many bytes. Returns
    /// the bodies with updates.
    fn run(queue: &mut UpdateQueue, tick: u64, share: f64, bytes: u64) -> Vec<u32> {
        let tick = Tick::new(tick);
        let observations: Vec<_> = (0..BODIES).map(observation).collect();
        let urgent = false;
        let due = queue.begin_tick(tick, Ticks::new(1), &observations, |_| {
            (share > 1.0).then_some(Need { share, urgent })
        });
        let mut updates = queue.spend(due, tick);
        let mut updated = Vec::new();
        while let Some(observation) = updates.next() {
            updates.pass(bytes * BYTE, 0.5);
            updated.push(observation.id.index());
        }
        updates.end();
        queue.pay_packets(updated.len() * bytes as usize);
        updated
    }

    proptest! {
        #[test]
        fn a_due_body_gets_its_update_or_waits_and_none_waits_forever(
            (rate, bytes) in (8_000_u32..80_000, 10_u64..60),
        ) {
            let mut queue = queue(rate);
            let mut last = [0_u64; BODIES as usize];
            let mut over_budget = 0;
            for tick in 1..=300 {
                let updated = run(&mut queue, tick, 3.0, bytes);
                let waiting: Vec<u32> = queue.waiting().map(|waiting| waiting.body.index()).collect();
                prop_assert_eq!(updated.len() + waiting.len(), BODIES as usize);
                prop_assert!(updated.iter().all(|index| !waiting.contains(index)));
                prop_assert_eq!(queue.len(), waiting.len());
                over_budget += waiting.len() as u64;
                prop_assert_eq!(queue.over_budget(), over_budget);
                let scale = if waiting.is_empty() { 1.0 } else { 3.0 };
                prop_assert_eq!(queue.error_scale(), ErrorScale::covering(scale));
                for index in updated {
                    last[index as usize] = tick;
                }
            }
            prop_assert!(last.iter().all(|tick| *tick > 100), "{:?}", last);
        }
    }

    #[test]
    fn tolerances_rise_while_bodies_wait_and_are_usual_as_soon_as_the_budget_suffices() {
        let mut queue = queue(8_000);
        for tick in 1..=100 {
            run(&mut queue, tick, 5.0, 50);
        }
        assert!(queue.len() > 0);
        assert!((queue.slack - (1.0 + 4.0 * LOOSE)).abs() < 1e-6);
        for tick in 101..=200 {
            run(&mut queue, tick, 0.5, 50);
        }
        assert_eq!((queue.len(), queue.slack), (0, 1.0));
        assert_eq!(queue.error_scale(), ErrorScale::NONE);
    }

    #[test]
    fn a_waiting_body_that_fell_asleep_is_due_by_its_last_observation() {
        let mut queue = queue(8_000);
        queue.pay(1_000_000);
        run(&mut queue, 1, 2.0, 50);
        assert_eq!(queue.len(), BODIES as usize);
        let urgent = false;
        let due = queue.begin_tick(Tick::new(2), Ticks::new(1), &[observation(7)], |_| {
            Some(Need { share: 2.0, urgent })
        });
        assert_eq!(due.len(), BODIES as usize, "each body once");
        assert!(due.iter().all(|due| due.since == Tick::new(1)));
    }

    #[test]
    fn an_urgent_body_gets_its_update_from_an_empty_bucket() {
        let mut queue = queue(8_000);
        queue.pay(1_000_000);
        let observations: Vec<_> = (0..BODIES).map(observation).collect();
        let due = queue.begin_tick(Tick::new(1), Ticks::new(1), &observations, |observation| {
            let urgent = observation.id.index() == 9;
            Some(Need { share: 2.0, urgent })
        });
        let mut updates = queue.spend(due, Tick::new(1));
        let first = updates.next().map(|observation| observation.id.index());
        assert_eq!(first, Some(9));
        updates.pass(BYTE, 0.5);
        assert!(updates.next().is_none());
        updates.end();
        assert_eq!(queue.len(), BODIES as usize - 1);
    }

    #[test]
    fn a_share_that_is_no_number_counts_as_infinite() {
        assert_eq!(worse(2.0, f64::NAN), f64::INFINITY);
        assert_eq!(worse(f64::INFINITY, 3.0), f64::INFINITY);
        assert_eq!((worse(2.0, 3.0), worse(3.0, 2.0)), (3.0, 3.0));
    }

    const NOW: Tick = Tick::new(100);

    fn due(index: usize, (share, since, urgent): (f64, u64, bool)) -> DueUpdate {
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        DueUpdate {
            observation: Observation {
                id: BodyId::new(index as u32, 0),
                motion: still.expect("it is finite"),
                activity: Activity::Awake,
            },
            share,
            since: Tick::new(since),
            urgent,
        }
    }

    fn index((_, due): &(Pick, DueUpdate)) -> u32 {
        due.observation.id.index()
    }

    proptest! {
        #[test]
        fn every_due_body_is_picked_once_and_one_in_four_picks_waited_longest(
            bodies in proptest::collection::vec((0.0_f64..9.0, 0_u64..100, any::<bool>()), 0..50),
        ) {
            let due: Vec<_> = bodies.iter().enumerate().map(|(at, body)| due(at, *body)).collect();
            let order = PickOrder::default().sorted(due, NOW);
            let mut indices: Vec<u32> = order.iter().map(index).collect();
            for (at, (pick, picked)) in order.iter().enumerate() {
                let left = order[at..].iter().map(|(_, due)| due);
                match pick {
                    Pick::LongestWaiting => {
                        prop_assert_eq!(at % PICKS_PER_LONGEST_WAITING, PICKS_PER_LONGEST_WAITING - 1);
                        prop_assert!(left.clone().all(|other| picked.since <= other.since));
                    }
                    Pick::Worst => {
                        let rank = |due: &DueUpdate| (due.urgent, due.weight(NOW));
                        prop_assert!(left.clone().all(|other| rank(picked) >= rank(other)));
                    }
                }
            }
            indices.sort_unstable();
            prop_assert!(indices.into_iter().eq(0..bodies.len() as u32));
        }
    }
}
