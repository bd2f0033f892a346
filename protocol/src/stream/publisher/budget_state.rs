//! What is said first where a budget does not suffice, and what waits
//!
//! Invariant: what waits, waits by choice, is counted, and is reported of: the stream states the greatest share of a
//! tolerance that its tracks use. Costs a publisher without a budget nothing.

use alloc::boxed::Box;
use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{BodyId, Predictor, TRACK_AGE_MAX, Tick};

use super::Publisher;
use crate::packet::{CostModel, ErrorScale, InitialCostModel, Keyframe, Update};
use crate::stream::budget::{Budget, TokenBucket};
use crate::stream::mode_decision::share;
use crate::stream::observation::{Activity, Observation};
use crate::stream::observation_history::ObservationHistory;
use crate::stream::tracks::Slot;

/// A waiting body's error counts double after so many ticks, and so on.
const AGE: f64 = 60.0;
/// An error counts so much at least: of a body that sleeps, and only lacks the last digits.
const ERROR_LEAST: f64 = 0.25;
/// Each so many-th word goes to whoever waited longest: nobody starves, however wrong others are.
const PICKS_PER_LONGEST_WAITING: usize = 4;
/// While less is left nothing is said: heads would take more than words.
const PACKET_BYTES_MIN: u64 = 96;
/// Bytes of a packet besides its updates.
const HEAD: u64 = 12;
/// More bytes than any update takes.
const UPDATE_BYTES_BOUND: usize = Keyframe::BITS_MAX / 8 + 32;
/// While some wait, tolerances are loosened by this share of what the worst of them is beyond its own: on the recorded cubes
/// a twentieth and six tenths are as good (`replay --budget 8000`).
const LOOSE: f64 = 0.25;
/// How much of the way to that they go each tick.
const FOLLOW: f64 = 0.2;
/// They are never loosened more.
const SLACK_MAX: f64 = 1_000.0;

/// A budget in use.
#[derive(Debug)]
pub(super) struct BudgetState {
    token_bucket: TokenBucket,
    /// Bodies that were due and have not had a word since, by index.
    waiting: BTreeMap<u32, WaitingBody>,
    /// The greatest share that any track used at the ticks since the last packet, or at those that it spoke of.
    worst: f64,
    /// A packet was said, so that the next tick begins anew.
    reported: bool,
    pick_order: PickOrder,
}

/// A body that waits for a word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverBudget {
    /// Which one.
    pub body: BodyId,
    /// How much of its tolerance its track uses: more than one where it is off.
    pub share: f64,
    /// Since when it waits.
    pub since: Tick,
}

#[derive(Clone, Copy, Debug)]
struct WaitingBody {
    since: Tick,
    /// The share of its tolerance that its track used when it was passed over last.
    share: f64,
    /// What was observation of it last, and when.
    observation: Observation,
    observed_at: Tick,
}

/// A body that should have a word.
#[derive(Clone, Copy, Debug)]
struct DueUpdate {
    observation: Observation,
    share: f64,
    since: Tick,
    /// Its track is too old to be corrected any later.
    urgent: bool,
}

/// To whom a word goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pick {
    Worst,
    LongestWaiting,
}

/// Whose pick it is, counted from tick to tick: also where a tick pays for a word or two, who waited longest has some.
#[derive(Clone, Copy, Debug, Default)]
struct PickOrder {
    /// Words since the last one that went to who waited longest, as far as they matter.
    since_longest_waiting: usize,
}

impl PickOrder {
    const fn next(self) -> Pick {
        if self.since_longest_waiting < PICKS_PER_LONGEST_WAITING - 1 {
            Pick::Worst
        } else {
            Pick::LongestWaiting
        }
    }

    /// A word was given.
    fn pass(&mut self, pick: Pick) {
        self.since_longest_waiting = match pick {
            Pick::Worst => (self.since_longest_waiting + 1).min(PICKS_PER_LONGEST_WAITING - 1),
            Pick::LongestWaiting => 0,
        };
    }
}

impl DueUpdate {
    fn weight(&self, tick: Tick) -> f64 {
        let waited = tick.since(self.since).unwrap_or_default().count();
        self.share.max(ERROR_LEAST) * (1.0 + f64::from(waited) / AGE)
    }
}

impl Publisher {
    /// Holds what is said from now on to a budget.
    ///
    /// No body holds another then: each is worth a word by itself. No repair_symbols are said: they would take what words need.
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

    /// By what factor tracks exceed their tolerances at most, at the ticks since the last packet; if that was said at this
    /// tick, at those that it spoke of: a watermark behind it may be received_below without it.
    #[must_use]
    pub fn error_scale(&self) -> ErrorScale {
        let budget_state = self.budget_state.as_ref();
        budget_state.map_or(ErrorScale::NONE, |budget_state| {
            ErrorScale::covering(budget_state.worst)
        })
    }

