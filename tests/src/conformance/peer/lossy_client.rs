//! A client that keeps a copy, over a lane that loses what a case wants lost.
//!
//! The copy is that of this house's session; what reaches it is the case's matter. So a case holds a server's stream
//! against what a subscriber may conclude from it.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fmt;
use std::rc::Rc;
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::message::{ClientMessage, Frames, StreamChoice, Welcome};
use rhumb_protocol::scene::{Command, CommandError, IdRange, SceneConfig, SceneName};
use rhumb_protocol::session::{ClientSession, Event, Misuse, Replica};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{BodyId, Pose, Tick};
use rhumb_transport::{Clock, RawConnection, RawEvent, RawPeerEnd, UdpRelay};

use super::raw_client::{Parts, RawClient};
use crate::conformance::outcome::{CaseResult, Stop};
use crate::conformance::trial::Log;
use crate::grammar::hex;

/// What becomes of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LaneAction {
    /// It comes.
    Comes,
    /// It is lost.
    Lost,
    /// It comes twice.
    Twice,
    /// It comes behind the next one that comes.
    Late,
}

type LaneFilter = Box<dyn FnMut(&[u8]) -> LaneAction>;

/// A client that keeps a copy.
pub struct LossyClient {
    /// The session with the copy.
    pub session: ClientSession,
    /// What happened and was not taken yet.
    pub events: VecDeque<Event>,
    /// What it was granted, as a member.
    pub granted: IdRange,
    /// What its connection is about.
    pub scene: SceneName,
    /// Datagrams that came, whatever became of them.
    pub arrived: u64,
    /// How often it asked for a new snapshot.
    pub resyncs: u64,
    /// Where every body was at each tick that the copy was complete for, if that is recorded.
    pub seen: Option<BTreeMap<Tick, BTreeMap<BodyId, Pose>>>,
    line: RawConnection,
    clock: Clock,
    sieve: LaneFilter,
    late: Vec<Bytes>,
    sent: Frames,
    timeout: Duration,
    log: Log,
    scenes: Rc<RefCell<BTreeSet<SceneName>>>,
    _relay: Option<UdpRelay>,
}

const SERVER: Peer = Peer(0);

