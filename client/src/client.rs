//! A member of one scene, for a plain frame loop.
//!
//! A call returns at once or within the client's timeout. Commands are queued and sent together, by `flush` or by the
//! next call that handles received data. Every other request is sent at once. A denial goes to the call that it answers:
//! one of a stream fails no step.

mod asking;
#[cfg(feature = "local")]
mod feeding;
#[cfg(all(test, feature = "quic"))]
mod tests;

use std::collections::VecDeque;
use std::time::Duration;

use rhumb_protocol::message::{Denial, Inspection, StreamChoice};
use rhumb_protocol::scene::{BodyBuilder, BodyDesc, Command, IdRange, SceneConfig, Stepping};
use rhumb_protocol::session::{CloseCode, Event, Misuse, Replica};
use rhumb_protocol::stream::{ErrorBound, Subscriber};
use rhumb_protocol::{Ending, Instant};
use rhumb_reckoning::{BodyId, BodyState, Tick, Ticks, Tolerance};
use rhumb_view::{
    ClientIds, Contacts, InvalidTicks, LiveView, PipelineDepth, RenderTime, UpstreamClock, View,
    may_resume,
};

use crate::connection::{Pump, Statistics, TURNS_MAX, TapChannel, span};
use crate::error::{ClientError, Unreported};
#[cfg(feature = "local")]
use crate::feeding::{Feeding, change_of};
use crate::join_options::{JoinOptions, Refusals};

/// Limit of queued events. Beyond it, the oldest events are dropped, and counted.
const EVENTS_KEPT: usize = 65_536;

/// A member of one scene.
pub struct Client {
    pump: Pump,
    timeout: Duration,
    /// The last deadline that was over before its time: what had arrived was handled then.
    overdue: Option<Instant>,
    live_view: LiveView,
    ids: ClientIds,
    upstream_clock: UpstreamClock,
    requested: Tick,
    /// The newest command before the last request of a tick, until it is answered.
    unanswered: Option<u64>,
    /// The newest command that is answered.
    answered: Option<u64>,
    events: VecDeque<(Tick, Event)>,
    /// Events that were dropped unread.
    events_left_out: u64,
    contacts: Contacts,
    /// Refusals that no call has reported yet, if calls report them.
    refused: Unreported,
    refusals: Refusals,
    inspected: Option<Inspection>,
    denied: Option<Denial>,
    /// The denial of an advance.
    denied_advance: Option<Denial>,
    deleted: bool,
    faulted: Option<Tick>,
    ended: Option<Ending>,
    /// Time for attempts to continue over another connection.
    resume_within: Duration,
    /// End of the last connection, until the session continues.
    interrupted: Option<(Instant, Ending)>,
    #[cfg(feature = "queries")]
    copy_queries: rhumb_view::CopyQueries,
    /// The owner's end of the scene, if this client feeds it.
    #[cfg(feature = "local")]
    feeding: Option<Feeding>,
}

impl Client {
    pub(crate) fn joined(
        pump: Pump,
        timeout: Duration,
        options: &JoinOptions,
        granted: IdRange,
    ) -> Self {
        let config = *pump
            .session
            .config()
            .expect("a member has its scene's config");
        let watermark_tick = pump
            .session
            .replica()
            .map_or(Tick::ZERO, |replica| replica.stream().watermark_tick());
        let resume_within = options.resumption_time(&pump.session);
        let mut client = Self {
            pump,
            timeout,
            overdue: None,
            live_view: LiveView::new(config, options.view_options()),
            ids: ClientIds::new(granted),
            upstream_clock: UpstreamClock::new(config.integrator.rate, options.lead_ticks),
            requested: watermark_tick,
            unanswered: None,
            answered: None,
            events: VecDeque::new(),
            events_left_out: 0,
            contacts: Contacts::default(),
            refused: Unreported::default(),
            refusals: options.refusals,
            inspected: None,
            denied: None,
            denied_advance: None,
            deleted: false,
            faulted: None,
            ended: None,
            resume_within,
            interrupted: None,
            #[cfg(feature = "queries")]
            copy_queries: rhumb_view::CopyQueries::default(),
            #[cfg(feature = "local")]
            feeding: None,
        };
        client.show(watermark_tick);
        client
    }

