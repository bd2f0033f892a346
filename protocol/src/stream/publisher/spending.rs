//! What is said first where a budget does not suffice, and what waits
//!
//! Invariant: what waits, waits by choice, is counted, and is told of: the stream states the greatest share of a
//! tolerance that its tracks use. Costs a publisher without a budget nothing.

use alloc::boxed::Box;
use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{BodyId, HORIZON, Predictor, Tick};

use super::Publisher;
use crate::packet::{Excess, Opening, Pricing, TrackSaying, Update};
use crate::stream::budget::{Budget, Purse};
use crate::stream::choose::share;
use crate::stream::observation::{Activity, Observation};
use crate::stream::tracks::Slot;
use crate::stream::witness::Witness;

/// A waiting body's error counts double after so many ticks, and so on.
const AGE: f64 = 60.0;
/// An error counts so much at least: of a body that sleeps, and only lacks the last digits.
const ERROR_LEAST: f64 = 0.25;
/// Each so many-th word goes to whoever waited longest: nobody starves, however wrong others are.
const TURNS: usize = 4;
/// While less is left nothing is said: heads would take more than words.
const WORTH_A_PACKET: u64 = 96;
/// Bytes of a packet besides its updates.
const HEAD: u64 = 12;
/// More bytes than any update takes.
const LONGEST_WORD: usize = TrackSaying::BITS_MAX / 8 + 32;
/// While some wait, tolerances are loosened by this share of what the worst of them is beyond its own: on the recorded cubes
/// a twentieth and six tenths are as good (`replay --budget 8000`).
const LOOSE: f64 = 0.25;
/// How much of the way to that they go each tick.
const FOLLOW: f64 = 0.2;
/// They are never loosened more.
const SLACK_MOST: f64 = 1_000.0;

/// A budget in use.
#[derive(Debug)]
pub(super) struct Spending {
    purse: Purse,
    /// Bodies that were due and have not had a word since, by index.
    waiting: BTreeMap<u32, Waiting>,
    /// The greatest share that any track used at the ticks since the last packet, or at those that it spoke of.
    worst: f64,
    /// A packet was said, so that the next tick begins anew.
    told: bool,
    turns: Turns,
}

/// A body that waits for a word.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InArrears {
    /// Which one.
    pub body: BodyId,
    /// How much of its tolerance its track uses: more than one where it is off.
    pub share: f64,
    /// Since when it waits.
    pub since: Tick,
}

#[derive(Clone, Copy, Debug)]
struct Waiting {
    since: Tick,
    /// The share of its tolerance that its track used when it was passed over last.
    share: f64,
    /// What was seen of it last, and when.
    seen: Observation,
    seen_at: Tick,
}

/// A body that should have a word.
#[derive(Clone, Copy, Debug)]
struct Due {
    seen: Observation,
    share: f64,
    since: Tick,
    /// Its track is too old to be corrected any later.
    urgent: bool,
}

/// To whom a word goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    Worst,
    Eldest,
}

/// Whose turn it is, counted from tick to tick: also where a tick pays for a word or two, who waited longest has some.
#[derive(Clone, Copy, Debug, Default)]
struct Turns {
    /// Words since the last one that went to who waited longest, as far as they matter.
    since_eldest: usize,
}

impl Turns {
    const fn next(self) -> Turn {
        if self.since_eldest < TURNS - 1 {
            Turn::Worst
        } else {
            Turn::Eldest
        }
    }

    /// A word was given.
    fn pass(&mut self, turn: Turn) {
        self.since_eldest = match turn {
            Turn::Worst => (self.since_eldest + 1).min(TURNS - 1),
            Turn::Eldest => 0,
        };
    }
}

impl Due {
    fn weight(&self, tick: Tick) -> f64 {
        let waited = tick.since(self.since).unwrap_or_default().count();
        self.share.max(ERROR_LEAST) * (1.0 + f64::from(waited) / AGE)
    }
}

