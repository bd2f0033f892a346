//! The command log of a scene, and what waits for it.
//!
//! Snapshots are due by the time that steps have taken, so that their replay takes no longer.

use std::collections::VecDeque;

use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::Tick;

use super::acknowledgements::Acknowledgements;
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
