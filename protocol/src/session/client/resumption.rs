//! Commands that a client keeps so that another connection can go on.
//!
//! Commands and advances in the order of sending, until the server has what the scene promises: a scene with a command
//! log has them when they are durable, another one when they are done. Invariant: no command is given up that the
//! server may ask for again.

use alloc::collections::VecDeque;

use rhumb_reckoning::Tick;

use crate::message::{SessionKey, SessionState, StreamChoice};
use crate::scene::Command;

/// The session, and what is not finished of it.
#[derive(Debug, Default)]
pub(super) struct Resumption {
    pub(super) key: Option<SessionKey>,
    /// True if the scene has a command log.
    pub(super) durable: bool,
    /// Commands known to be done.
    pub(super) answered: u64,
    pub(super) unfinished: VecDeque<Unfinished>,
    /// The stream to join again, between two connections.
    pub(super) rejoin: Option<StreamChoice>,
    /// Where the session goes on, until the snapshot is complete.
    pub(super) state: Option<SessionState>,
}

/// A message that may have to be sent again.
#[derive(Debug)]
pub(super) enum Unfinished {
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

    /// Number of first unfinished messages that are done if so many commands are, and the scene is at this tick. A
    /// command is done after everything before it.
    pub(super) fn done(&self, commands: u64, tick: Tick) -> usize {
        let is_done = |message: &Unfinished| matches!(message, Unfinished::Command(number, _) if *number < commands);
        let last = self.unfinished.iter().rposition(is_done);
        let through = last.map_or(0, |last| last + 1);
        let rest = self.unfinished.iter().skip(through);
        let is_reached =
            |message: &&Unfinished| matches!(message, Unfinished::Advance(to) if *to <= tick);
        through + rest.take_while(is_reached).count()
    }

    /// True if the first unfinished command is the one that the server wants next.
    pub(super) fn has_from(&self, commands: u64, sent: u64) -> bool {
        let mut unfinished = self.unfinished.iter();
        let first = unfinished.find_map(|message| match message {
            Unfinished::Command(number, _) => Some(*number),
            Unfinished::Advance(_) => None,
        });
        first.unwrap_or(sent) <= commands && commands <= sent
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
