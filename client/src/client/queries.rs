//! Queries whose answers the caller waits for.

use rhumb_protocol::message::QueryResult;
use rhumb_protocol::scene::Query;
use rhumb_protocol::session::Event;

use super::Client;
use crate::error::ClientError;

impl Client {
    /// Sends queries with all queued commands, and waits for their answers.
    ///
    /// The answers are not queued as an event; other events stay queued. [`Self::query`] does not wait.
    ///
    /// # Errors
    ///
    /// As [`Self::query`], and [`ClientError::Timeout`] when no answer arrives in time.
    pub fn ask(&mut self, queries: Vec<Query>) -> Result<QueryResult, ClientError> {
        let number = self.query(queries)?;
        let deadline = self.deadline();
        loop {
            let is_answer = |event: &Event| matches!(event, Event::QueryResult(result) if result.number == number);
            let place = self.events.iter().rposition(|(_, event)| is_answer(event));
            let answer = place.and_then(|place| self.events.remove(place));
            if let Some((_, Event::QueryResult(result))) = answer {
                return Ok(result);
            }
            self.turn(deadline, "answer to queries")?;
        }
    }
}
