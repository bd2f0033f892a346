//! A scene hands its record to its command log, and reports what is durable.
//!
//! Never waits for the disk. Snapshots are due by the time that steps have taken, so that their replay takes no longer.

use rhumb_protocol::message::ServerMessage;
use rhumb_protocol::{Peer, Span};

use super::RunningScene;
use crate::clients::Clients;
use crate::command_log::{CommandLog, Durability, Frozen};
use crate::member::SessionCommands;
use crate::record::{LogEntry, SessionNumber};

impl RunningScene {
    /// Starts the command log. `replayed`: time that its restoration took.
    pub(crate) fn keep_log(&mut self, log: Box<dyn CommandLog>, replayed: Span) {
        self.scene.record_mut().begin_log();
        let tick = self.scene.tick();
        self.durability = Some(Durability::new(log, replayed, tick));
    }

    /// True if the scene survives the process.
    pub(crate) const fn is_durable(&self) -> bool {
        self.durability.is_some()
    }

    /// Notes what concerns a session, here and for the log.
    pub(super) fn note_session(&mut self, entry: LogEntry) {
        self.sessions.replay(&entry);
        let tick = self.scene.tick();
        self.scene.record_mut().note(tick, entry);
    }

    /// Notes that a command of a member is done.
    pub(super) fn note_command(
        &mut self,
        session: Option<SessionNumber>,
        refused: Option<rhumb_protocol::scene::CommandError>,
    ) {
        if let Some(session) = session {
            self.note_session(LogEntry::Counted(session, refused));
        }
    }

    /// Hands everything since the last call to the log.
    pub(super) fn commit(&mut self, clients: &mut Clients) {
        // The scene comes back as it was before the work at which it was given up.
        if self.settings.heartbeat.is_abandoned() {
            return;
        }
        let Some(durability) = &mut self.durability else {
            return;
        };
        let Some(batch) = self.scene.record_mut().take_batch() else {
            return;
        };
        if durability.is_beyond(2 * self.settings.limits.scene_log_bytes()) {
            let mib = 2 * self.settings.limits.scene_log_mib;
            tracing::error!(
                mib,
                "a log without a snapshot is too long: commands are not durable until the next one"
            );
            durability.log.give_up();
        }
        let number = durability.log.append(batch);
        let tick = self.scene.tick();
        for (member, _) in clients.members_mut().0 {
            member.note_logged(number, tick);
        }
    }

    /// Hands a snapshot to the log if one is due by the time of steps, of which this is the newest one, or by bytes.
    pub(super) fn snapshot_if_due(&mut self, stepped: Span, clients: &mut Clients) {
        let tick = self.scene.tick();
        let Some(durability) = &mut self.durability else {
            return;
        };
        let taken = durability.stepped.as_nanos() + stepped.as_nanos();
        durability.stepped = Span::from_nanos(taken);
        if durability.is_snapshot_due(tick) {
            self.snapshot(clients);
        }
    }

    /// Hands a snapshot to the log if that is long. A scene that is not stepped has no other occasion.
    pub(super) fn shorten_log(&mut self, clients: &mut Clients) {
        if (self.durability.as_ref()).is_some_and(Durability::is_long) {
            self.snapshot(clients);
        }
    }

    /// True if the log takes no more commands before a step, which lets a snapshot shorten it.
    pub(super) fn is_log_full(&self) -> bool {
        let most = self.settings.limits.scene_log_bytes();
        (self.durability.as_ref()).is_some_and(|durability| durability.is_beyond(most))
    }

    /// Hands a snapshot to the log, unless something has changed since the last step that it would lack.
    fn snapshot(&mut self, clients: &mut Clients) {
        if self.settings.heartbeat.is_abandoned() {
            return;
        }
        let tick = self.scene.tick();
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
        if let Some(durability) = &self.durability
            && !durability.log.is_broken()
        {
            clients.keep_back(peer, durability.log.appended());
        }
    }

    /// Tells a member when the commands of the session that it takes up are durable, though it sends no other ones.
    pub(super) fn acknowledge_resumed(&mut self, peer: Peer, clients: &mut Clients) {
        self.commit(clients);
        let count = (self.session_of(peer, clients)).map_or(0, |session| session.commands);
        let tick = self.scene.tick();
        if count > 0
            && let Some(durability) = &self.durability
            && let Some(member) = clients.member_mut(peer)
        {
            let newest = durability.log.appended();
            member.awaited.push(newest, SessionCommands { count, tick });
        }
    }

    /// Tells members which of their commands are durable, and sends the answers that waited for the log.
    pub(crate) fn report_durable(&mut self, clients: &mut Clients) {
        let Some(durability) = &self.durability else {
            return;
        };
        let durable = durability.log.durable();
        let is_broken = durability.log.is_broken();
        clients.release(|batch| batch <= durable || is_broken);
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            while let Some(SessionCommands { count, tick }) = member.awaited.pop_durable(durable) {
                let commands = count;
                control.send(&ServerMessage::Durable { commands, tick }, out);
            }
        }
    }

    /// Removes the files of a scene that has ended.
    pub(super) fn delete_log(&mut self, clients: &mut Clients) {
        if let Some(durability) = self.durability.take() {
            clients.release(|_| true);
            durability.log.delete();
        }
    }
}
