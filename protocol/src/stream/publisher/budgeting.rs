//! The order of updates when a budget does not suffice.
//!
//! Invariant: every delayed update is counted and reported. The stream states the greatest share of a tolerance that
//! its tracks use. A publisher without a budget pays nothing for this.

use alloc::boxed::Box;
use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{Predictor, TRACK_AGE_MAX, Tick};

use super::Publisher;
use super::budget_state::{BudgetState, DueUpdate, OverBudget, Pick, PickOrder, WaitingBody};
use super::window::ObservedTicks;
use crate::packet::{CostModel, ErrorScale, InitialCostModel, Keyframe, Update};
use crate::stream::budget::{Budget, TokenBucket};
use crate::stream::mode_decision::share;
use crate::stream::observation::{Activity, Observation};
use crate::stream::observation_history::ObservationHistory;
use crate::stream::tracks::Slot;

/// With fewer bytes left no packet is sent, because its head would take more than its updates.
const PACKET_BYTES_MIN: u64 = 96;
/// Bytes of a packet besides its updates.
const HEAD: u64 = 12;
/// More bytes than any update takes.
const UPDATE_BYTES_BOUND: usize = Keyframe::BITS_MAX / 8 + 32;
/// While bodies wait, tolerances are raised by this share of the worst waiting body's excess over its own. Measured on
/// the recorded cubes: 0.05 and 0.6 do as well (`replay --budget 8000`).
const LOOSE: f64 = 0.25;
/// The share of the remaining difference by which tolerances change each tick.
const FOLLOW: f64 = 0.2;
/// The greatest factor on tolerances.
const SLACK_MAX: f64 = 1_000.0;

impl Publisher {
    /// Holds the stream to a budget from now on.
    ///
    /// Attachment is switched off, so that each update is useful alone. Repair symbols are switched off, because they
    /// would take bytes from updates.
    pub fn limit(&mut self, budget: Budget) {
        self.features.attached = false;
        self.features.redundancy = false;
        self.budget_state = Some(Box::new(BudgetState {
            token_bucket: TokenBucket::new(budget, self.tracks.integrator().rate),
            waiting: BTreeMap::new(),
            worst: 1.0,
            reported: false,
            pick_order: PickOrder::default(),
        }));
    }

    /// The greatest factor by which tracks exceed their tolerances, at the ticks since the last packet. If a packet was
    /// sent at this tick, at the ticks that it covers: a watermark may arrive without the packet before it.
    #[must_use]
    pub fn error_scale(&self) -> ErrorScale {
        let budget_state = self.budget_state.as_ref();
        budget_state.map_or(ErrorScale::NONE, |budget_state| {
            ErrorScale::covering(budget_state.worst)
        })
    }

    /// True if the stream has a budget.
    pub(crate) const fn has_budget(&self) -> bool {
        self.budget_state.is_some()
    }

    /// The number of bodies whose updates wait.
    #[must_use]
    pub fn waiting(&self) -> usize {
        let budget_state = self.budget_state.as_ref();
        budget_state.map_or(0, |budget_state| budget_state.waiting.len())
    }

    /// The bodies whose updates wait, in order of index.
    pub fn over_budget(&self) -> impl Iterator<Item = OverBudget> {
        let budget_state = self.budget_state.as_ref().into_iter();
        let waiting = budget_state.flat_map(|budget_state| budget_state.waiting.values());
        waiting.map(|waiting| OverBudget {
            body: waiting.observation.id,
            share: waiting.share,
            since: waiting.since,
        })
    }

    /// The waiting body whose track uses the greatest share of its tolerance.
    #[must_use]
    pub fn worst_waiting(&self) -> Option<OverBudget> {
        let waiting = self.over_budget();
        waiting.max_by(|a, b| a.share.total_cmp(&b.share))
    }

