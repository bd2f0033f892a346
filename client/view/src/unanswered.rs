//! Commands without an answer so far, and requests that the server refused.
//!
//! Invariant: the numbers of commands rise. A session gives them out in this order, so that a new one is last.

use std::collections::VecDeque;
use std::fmt;

use rhumb_protocol::message::AuthorityError;
use rhumb_protocol::scene::CommandError;
use rhumb_protocol::session::Event;
use rhumb_reckoning::BodyId;

/// A value for some of the commands, by number.
#[derive(Debug)]
pub(crate) struct Unanswered<T>(Vec<(u64, T)>);

impl<T> Default for Unanswered<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> Unanswered<T> {
    /// Stores the value of a command, unless it has one.
    pub(crate) fn insert(&mut self, command: u64, value: T) {
        let place = self.place(command);
        if self.0.get(place).is_none_or(|(at, _)| *at != command) {
            self.0.insert(place, (command, value));
        }
    }

    /// Takes the value of one command.
    pub(crate) fn remove(&mut self, command: u64) -> Option<T> {
        let place = self.place(command);
        let is_found = self.0.get(place).is_some_and(|(at, _)| *at == command);
        is_found.then(|| self.0.remove(place).1)
    }

    /// Takes the values of all commands up to this number.
    pub(crate) fn take_through(&mut self, through: u64) -> Vec<(u64, T)> {
        let later = self.0.split_off(self.place(through.saturating_add(1)));
        core::mem::replace(&mut self.0, later)
    }

    /// Keeps the values for which this holds; it may change them.
    pub(crate) fn retain_mut(&mut self, mut holds: impl FnMut(&mut T) -> bool) {
        self.0.retain_mut(|(_, value)| holds(value));
    }

    /// The values of the commands from this number on.
    pub(crate) fn from(&self, command: u64) -> &[(u64, T)] {
        &self.0[self.place(command)..]
    }

    /// True if a command has a value.
    pub(crate) fn has(&self, command: u64) -> bool {
        self.from(command)
            .first()
            .is_some_and(|(at, _)| *at == command)
    }

    fn place(&self, command: u64) -> usize {
        self.0.partition_point(|(at, _)| *at < command)
    }
}

/// A request that the server refused, and that changed nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RefusedRequest {
    /// The command's number; `None` for a request for authority, or of another member.
    pub number: Option<u64>,
    /// The body that the request is about: for a shape the body with which it came. `None` where that is not known.
    pub body: Option<BodyId>,
    /// The server's reason.
    pub reason: RefusalReason,
}

/// The server's reason for a refusal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RefusalReason {
    /// Of a command.
    Command(CommandError),
    /// Of a request for authority.
    Authority(AuthorityError),
    /// Of another member's request, which this client accepted as the owner of a fed scene.
    Request(CommandError),
}

impl RefusalReason {
    /// The refused request, for a sentence that begins with "the server refused".
    #[must_use]
    pub const fn subject(&self) -> &'static str {
        match self {
            Self::Command(_) => "command",
            Self::Authority(_) => "the authority",
            Self::Request(_) => "the request of another member, which was accepted,",
        }
    }

    /// Its name in languages without enumerations.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Command(error) | Self::Request(error) => error.word(),
            Self::Authority(error) => error.word(),
        }
    }
}

impl fmt::Display for RefusalReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Command(error) => error.fmt(f),
            Self::Authority(error) => error.fmt(f),
            Self::Request(CommandError::NotAllowed) => f.write_str(
                "the member has left, or may not do that; what it asked for was not done",
            ),
            Self::Request(error) => error.fmt(f),
        }
    }
}

impl fmt::Display for RefusedRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the server refused {}", self.reason.subject())?;
        if let Some(number) = self.number {
            write!(f, " {number}")?;
        }
        if let Some(body) = self.body {
            write!(f, " about {body}")?;
        }
        write!(f, ": {}", self.reason)
    }
}

impl std::error::Error for RefusedRequest {}

