//! What a client keeps so that another connection can go on with its session.
//!
//! Commands and advances in the order of sending, until the server has what the scene promises: a scene with a command
//! log has them when they are durable, another one when they are done. Invariant: no command is given up that the
//! server may ask for again.

use alloc::collections::VecDeque;

use rhumb_reckoning::Tick;

use super::ClientSession;
use super::ClientState;
use crate::message::{ClientMessage, SessionKey, SessionRequest, SessionState, StreamChoice};
use crate::scene::Command;
use crate::session::close::CloseCode;
use crate::session::event::Event;
use crate::session::misuse::Misuse;

/// The session, and what is not finished of it.
#[derive(Debug, Default)]
pub(super) struct Resumption {
    key: Option<SessionKey>,
    /// Whether the scene has a command log.
    durable: bool,
    /// Commands known to be done.
    answered: u64,
    unfinished: VecDeque<Unfinished>,
    /// The stream to join again, between two connections.
    rejoin: Option<StreamChoice>,
    /// Where the session goes on, until the snapshot is complete.
    state: Option<SessionState>,
}

/// A message that may have to be sent again.
#[derive(Debug)]
enum Unfinished {
    Command(u64, Command),
    Advance(Tick),
}

impl Resumption {
    pub(super) fn note_command(&mut self, number: u64, command: &Command) {
        if self.key.is_some() {
            let command = command.clone();
            self.unfinished
                .push_back(Unfinished::Command(number, command));
        }
    }

    pub(super) fn note_advance(&mut self, to: Tick) {
        if self.key.is_none() {
            return;
        }
        // Without a command between them, the later of two advances is enough.
        match self.unfinished.back_mut() {
            Some(Unfinished::Advance(last)) => *last = (*last).max(to),
            _ => self.unfinished.push_back(Unfinished::Advance(to)),
        }
    }

    /// All commands up to this number are done; the scene is at this tick.
    pub(super) fn note_applied(&mut self, through: u64, tick: Tick) {
        self.answered = self.answered.max(through + 1);
        if !self.durable {
            self.finish(through + 1, tick);
        }
    }

    /// The server keeps so many commands, and the scene up to this tick.
    pub(super) fn finish(&mut self, commands: u64, tick: Tick) {
        self.unfinished.drain(..self.done(commands, tick));
    }

    /// How many of the first unfinished messages are done where so many commands are, and the scene is at this tick. A
    /// command is done after everything before it.
    fn done(&self, commands: u64, tick: Tick) -> usize {
        let is_done = |message: &Unfinished| matches!(message, Unfinished::Command(number, _) if *number < commands);
        let last = self.unfinished.iter().rposition(is_done);
        let through = last.map_or(0, |last| last + 1);
        let rest = self.unfinished.iter().skip(through);
        let is_reached =
            |message: &&Unfinished| matches!(message, Unfinished::Advance(to) if *to <= tick);
        through + rest.take_while(is_reached).count()
    }

    /// Whether the first unfinished command is the one that the server wants next.
    fn has_from(&self, commands: u64, sent: u64) -> bool {
        let mut unfinished = self.unfinished.iter();
        let first = unfinished.find_map(|message| match message {
            Unfinished::Command(number, _) => Some(*number),
            Unfinished::Advance(_) => None,
        });
        first.unwrap_or(sent) <= commands && commands <= sent
    }
}

