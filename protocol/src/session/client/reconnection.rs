//! A client goes on with its session over another connection.

use super::resumption::{Resumption, Unfinished};
use super::{ClientSession, ClientState};
use crate::message::{ClientMessage, SessionKey, SessionRequest, SessionState, StreamChoice};
use crate::session::close::CloseCode;
use crate::session::event::Event;
use crate::session::misuse::Misuse;

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

    /// True if the member has a session in a scene that survives its server.
    #[must_use]
    pub const fn is_durable(&self) -> bool {
        self.resumption.key.is_some() && self.resumption.durable
    }

    /// True if another connection could go on with the session.
    #[must_use]
    pub const fn can_reconnect(&self) -> bool {
        self.resumption.key.is_some() && self.resumption.rejoin.is_some()
    }

    /// True if the client was a member, and another connection is to make it one again.
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
        self.set_largest_packet(before.upstream_state.largest_packet);
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
        // Commands that are done but not yet durable are kept: the server may ask for them if it fails again.
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
