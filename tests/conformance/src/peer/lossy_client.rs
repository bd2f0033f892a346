//! A client with a replica, whose datagrams a case drops or reorders.
//!
//! The replica is kept by the project's own session; the case selects which datagrams reach it. So a case can compare
//! the server's stream with the conclusions that the protocol allows a subscriber.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::rc::Rc;
use std::time::Duration;

use bytes::Bytes;
use rhumb_netsim::{RawConnection, RawEvent, RawPeerEnd, UdpRelay};
use rhumb_protocol::message::{ClientMessage, Frames, StreamChoice, Welcome};
use rhumb_protocol::scene::{Command, CommandError, IdRange, SceneConfig, SceneName};
use rhumb_protocol::session::{ClientSession, Event, Misuse, Replica};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{BodyId, Pose, Tick};
use rhumb_transport::Clock;

use super::raw_client::{Parts, RawClient};
use crate::grammar::hex;
use crate::log::Log;
use crate::outcome::{CaseResult, Stop};

/// The fate of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LaneAction {
    /// It is delivered.
    Comes,
    /// It is lost.
    Lost,
    /// It is delivered twice.
    Twice,
    /// It is delivered after the next delivered one.
    Late,
}

type LaneFilter = Box<dyn FnMut(&[u8]) -> LaneAction>;

/// A client with a replica.
pub struct LossyClient {
    /// The session with the replica.
    pub session: ClientSession,
    /// Events that the case has not taken yet.
    pub events: VecDeque<Event>,
    /// The id range granted to it as a member.
    pub granted: IdRange,
    /// The scene of its connection.
    pub scene: SceneName,
    /// Number of received datagrams, dropped ones included.
    pub arrived: u64,
    /// The number of new snapshots that it requested.
    pub resyncs: u64,
    /// The pose of each body at each complete tick, if they are recorded.
    pub recorded: Option<BTreeMap<Tick, BTreeMap<BodyId, Pose>>>,
    connection: RawConnection,
    clock: Clock,
    filter: LaneFilter,
    late: Vec<Bytes>,
    sent: Frames,
    timeout: Duration,
    log: Log,
    scenes: Rc<RefCell<BTreeSet<SceneName>>>,
    _relay: Option<UdpRelay>,
}

const SERVER: Peer = Peer(0);

impl LossyClient {
    pub(crate) fn new(client: RawClient) -> Self {
        let token = client.token.clone();
        let Parts {
            connection,
            scene,
            timeout,
            log,
            scenes,
            relay,
        } = client.into_parts();
        let mut session = ClientSession::new(scene.clone());
        if let Some(token) = token {
            session.set_token(token);
        }
        let clock = Clock::start();
        session.handle_opened(clock.now(), SERVER);
        Self {
            session,
            events: VecDeque::new(),
            granted: IdRange::EMPTY,
            scene,
            arrived: 0,
            resyncs: 0,
            sent: Frames::new(),
            recorded: None,
            connection,
            clock,
            filter: Box::new(|_| LaneAction::Comes),
            late: Vec::new(),
            timeout,
            log,
            scenes,
            _relay: relay,
        }
    }

    /// Sets the fate of all datagrams from now on. Answers to loss reports may be lost too, several times, so every
    /// time limit is extended.
    pub fn filter_datagrams(&mut self, filter: impl FnMut(&[u8]) -> LaneAction + 'static) {
        self.timeout *= 4;
        self.filter = Box::new(filter);
    }

    /// Sends `Hello` and waits for `Welcome`.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when no `Welcome` comes.
    pub fn greet(&mut self) -> Result<Welcome, Stop> {
        self.until("welcome", |event| match event {
            Event::Welcomed(welcome) => Some(welcome),
            _ => None,
        })
    }

    /// Sends hello and creates the scene.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is denied.
    pub fn create(&mut self, config: SceneConfig) -> CaseResult {
        self.greet()?;
        self.task(|session| session.create(config))?;
        self.until("answer to create", |event| match event {
            Event::Created => Some(Ok(())),
            Event::Denied(denial) => Some(Stop::fail(format!(
                "creating the scene is denied: {denial}"
            ))),
            _ => None,
        })?
    }

