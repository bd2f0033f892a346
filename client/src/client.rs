//! A member of one scene, from a plain frame loop.
//!
//! Every call says how long it may wait: not at all, or no longer than its patience for an answer. Only opening awaits
//! several, after the system has resolved a name. What it cannot have in time can be asked for again.

mod driving;

use std::collections::VecDeque;
use std::net::{SocketAddr, ToSocketAddrs};
use std::time::Duration;

use rhumb_protocol::limits::SILENCE_MS_MAX;
use rhumb_protocol::message::{Denial, Inspection, Moves, StreamChoice};
use rhumb_protocol::scene::{Command, IdRange, SceneTerms};
use rhumb_protocol::session::{ClientSession, CloseCode, Event, Replica};
use rhumb_protocol::stream::{Bound, Subscriber};
use rhumb_protocol::{Ending, Instant, Span};
use rhumb_reckoning::{BodyId, Seconds, Tick, Ticks, Tolerance};
use rhumb_transport::{ClientOptions, QuicClient};

use crate::clock::{DisplayTime, SceneClock};
use crate::depth::Depth;
use crate::error::{ClientError, OpenError};
use crate::happening::{Happening, Statistics};
use crate::options::{Entry, Options};
use crate::pump::{Pump, Way};
use crate::view::{Glass, View};

/// Beyond the tick that should be vouched for by now a free-running view predicts at most this far, then holds: half a
/// second.
const PREDICT_SECONDS: f64 = 0.5;
/// Happenings that are kept for a caller who does not ask; the oldest go first.
const HAPPENINGS_KEPT: usize = 65_536;

/// A member of one scene.
pub struct Client {
    pump: Pump,
    patience: Duration,
    view: View,
    granted: IdRange,
    terms: SceneTerms,
    clock: SceneClock,
    /// The same for what is driven, which the view's delay does not hold back.
    drive_clock: SceneClock,
    delay_ticks: f64,
    lead_ticks: f64,
    whole_ticks: bool,
    smooth: bool,
    requested: Tick,
    happenings: VecDeque<Happening>,
    inspected: Option<Inspection>,
    denied: Option<Denial>,
    deleted: bool,
    faulted: Option<Tick>,
    ended: Option<Ending>,
}

impl Client {
    /// Connects and comes into the scene.
    ///
    /// Resolves the server's name first, for as long as the system takes to. Then waits no longer than the patience of the
    /// options for each of up to four answers: connection, welcome, creation, snapshot.
    ///
    /// # Errors
    ///
    /// [`OpenError`] names what failed: the address, the connection, the scene, or the server's patience.
    pub fn open(options: Options) -> Result<Self, OpenError> {
        let address = resolve(&options.server)?;
        let connection = QuicClient::connect(
            ClientOptions {
                server_name: host_of(&options.server).to_owned(),
                ..ClientOptions::new(address, options.trust.clone())
            },
            options.patience,
        )?;
        let mut pump = Pump::new(ClientSession::new(options.scene.clone()), connection);
        let denied = |denial| OpenError::Denied {
            scene: options.scene.clone(),
            denial,
        };
        let welcome = await_event(
            &mut pump,
            options.patience,
            "welcome",
            |event| match event {
                Event::Welcomed(welcome) => Some(Ok(welcome)),
                _ => None,
            },
        )?
        .map_err(denied)?;
        let create = match options.entry {
            Entry::Create(terms) => Some(terms),
            Entry::CreateOrJoin(terms) if welcome.scene.is_none() => Some(terms),
            Entry::CreateOrJoin(_) | Entry::Join => None,
        };
        if let Some(terms) = create {
            pump.session.create(terms).map_err(ClientError::from)?;
            let created =
                await_event(&mut pump, options.patience, "answer", |event| match event {
                    Event::Created => Some(Ok(())),
                    Event::Denied(denial) => Some(Err(denial)),
                    _ => None,
                })?;
            match created {
                // Somebody else was faster; that is as good.
                Err(Denial::SceneExists) if matches!(options.entry, Entry::CreateOrJoin(_)) => {}
                other => other.map_err(denied)?,
            }
        }
        pump.session
            .join(options.stream)
            .map_err(ClientError::from)?;
        let granted = await_event(&mut pump, options.patience, "scene", |event| match event {
            Event::Joined(granted) => Some(Ok(granted)),
            Event::Denied(denial) => Some(Err(denial)),
            _ => None,
        })?
        .map_err(denied)?;
        Ok(Self::joined(pump, &options, granted))
    }