    /// Spends bytes of the budget on datagrams other than packets.
    pub fn pay(&mut self, bytes: usize) {
        if let Some(budget_state) = &mut self.budget_state {
            budget_state.token_bucket.spend(bytes);
        }
    }

    /// Publishes the due updates that the budget allows; `before` is the last published tick.
    pub(super) fn publish_within(
        &mut self,
        mut budget_state: Box<BudgetState>,
        observation_history: &ObservationHistory,
        before: Tick,
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        let tick = self.tick;
        if core::mem::take(&mut budget_state.reported) {
            budget_state.worst = 1.0;
        }
        self.alias_table.begin_tick();
        budget_state
            .token_bucket
            .earn(tick.since(before).unwrap_or_default());
        let observations = observation_history.at(tick).unwrap_or_default();
        self.statistics.checked += observations.len() as u64;
        let due = self.due(&mut budget_state, tick, observations);
        let mut updates = core::mem::take(&mut self.updates);
        updates.clear();
        self.encode_due(&mut budget_state, observation_history, due, &mut updates);

        let first_new = out.len();
        let has_updates = !updates.is_empty();
        self.budget_state = Some(budget_state);
        self.encode_updates(tick, &mut updates, scene_events, out);
        self.updates = updates;
        if let Some(budget_state) = self.budget_state.as_mut().filter(|_| has_updates) {
            budget_state
                .token_bucket
                .spend(out[first_new..].iter().map(Bytes::len).sum());
            budget_state.reported = true;
        }
    }

    /// Raises tolerances while bodies wait, by a share of the worst body's excess. An update that cannot be sent often
    /// then lasts longer.
    fn loosen(&mut self, worst_over_budget: f64) {
        let wanted = 1.0 + (worst_over_budget - 1.0).max(0.0) * LOOSE;
        self.slack += (wanted.min(SLACK_MAX) - self.slack) * FOLLOW;
    }

    /// The bodies that are due: those with tracks out of tolerance, and those that wait.
    fn due(
        &self,
        budget_state: &mut BudgetState,
        tick: Tick,
        observations: &[Observation],
    ) -> Vec<DueUpdate> {
        for observation in observations {
            if let Some(waiting) = budget_state.waiting.get_mut(&observation.id.index()) {
                (waiting.observation, waiting.observed_at) = (*observation, tick);
            }
        }
        let asleep = budget_state.waiting.values();
        let unseen = asleep
            .filter(|waiting| waiting.observed_at != tick)
            .map(|waiting| waiting.observation);
        let mut due = Vec::new();
        for observation in observations.iter().copied().chain(unseen) {
            let since = budget_state.waiting.get(&observation.id.index());
            let since = since.map_or(tick, |waiting| waiting.since);
            let found = self
                .observed_slot(&observation)
                .and_then(|slot| self.is_due(slot, tick, &observation));
            due.extend(found.map(|(share, urgent)| DueUpdate {
                observation,
                share,
                since,
                urgent,
            }));
        }
        due
    }

    /// The share of its tolerance that a track uses, and whether its update is urgent; `None` if it needs no update.
    fn is_due(&self, slot: &Slot, tick: Tick, observation: &Observation) -> Option<(f64, bool)> {
        let predicted_motion = self
            .tracks
            .predicted_motion((observation.id.index(), slot), tick);
        let tolerance = self.tracks.tolerance_of(slot);
        let truth = observation.motion.motion();
        let used = share(
            &truth.pose(),
            &predicted_motion.pose(),
            tolerance,
            self.tracks.radius(slot),
        );
        let age = tick.since(slot.origin())?;
        let moves = slot.predictor() != Predictor::Rest;
        let urgent = age >= TRACK_AGE_MAX && moves;
        let reported = match observation.activity {
            Activity::Asleep => slot.is_exact_rest() && used <= 1.0,
            Activity::Awake => used <= 1.0 && self.features.prefilter,
        };
        (urgent || !reported).then_some((used, urgent))
    }

