//! A scene hands records to its command log, and reports what is durable.
//!
//! Never waits for the disk.

use std::collections::BTreeMap;

use rhumb_protocol::message::ServerMessage;
use rhumb_protocol::{Peer, Span};

use super::SceneRunner;
use super::durability::{Durability, SessionCommands};
use crate::clients::Clients;
use crate::command_log::{CommandLog, Frozen};
use crate::record::{Journal, Record, SessionNumber};

impl SceneRunner {
    /// Starts the command log. `replayed`: time that its restoration took.
    pub(crate) fn keep_log(&mut self, log: Box<dyn CommandLog>, replayed: Span) {
        self.scene.keep_journal();
        let tick = self.scene.tick();
        self.durability = Some(Durability::new(log, replayed, tick));
    }

    /// True if the scene survives the process.
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
    pub(super) fn commit(&mut self, clients: &mut Clients) {
        let Some(durability) = &mut self.durability else {
            return;
        };
        let Some(batch) = self.scene.journal_mut().and_then(Journal::take) else {
            return;
        };
        let number = durability.log.append(batch);
        let tick = self.scene.tick();
        let mut commands: BTreeMap<Peer, SessionCommands> = BTreeMap::new();
        for (member, control) in clients.members_mut().0 {
            let count = member.take_undurable();
            commands.extend(count.map(|count| (control.peer(), SessionCommands { count, tick })));
        }
        if !commands.is_empty() {
            durability.awaited.push(number, commands);
        }
    }

    /// Hands a snapshot to the log if one is due. Only right after a step, whose time this is.
    pub(super) fn snapshot_if_due(&mut self, stepped: Span, clients: &mut Clients) {
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
        self.commit(clients);
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

    /// Keeps the answers to a member back until its session and its indices are durable: they then survive a failure of
    /// the server. A broken log keeps no answers back.
    pub(super) fn answer_durably(&mut self, peer: Peer, clients: &mut Clients) {
        self.commit(clients);
        if let Some(durability) = &mut self.durability
            && !durability.log.is_broken()
        {
            let batch = durability.log.appended();
            durability.unanswered.push_back((batch, peer));
            clients.keep_back(peer);
        }
    }

    /// Tells a member when the commands of the session that it takes up are durable, though it sends no other ones.
    pub(super) fn acknowledge_resumed(&mut self, peer: Peer, clients: &mut Clients) {
        self.commit(clients);
        let count = self
            .session_of(peer, clients)
            .map_or(0, |session| session.commands);
        let tick = self.scene.tick();
        if let Some(durability) = self.durability.as_mut().filter(|_| count > 0) {
            let commands = BTreeMap::from([(peer, SessionCommands { count, tick })]);
            let newest = durability.log.appended();
            durability.awaited.push(newest, commands);
        }
    }

    /// Tells members which of their commands are durable, and sends the answers that waited for the log.
    pub(crate) fn report_durable(&mut self, clients: &mut Clients) {
        let Some(durability) = &mut self.durability else {
            return;
        };
        let durable = durability.log.durable();
        let is_broken = durability.log.is_broken();
        while let Some((batch, peer)) = durability.unanswered.front().copied()
            && (batch <= durable || is_broken)
        {
            durability.unanswered.pop_front();
            let waits_again = durability
                .unanswered
                .iter()
                .any(|(_, other)| *other == peer);
            if !waits_again {
                clients.release(peer);
            }
        }
        while let Some(members) = durability.awaited.pop_durable(durable) {
            for (peer, done) in members {
                let (commands, tick) = (done.count, done.tick);
                clients.send(peer, &ServerMessage::Durable { commands, tick });
            }
        }
    }

    /// Removes the files of a scene that has ended.
    pub(super) fn delete_log(&mut self, clients: &mut Clients) {
        if let Some(durability) = self.durability.take() {
            for (_, peer) in &durability.unanswered {
                clients.release(*peer);
            }
            durability.log.delete();
        }
    }
}