    fn joined(pump: Pump, options: &Options, granted: IdRange) -> Self {
        let terms = *pump
            .session
            .terms()
            .expect("a member knows its scene's terms");
        let vouched = pump
            .session
            .replica()
            .map_or(Tick::ZERO, |replica| replica.stream().vouched());
        let mut client = Self {
            pump,
            patience: options.patience,
            view: View::default(),
            granted,
            terms,
            clock: SceneClock::new(terms.integrator.rate),
            drive_clock: SceneClock::new(terms.integrator.rate),
            delay_ticks: options.delay_ticks,
            lead_ticks: options.lead_ticks,
            whole_ticks: options.whole_ticks,
            smooth: options.smooth,
            requested: vouched,
            happenings: VecDeque::new(),
            inspected: None,
            denied: None,
            deleted: false,
            faulted: None,
            ended: None,
        };
        client.refresh(DisplayTime::at(vouched), false);
        client
    }

    /// Body indices that are this client's to give out.
    #[must_use]
    pub const fn granted(&self) -> IdRange {
        self.granted
    }

    /// What the scene was created with.
    #[must_use]
    pub const fn terms(&self) -> &SceneTerms {
        &self.terms
    }

    /// The bodies as they were when the view was last computed.
    #[must_use]
    pub const fn view(&self) -> &View {
        &self.view
    }

    /// The copy of the scene: shapes, bodies, tracks.
    #[must_use]
    pub const fn replica(&self) -> Option<&Replica> {
        self.pump.session.replica()
    }

    /// What the copy is by now.
    #[must_use]
    pub fn stream(&self) -> Option<StreamChoice> {
        self.replica().map(Replica::choice)
    }

    /// How far off the copy may be now; none by a full stream, which says the very bits.
    #[must_use]
    pub fn tolerance(&self) -> Option<Tolerance> {
        match self.stream()? {
            StreamChoice::Within(tolerance) | StreamChoice::Capped { tolerance, .. } => {
                Some(tolerance)
            }
            StreamChoice::Full => None,
        }
    }