impl Publisher {
    /// Holds what is said from now on to a budget.
    ///
    /// No body holds another then: each is worth a word by itself. No parities are said: they would take what words need.
    pub fn limit(&mut self, budget: Budget) {
        self.features.held = false;
        self.features.redundancy = false;
        self.spending = Some(Box::new(Spending {
            purse: Purse::new(budget, self.tracks.integrator().rate),
            waiting: BTreeMap::new(),
            worst: 1.0,
            told: false,
            turns: Turns::default(),
        }));
    }

    /// By what factor tracks exceed their tolerances at most, at the ticks since the last packet; if that was said at this
    /// tick, at those that it spoke of: a vouch behind it may be heard without it.
    #[must_use]
    pub fn excess(&self) -> Excess {
        let spending = self.spending.as_ref();
        spending.map_or(Excess::NONE, |spending| Excess::covering(spending.worst))
    }

    /// Bodies that wait for a word.
    #[must_use]
    pub fn waiting(&self) -> usize {
        let spending = self.spending.as_ref();
        spending.map_or(0, |spending| spending.waiting.len())
    }

    /// Bodies that wait for a word, in order of index.
    pub fn in_arrears(&self) -> impl Iterator<Item = InArrears> {
        let spending = self.spending.as_ref().into_iter();
        let waiting = spending.flat_map(|spending| spending.waiting.values());
        waiting.map(|waiting| InArrears {
            body: waiting.seen.id,
            share: waiting.share,
            since: waiting.since,
        })
    }

    /// The one of them that is farthest off for its tolerance.
    #[must_use]
    pub fn worst_waiting(&self) -> Option<InArrears> {
        let waiting = self.in_arrears();
        waiting.max_by(|a, b| a.share.total_cmp(&b.share))
    }

    /// Takes from the budget what was said beside the packets and is to be paid for too.
    pub fn pay(&mut self, bytes: usize) {
        if let Some(spending) = &mut self.spending {
            spending.purse.spend(bytes);
        }
    }

    /// Says what the budget allows of what is due at a tick; `before`: the tick that was spoken of before.
    pub(super) fn publish_within(
        &mut self,
        mut spending: Box<Spending>,
        witness: &Witness,
        before: Tick,
        notices: u64,
        out: &mut Vec<Bytes>,
    ) {
        let tick = self.tick;
        if core::mem::take(&mut spending.told) {
            spending.worst = 1.0;
        }
        self.statistics.seats += self.usher.sweep(tick);
        spending.purse.earn(tick.since(before).unwrap_or_default());
        let observations = witness.at(tick).unwrap_or_default();
        self.statistics.looked += observations.len() as u64;
        let due = self.due(&mut spending, tick, observations);
        let mut updates = core::mem::take(&mut self.updates);
        updates.clear();
        self.speak(&mut spending, witness, due, &mut updates);

        let begun = out.len();
        let spoke = !updates.is_empty();
        self.spending = Some(spending);
        self.say(tick, &mut updates, notices, out);
        self.updates = updates;
        if let Some(spending) = self.spending.as_mut().filter(|_| spoke) {
            spending
                .purse
                .spend(out[begun..].iter().map(Bytes::len).sum());
            spending.told = true;
        }
    }

    /// Loosens tolerances while bodies wait, by a share of how far off the worst of them is: what cannot be said as often
    /// as it should is better said so that it serves longer.
    fn loosen(&mut self, worst_withheld: f64) {
        let wanted = 1.0 + (worst_withheld - 1.0).max(0.0) * LOOSE;
        self.slack += (wanted.min(SLACK_MOST) - self.slack) * FOLLOW;
    }

    /// Who should have a word: whose track is off, and who waits.
    fn due(&self, spending: &mut Spending, tick: Tick, observations: &[Observation]) -> Vec<Due> {
        for observation in observations {
            if let Some(waiting) = spending.waiting.get_mut(&observation.id.index()) {
                (waiting.seen, waiting.seen_at) = (*observation, tick);
            }
        }
        let asleep = spending.waiting.values();
        let unseen = asleep
            .filter(|waiting| waiting.seen_at != tick)
            .map(|waiting| waiting.seen);
        let mut due = Vec::new();
        for seen in observations.iter().copied().chain(unseen) {
            let since = spending.waiting.get(&seen.id.index());
            let since = since.map_or(tick, |waiting| waiting.since);
            let found = self
                .seen_slot(&seen)
                .and_then(|slot| self.is_due(slot, tick, &seen));
            due.extend(found.map(|(share, urgent)| Due {
                seen,
                share,
                since,
                urgent,
            }));
        }
        due
    }

