//! Requests that the server refused, with the bodies that they are about.

use std::collections::VecDeque;
use std::fmt;

use rhumb_protocol::message::AuthorityError;
use rhumb_protocol::scene::CommandError;
use rhumb_protocol::session::Event;
use rhumb_reckoning::BodyId;

/// A request that the server refused, and that changed nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RefusedRequest {
    /// The command's number; `None` for a request for authority.
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
}

impl RefusalReason {
    /// Its name in languages without enumerations.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Command(error) => error.word(),
            Self::Authority(error) => error.word(),
        }
    }
}

impl fmt::Display for RefusalReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Command(error) => error.fmt(f),
            Self::Authority(error) => error.fmt(f),
        }
    }
}

impl fmt::Display for RefusedRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the server refused ")?;
        match self.number {
            Some(number) => write!(f, "command {number}")?,
            None => f.write_str("the authority")?,
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

    fn get(&self, number: u64) -> Option<BodyId> {
        let place = self.0.partition_point(|(command, _)| *command < number);
        let (command, body) = self.0.get(place)?;
        (*command == number).then_some(*body)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