    /// Asks for another stream, and does not wait: [`Happening::Following`] tells when the copy is by it. Until then it is
    /// by the present one, and no tick is missed between the two. A choice that is made meanwhile takes its place.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn change_stream(&mut self, choice: StreamChoice) -> Result<(), ClientError> {
        self.must_stand()?;
        self.pump.session.follow(choice)?;
        self.pump.flush();
        Ok(())
    }

    /// Says where the server may move this client when its link is thin: to coarse (20 cm) unless this says otherwise.
    /// [`Happening::Moved`] tells when it does, and [`Self::tolerance`] what holds.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn allow_moves(&mut self, moves: Moves) -> Result<(), ClientError> {
        self.must_stand()?;
        self.pump.session.allow(moves)?;
        self.pump.flush();
        Ok(())
    }

    /// How far off the copy of a body may be, at the newest tick that the stream vouched for.
    #[must_use]
    pub fn bound(&self, id: BodyId) -> Option<Bound> {
        self.replica()?.stream().bound(id)
    }

    /// How far off the copy of a body may be at a tick, such as the one that the view shows.
    #[must_use]
    pub fn bound_at(&self, id: BodyId, tick: Tick) -> Option<Bound> {
        self.replica()?.stream().bound_at(id, tick)
    }

    /// The next thing that happened.
    pub fn poll_happening(&mut self) -> Option<Happening> {
        self.happenings.pop_front()
    }

    /// Wishes something before the next tick; returns the number that its answer will name. Does not wait.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for a number that no engine should be given; nothing is sent then.
    pub fn command(&mut self, command: Command) -> Result<u64, ClientError> {
        self.must_stand()?;
        Ok(self.pump.session.command(command)?)
    }

    /// Asks for more body indices, and waits for them.
    ///
    /// # Errors
    ///
    /// [`ClientError::Denied`] when there are none left.
    pub fn reserve(&mut self, count: u32) -> Result<IdRange, ClientError> {
        self.must_stand()?;
        self.pump.session.reserve(count)?;
        self.denied = None;
        let deadline = self.deadline();
        loop {
            if let Some(place) = self
                .happenings
                .iter()
                .position(|h| matches!(h, Happening::Reserved(_)))
                && let Some(Happening::Reserved(range)) = self.happenings.remove(place)
            {
                return Ok(range);
            }
            if let Some(denial) = self.denied.take() {
                return Err(ClientError::Denied(denial));
            }
            self.turn(deadline, "answer")?;
        }
    }

    /// Lets a lockstep scene step once, and shows it: this tick at depth 0, the one before at depth 1.
    ///
    /// A scene whose streams do not speak of every tick steps to the next one that they speak of, and depth counts those.
    ///
    /// Returns the tick that the view shows. If more of the server's work has already arrived, that is shown.
    ///
    /// # Errors
    ///
    /// [`ClientError::Patience`] when the tick's stream was not complete in time; [`Self::wait`] goes on waiting.
    /// [`ClientError::Denied`] when the scene is not led by members, or the tick lies too far ahead.
    pub fn advance(&mut self, depth: Depth) -> Result<Tick, ClientError> {
        self.must_stand()?;
        self.denied = None;
        self.requested = self.terms.cadence.next_spoken(self.requested);
        let now = self.pump.now();
        self.pump.session.advance(now, self.requested)?;
        self.pump.flush();
        self.wait(depth)
    }

    /// Waits for the tick that the last [`Self::advance`] asked for, and shows it.
    ///
    /// # Errors
    ///
    /// As [`Self::advance`].
    pub fn wait(&mut self, depth: Depth) -> Result<Tick, ClientError> {
        let wanted = self
            .requested
            .before(self.spoken_ticks(depth))
            .unwrap_or_default();
        let deadline = self.deadline();
        self.pump.turn(Instant::ZERO);
        self.take_events();
        while self.complete() < wanted {
            if let Some(denial) = self.denied.take() {
                self.requested = self.complete();
                return Err(ClientError::Denied(denial));
            }
            self.turn(deadline, "complete tick")?;
        }
        let tick = self.complete();
        self.refresh(DisplayTime::at(tick), false);
        Ok(tick)
    }

    /// Takes in what has arrived from a free-running scene and shows it as of now. Does not wait.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn follow(&mut self) -> Result<DisplayTime, ClientError> {
        self.must_stand()?;
        self.pump.turn(Instant::ZERO);
        self.take_events();
        self.must_stand()?;
        let now = self.pump.now();
        let step = self.terms.integrator.rate.step().seconds();
        let stream = self.replica().map(Replica::stream);
        let known = stream.map_or(0.0, |stream| stream.vouched().value() as f64);
        let silent = stream.map_or(0.0, |stream| stream.silent_ticks() as f64);
        // The next vouch is due when the silence has doubled, or has gone on for as long as any may, and at a tick that is
        // spoken of.
        let due = silent.min(f64::from(SILENCE_MS_MAX) / (1e3 * step));
        let cadence = self.terms.cadence;
        let due = due.max(f64::from(cadence.every.get()));
        let limit = known + due + PREDICT_SECONDS / step;
        let shown = self.clock.show(now, self.delay_ticks(), known, limit);
        let at = if self.whole_ticks {
            DisplayTime::at(shown.tick)
        } else {
            shown
        };
        self.refresh(at, self.smooth);
        Ok(at)
    }

    /// How many ticks a free-running view stays behind the server's clock: as many as its options say, after those that the
    /// scene is spoken of late.
    #[must_use]
    pub fn delay_ticks(&self) -> f64 {
        self.delay_ticks + f64::from(self.terms.cadence.hindsight.count())
    }

    /// Takes in what arrives until `patience` is over, without showing it.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn idle(&mut self, patience: Duration) -> Result<(), ClientError> {
        let deadline = self.pump.now() + span(patience);
        while self.pump.now() < deadline {
            self.pump.turn(deadline);
            self.take_events();
            self.must_stand()?;
        }
        Ok(())
    }

    /// Asks how the scene is, and waits for the answer.
    ///
    /// # Errors
    ///
    /// [`ClientError::Patience`] when there is none in time.
    pub fn inspect(&mut self) -> Result<Inspection, ClientError> {
        self.must_stand()?;
        self.inspected = None;
        self.pump.session.inspect()?;
        let deadline = self.deadline();
        loop {
            if let Some(inspection) = self.inspected.take() {
                return Ok(inspection);
            }
            self.turn(deadline, "inspection")?;
        }
    }

    /// Ends the scene for everyone, and waits until it is gone.
    ///
    /// # Errors
    ///
    /// [`ClientError::Denied`] when there is no such scene any more.
    pub fn delete(&mut self) -> Result<(), ClientError> {
        self.must_stand()?;
        self.pump.session.delete()?;
        self.denied = None;
        let deadline = self.deadline();
        while !self.deleted {
            if let Some(denial) = self.denied.take() {
                return Err(ClientError::Denied(denial));
            }
            match self.turn(deadline, "answer") {
                Ok(()) | Err(ClientError::SceneDeleted) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Leaves; what was commanded before is delivered first, for little more than half a second at most. Dropping a client
    /// does the same.
    pub fn close(mut self) {
        self.say_goodbye();
    }

    fn say_goodbye(&mut self) {
        if self.ended.is_none() {
            self.pump.session.close(CloseCode::DONE);
            self.pump.flush();
        }
    }

    /// How the connection and the stream are doing.
    #[must_use]
    pub fn statistics(&self) -> Statistics {
        let stream = self.replica().map(Replica::stream);
        let server = self.clock.server(self.pump.now());
        Statistics {
            wire: self.pump.connection.statistics(),
            stream: stream.map(Subscriber::statistics).unwrap_or_default(),
            driven: self.pump.session.upstream().unwrap_or_default(),
            vouched: stream.map(Subscriber::vouched).unwrap_or_default(),
            complete: self.complete(),
            behind_ticks: server
                .zip(self.view.time())
                .map(|(server, shown)| server - shown.ticks()),
        }
    }

    /// Hands every piece of the control stream and every datagram to `tap` as it passes, for recording.
    pub fn record(&mut self, tap: impl FnMut(Way, &[u8]) + Send + 'static) {
        self.pump.tap(Box::new(tap));
    }

    fn complete(&self) -> Tick {
        self.replica()
            .map_or(Tick::ZERO, |replica| replica.stream().complete())
    }

    /// The ticks from one that is spoken of to the one so many later.
    fn spoken_ticks(&self, depth: Depth) -> Ticks {
        Ticks::new(depth.ticks().saturating_mul(self.terms.cadence.every.get()))
    }

    fn deadline(&self) -> Instant {
        self.pump.now() + span(self.patience)
    }

    /// Waits for anything until the deadline.
    ///
    /// The deadline is looked at first, so that an answer which came just in time is still taken by the caller.
    fn turn(&mut self, deadline: Instant, awaited: &'static str) -> Result<(), ClientError> {
        if self.pump.now() >= deadline {
            let patience = self.patience;
            return Err(ClientError::Patience { awaited, patience });
        }
        self.pump.turn(deadline);
        self.take_events();
        self.must_stand()
    }

    fn must_stand(&self) -> Result<(), ClientError> {
        if let Some(ending) = self.ended {
            return Err(ClientError::Ended(ending));
        }
        if self.deleted {
            return Err(ClientError::SceneDeleted);
        }
        match self.faulted {
            Some(tick) => Err(ClientError::SceneFaulted(tick)),
            None => Ok(()),
        }
    }

    fn take_events(&mut self) {
        while let Some(event) = self.pump.session.poll_event() {
            let happening = match event {
                Event::Applied { through, tick } => Happening::Applied { through, tick },
                Event::Refused { number, error } => Happening::Refused { number, error },
                Event::BodyPlaced(id) => Happening::BodyPlaced(id),
                Event::BodyRemoved { id, cause } => Happening::BodyRemoved { id, cause },
                Event::Amended(id) => Happening::Amended(id),
                Event::Reserved(range) => Happening::Reserved(range),
                Event::Following(choice) => Happening::Following(choice),
                Event::Moved { to, cause } => Happening::Moved { to, cause },
                Event::Driving(bodies) => Happening::Driving(bodies),
                Event::NotDriving(error) => Happening::NotDriving(error),
                Event::Denied(denial) => {
                    self.denied = Some(denial);
                    Happening::Denied(denial)
                }
                other => {
                    self.take_state(&other);
                    continue;
                }
            };
            if self.happenings.len() == HAPPENINGS_KEPT {
                self.happenings.pop_front();
            }
            self.happenings.push_back(happening);
        }
    }

    /// Takes in what changes the state of this client rather than of the scene.
    fn take_state(&mut self, event: &Event) {
        match *event {
            Event::Inspected(inspection) => self.inspected = Some(inspection),
            Event::ClockSeen {
                at,
                tick,
                since_tick,
                round_trip,
            } => {
                self.clock.sample(at, tick, since_tick, round_trip);
                self.drive_clock.sample(at, tick, since_tick, round_trip);
            }
            Event::SceneFaulted(tick) => self.faulted = Some(tick),
            Event::Deleted => self.deleted = true,
            Event::Ended(ending) => self.ended = Some(ending),
            _ => {}
        }
    }

    fn refresh(&mut self, at: DisplayTime, smooth: bool) {
        let now = Seconds::new(self.pump.now().as_nanos() as f64 / 1e9);
        let Some(replica) = self.pump.session.replica_mut() else {
            return;
        };
        let glass = Glass { at, now, smooth };
        self.view.refresh(replica.stream_mut(), &glass);
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.say_goodbye();
    }
}

/// Turns until an event is the one awaited; the inner result is the server's.
fn await_event<T>(
    pump: &mut Pump,
    patience: Duration,
    awaited: &'static str,
    wanted: impl Fn(Event) -> Option<Result<T, Denial>>,
) -> Result<Result<T, Denial>, ClientError> {
    let deadline = pump.now() + span(patience);
    loop {
        pump.turn(deadline);
        while let Some(event) = pump.session.poll_event() {
            if let Event::Ended(ending) = event {
                return Err(ClientError::Ended(ending));
            }
            if let Some(answer) = wanted(event) {
                return Ok(answer);
            }
        }
        if pump.now() >= deadline {
            return Err(ClientError::Patience { awaited, patience });
        }
    }
}

/// A patience as the protocol counts it; one of centuries saturates.
fn span(patience: Duration) -> Span {
    Span::from_nanos(u64::try_from(patience.as_nanos()).unwrap_or(u64::MAX))
}

fn resolve(server: &str) -> Result<SocketAddr, OpenError> {
    let failed = |cause| OpenError::Address {
        server: server.to_owned(),
        cause,
    };
    let mut addresses = server.to_socket_addrs().map_err(failed)?;
    addresses
        .next()
        .ok_or_else(|| failed(std::io::ErrorKind::NotFound.into()))
}

/// The part of `host:port` that a certificate names.
fn host_of(server: &str) -> &str {
    let host = server.rsplit_once(':').map_or(server, |(host, _)| host);
    host.trim_start_matches('[').trim_end_matches(']')
}