impl LossyClient {
    pub(in crate::conformance) fn new(guest: RawClient) -> Self {
        let Parts {
            line,
            scene,
            timeout,
            log,
            scenes,
            relay,
        } = guest.into_parts();
        let mut session = ClientSession::new(scene.clone());
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
            seen: None,
            line,
            clock,
            sieve: Box::new(|_| LaneAction::Comes),
            late: Vec::new(),
            timeout,
            log,
            scenes,
            _relay: relay,
        }
    }

    /// What becomes of the datagrams that come from now on. Where some are lost, answers to what is asked for them may be
    /// lost too, several times: so everything may take longer.
    pub fn sift(&mut self, sieve: impl FnMut(&[u8]) -> LaneAction + 'static) {
        self.timeout *= 4;
        self.sieve = Box::new(sieve);
    }

    /// Is welcomed.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is not.
    pub fn greet(&mut self) -> Result<Welcome, Stop> {
        self.until("welcome", |event| match event {
            Event::Welcomed(welcome) => Some(welcome),
            _ => None,
        })
    }

    /// Greets, and creates the scene.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when that is denied.
    pub fn create(&mut self, config: SceneConfig) -> CaseResult {
        self.greet()?;
        self.task(|session| session.create(config))?;
        self.until("answer to create", |event| match event {
            Event::Created => Some(Ok(())),
            Event::Denied(denial) => Some(Stop::fail(format!("no scene is created: {denial}"))),
            _ => None,
        })?
    }

    /// Becomes a member.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when that is denied.
    pub fn join(&mut self, choice: StreamChoice) -> Result<IdRange, Stop> {
        self.task(|session| session.join(choice))?;
        self.granted = self.until("snapshot", |event| match event {
            Event::Joined(granted) => Some(Ok(granted)),
            Event::Denied(denial) => Some(Stop::fail(format!("nobody is let in: {denial}"))),
            _ => None,
        })??;
        Ok(self.granted)
    }

    /// Does something with the session that it allows.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when it does not.
    pub fn task<T>(
        &mut self,
        task: impl FnOnce(&mut ClientSession) -> Result<T, Misuse>,
    ) -> Result<T, Stop> {
        let sent = task(&mut self.session);
        let sent = sent.map_err(|misuse| Stop::Inconclusive(format!("the suite errs: {misuse}")));
        self.flush();
        sent
    }

    /// Commands, and waits for what came of it.
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

    /// Commands what must be applied.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it is refused.
    pub fn must(&mut self, command: Command) -> Result<Tick, Stop> {
        let sent = format!("{command:?}");
        self.command(command)?
            .map_err(|error| Stop::Fail(format!("{sent} is refused: {error}")))
    }

    /// Lets a lockstep scene step to a tick, and does not wait.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when it is no member.
    pub fn ask_for(&mut self, to: Tick) -> CaseResult {
        let now = self.clock.now();
        self.task(|session| session.advance(now, to))
    }

    /// Lets a lockstep scene step to a tick, and waits until the copy is complete there.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not become so in time.
    pub fn advance(&mut self, to: Tick) -> CaseResult {
        self.ask_for(to)?;
        self.complete(to)
    }

    /// Records from now on where bodies are at each tick that the copy is complete for.
    pub fn record(&mut self) {
        self.seen = Some(BTreeMap::new());
    }

    fn note_seen(&mut self) {
        let (Some(seen), Some(copy)) = (&mut self.seen, self.session.replica()) else {
            return;
        };
        let stream = copy.stream();
        let tick = stream.complete();
        if seen.contains_key(&tick) || !stream.is_converged() {
            return;
        }
        let poses = copy.bodies().filter_map(|desc| {
            let predicted_motion = stream.predicted_motion(desc.id, tick)?;
            Some((desc.id, predicted_motion.pose()))
        });
        seen.insert(tick, poses.collect());
    }

    /// Waits until the copy is complete at a tick.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not become so in time.
    pub fn complete(&mut self, tick: Tick) -> CaseResult {
        let what = format!("complete copy at {tick}");
        self.turn_until(&what, |follower| {
            follower
                .copy()
                .is_some_and(|copy| copy.stream().complete() >= tick)
        })
    }

    /// The copy.
    #[must_use]
    pub const fn copy(&self) -> Option<&Replica> {
        self.session.replica()
    }

    /// The copy, which a member has.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when it is none.
    pub fn replica(&self) -> Result<&Replica, Stop> {
        let none = || Stop::Inconclusive("the suite has no copy of the scene".into());
        self.copy().ok_or_else(none)
    }

    /// What is made of the first event of which something is.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when there is none in time.
    pub fn until<T>(
        &mut self,
        what: &str,
        mut seen: impl FnMut(Event) -> Option<T>,
    ) -> Result<T, Stop> {
        let mut found = None;
        self.turn_until(what, |follower| {
            while let Some(event) = follower.events.pop_front() {
                found = seen(event);
                if found.is_some() {
                    return true;
                }
            }
            false
        })?;
        found.ok_or_else(|| Stop::Inconclusive("the suite lost an event".into()))
    }

    /// Goes on until something is so.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not become so in time.
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

    /// Goes on for so long.
    pub fn turn_for(&mut self, time: Duration) {
        self.turn_for_and_look(time, |_| {});
    }

    /// Goes on for so long, and shows the copy after each thing that comes.
    pub fn turn_for_and_look(&mut self, time: Duration, mut look: impl FnMut(&Replica)) {
        let end = self.clock.now() + span(time);
        while self.clock.now() < end {
            self.turn(end);
            self.copy().into_iter().for_each(&mut look);
        }
    }

    /// Takes in what comes until a moment, one thing at most.
    fn turn(&mut self, until: Instant) {
        self.flush();
        let wake = self
            .session
            .poll_timeout()
            .map_or(until, |wake| wake.at.min(until));
        if let Some(seen) = self.line.hear(self.clock.until(wake)) {
            let now = self.clock.now();
            match seen {
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
        self.note_seen();
        self.flush();
    }

    fn note_control(&self, bytes: &[u8]) {
        self.log.note(format!("< {}", hex(bytes)));
    }

    fn sort(&mut self, now: Instant, bytes: &Bytes) {
        self.arrived += 1;
        let fate = (self.sieve)(bytes);
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
                    self.line.say(bytes);
                }
                Transmit::State { bytes, .. } => {
                    self.log.note(format!("> datagram {}", hex(&bytes)));
                    // What QUIC cannot send now is lost, as any datagram may be.
                    let _ = self.line.datagram(bytes);
                }
                Transmit::Close { code, .. } => self.line.close(code),
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
