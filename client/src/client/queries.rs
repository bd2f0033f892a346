//! Queries whose answers the caller waits for.

use rhumb_protocol::message::QueryResult;
use rhumb_protocol::scene::Query;
use rhumb_protocol::session::Event;

use super::Client;
use crate::error::ClientError;

impl Client {
    /// Sends queries with all queued commands, and waits for their answers.
    ///
    /// The answers are not queued as an event; other events stay queued. [`Self::query`] does not wait. Queries that an
    /// ended connection left unanswered are asked again when the session continues.
    ///
    /// # Errors
    ///
    /// As [`Self::query`], and [`ClientError::Timeout`] when no answer arrives in time.
    pub fn ask(&mut self, queries: Vec<Query>) -> Result<QueryResult, ClientError> {
        let deadline = self.deadline();
        let mut asked = None;
        loop {
            if let Some(result) = asked.and_then(|number| self.take_answer(number)) {
                return Ok(result);
            }
            if self.interrupted.is_some() {
                asked = None;
            } else if asked.is_none() {
                asked = Some(self.query(queries.clone())?);
            }
            self.turn(deadline, "answer to queries")?;
        }
    }

    /// Takes the answer to queries of this number out of the queued events.
    fn take_answer(&mut self, number: u64) -> Option<QueryResult> {
        let is_answer =
            |event: &Event| matches!(event, Event::QueryResult(result) if result.number == number);
        let place = self.events.iter().rposition(|(_, event)| is_answer(event));
        match self.events.remove(place?) {
            Some((_, Event::QueryResult(result))) => Some(result),
            _ => None,
        }
    }
}