    /// Whether what it says is attached to a budget.
    pub(crate) const fn has_budget(&self) -> bool {
        self.budget_state.is_some()
    }

    /// Bodies that wait for a word.
    #[must_use]
    pub fn waiting(&self) -> usize {
        let budget_state = self.budget_state.as_ref();
        budget_state.map_or(0, |budget_state| budget_state.waiting.len())
    }

    /// Bodies that wait for a word, in order of index.
    pub fn over_budget(&self) -> impl Iterator<Item = OverBudget> {
        let budget_state = self.budget_state.as_ref().into_iter();
        let waiting = budget_state.flat_map(|budget_state| budget_state.waiting.values());
        waiting.map(|waiting| OverBudget {
            body: waiting.observation.id,
            share: waiting.share,
            since: waiting.since,
        })
    }

    /// The one of them that is farthest off for its tolerance.
    #[must_use]
    pub fn worst_waiting(&self) -> Option<OverBudget> {
        let waiting = self.over_budget();
        waiting.max_by(|a, b| a.share.total_cmp(&b.share))
    }

    /// Takes from the budget what was said beside the packets and is to be paid for too.
    pub fn pay(&mut self, bytes: usize) {
        if let Some(budget_state) = &mut self.budget_state {
            budget_state.token_bucket.spend(bytes);
        }
    }

    /// Says what the budget allows of what is due at a tick; `before`: the tick that was spoken of before.
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
        self.statistics.aliases += self.alias_table.release_idle_aliases(tick);
        budget_state
            .token_bucket
            .earn(tick.since(before).unwrap_or_default());
        let observations = observation_history.at(tick).unwrap_or_default();
        self.statistics.looked += observations.len() as u64;
        let due = self.due(&mut budget_state, tick, observations);
        let mut updates = core::mem::take(&mut self.updates);
        updates.clear();
        self.encode_due(&mut budget_state, observation_history, due, &mut updates);

        let begun = out.len();
        let spoke = !updates.is_empty();
        self.budget_state = Some(budget_state);
        self.say(tick, &mut updates, scene_events, out);
        self.updates = updates;
        if let Some(budget_state) = self.budget_state.as_mut().filter(|_| spoke) {
            budget_state
                .token_bucket
                .spend(out[begun..].iter().map(Bytes::len).sum());
            budget_state.reported = true;
        }
    }

    /// Loosens tolerances while bodies wait, by a share of how far off the worst of them is: what cannot be said as often
    /// as it should is better said so that it serves longer.
    fn loosen(&mut self, worst_over_budget: f64) {
        let wanted = 1.0 + (worst_over_budget - 1.0).max(0.0) * LOOSE;
        self.slack += (wanted.min(SLACK_MAX) - self.slack) * FOLLOW;
    }

    /// Who should have a word: whose track is off, and who waits.
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
                .seen_slot(&observation)
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

    /// The share of its tolerance that a track uses, and whether it cannot wait; `None` while it needs no word.
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

    /// Gives words to the worst, and each few to who waited longest, while the budget lasts.
    fn encode_due(
        &mut self,
        budget_state: &mut BudgetState,
        observation_history: &ObservationHistory,
        due: Vec<DueUpdate>,
        updates: &mut Vec<Update>,
    ) {
        let tick = self.tick;
        let allowed = budget_state.token_bucket.left();
        let allowed = if allowed < PACKET_BYTES_MIN {
            0
        } else {
            allowed
        };
        let mut spent = HEAD * 8 * 256;
        let mut waiting = BTreeMap::new();
        let mut worst = 1.0;
        // Where all of them may encode_due, they do so in the order of a stream without a budget.
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
                let update = self.check(observation_history, tick, (0, &due.observation), None);
                spent += update.as_ref().map_or(0, Self::bits_of);
                updates.extend(update);
                budget_state.pick_order.pass(pick);
                // Loosened words may release more than the tolerance.
                let left = self.seen_slot(&due.observation);
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

    /// Bits of an update in 256ths, more or less.
    pub(super) fn bits_of(update: &Update) -> u64 {
        /// Naming a body by its index, and by its alias.
        const NAMED: u64 = 24 * 256;
        const SEATED: u64 = 4 * 256;
        let name = if update.body.is_some() { NAMED } else { SEATED };
        u64::from(InitialCostModel.cost(&update.payload)) + name
    }
}

/// The greater share; what is no number is beyond any.
fn worse(one: f64, other: f64) -> f64 {
    if other <= one {
        one
    } else if other.is_nan() {
        f64::INFINITY
    } else {
        other
    }
}

/// The urgent first, then the worst; each few words one to who waited longest, counted from the last tick on.
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