    /// Encodes the updates of the worst bodies and, now and then, of the longest waiting, while the budget lasts.
    fn encode_due(
        &mut self,
        budget_state: &mut BudgetState,
        observation_history: &ObservationHistory,
        due: Vec<DueUpdate>,
        updates: &mut Vec<Update>,
    ) {
        let tick = self.tick;
        let ticks = ObservedTicks::around(observation_history, tick);
        let allowed = budget_state.token_bucket.left();
        let allowed = if allowed < PACKET_BYTES_MIN {
            0
        } else {
            allowed
        };
        let mut spent = HEAD * 8 * 256;
        let mut waiting = BTreeMap::new();
        let mut worst = 1.0;
        // If the budget suffices for all, the order is that of a stream without a budget.
        let all = (due.len() * UPDATE_BYTES_BOUND) as u64 <= allowed;
        if all {
            self.slack = 1.0;
        }
        let mut over_budget: f64 = 1.0;
        let order = if all {
            due.into_iter().map(|due| (Pick::Worst, due)).collect()
        } else {
            pick_in_order(due, tick, budget_state.pick_order)
        };
        for (pick, due) in order {
            if due.urgent || all || spent < allowed * 8 * 256 {
                let update = self.check(&ticks, (0, &due.observation), None);
                spent += update.as_ref().map_or(0, Self::bits_of);
                updates.extend(update);
                budget_state.pick_order.pass(pick);
                // After an update under raised tolerances, the body may still exceed its own tolerance.
                let left = self.observed_slot(&due.observation);
                let left = left.and_then(|slot| self.is_due(slot, tick, &due.observation));
                worst = worse(worst, left.map_or(1.0, |(share, _)| share));
                continue;
            }
            let mine = WaitingBody {
                since: due.since,
                share: due.share,
                observation: due.observation,
                observed_at: tick,
            };
            waiting.insert(due.observation.id.index(), mine);
            self.statistics.over_budget += u64::from(due.share > 1.0);
            worst = worse(worst, due.share);
            over_budget = over_budget.max(due.share);
        }
        self.loosen(over_budget);
        budget_state.waiting = waiting;
        budget_state.worst = worse(budget_state.worst, worst);
    }

    /// The approximate cost of an update, in 1/256 bits.
    pub(super) fn bits_of(update: &Update) -> u64 {
        /// The cost of a body's index and its new alias.
        const NAMED: u64 = 24 * 256;
        /// The cost of an existing alias.
        const ALIASED: u64 = 4 * 256;
        let name = if update.body.is_some() {
            NAMED
        } else {
            ALIASED
        };
        u64::from(InitialCostModel.cost(&update.payload)) + name
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

/// The order of picks: urgent bodies first, then the worst. Every few picks one goes to the longest waiting body,
/// counted from the last tick on.
fn pick_in_order(
    mut due: Vec<DueUpdate>,
    tick: Tick,
    mut pick_order: PickOrder,
) -> Vec<(Pick, DueUpdate)> {
    due.sort_by(|a, b| {
        let by_weight = b.weight(tick).total_cmp(&a.weight(tick));
        b.urgent.cmp(&a.urgent).then(by_weight)
    });
    let mut eldest: Vec<usize> = (0..due.len()).collect();
    eldest.sort_by_key(|place| due[*place].since);
    let mut taken = alloc::vec![false; due.len()];
    let mut order = Vec::with_capacity(due.len());
    let (mut worst, mut eldest) = (0..due.len(), eldest.into_iter());
    while order.len() < due.len() {
        let is_free = |place: &usize| !taken[*place];
        let pick = pick_order.next();
        let place = match pick {
            Pick::LongestWaiting => eldest.find(is_free),
            Pick::Worst => worst.find(is_free),
        };
        let Some(place) = place else { break };
        taken[place] = true;
        pick_order.pass(pick);
        order.push((pick, due[place]));
    }
    order
}