    /// The configuration of the scene since its creation.
    #[must_use]
    pub const fn config(&self) -> &SceneConfig {
        self.live_view.config()
    }

    /// The view as of the last call that computed it. A member by cells has there what it takes, and what is in no cell:
    /// each body once, and all of one moment.
    #[must_use]
    pub const fn view(&self) -> &View {
        self.live_view.view()
    }

    /// The copy of the scene: shapes, bodies, tracks. That of a member by cells has the bodies that are in no cell;
    /// [`Self::body`] has those of its cells too.
    #[must_use]
    pub const fn replica(&self) -> Option<&Replica> {
        self.pump.session.replica()
    }

    /// The descriptor of a body, as of the newest news; `None` for a body that this client does not have.
    #[must_use]
    pub fn body(&self, id: BodyId) -> Option<BodyDesc> {
        self.pump.session.body(id)
    }

    /// The stream that the copy follows now; cells have streams of their own.
    #[must_use]
    pub fn stream(&self) -> Option<StreamChoice> {
        self.replica().map(Replica::choice)
    }

    /// Tolerance of the copy's stream; `None` for one whose states are exact.
    #[must_use]
    pub fn tolerance(&self) -> Option<Tolerance> {
        match self.stream()? {
            StreamChoice::Within(tolerance) | StreamChoice::Capped { tolerance, .. } => {
                Some(tolerance)
            }
            StreamChoice::Full | StreamChoice::Changed => None,
        }
    }

    /// Bound on the error of the pose that the view shows: how far any point of the body may be from its true place at the
    /// moment of the view. `None` for a body that is not in the view.
    ///
    /// It is the body's tolerance where everything up to the moment of the view has arrived, plus what a smoothed
    /// correction has still to cover, or what updates that were read since the view was computed would change. Between two
    /// ticks, the truth is the interpolation of the two true poses.
    ///
    /// It is [`ErrorBound::Unknown`] as long as anything is missing: a packet, or the news of a moment that the view
    /// shows ahead of them. Without a delay, a free-running view always predicts the last moments, and nothing finite is
    /// certain of them: a command may have put a body anywhere. [`JoinOptions::delay_ticks`](crate::JoinOptions) of the
    /// network's delay and a little more gives a finite bound. Nor is one known while the client resumes its session.
    #[must_use]
    pub fn error_bound(&self, id: BodyId) -> Option<ErrorBound> {
        self.live_view.error_bound(&self.pump.session, id)
    }

    /// The bound of each body of the view, in its order: see [`Self::error_bound`].
    pub fn error_bounds(&self) -> impl Iterator<Item = ErrorBound> {
        self.live_view.error_bounds(&self.pump.session)
    }

    /// Bound on the error of what is known of a body at a tick, whatever the view shows: that of its track. `None` for a
    /// body that the copy does not have.
    #[must_use]
    pub fn tick_error_bound(&self, id: BodyId, tick: Tick) -> Option<ErrorBound> {
        if self.replica().is_none() {
            return self.error_bound(id);
        }
        let (copy, local) = self.pump.session.copy_of(id)?;
        copy.stream().bound_at(local, tick)
    }