/// The bodies of commands that the server has not answered yet.
#[derive(Debug, Default)]
pub(crate) struct CommandBodies(VecDeque<(u64, BodyId)>);

impl CommandBodies {
    /// Stores the body of a queued command. Numbers rise.
    pub(crate) fn add(&mut self, command: u64, body: BodyId) {
        self.0.push_back((command, body));
    }

    /// Forgets the commands up to this number, which are answered.
    pub(crate) fn handle_applied(&mut self, through: u64) {
        while (self.0.pop_front_if(|(command, _)| *command <= through)).is_some() {}
    }

    /// The refusal that an event reports.
    pub(crate) fn refusal(&self, event: &Event) -> Option<RefusedRequest> {
        match *event {
            Event::Refused { number, error } => Some(RefusedRequest {
                number: Some(number),
                body: self.get(number).or(error.body()),
                reason: RefusalReason::Command(error),
            }),
            // The client requests the authority again by itself.
            Event::AuthorityDenied(AuthorityError::LostSync) => None,
            Event::AuthorityDenied(error) => Some(RefusedRequest {
                number: None,
                body: error.body(),
                reason: RefusalReason::Authority(error),
            }),
            _ => None,
        }
    }

    pub(crate) fn get(&self, number: u64) -> Option<BodyId> {
        let place = self.0.partition_point(|(command, _)| *command < number);
        let (command, body) = self.0.get(place)?;
        (*command == number).then_some(*body)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_found_by_number_and_taken_in_order() {
        let mut unanswered = Unanswered::default();
        for command in [2, 5, 8, 3, 5] {
            unanswered.insert(command, 10 * command);
        }
        assert_eq!((unanswered.has(3), unanswered.has(4)), (true, false));
        assert_eq!(
            (unanswered.remove(4), unanswered.remove(3)),
            (None, Some(30))
        );
        assert_eq!(unanswered.from(3), [(5, 50), (8, 80)]);
        assert_eq!(unanswered.take_through(5), [(2, 20), (5, 50)]);
        assert_eq!(unanswered.take_through(u64::MAX), [(8, 80)]);
        assert!(!unanswered.has(8));
    }

    #[test]
    fn a_refusal_names_the_body_of_its_command_until_the_answer() {
        let mut bodies = CommandBodies::default();
        let ids = [3, 4].map(|index| BodyId::new(index, 1));
        bodies.add(7, ids[0]);
        bodies.add(9, ids[1]);
        let body = |bodies: &CommandBodies, number| {
            let error = CommandError::TooManyBodies;
            let refusal = bodies.refusal(&Event::Refused { number, error })?;
            refusal.body
        };
        assert_eq!(
            [7, 8, 9].map(|number| body(&bodies, number)),
            [Some(ids[0]), None, Some(ids[1])]
        );
        bodies.handle_applied(8);
        assert_eq!(
            [7, 8, 9].map(|number| body(&bodies, number)),
            [None, None, Some(ids[1])]
        );
        let error = CommandError::UnknownBody(ids[0]);
        let named = bodies.refusal(&Event::Refused { number: 8, error });
        let text = "the server refused command 8 about body 3.1: the scene has no body 3.1";
        assert_eq!(
            named.map(|refusal| refusal.to_string()).as_deref(),
            Some(text)
        );
    }

    #[test]
    fn an_authority_that_is_denied_is_refused_and_one_that_lost_sync_is_not() {
        let bodies = CommandBodies::default();
        let id = BodyId::new(3, 1);
        let denied = bodies.refusal(&Event::AuthorityDenied(AuthorityError::NotYours(id)));
        assert_eq!(denied.and_then(|refusal| refusal.body), Some(id));
        assert_eq!(
            denied.map(|refusal| refusal.reason.word()),
            Some("not yours")
        );
        assert_eq!(
            bodies.refusal(&Event::AuthorityDenied(AuthorityError::LostSync)),
            None
        );
        assert_eq!(bodies.refusal(&Event::Deleted), None);
    }
}