    /// Becomes a member.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is denied.
    pub fn join(&mut self, choice: StreamChoice) -> Result<IdRange, Stop> {
        self.task(|session| session.join(choice))?;
        self.granted = self.until("snapshot", |event| match event {
            Event::Joined(granted) => Some(Ok(granted)),
            Event::Denied(denial) => Some(Stop::fail(format!("joining is denied: {denial}"))),
            _ => None,
        })??;
        Ok(self.granted)
    }

    /// Calls the session.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when the session refuses the call.
    pub fn task<T>(
        &mut self,
        task: impl FnOnce(&mut ClientSession) -> Result<T, Misuse>,
    ) -> Result<T, Stop> {
        let sent = task(&mut self.session);
        let sent =
            sent.map_err(|misuse| Stop::Inconclusive(format!("error of the suite: {misuse}")));
        self.flush();
        sent
    }

    /// Sends a command and waits for its outcome.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when no answer comes.
    pub fn command(&mut self, command: Command) -> Result<Result<Tick, CommandError>, Stop> {
        let number = self.task(|session| session.command(command))?;
        let mut refused = None;
        let tick = self.until("answer to a command", |event| match event {
            Event::Refused { number: of, error } if of == number => {
                refused = Some(error);
                None
            }
            Event::Applied { through, tick } if through >= number => Some(tick),
            _ => None,
        })?;
        Ok(refused.map_or(Ok(tick), Err))
    }

    /// Sends a command that must be applied; returns its tick.
    ///
    /// # Errors
    ///
    /// [`Stop::refused`] when it is refused.
    pub fn must(&mut self, command: Command) -> Result<Tick, Stop> {
        let sent = command.clone();
        self.command(command)?
            .map_err(|error| Stop::refused(&sent, &error))
    }

    /// Lets a lockstep scene step to a tick, without waiting.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when the client is not a member.
    pub fn ask_for(&mut self, to: Tick) -> CaseResult {
        let now = self.clock.now();
        self.task(|session| session.advance(now, to))
    }

    /// Lets a lockstep scene step to a tick, and waits until the copy is complete there.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when that does not happen in time.
    pub fn advance(&mut self, to: Tick) -> CaseResult {
        self.ask_for(to)?;
        self.complete(to)
    }

    /// Records the poses of all bodies at each complete tick from now on.
    pub fn record(&mut self) {
        self.recorded = Some(BTreeMap::new());
    }

    fn record_poses(&mut self) {
        let (Some(recorded), Some(copy)) = (&mut self.recorded, self.session.replica()) else {
            return;
        };
        let stream = copy.stream();
        let tick = stream.complete();
        if recorded.contains_key(&tick) || !stream.is_converged() {
            return;
        }
        let poses = copy.bodies().filter_map(|desc| {
            let predicted_motion = stream.predicted_motion(desc.id, tick)?;
            Some((desc.id, predicted_motion.pose()))
        });
        recorded.insert(tick, poses.collect());
    }

    /// Waits until the copy is complete at a tick.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when that does not happen in time.
    pub fn complete(&mut self, tick: Tick) -> CaseResult {
        let what = format!("complete copy at {tick}");
        self.turn_until(&what, |subscriber| {
            subscriber
                .copy()
                .is_some_and(|copy| copy.stream().complete() >= tick)
        })
    }

    /// The replica, if there is one.
    #[must_use]
    pub const fn copy(&self) -> Option<&Replica> {
        self.session.replica()
    }

    /// The replica, which every member has.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when there is none.
    pub fn replica(&self) -> Result<&Replica, Stop> {
        let none = || Stop::Inconclusive("the suite has no copy of the scene".into());
        self.copy().ok_or_else(none)
    }

    /// Waits for the first event that `wanted` accepts, and returns its result.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when none comes in time.
    pub fn until<T>(
        &mut self,
        what: &str,
        mut wanted: impl FnMut(Event) -> Option<T>,
    ) -> Result<T, Stop> {
        let mut found = None;
        self.turn_until(what, |subscriber| {
            while let Some(event) = subscriber.events.pop_front() {
                found = wanted(event);
                if found.is_some() {
                    return true;
                }
            }
            false
        })?;
        found.ok_or_else(|| Stop::Inconclusive("the suite lost an event".into()))
    }

