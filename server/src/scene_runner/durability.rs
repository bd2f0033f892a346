//! The command log of a scene, and the commands that wait for it.
//!
//! Sends nothing. Snapshots are due by the time that steps have taken, so that their replay takes no longer.

use std::collections::{BTreeMap, VecDeque};

use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::Tick;

use crate::command_log::CommandLog;

/// Time of steps after which a snapshot is due: a third of the time for a restart.
const SNAPSHOT_AFTER: Span = Span::from_millis(1_000);
/// Bytes of the log after which a snapshot is due.
const SNAPSHOT_BYTES: usize = 4 << 20;
/// Steps after which a snapshot is tried that makes a broken log whole.
const REPAIR_STEPS: u64 = 60;

/// The log of a scene, and what waits for it.
pub(super) struct Durability {
    pub(super) log: Box<dyn CommandLog>,
    /// Time of the steps since the last snapshot.
    pub(super) stepped: Span,
    pub(super) snapshot_tick: Tick,
    /// Commands of sessions that are not reported as durable.
    pub(super) awaited: Acknowledgements,
    /// Members whose answers are kept back, each with the batch that must be durable.
    pub(super) unanswered: VecDeque<(u64, Peer)>,
}

impl Durability {
    /// `stepped`: time that the replay of the log took.
    pub(super) fn new(log: Box<dyn CommandLog>, stepped: Span, tick: Tick) -> Self {
        Self {
            log,
            stepped,
            snapshot_tick: tick,
            awaited: Acknowledgements::new(),
            unanswered: VecDeque::new(),
        }
    }

    pub(super) fn is_snapshot_due(&self, tick: Tick) -> bool {
        let steps = tick.value().saturating_sub(self.snapshot_tick.value());
        let due = if self.log.is_broken() {
            steps >= REPAIR_STEPS
        } else {
            self.stepped >= SNAPSHOT_AFTER || self.log.bytes() >= SNAPSHOT_BYTES
        };
        due && self.log.may_snapshot()
    }
}

/// Batches with commands of sessions that are not acknowledged, in their order.
///
/// Bounded, however long the disk takes. Invariants: no command is acknowledged before its batch is durable, and none is put
/// off for ever by those that follow it.
pub(super) struct Acknowledgements(VecDeque<AwaitedBatch>);

/// A batch after which members learn that their commands are durable.
struct AwaitedBatch {
    number: u64,
    commands: BTreeMap<Peer, SessionCommands>,
}

/// Commands of a member's session that are done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SessionCommands {
    /// Their number, from the first one of the session on.
    pub(super) count: u64,
    /// The tick before the step in which the last of them acts, or a later one.
    pub(super) tick: Tick,
}

/// Batches at most. The newest one stands for those beyond it: their commands are acknowledged with the last of them.
const BATCHES_MAX: usize = 256;

impl Acknowledgements {
    pub(super) const fn new() -> Self {
        Self(VecDeque::new())
    }

    /// Adds commands that wait for a batch, the newest one.
    pub(super) fn push(&mut self, number: u64, commands: BTreeMap<Peer, SessionCommands>) {
        let is_full = self.0.len() >= BATCHES_MAX;
        match self.0.back_mut().filter(|_| is_full) {
            Some(newest) => {
                newest.number = number;
                newest.commands.extend(commands);
            }
            None => self.0.push_back(AwaitedBatch { number, commands }),
        }
    }

    /// The commands of the oldest batch, if batches are durable up to it.
    pub(super) fn pop_durable(&mut self, durable: u64) -> Option<BTreeMap<Peer, SessionCommands>> {
        self.0.front().filter(|oldest| oldest.number <= durable)?;
        self.0.pop_front().map(|oldest| oldest.commands)
    }

    /// Leaves out a member that has left: a later membership has another session.
    pub(super) fn forget(&mut self, peer: Peer) {
        for batch in &mut self.0 {
            batch.commands.remove(&peer);
        }
        self.0.retain(|batch| !batch.commands.is_empty());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ANNA: Peer = Peer(1);
    const BORIS: Peer = Peer(2);

    fn commands(peer: Peer, count: u64) -> BTreeMap<Peer, SessionCommands> {
        let tick = Tick::new(count / 2);
        BTreeMap::from([(peer, SessionCommands { count, tick })])
    }

    /// The counts that a member learns when batches are durable up to a number.
    fn learned(waiting: &mut Acknowledgements, peer: Peer, durable: u64) -> Vec<u64> {
        std::iter::from_fn(|| waiting.pop_durable(durable))
            .filter_map(|commands| commands.get(&peer).map(|of_session| of_session.count))
            .collect()
    }

    #[test]
    fn commands_are_acknowledged_with_their_batch_and_not_before() {
        let mut waiting = Acknowledgements::new();
        waiting.push(3, commands(ANNA, 7));
        waiting.push(5, commands(ANNA, 9));
        assert_eq!(waiting.pop_durable(2), None);
        assert_eq!(waiting.pop_durable(4), Some(commands(ANNA, 7)));
        assert_eq!(waiting.pop_durable(4), None);
        assert_eq!(waiting.pop_durable(5), Some(commands(ANNA, 9)));
        assert_eq!(waiting.pop_durable(9), None);
    }

    #[test]
    fn what_waits_is_bounded_and_every_command_is_acknowledged() {
        let mut waiting = Acknowledgements::new();
        for number in 1..=10_000 {
            waiting.push(number, commands(ANNA, number));
        }
        waiting.push(10_001, commands(BORIS, 1));
        assert_eq!(waiting.0.len(), BATCHES_MAX);
        let learned_early = learned(&mut waiting, ANNA, 10_000);
        assert_eq!(learned_early.last(), Some(&(BATCHES_MAX as u64 - 1)));
        let rest = waiting.pop_durable(10_001).unwrap();
        assert_eq!(rest[&ANNA], commands(ANNA, 10_000)[&ANNA]);
        assert_eq!(rest[&BORIS], commands(BORIS, 1)[&BORIS]);
    }

    #[test]
    fn commands_that_follow_put_no_acknowledgement_off_for_ever() {
        const BEHIND: u64 = 1_000;
        let mut waiting = Acknowledgements::new();
        let mut acknowledged = 0;
        for number in 1..=20_000_u64 {
            waiting.push(number, commands(ANNA, number));
            let durable = number.saturating_sub(BEHIND);
            let counts = learned(&mut waiting, ANNA, durable);
            acknowledged = counts.last().copied().unwrap_or(acknowledged);
            assert!(acknowledged <= durable, "batch {number}");
            assert!(durable - acknowledged <= 2 * BEHIND, "batch {number}");
        }
    }

    #[test]
    fn a_member_that_has_left_learns_nothing() {
        let mut waiting = Acknowledgements::new();
        let both = [commands(ANNA, 7), commands(BORIS, 2)];
        waiting.push(1, both.into_iter().flatten().collect());
        waiting.push(2, commands(ANNA, 8));
        waiting.forget(ANNA);
        assert_eq!(waiting.pop_durable(2), Some(commands(BORIS, 2)));
        assert_eq!(waiting.pop_durable(2), None);
    }
}
