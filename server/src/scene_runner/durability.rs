//! What a scene hands to its command log, and what it tells its members of it.
//!
//! Never waits for the disk. Snapshots are due by the time that steps have taken, so that their replay takes no longer.

use std::collections::VecDeque;

use rhumb_protocol::message::ServerMessage;
use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::Tick;

use super::SceneRunner;
use crate::durable::{Frozen, Journal, Record, SceneLog, SessionNumber};
use crate::outbox::Outbox;

/// Time of steps after which a snapshot is due: a third of the time for a restart.
const SNAPSHOT_AFTER: Span = Span::from_millis(1_000);
/// Bytes of the log after which a snapshot is due.
const SNAPSHOT_BYTES: usize = 4 << 20;
/// Steps after which a snapshot is tried that makes a broken log whole.
const REPAIR_STEPS: u64 = 60;

/// The log of a scene, and what waits for it.
pub(super) struct Durability {
    log: SceneLog,
    /// Time of the steps since the last snapshot.
    stepped: Span,
    snapshot_tick: Tick,
    /// Batches with commands of sessions that are not reported as durable.
    awaited: VecDeque<AwaitedBatch>,
}

/// A batch after which members learn that their commands are durable.
struct AwaitedBatch {
    number: u64,
    tick: Tick,
    /// Commands of each member's session up to the end of the batch.
    commands: Vec<(Peer, u64)>,
}

impl Durability {
    /// `stepped`: time that the replay of the log took.
    pub(super) const fn new(log: SceneLog, stepped: Span, tick: Tick) -> Self {
        Self {
            log,
            stepped,
            snapshot_tick: tick,
            awaited: VecDeque::new(),
        }
    }

    fn is_snapshot_due(&self, tick: Tick) -> bool {
        let steps = tick.value().saturating_sub(self.snapshot_tick.value());
        let due = if self.log.is_broken() {
            steps >= REPAIR_STEPS
        } else {
            self.stepped >= SNAPSHOT_AFTER || self.log.bytes() >= SNAPSHOT_BYTES
        };
        due && self.log.may_snapshot()
    }
}

impl SceneRunner {
    /// Has the scene write a log from now on. `replayed`: time that its restoration took.
    pub(crate) fn keep_log(&mut self, log: SceneLog, replayed: Span) {
        self.scene.keep_journal();
        let tick = self.scene.tick();
        self.durability = Some(Durability::new(log, replayed, tick));
    }

    /// Whether the scene survives the process.
    pub(crate) const fn is_durable(&self) -> bool {
        self.durability.is_some()
    }

    /// Notes what concerns a session, here and for the log.
    pub(super) fn note_session(&mut self, record: &Record) {
        self.sessions.replay(record);
        let tick = self.scene.tick();
        if let Some(journal) = self.scene.journal_mut() {
            journal.push(tick, record);
        }
    }

    /// Notes that a command of a member is done.
    pub(super) fn note_command(
        &mut self,
        session: Option<SessionNumber>,
        refused: Option<rhumb_protocol::scene::CommandError>,
    ) {
        if let Some(session) = session {
            self.note_session(&Record::Counted(session, refused));
        }
    }

    /// Hands everything since the last call to the log.
    pub(super) fn commit(&mut self) {
        let Some(durability) = &mut self.durability else {
            return;
        };
        let Some(batch) = self.scene.journal_mut().and_then(Journal::take) else {
            return;
        };
        let number = durability.log.append(batch);
        let mut commands = Vec::new();
        for (peer, member) in &mut self.members {
            commands.extend(member.take_undurable().map(|commands| (*peer, commands)));
        }
        if !commands.is_empty() {
            durability.awaited.push_back(AwaitedBatch {
                number,
                tick: self.scene.tick(),
                commands,
            });
        }
    }

    /// Hands a snapshot to the log if one is due. Only right after a step, whose time this is.
    pub(super) fn snapshot_if_due(&mut self, stepped: Span) {
        let tick = self.scene.tick();
        let Some(durability) = &mut self.durability else {
            return;
        };
        let taken = durability.stepped.as_nanos() + stepped.as_nanos();
        durability.stepped = Span::from_nanos(taken);
        if !durability.is_snapshot_due(tick) {
            return;
        }
        let Some(scene) = self.scene.freeze() else {
            return;
        };
        self.commit();
        let frozen = Frozen {
            tick,
            digest: self.scene.digest(),
            sessions: self.sessions.clone(),
            ownership: self.ownership.clone(),
            scene,
        };
        if let Some(durability) = &mut self.durability {
            durability.stepped = Span::ZERO;
            durability.snapshot_tick = tick;
            durability.log.snapshot(frozen);
        }
    }

    /// Tells members which of their commands have become durable.
    pub(crate) fn report_durable(&mut self, out: &mut Outbox) {
        let Some(durability) = &mut self.durability else {
            return;
        };
        let durable = durability.log.durable();
        while let Some(batch) = durability.awaited.front()
            && batch.number <= durable
        {
            for (peer, commands) in &batch.commands {
                if self.members.contains_key(peer) {
                    let (commands, tick) = (*commands, batch.tick);
                    out.send(*peer, &ServerMessage::Durable { commands, tick });
                }
            }
            durability.awaited.pop_front();
        }
    }

    /// Removes the files of a scene that has ended.
    pub(super) fn delete_log(&mut self) {
        if let Some(durability) = self.durability.take() {
            durability.log.delete();
        }
    }
}