    /// Requests an inspection of the scene, and waits for the answer. A scene that stands still answers, too.
    ///
    /// # Errors
    ///
    /// [`ClientError::Timeout`] when no answer arrives in time.
    pub fn inspect(&mut self) -> Result<Inspection, ClientError> {
        self.check_member()?;
        self.inspected = None;
        self.pump.session.inspect()?;
        let deadline = self.deadline();
        loop {
            if let Some(inspection) = self.inspected.take() {
                return Ok(inspection);
            }
            match self.turn(deadline, "inspection") {
                Ok(()) | Err(ClientError::SceneFaulted(_)) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Deletes the scene for all members, and waits for the answer. One that stands still can be deleted, too.
    ///
    /// # Errors
    ///
    /// [`ClientError::Denied`] when the scene no longer exists.
    pub fn delete(&mut self) -> Result<(), ClientError> {
        self.check_member()?;
        self.pump.session.delete()?;
        self.denied = None;
        let deadline = self.deadline();
        while !self.deleted {
            if let Some(denial) = self.denied.take() {
                return Err(ClientError::Denied(denial));
            }
            match self.turn(deadline, "answer") {
                Ok(()) | Err(ClientError::SceneDeleted | ClientError::SceneFaulted(_)) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// The oldest unread event, and the newest complete tick when the data with which it arrived was read. No view of an
    /// earlier tick shows its effect, and every view of a later tick does.
    ///
    /// An answer that a call of this client waits for is not queued as an event. A client keeps 65,536 unread events; those
    /// that it drops are counted in [`Statistics::events_left_out`].
    pub fn poll_event(&mut self) -> Option<(Tick, Event)> {
        self.events.pop_front()
    }

    /// Queues the addition of a body, and of its shape unless the scene has an equal one; returns the body's id.
    ///
    /// The origin of its shape is its centre of mass. A hull or compound that is given from elsewhere is moved there by
    /// [`BodyBuilder::centred`]; a dynamic one that is not is an error.
    ///
    /// # Errors
    ///
    /// As [`Self::add_bodies`].
    pub fn add_body(&mut self, body: BodyBuilder) -> Result<BodyId, ClientError> {
        let state = self.check_body(&body)?;
        check_centre(&body)?;
        self.reserve_ids(1)?;
        let id = self.ids.add_body(&mut self.pump.session, &body, state)?;
        #[cfg(feature = "local")]
        self.note_added(&[id]);
        Ok(id)
    }

    /// Queues the addition of many bodies, and returns their ids in the same order. Equal shapes are sent once.
    ///
    /// Does not wait, unless the server must grant more indices first: it grants 4,096 when a client joins. The
    /// commands are sent as with [`Self::command`]. [`Event::BodyPlaced`] or [`Event::Refused`] reports the result for
    /// each body; a refusal is also an error of the next call that computes the view, see [`JoinOptions::refusals`].
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for an invalid number, [`ClientError::OffCentre`] for a dynamic body whose shape has another
    /// centre of mass than its origin, [`ClientError::Denied`] when the server grants no more indices,
    /// [`ClientError::TooManyShapes`] when the scene has no number left for a shape. Then none of the bodies is queued.
    pub fn add_bodies(
        &mut self,
        bodies: impl IntoIterator<Item = BodyBuilder>,
    ) -> Result<Vec<BodyId>, ClientError> {
        let mut checked: Vec<(BodyBuilder, BodyState)> = Vec::new();
        for body in bodies {
            let state = self.check_body(&body)?;
            // Many bodies of one shape come one after the other, and to find its centre takes time.
            let is_like = |(before, _): &(BodyBuilder, _)| before.is_turned_like(&body);
            if !checked.last().is_some_and(is_like) {
                check_centre(&body)?;
            }
            checked.push((body, state));
        }
        self.reserve_ids(u32::try_from(checked.len()).unwrap_or(u32::MAX))?;
        let ids = self.ids.add_bodies(&mut self.pump.session, &checked)?;
        #[cfg(feature = "local")]
        self.note_added(&ids);
        Ok(ids)
    }

    /// Queues the removal of the shapes that came with bodies of this client and that no body has any more; returns their
    /// number. A scene holds a limited number of bytes of shapes, and keeps them until they are removed.
    ///
    /// Queued additions, changes and removals of bodies count. A shape that another member gave to a body meanwhile stays. A
    /// body that another member adds with the shape before its replica shows the removal is refused.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn remove_unused_shapes(&mut self) -> Result<usize, ClientError> {
        self.check_open()?;
        Ok(self.ids.remove_unused_shapes(&mut self.pump.session)?)
    }

    /// Ids for bodies that the caller adds by commands of its own, such as a recorded script.
    ///
    /// Does not wait, unless the server must grant more indices first. The id of a body that is refused stays the
    /// caller's, and that of a body that was removed does not.
    ///
    /// # Errors
    ///
    /// As [`Self::add_bodies`].
    pub fn new_ids(&mut self, count: u32) -> Result<Vec<BodyId>, ClientError> {
        self.reserve_ids(count)?;
        Ok(self.ids.take_ids(count))
    }

    /// Queues a command, which is applied before the next tick; returns the command number that the answer refers to.
    ///
    /// All queued commands are sent together, by [`Self::flush`] or by the next call that handles received data:
    /// [`Self::advance`], [`Self::wait`], [`Self::poll`], [`Self::idle`] and every call that waits for an answer.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for an invalid number, [`ClientError::Id`] for an id that no scene can have; then the
    /// command is not queued.
    pub fn command(&mut self, command: Command) -> Result<u64, ClientError> {
        self.check_open()?;
        command.check_ids()?;
        #[cfg(feature = "local")]
        let fed = change_of(&command);
        let number = self.ids.command(&mut self.pump.session, command)?;
        #[cfg(feature = "local")]
        self.note_change(fed);
        Ok(number)
    }

    /// The number of the command that this client queued last: after [`Self::add_body`] that of the body's addition, which
    /// [`Event::Refused`] may name. `None` before the first command.
    #[must_use]
    pub const fn last_command(&self) -> Option<u64> {
        self.ids.last_command()
    }

    /// Sends the queued commands at once.
    pub fn flush(&mut self) {
        self.pump.flush();
    }

    fn check_body(&self, body: &BodyBuilder) -> Result<BodyState, ClientError> {
        self.check_open()?;
        body.check().map_err(Misuse::Invalid)?;
        Ok(body.state().map_err(Misuse::Invalid)?)
    }

    /// Waits until `count` ids are available.
    fn reserve_ids(&mut self, count: u32) -> Result<(), ClientError> {
        self.check_open()?;
        let missing = self.ids.missing_ids(count);
        if missing == 0 {
            return Ok(());
        }
        self.pump.session.reserve(missing)?;
        self.denied = None;
        let deadline = self.deadline();
        while self.ids.missing_ids(count) > 0 {
            if let Some(denial) = self.denied.take() {
                return Err(ClientError::Denied(denial));
            }
            self.turn(deadline, "grant of body ids")?;
        }
        Ok(())
    }

    /// Steps a lockstep scene once and computes the view: of this tick at depth 0, of the tick before at depth 1.
    ///
    /// The scene steps to the next published tick, and depth counts published ticks. At depth 0, the server's answers to the
    /// commands before it are there, too.
    ///
    /// Returns the tick of the view, which is later than requested if later ticks are already complete. The view of a
    /// tick has the bodies of that tick: what commands add, remove or change after it appears in the next published
    /// one. A member that joins is the exception: its snapshot already has the changes of later commands, and does not
    /// tell when they come.
    ///
    /// # Errors
    ///
    /// [`ClientError::Timeout`] when the tick is not complete in time; [`Self::wait`] continues to wait.
    /// [`ClientError::Denied`] when the scene is not a lockstep scene, or the tick lies too far ahead.
    /// [`ClientError::Ticks`] for a depth beyond [`DEPTH_MAX`](crate::DEPTH_MAX).
    /// [`ClientError::Refused`] for requests that the server refused, such as the addition of a body, unless
    /// [`JoinOptions::refusals`] leaves them to the events: the tick is done then, its view computed, and the next call
    /// continues.
    pub fn advance(&mut self, depth: PipelineDepth) -> Result<Tick, ClientError> {
        InvalidTicks::check_depth(depth.ticks())?;
        self.request_tick()?;
        self.wait(depth)
    }

    /// Requests the next published tick of a lockstep scene at once, does not wait, and returns the tick.
    ///
    /// [`Self::try_wait`] shows it once it is complete; [`Self::wait`] waits for it. [`Self::advance`] requests and
    /// waits.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn request_tick(&mut self) -> Result<Tick, ClientError> {
        let requested = self.queue_tick()?;
        self.pump.flush();
        Ok(requested)
    }

    /// As [`Self::request_tick`], but sends nothing yet: the request leaves with the next message, or by [`Self::flush`]. So
    /// several ticks, and what is asked between them, are one piece of work for the server.
    ///
    /// # Errors
    ///
    /// As [`Self::request_tick`].
    pub fn queue_tick(&mut self) -> Result<Tick, ClientError> {
        self.check_open()?;
        #[cfg(feature = "local")]
        self.check_advances()?;
        self.denied_advance = None;
        let newest = self.ids.last_command();
        self.unanswered = newest.filter(|number| Some(*number) > self.answered);
        let publish_schedule = self.config().publish_schedule;
        self.requested = publish_schedule.next_published(self.requested);
        let now = self.pump.now();
        self.pump.session.advance(now, self.requested)?;
        Ok(self.requested)
    }

    /// Waits for the tick that the last [`Self::advance`] requested, and computes its view.
    ///
    /// # Errors
    ///
    /// As [`Self::advance`].
    pub fn wait(&mut self, depth: PipelineDepth) -> Result<Tick, ClientError> {
        let tick = self.wait_until_complete(depth)?;
        self.show(tick);
        self.report_refusals()?;
        Ok(tick)
    }

    /// Waits as [`Self::wait`] at depth 0, but computes no view: for a program that reads [`Self::replica`] only.
    ///
    /// # Errors
    ///
    /// As [`Self::wait`].
    pub fn wait_for_replica(&mut self) -> Result<Tick, ClientError> {
        let tick = self.wait_until_complete(PipelineDepth::LOCKSTEP)?;
        if let Some(replica) = self.pump.session.replica_mut() {
            replica.stream_mut().forget_before(tick);
        }
        for (_, copy) in self.pump.session.cells_mut() {
            copy.stream_mut().forget_before(tick);
        }
        self.report_refusals()?;
        Ok(tick)
    }

    /// Waits for the tick that a view at this depth shows; returns the newest complete one.
    fn wait_until_complete(&mut self, depth: PipelineDepth) -> Result<Tick, ClientError> {
        let awaited = self.awaited(depth)?;
        let deadline = self.deadline();
        self.read_waiting();
        // The answers come beside the tick, and may be the later ones.
        while self.complete() < awaited
            || (depth == PipelineDepth::LOCKSTEP && self.unanswered.is_some())
        {
            if let Some(refusal) = self.take_refusal() {
                return Err(refusal);
            }
            self.turn(deadline, "complete tick")?;
        }
        Ok(self.complete())
    }

    /// Handles received data, and computes the view as [`Self::wait`] if its tick is complete. Does not wait: returns
    /// `None` while the tick is not complete, and leaves the view as it is.
    ///
    /// # Errors
    ///
    /// As [`Self::wait`], except that it never times out.
    pub fn try_wait(&mut self, depth: PipelineDepth) -> Result<Option<Tick>, ClientError> {
        let awaited = self.awaited(depth)?;
        self.read_waiting();
        let tick = self.complete();
        if tick >= awaited {
            self.show(tick);
            self.report_refusals()?;
            return Ok(Some(tick));
        }
        self.check_open()?;
        self.report_refusals()?;
        match self.take_refusal() {
            Some(refusal) => Err(refusal),
            None => Ok(None),
        }
    }

    /// Handles received data and computes the view for the present moment. Does not wait.
    ///
    /// A lockstep scene stands still until a member advances it: then the view is that of the newest complete tick.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over. [`ClientError::Refused`] as [`Self::advance`]: the view is
    /// computed then.
    pub fn poll(&mut self) -> Result<RenderTime, ClientError> {
        self.check_open()?;
        self.read_waiting();
        self.check_open()?;
        let now = self.pump.now();
        let shown = self.live_view.show_present(&mut self.pump.session, now);
        self.report_refusals()?;
        Ok(shown)
    }

    /// Ticks by which a free-running view stays behind the server's clock: the delay of its options plus the scene's
    /// lookahead.
    #[must_use]
    pub fn delay_ticks(&self) -> f64 {
        self.live_view.delay_ticks()
    }

    /// Handles received data for `duration`, without computing the view. A duration of zero handles what is there.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn idle(&mut self, duration: Duration) -> Result<(), ClientError> {
        let deadline = self.pump.now() + span(duration);
        while self.pump.now() < deadline {
            self.pump.turn(deadline);
            self.take_events();
            self.check_open()?;
        }
        self.read_waiting();
        self.check_open()
    }

    /// Leaves the scene and closes the connection. Commands sent before are delivered first, within little more than
    /// half a second. Dropping a client does the same.
    pub fn close(mut self) {
        self.close_connection();
    }

    fn close_connection(&mut self) {
        if self.ended.is_none() && self.interrupted.is_none() {
            self.pump.session.close(CloseCode::DONE);
            self.pump.flush();
        }
    }

    /// Statistics of the connection and of the stream.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        let stream = self.replica().map(Replica::stream);
        Statistics {
            wire: self.pump.connection.statistics(),
            stream: stream.map(Subscriber::statistics).unwrap_or_default(),
            upstream: self.pump.session.upstream().unwrap_or_default(),
            watermark_tick: stream.map(Subscriber::watermark_tick).unwrap_or_default(),
            complete: self.complete(),
            behind_ticks: self.live_view.behind_ticks(self.pump.now()),
            events_left_out: self.events_left_out,
            contacts_left_out: self.contacts.left_out(),
        }
    }

    /// Calls `tap` with every piece of the control stream and every datagram, in both directions, for recording.
    pub fn record(&mut self, tap: impl FnMut(TapChannel, &[u8]) + Send + 'static) {
        self.pump.tap(Box::new(tap));
    }

    /// The tick that a view at this depth shows, after the last request.
    fn awaited(&self, depth: PipelineDepth) -> Result<Tick, InvalidTicks> {
        InvalidTicks::check_depth(depth.ticks())?;
        let interval = self.config().publish_schedule.publish_interval.get();
        let span = Ticks::new(depth.ticks() * interval);
        Ok(self.requested.before(span).unwrap_or_default())
    }

    /// The server's denial of the last request; the next request then begins at the newest complete tick.
    fn take_refusal(&mut self) -> Option<ClientError> {
        let denial = self.denied_advance.take()?;
        self.requested = self.complete();
        Some(ClientError::Denied(denial))
    }

    fn complete(&self) -> Tick {
        self.pump.session.complete().unwrap_or_default()
    }

    fn deadline(&self) -> Instant {
        self.pump.now() + span(self.timeout)
    }

    /// Waits for received data until the deadline.
    ///
    /// The deadline is checked first, so that the caller still handles an answer that arrives just in time. So it does with
    /// what arrived while the process stood still, however long that was.
    fn turn(&mut self, deadline: Instant, awaited: &'static str) -> Result<(), ClientError> {
        if self.pump.now() < deadline {
            self.pump.turn(deadline);
            self.take_events();
        } else if self.overdue.replace(deadline) != Some(deadline) {
            self.read_waiting();
        } else {
            let timeout = self.timeout;
            return Err(ClientError::Timeout { awaited, timeout });
        }
        self.check_open()
    }

    /// Handles all data that waits, however long the client was not called.
    fn read_waiting(&mut self) {
        for _ in 0..TURNS_MAX {
            let is_more = self.pump.turn(Instant::ZERO);
            self.take_events();
            if !is_more {
                break;
            }
        }
    }

    fn check_open(&self) -> Result<(), ClientError> {
        self.check_member()?;
        match self.faulted {
            Some(tick) => Err(ClientError::SceneFaulted(tick)),
            None => Ok(()),
        }
    }

    /// Checks that the client is still a member, of a scene that may stand still.
    const fn check_member(&self) -> Result<(), ClientError> {
        match self.ended {
            Some(ending) => Err(ClientError::Ended(ending)),
            None if self.deleted => Err(ClientError::SceneDeleted),
            None => Ok(()),
        }
    }

    fn take_events(&mut self) {
        while let Some(event) = self.pump.session.poll_event() {
            if !self.note(&event) {
                continue;
            }
            if self.events.len() == EVENTS_KEPT {
                self.events.pop_front();
                self.events_left_out += 1;
            }
            let after = self.tick_before(&event);
            self.events.push_back((after, event));
        }
        if let Some((_, ending)) = self.interrupted
            && self.pump.has_given_up()
            && self.ended.is_none()
        {
            self.ended = Some(ending);
            self.events.push_back((Tick::ZERO, Event::Ended(ending)));
        }
    }

    /// The last tick of a view without the effect of an event that has just been read.
    fn tick_before(&self, event: &Event) -> Tick {
        let complete = self.complete();
        let Event::BodyPlaced(id) = event else {
            return complete;
        };
        // In lockstep, a body is shown from the tick after the one at which it was placed.
        let copy = self.pump.session.copy_of(*id);
        let track = copy.and_then(|(copy, local)| copy.stream().track(local));
        match (self.config().stepping, track) {
            (Stepping::Lockstep, Some(track)) => complete.max(track.origin),
            _ => complete,
        }
    }

    /// Tries to continue over another connection, unless the server refuses this client or the time is over.
    fn try_to_resume(&mut self, ending: Ending) -> bool {
        let now = self.pump.now();
        let since = self.interrupted.map_or(now, |(since, _)| since);
        self.interrupted = Some((since, ending));
        let until = since + span(self.resume_within);
        let has_no_place = ending == Ending::Closed(CloseCode::BUSY.0);
        let full_since = if has_no_place { since } else { now };
        may_resume(ending) && now < until && self.pump.reconnect(full_since, until)
    }

    /// Updates this client from an event; returns whether the event is passed to the caller.
    fn note(&mut self, event: &Event) -> bool {
        self.live_view.note(event);
        self.upstream_clock.note(event);
        #[cfg(feature = "local")]
        self.note_fed(event);
        let session = &self.pump.session;
        self.contacts
            .note(event, |id| session.copy_of(id).is_some());
        match *event {
            Event::ClockSeen { .. } => return false,
            Event::Inspected(inspection) => {
                self.inspected = Some(inspection);
                return false;
            }
            Event::Denied(denial) => self.note_denial(denial),
            Event::SceneFaulted { tick, .. } => self.faulted = Some(tick),
            Event::Deleted => self.deleted = true,
            Event::Ended(ending) => {
                let is_first = self.interrupted.is_none();
                if self.try_to_resume(ending) {
                    if is_first {
                        let interrupted = Event::Interrupted(ending);
                        self.events.push_back((Tick::ZERO, interrupted));
                    }
                    return false;
                }
                self.ended = Some(ending);
            }
            Event::Resumed(_) => {
                self.interrupted = None;
                self.unanswered = None;
            }
            Event::Applied { through, .. } => {
                self.answered = Some(through);
                self.unanswered = self.unanswered.filter(|number| *number > through);
            }
            _ => {}
        }
        let is_passed = self.ids.note(event, &mut self.pump.session);
        let is_reported = is_passed && self.refusals == Refusals::Errors;
        if let Some(refusal) = self.ids.refusal(event).filter(|_| is_reported) {
            self.refused.add(refusal);
        }
        is_passed
    }

    /// Keeps a denial for the call that it answers (PROTOCOL 4.7-1).
    const fn note_denial(&mut self, denial: Denial) {
        match denial {
            Denial::NotLockstep
            | Denial::TooFarAhead
            | Denial::AdvanceNotAllowed
            | Denial::SceneFaulted => self.denied_advance = Some(denial),
            Denial::Owned | Denial::Other(_) => {
                self.denied_advance = Some(denial);
                self.denied = Some(denial);
            }
            // No call waits for a stream.
            Denial::TooManyStreams => {}
            _ => self.denied = Some(denial),
        }
    }

    /// Refusals since the last call that reported some, as its error.
    fn report_refusals(&mut self) -> Result<(), ClientError> {
        let refused = self.refused.take();
        refused.map_or(Ok(()), |refused| Err(ClientError::Refused(refused)))
    }

    /// Computes the view of a tick.
    fn show(&mut self, tick: Tick) {
        let now = self.pump.now();
        let session = &mut self.pump.session;
        self.live_view
            .show(session, now, RenderTime::at(tick), false);
    }
}

/// Refuses a body that the engine would turn about another point than its centre of mass.
fn check_centre(body: &BodyBuilder) -> Result<(), ClientError> {
    body.off_centre()
        .map_or(Ok(()), |centre| Err(ClientError::OffCentre(centre)))
}

impl Drop for Client {
    fn drop(&mut self) {
        self.close_connection();
    }
}