    /// The share of its tolerance that a track uses, and whether it cannot wait; `None` while it needs no word.
    fn is_due(&self, slot: &Slot, tick: Tick, seen: &Observation) -> Option<(f64, bool)> {
        let believed = self.tracks.believed((seen.id.index(), slot), tick);
        let tolerance = self.tracks.tolerance_of(slot);
        let truth = seen.motion.motion();
        let used = share(
            &truth.pose(),
            &believed.pose(),
            tolerance,
            self.tracks.radius(slot),
        );
        let age = tick.since(slot.origin())?;
        let moves = slot.predictor() != Predictor::Rest;
        let urgent = age >= HORIZON && moves;
        let told = match seen.activity {
            Activity::Asleep => slot.is_verbatim_rest() && used <= 1.0,
            Activity::Awake => used <= 1.0 && self.features.gate,
        };
        (urgent || !told).then_some((used, urgent))
    }

    /// Gives words to the worst, and each few to who waited longest, while the budget lasts.
    fn speak(
        &mut self,
        spending: &mut Spending,
        witness: &Witness,
        due: Vec<Due>,
        updates: &mut Vec<Update>,
    ) {
        let tick = self.tick;
        let allowed = spending.purse.left();
        let allowed = if allowed < WORTH_A_PACKET { 0 } else { allowed };
        let mut spent = HEAD * 8 * 256;
        let mut waiting = BTreeMap::new();
        let mut worst = 1.0;
        // Where all of them may speak, they do so in the order of a stream without a budget.
        let all = (due.len() * LONGEST_WORD) as u64 <= allowed;
        if all {
            self.slack = 1.0;
        }
        let mut withheld: f64 = 1.0;
        let order = if all {
            due.into_iter().map(|due| (Turn::Worst, due)).collect()
        } else {
            in_turn(due, tick, spending.turns)
        };
        for (turn, due) in order {
            if due.urgent || all || spent < allowed * 8 * 256 {
                let update = self.judge(witness, tick, (0, &due.seen), None);
                spent += update.as_ref().map_or(0, Self::bits_of);
                updates.extend(update);
                spending.turns.pass(turn);
                // Loosened words may leave more than the tolerance.
                let left = self.seen_slot(&due.seen);
                let left = left.and_then(|slot| self.is_due(slot, tick, &due.seen));
                worst = worse(worst, left.map_or(1.0, |(share, _)| share));
                continue;
            }
            let mine = Waiting {
                since: due.since,
                share: due.share,
                seen: due.seen,
                seen_at: tick,
            };
            waiting.insert(due.seen.id.index(), mine);
            self.statistics.withheld += u64::from(due.share > 1.0);
            worst = worse(worst, due.share);
            withheld = withheld.max(due.share);
        }
        self.loosen(withheld);
        spending.waiting = waiting;
        spending.worst = worse(spending.worst, worst);
    }

    /// Bits of an update in 256ths, more or less.
    pub(super) fn bits_of(update: &Update) -> u64 {
        /// Naming a body by its index, and by its seat.
        const NAMED: u64 = 24 * 256;
        const SEATED: u64 = 4 * 256;
        let name = if update.body.is_some() { NAMED } else { SEATED };
        u64::from(Opening.cost(&update.saying)) + name
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
fn in_turn(mut due: Vec<Due>, tick: Tick, mut turns: Turns) -> Vec<(Turn, Due)> {
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
        let turn = turns.next();
        let place = match turn {
            Turn::Eldest => eldest.find(is_free),
            Turn::Worst => worst.find(is_free),
        };
        let Some(place) = place else { break };
        taken[place] = true;
        turns.pass(turn);
        order.push((turn, due[place]));
    }
    order
}