impl ClientSession {
    /// Begins a session with the next join. A client that draws its key at random can go on with the session over
    /// another connection, by [`Self::reconnect`].
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] before the welcome or as a member.
    pub fn begin_session(&mut self, key: SessionKey) -> Result<(), Misuse> {
        self.must_be(ClientState::Lobby)?;
        self.resumption = Resumption {
            key: Some(key),
            ..Resumption::default()
        };
        self.send(&ClientMessage::Session(SessionRequest { key, answered: 0 }));
        Ok(())
    }

    /// Whether another connection could go on with the session.
    #[must_use]
    pub const fn can_reconnect(&self) -> bool {
        self.resumption.key.is_some() && self.resumption.rejoin.is_some()
    }

    /// Whether the client was a member, and another connection is to make it one again.
    pub(super) fn is_resuming(&self) -> bool {
        !matches!(self.state, ClientState::Member | ClientState::Ended) && self.can_reconnect()
    }

    /// Commands that the server may have to be sent again.
    #[must_use]
    pub fn unfinished_commands(&self) -> usize {
        let unfinished = self.resumption.unfinished.iter();
        let commands = unfinished.filter(|message| matches!(message, Unfinished::Command(..)));
        commands.count()
    }

    /// Makes the session ready for another connection: it joins the scene again by itself, and sends again what was not
    /// done. [`Event::Resumed`] reports that the scene goes on; the replica is absent until then. Authority over bodies
    /// and requests that were not answered are lost.
    ///
    /// # Errors
    ///
    /// [`Misuse::NotNow`] unless a connection of a member with a session has ended.
    pub fn reconnect(&mut self) -> Result<(), Misuse> {
        self.must_be(ClientState::Ended)?;
        if !self.can_reconnect() {
            return Err(Misuse::NotNow);
        }
        let fresh = Self::new(self.scene.clone());
        let before = core::mem::replace(self, fresh);
        self.token = before.token;
        self.resumption = before.resumption;
        self.commands = before.commands;
        self.config = before.config;
        self.round_trip = before.round_trip;
        self.events = before.events;
        Ok(())
    }

    /// The stream that a later connection joins.
    pub(super) fn note_choice(&mut self, choice: StreamChoice) {
        self.resumption.rejoin = Some(choice);
    }

    /// Takes the session up after the welcome of another connection.
    pub(super) fn rejoin(&mut self) {
        let Resumption {
            key,
            rejoin,
            answered,
            ..
        } = self.resumption;
        if let (Some(key), Some(choice)) = (key, rejoin) {
            self.send(&ClientMessage::Session(SessionRequest { key, answered }));
            self.send(&ClientMessage::Join(choice));
        }
    }

    /// Where the session goes on. A server that does not know it has lost commands.
    pub(super) fn handle_session(&mut self, state: SessionState) -> Result<(), CloseCode> {
        if self.resumption.key.is_none() || self.state != ClientState::Lobby {
            return Err(CloseCode::VIOLATION);
        }
        let is_new = self.resumption.rejoin.is_none();
        if is_new && state.commands == 0 {
            self.resumption.durable = state.durable;
            return Ok(());
        }
        if !state.resumed || !self.resumption.has_from(state.commands, self.commands) {
            self.resumption = Resumption::default();
            self.events.push_back(Event::SessionLost(state));
            return Err(CloseCode::DONE);
        }
        self.resumption.durable = state.durable;
        if !state.durable {
            self.resumption.finish(state.commands, state.tick);
        }
        self.resumption.state = Some(state);
        Ok(())
    }

    /// Sends again what was not done, after the snapshot of a resumed session; `false` for another one.
    pub(super) fn resume(&mut self) -> bool {
        let Some(state) = self.resumption.state.take() else {
            return false;
        };
        // What is done but not yet durable is kept: the server may ask for it if it fails again.
        let done = self.resumption.done(state.commands, state.tick);
        let unfinished = core::mem::take(&mut self.resumption.unfinished);
        for message in unfinished.iter().skip(done) {
            match message {
                Unfinished::Command(_, command) => {
                    self.send(&ClientMessage::Command(command.clone()));
                }
                Unfinished::Advance(to) => {
                    self.awaited = self.awaited.max(*to);
                    self.send(&ClientMessage::Advance { to: *to });
                }
            }
        }
        self.resumption.unfinished = unfinished;
        self.events.push_back(Event::Resumed(state));
        true
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    fn resumption(durable: bool) -> Resumption {
        let mut resumption = Resumption {
            key: Some(SessionKey([1; 16])),
            durable,
            ..Resumption::default()
        };
        let gravity = Command::SetGravity { gravity: Vec3::X };
        for (number, advance) in [(0, 1), (1, 2), (2, 3)] {
            resumption.note_command(number, &gravity);
            resumption.note_advance(Tick::new(advance));
        }
        resumption
    }

    #[test]
    fn a_command_is_kept_until_it_is_done_or_durable() {
        let mut plain = resumption(false);
        plain.note_applied(1, Tick::new(2));
        assert!(plain.has_from(2, 3) && !plain.has_from(1, 3));
        let mut durable = resumption(true);
        durable.note_applied(1, Tick::new(2));
        assert!(durable.has_from(0, 3));
        durable.finish(2, Tick::new(2));
        assert!(durable.has_from(2, 3) && !durable.has_from(1, 3));
    }

    #[test]
    fn what_is_done_lies_before_the_first_command_that_the_server_wants() {
        let resumption = resumption(true);
        assert_eq!(resumption.done(0, Tick::ZERO), 0);
        assert_eq!(resumption.done(1, Tick::ZERO), 1);
        assert_eq!(resumption.done(1, Tick::new(1)), 2);
        assert_eq!(resumption.done(3, Tick::new(2)), 5);
        assert_eq!(resumption.done(3, Tick::new(3)), 6);
    }

    #[test]
    fn advances_without_a_command_between_them_are_one() {
        let mut resumption = resumption(true);
        for tick in 4..100 {
            resumption.note_advance(Tick::new(tick));
        }
        assert_eq!(resumption.unfinished.len(), 6);
    }

    #[test]
    fn a_server_that_is_ahead_of_the_client_has_another_session() {
        assert!(resumption(true).has_from(3, 3));
        assert!(!resumption(true).has_from(4, 3));
    }
}
