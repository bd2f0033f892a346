//! What a member asks: the server, its own copy, which bodies touch.

use rhumb_protocol::message::QueryResult;
use rhumb_protocol::scene::Query;
use rhumb_protocol::session::Event;
#[cfg(feature = "queries")]
use rhumb_protocol::session::Misuse;
use rhumb_reckoning::BodyId;
use rhumb_view::TouchingPair;

use super::Client;
use crate::error::ClientError;

impl Client {
    /// The bodies that touch a body, or all pairs, by the events that were received: those of which one reports its contacts
    /// ([`ActiveEvents::contacts`](rhumb_protocol::scene::ActiveEvents)). A member that joins later knows them, too. One
    /// with [`ActiveEvents::force`](rhumb_protocol::scene::ActiveEvents) keeps the force of each tick.
    ///
    /// [`Query::contacts`] asks the server about any body, whether or not it reports.
    pub fn contacts(&self, body: Option<BodyId>) -> impl Iterator<Item = TouchingPair> {
        self.contacts.of(body)
    }

    /// Pairs that [`Self::contacts`] lacks since more touch than a client knows
    /// ([`STANDING_PAIRS_MAX`](rhumb_protocol::limits::STANDING_PAIRS_MAX)), counted as they began. Their events come as
    /// all others.
    #[must_use]
    pub const fn contacts_left_out(&self) -> u64 {
        self.contacts.left_out()
    }

    /// Queues queries in one message, and returns the number that their answer names: [`Event::QueryResult`].
    ///
    /// The answer tells where the bodies were at its tick: the newest one when the server read the message, which is
    /// sent as a command is. Neither waits for a step. Their cost is limited, see [`Query::cost`]. Queries that are not
    /// answered when [`Event::Interrupted`] comes get no answer.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for an invalid number, too many queries, or an interrupted session, [`ClientError::Id`] for an
    /// id that no scene can have; then none is queued.
    pub fn query(&mut self, queries: Vec<Query>) -> Result<u64, ClientError> {
        self.check_open()?;
        queries.iter().try_for_each(Query::check_ids)?;
        Ok(self.pump.session.query(queries)?)
    }

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

    /// Answers queries on the client's own copy, where the view shows its bodies. Nothing is sent, and nothing waits.
    ///
    /// The queries are those of [`Self::query`], and so are the answers if the bodies are where the view shows them: the
    /// bounds of each answer say how far its bodies may be off, as [`Self::error_bound`] does. Only the first call after a
    /// new view or a scene event looks at each body.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for an invalid number; then none is answered. [`ClientError::Ended`] when the connection
    /// is over.
    #[cfg(feature = "queries")]
    pub fn query_copy(
        &mut self,
        queries: &[Query],
    ) -> Result<Vec<rhumb_view::CopyAnswer>, ClientError> {
        self.check_open()?;
        let Some(replica) = self.pump.session.replica() else {
            return Ok(Vec::new());
        };
        self.copy_queries.refresh(self.live_view.view(), replica);
        let answers = self.copy_queries.answer(queries, replica);
        Ok(answers.map_err(Misuse::Invalid)?)
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