    /// Runs until a condition holds.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not hold in time.
    pub fn turn_until(&mut self, what: &str, mut is: impl FnMut(&mut Self) -> bool) -> CaseResult {
        let end = self.clock.now() + span(self.timeout);
        loop {
            if is(self) {
                return Ok(());
            }
            let ended = self.events.iter().find_map(|event| match event {
                Event::Ended(ending) => Some(*ending),
                _ => None,
            });
            if let Some(ending) = ended {
                return Stop::fail(format!("no {what}: the connection ended, {ending:?}"));
            }
            if self.clock.now() >= end {
                return Stop::fail(format!("no {what} within {:?}", self.timeout));
            }
            self.turn(end);
        }
    }

    /// Runs for this time.
    pub fn turn_for(&mut self, time: Duration) {
        self.turn_for_and_look(time, |_| {});
    }

    /// Runs for this time, and shows the replica after each received event.
    pub fn turn_for_and_look(&mut self, time: Duration, mut look: impl FnMut(&Replica)) {
        let end = self.clock.now() + span(time);
        while self.clock.now() < end {
            self.turn(end);
            self.copy().into_iter().for_each(&mut look);
        }
    }

    /// Processes at most one event until a moment.
    fn turn(&mut self, until: Instant) {
        self.flush();
        let wake = self
            .session
            .poll_timeout()
            .map_or(until, |wake| wake.at.min(until));
        if let Some(event) = self.connection.next_event(self.clock.until(wake)) {
            let now = self.clock.now();
            match event {
                RawEvent::Control(bytes) => {
                    self.note_control(&bytes);
                    self.session.handle_control(now, SERVER, &bytes);
                }
                RawEvent::Datagram(bytes) => self.sort(now, &bytes),
                RawEvent::Ended(end) => {
                    self.log.note(format!("< {end}"));
                    let ending = match end {
                        RawPeerEnd::Closed(code) => {
                            Ending::Closed(u32::try_from(code).unwrap_or(u32::MAX))
                        }
                        RawPeerEnd::TimedOut => Ending::TimedOut,
                        _ => Ending::Broken,
                    };
                    self.session.handle_ended(now, SERVER, ending);
                }
                RawEvent::Opened { .. } | RawEvent::ControlFinished | RawEvent::ControlReset(_) => {
                    self.session.handle_ended(now, SERVER, Ending::Broken);
                }
            }
        }
        self.session.handle_timeout(self.clock.now());
        self.record_poses();
        self.flush();
    }

    fn note_control(&self, bytes: &[u8]) {
        self.log.note(format!("< {}", hex(bytes)));
    }

    fn sort(&mut self, now: Instant, bytes: &Bytes) {
        self.arrived += 1;
        let fate = (self.filter)(bytes);
        self.log
            .note(format!("< datagram, {fate:?}: {}", hex(bytes)));
        match fate {
            LaneAction::Lost => return,
            LaneAction::Late => return self.late.push(bytes.clone()),
            LaneAction::Comes => {}
            LaneAction::Twice => self.session.handle_datagram(now, SERVER, bytes),
        }
        self.session.handle_datagram(now, SERVER, bytes);
        for late in std::mem::take(&mut self.late) {
            self.session.handle_datagram(now, SERVER, &late);
        }
    }

    fn flush(&mut self) {
        while let Some(transmit) = self.session.poll_transmit() {
            match transmit {
                Transmit::Control { bytes, .. } => {
                    self.log.note(format!("> {}", hex(&bytes)));
                    self.sent.push(&bytes);
                    while let Ok(Some(framed)) = self.sent.next_frame() {
                        let sent = ClientMessage::decode(&framed);
                        self.resyncs +=
                            u64::from(matches!(sent, Ok(Some(ClientMessage::Resync(_)))));
                    }
                    self.connection.send_control(bytes);
                }
                Transmit::State { bytes, .. } => {
                    self.log.note(format!("> datagram {}", hex(&bytes)));
                    // A datagram that QUIC cannot send now is lost, which datagrams allow.
                    let _ = self.connection.send_datagram(bytes);
                }
                Transmit::Close { code, .. } => self.connection.close(code),
            }
        }
        while let Some(event) = self.session.poll_event() {
            match event {
                Event::Created => {
                    self.scenes.borrow_mut().insert(self.scene.clone());
                }
                Event::Deleted => {
                    self.scenes.borrow_mut().remove(&self.scene);
                }
                _ => {}
            }
            self.events.push_back(event);
        }
    }
}

impl fmt::Debug for LossyClient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("LossyClient")
            .field("scene", &self.scene)
            .finish_non_exhaustive()
    }
}

fn span(time: Duration) -> Span {
    Span::from_nanos(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX))
}
