//! Requests of a member: its stream, cells, authority, the server, its copy.
//!
//! With authority, the caller publishes states of bodies that its own simulator moves, once per frame. States that the
//! server predicts within tolerance are not sent. A member that joins by cells has the bodies of those that it takes, each by a
//! stream of its own choice.

use std::collections::BTreeMap;

use glam::Vec3;
use rhumb_protocol::message::{QueryResult, StreamChoice, TierPolicy};
use rhumb_protocol::scene::{Cell, CellGrid, IdOutOfRange, Query, Stepping};
use rhumb_protocol::session::{CellState, Event, Misuse};
use rhumb_reckoning::{BodyId, BodyState, Metres, Tick, Tolerance};
use rhumb_view::{InvalidTicks, TouchingPair};

use super::Client;
use crate::error::ClientError;

impl Client {
    /// Requests another stream at once and does not wait. [`Event::SubscriptionChanged`] reports when the copy follows
    /// it.
    ///
    /// Until then the copy follows the present stream, and no tick is missed between the two. A later request replaces
    /// an unanswered one.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn change_stream(&mut self, choice: StreamChoice) -> Result<(), ClientError> {
        self.check_open()?;
        self.pump.session.subscribe(choice)?;
        self.pump.flush();
        Ok(())
    }

    /// Sends the range of tiers that the server may choose for this client on a link of low capacity, at once.
    ///
    /// Without a policy, the server may go down to the coarse tier (20 cm). [`Event::TierChanged`] reports each change,
    /// and [`Self::tolerance`] returns the present tolerance.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn set_tier_policy(&mut self, tier_policy: TierPolicy) -> Result<(), ClientError> {
        self.check_open()?;
        self.pump.session.set_tier_policy(tier_policy)?;
        self.pump.flush();
        Ok(())
    }

    /// Requests authority over these kinematic bodies, in place of the bodies that this client has authority over now.
    ///
    /// The server's bodies are then within `tolerance` of the states of [`Self::publish`]. Another member's copy is
    /// within the sum of this tolerance and that of its stream; its error bound is about the server's body. One member
    /// may have authority over 256 bodies. An empty list ends the authority.
    ///
    /// Sends at once and does not wait: [`Event::AuthorityGrant`](crate::Event::AuthorityGrant) or
    /// [`Event::AuthorityDenied`](crate::Event::AuthorityDenied) reports the result. During the authority, no command
    /// can move these bodies. The authority over a body ends when the body or this client leaves the scene; the body
    /// then stands still.
    ///
    /// A member by cells publishes a body once it has had it in a cell that it takes: until then the grant waits for the cell,
    /// and an event [`Event::AuthorityGrant`](crate::Event::AuthorityGrant) says each time which bodies are published. The body may
    /// leave the cells afterwards. [`Event::BodyRemoved`](crate::Event::BodyRemoved) reports its removal wherever it is.
    ///
    /// A client whose session was interrupted requests the authority again when the session continues, without bodies that
    /// it cannot have any more; the same events report the result. Requests meanwhile are sent then.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for more bodies than one member may have authority over, and while an earlier request is
    /// unanswered. [`ClientError::Id`] for a body that no scene can have.
    pub fn take_authority(
        &mut self,
        bodies: &[BodyId],
        tolerance: Tolerance,
    ) -> Result<(), ClientError> {
        self.check_open()?;
        let mut ids = bodies.iter().copied();
        ids.try_for_each(IdOutOfRange::check_body)?;
        self.pump.session.take_authority(tolerance, bodies)?;
        self.pump.flush();
        Ok(())
    }

    /// Publishes the present states of bodies under this client's authority; call it once per frame.
    ///
    /// A body that is left out stands still at its last published pose. Nothing is sent while the server predicts all
    /// of the bodies within tolerance.
    ///
    /// Returns the tick of the states. Returns `None`, and publishes nothing, before the authority is granted or while all of
    /// the bodies wait for their cells, while the session is interrupted and until it has the authority again, before the
    /// server's clock is known, and when a frame falls on the same tick as the frame before. In lockstep the tick is that of
    /// the next [`Self::advance`]. In a free-running scene it is the tick nearest to now by the server's clock, plus the
    /// `lead_ticks` of the options; positions are extrapolated to it by their velocities, by half a tick at most.
    ///
    /// The view shows these bodies as the server has them; a simulator shows its own states.
    ///
    /// When a client becomes silent, its bodies move as predicted until one second after its next update is due. Then
    /// they stand still.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for a body without requested authority or an invalid number; then nothing is published.
    pub fn publish(
        &mut self,
        motions: &[(BodyId, BodyState)],
    ) -> Result<Option<Tick>, ClientError> {
        self.check_open()?;
        let config = *self.config();
        let published = match config.stepping {
            Stepping::Lockstep => {
                let newest = self.requested.max(self.watermark_tick());
                let tick = config.publish_schedule.next_published(newest);
                (self.pump.session.publish(tick, motions)?).then_some(tick)
            }
            Stepping::FreeRunning => {
                self.read_waiting();
                self.check_open()?;
                let now = self.pump.now();
                self.upstream_clock
                    .publish(&mut self.pump.session, now, motions)?
            }
        };
        self.pump.flush();
        Ok(published)
    }

    /// Changes [`JoinOptions::lead_ticks`](crate::JoinOptions::lead_ticks): how many ticks ahead of the server's clock
    /// this client publishes.
    ///
    /// With half of the round trip of [`Self::statistics`], plus a tick or two for jitter, the server need not predict.
    ///
    /// # Errors
    ///
    /// [`InvalidTicks`] for a number that is not 0 to [`SHIFT_TICKS_MAX`](crate::SHIFT_TICKS_MAX); the lead stays as it was.
    pub fn set_lead_ticks(&mut self, ticks: f64) -> Result<(), InvalidTicks> {
        InvalidTicks::check_lead(ticks)?;
        self.upstream_clock.lead_ticks = ticks;
        Ok(())
    }

    /// The bodies under this client's authority, in rising order, without those that wait for their cells.
    pub fn authority_bodies(&self) -> impl Iterator<Item = BodyId> {
        self.pump.session.authority_bodies()
    }

    fn watermark_tick(&self) -> Tick {
        self.replica()
            .map_or(Tick::ZERO, |replica| replica.stream().watermark_tick())
    }
}

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
        let session = &self.pump.session;
        if session.replica().is_none() {
            return Ok(Vec::new());
        }
        self.copy_queries.refresh(&self.live_view, session);
        let answers = (self.copy_queries).answer(queries, &self.live_view, session);
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

    /// The grid of the scene's cells; `None` for a scene that is not divided, and for a client that did not join by cells.
    #[must_use]
    pub const fn cell_grid(&self) -> Option<CellGrid> {
        self.pump.session.cell_grid()
    }

    /// Takes these cells and no others, each by a stream, at once, and does not wait. The view has the bodies of a cell once its
    /// copy has caught up with the others: see [`Self::cells`].
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for a scene that is not divided, and for more than 256 cells; [`ClientError::Ended`] when the
    /// connection is over.
    pub fn take_cells(&mut self, cells: &BTreeMap<Cell, StreamChoice>) -> Result<(), ClientError> {
        self.check_open()?;
        self.pump.session.take_cells(cells)?;
        self.pump.flush();
        Ok(())
    }

    /// Takes the cells around a point by bands, in any order: each cell by the stream of the nearest band that reaches it. A
    /// program calls it as its point moves; what is taken already costs nothing. A radius of 0 takes the cell that has the point.
    ///
    /// # Errors
    ///
    /// As [`Self::take_cells`], and [`ClientError::Misuse`] for a point that is in no world and for a radius that is no length; then
    /// all stays as it was.
    pub fn take_cells_around(
        &mut self,
        point: impl Into<Vec3>,
        bands: &[(Metres, StreamChoice)],
    ) -> Result<(), ClientError> {
        let grid = self.cell_grid().ok_or(Misuse::NotDivided)?;
        let cells = grid.within(point.into(), bands);
        let cells = cells.map_err(Misuse::Invalid)?;
        self.take_cells(&cells.ok_or(Misuse::TooManyCells)?)
    }

    /// The cells that this client takes, in order, and the state of each: see [`CellState`]. The next [`Self::take_cells`] asks again for
    /// those that were denied.
    pub fn cells(&self) -> impl Iterator<Item = (Cell, CellState)> {
        self.pump.session.taken_cells()
    }
}
