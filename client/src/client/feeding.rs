//! Calls of a client that feeds its scene: states, requests of other members.
//!
//! Only the client of [`LocalServer::feed`](crate::LocalServer::feed) makes them.

use rhumb_protocol::scene::CommandError;
use rhumb_protocol::session::Event;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_scene::{FedRequest, FedVelocities};
use rhumb_view::{RefusalReason, RefusedRequest};

use super::Client;
use crate::error::{ClientError, FeedError};
use crate::feeding::{FedChange, Feeding, change_of};
use crate::join_options::Refusals;

/// Time between two looks at a scene that has not taken enough of what was fed.
const LOOK: Span = Span::from_millis(1);

impl Client {
    /// Hands over the states of one tick, and has the scene step to it: see
    /// [`LocalServer::feed`](crate::LocalServer::feed). Call it once for each step of the engine.
    ///
    /// Each body may have one state, in any order. One without a state rests where it is, and so does one that is fed
    /// at one pose without a velocity for five ticks; resting bodies cost nothing. Ticks may be left out, 600 at most:
    /// the bodies then go evenly from one state to the next.
    ///
    /// Members see every pose within the tolerance of their stream. How many bytes that takes depends on what predicts the
    /// bodies: gravity and substeps of the scene's configuration, mass, moments, damping and gravity scale of each body, and
    /// the velocities.
    ///
    /// Commands that were queued before act first. While the scene has four ticks to take, this call waits.
    ///
    /// Refusals since the last call are an error of this one, after the states were handed over.
    ///
    /// # Errors
    ///
    /// [`ClientError::Feed`] for a client that feeds no scene, and for states that are wrong; then none is handed over.
    /// [`ClientError::Timeout`] if the scene takes none of them in time. [`ClientError::Refused`] for commands of this
    /// client, and for requests that it has accepted.
    pub fn feed(
        &mut self,
        tick: Tick,
        states: &[(BodyId, BodyState)],
        velocities: FedVelocities,
    ) -> Result<(), ClientError> {
        self.check_open()?;
        // Refusals of the scene since then decide which bodies are there.
        self.take_failures();
        let feeding = self.feeding.as_mut().ok_or(FeedError::NotOwner)?;
        feeding.check(tick, states)?;
        self.pump.flush();
        self.await_room()?;
        let commands = self.ids.last_command().map_or(0, |number| number + 1);
        if let Some(feeding) = &mut self.feeding {
            feeding.push((tick, commands), states, velocities);
        }
        self.read_waiting();
        self.check_open()?;
        self.take_failures();
        self.report_refusals()
    }

    /// Notes the accepted requests that the scene refused.
    fn take_failures(&mut self) {
        while let Some((request, error)) = self.feeding.as_mut().and_then(Feeding::poll_failure) {
            if self.refusals == Refusals::Errors {
                self.refused.add(RefusedRequest {
                    number: None,
                    body: request.command.body(),
                    reason: RefusalReason::Request(error),
                });
            }
        }
    }

    /// The tick of the newest states that this client has fed; `None` for one that feeds no scene.
    #[must_use]
    pub fn fed_tick(&self) -> Option<Tick> {
        self.feeding.as_ref().map(Feeding::newest)
    }

    /// The oldest unread request of another member: a command that it gave. Each request is accepted, refused, or answered by
    /// what is fed.
    ///
    /// A body that another member asks for has an id already; it is in the scene once the request is accepted, and is fed
    /// from then on.
    pub fn poll_request(&mut self) -> Option<FedRequest> {
        self.feeding.as_ref()?.poll_request()
    }

    /// Changes the scene as another member asked. If the scene cannot, the member is refused after all, and so is this
    /// client, by its next [`Self::feed`].
    ///
    /// # Errors
    ///
    /// [`ClientError::Feed`] for a client that feeds no scene, and for a request that has an answer.
    pub fn accept_request(&mut self, request: FedRequest) -> Result<(), ClientError> {
        let change = change_of(&request.command);
        let feeding = self.feeding.as_ref().ok_or(FeedError::NotOwner)?;
        feeding.answer(request, None)?;
        self.note_change(change);
        self.read_waiting();
        self.check_open()
    }

    /// Refuses a request: its member gets [`Event::Refused`] with this reason.
    ///
    /// # Errors
    ///
    /// As [`Self::accept_request`].
    pub fn refuse_request(
        &mut self,
        request: FedRequest,
        reason: CommandError,
    ) -> Result<(), ClientError> {
        let feeding = self.feeding.as_ref().ok_or(FeedError::NotOwner)?;
        feeding.answer(request, Some(reason))?;
        self.read_waiting();
        self.check_open()
    }

    /// With the owner's end of the scene, if it feeds it.
    pub(crate) fn feeding(mut self, feeding: Option<Feeding>) -> Self {
        self.feeding = feeding;
        self
    }

    /// Waits until the scene has room for one more tick.
    fn await_room(&mut self) -> Result<(), ClientError> {
        let deadline = self.deadline();
        while self.feeding.as_ref().is_some_and(Feeding::is_full) {
            let look: Instant = self.pump.now() + LOOK;
            if look < deadline {
                self.pump.turn(look);
                self.take_events();
                self.check_open()?;
            } else {
                self.turn(deadline, "step to a fed tick")?;
            }
        }
        Ok(())
    }

    /// Refuses an advance of a client that feeds its scene.
    pub(super) fn check_advances(&self) -> Result<(), ClientError> {
        match self.feeding {
            Some(_) => Err(FeedError::StepsByFeed.into()),
            None => Ok(()),
        }
    }

    /// Notes bodies whose addition is queued.
    pub(super) fn note_added(&mut self, ids: &[BodyId]) {
        if let Some(feeding) = &mut self.feeding {
            ids.iter().for_each(|id| feeding.add(*id));
        }
    }

    /// Notes the effect of a command that is queued.
    pub(super) fn note_change(&mut self, change: FedChange) {
        match (&mut self.feeding, change) {
            (Some(feeding), FedChange::Adds(id)) => feeding.add(id),
            (Some(feeding), FedChange::Removes(id)) => feeding.remove(id),
            _ => {}
        }
    }

    /// Notes a body that left the scene, or did not come.
    pub(super) fn note_fed(&mut self, event: &Event) {
        let Some(feeding) = &mut self.feeding else {
            return;
        };
        let gone = match event {
            Event::BodyRemoved { id, .. } => Some(*id),
            // A body that has the id already is there, and is fed.
            Event::Refused {
                error: CommandError::BodyIdTaken(_),
                ..
            } => None,
            Event::Refused { number, .. } => self.ids.refused_addition(*number),
            _ => None,
        };
        gone.into_iter().for_each(|id| feeding.remove(id));
    }
}
