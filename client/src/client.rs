//! A member of one scene, from a plain frame loop.
//!
//! Every call says how long it may wait: not at all, or no longer than its patience for an answer. Only opening awaits
//! several, after the system has resolved a name. What it cannot have in time can be asked for again.

mod authority;

use std::collections::VecDeque;
use std::net::{SocketAddr, ToSocketAddrs};
use std::time::Duration;

use rhumb_protocol::limits::SILENCE_MS_MAX;
use rhumb_protocol::message::{Denial, Inspection, StreamChoice, TierPolicy};
use rhumb_protocol::scene::{Command, IdRange, SceneConfig};
use rhumb_protocol::session::{ClientSession, CloseCode, Event, Replica};
use rhumb_protocol::stream::{ErrorBound, Subscriber};
use rhumb_protocol::{Ending, Instant, Span};
use rhumb_reckoning::{BodyId, Seconds, Tick, Ticks, Tolerance};
use rhumb_transport::{ClientOptions, QuicClient};

use crate::client_event::{ClientEvent, Statistics};
use crate::clock::{RenderTime, SceneClock};
use crate::error::{ClientError, OpenError};
use crate::options::{JoinMode, Options};
use crate::pipeline_depth::PipelineDepth;
use crate::pump::{Pump, TapChannel};
use crate::view::{RenderParams, View};

/// Beyond the tick that should be watermark_tick for by now a free-running view predicts at most this far, then holds: half a
/// second.
const PREDICT_SECONDS: f64 = 0.5;
/// ClientEvents that are kept for a caller who does not ask; the oldest go first.
const EVENTS_KEPT: usize = 65_536;

/// A member of one scene.
pub struct Client {
    pump: Pump,
    patience: Duration,
    view: View,
    granted: IdRange,
    config: SceneConfig,
    clock: SceneClock,
    /// The same for what is driven, which the view's delay does not hold back.
    upstream_clock: SceneClock,
    delay_ticks: f64,
    lead_ticks: f64,
    whole_ticks: bool,
    smooth: bool,
    requested: Tick,
    client_events: VecDeque<ClientEvent>,
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
        let create = match options.join_mode {
            JoinMode::Create(config) => Some(config),
            JoinMode::CreateOrJoin(config) if welcome.scene.is_none() => Some(config),
            JoinMode::CreateOrJoin(_) | JoinMode::Join => None,
        };
        if let Some(config) = create {
            pump.session.create(config).map_err(ClientError::from)?;
            let created =
                await_event(&mut pump, options.patience, "answer", |event| match event {
                    Event::Created => Some(Ok(())),
                    Event::Denied(denial) => Some(Err(denial)),
                    _ => None,
                })?;
            match created {
                // Somebody else was faster; that is as good.
                Err(Denial::SceneExists)
                    if matches!(options.join_mode, JoinMode::CreateOrJoin(_)) => {}
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
        let config = *pump
            .session
            .config()
            .expect("a member knows its scene's config");
        let watermark_tick = pump
            .session
            .replica()
            .map_or(Tick::ZERO, |replica| replica.stream().watermark_tick());
        let mut client = Self {
            pump,
            patience: options.patience,
            view: View::default(),
            granted,
            config,
            clock: SceneClock::new(config.integrator.rate),
            upstream_clock: SceneClock::new(config.integrator.rate),
            delay_ticks: options.delay_ticks,
            lead_ticks: options.lead_ticks,
            whole_ticks: options.whole_ticks,
            smooth: options.smooth,
            requested: watermark_tick,
            client_events: VecDeque::new(),
            inspected: None,
            denied: None,
            deleted: false,
            faulted: None,
            ended: None,
        };
        client.refresh(RenderTime::at(watermark_tick), false);
        client
    }

    /// Body indices that are this client's to give out.
    #[must_use]
    pub const fn granted(&self) -> IdRange {
        self.granted
    }

    /// What the scene was created with.
    #[must_use]
    pub const fn config(&self) -> &SceneConfig {
        &self.config
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

    /// Asks for another stream, and does not wait: [`ClientEvent::SubscriptionChanged`] tells when the copy is by it. Until then it is
    /// by the present one, and no tick is missed between the two. A choice that is made meanwhile takes its place.
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

    /// Says where the server may move this client when its link is thin: to coarse (20 cm) unless this says otherwise.
    /// [`ClientEvent::TierChanged`] tells when it does, and [`Self::tolerance`] what holds.
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

    /// How far off the copy of a body may be, at the newest tick that the stream watermark_tick for.
    #[must_use]
    pub fn bound(&self, id: BodyId) -> Option<ErrorBound> {
        self.replica()?.stream().bound(id)
    }

    /// How far off the copy of a body may be at a tick, such as the one that the view shows.
    #[must_use]
    pub fn bound_at(&self, id: BodyId, tick: Tick) -> Option<ErrorBound> {
        self.replica()?.stream().bound_at(id, tick)
    }

    /// The next thing that happened.
    pub fn poll_event(&mut self) -> Option<ClientEvent> {
        self.client_events.pop_front()
    }

    /// Wishes something before the next tick; returns the number that its answer will name. Does not wait.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for a number that no engine should be given; nothing is sent then.
    pub fn command(&mut self, command: Command) -> Result<u64, ClientError> {
        self.check_open()?;
        Ok(self.pump.session.command(command)?)
    }

    /// Asks for more body indices, and waits for them.
    ///
    /// # Errors
    ///
    /// [`ClientError::Denied`] when there are none left.
    pub fn reserve(&mut self, count: u32) -> Result<IdRange, ClientError> {
        self.check_open()?;
        self.pump.session.reserve(count)?;
        self.denied = None;
        let deadline = self.deadline();
        loop {
            if let Some(place) = self
                .client_events
                .iter()
                .position(|h| matches!(h, ClientEvent::Reserved(_)))
                && let Some(ClientEvent::Reserved(range)) = self.client_events.remove(place)
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
    /// [`ClientError::Timeout`] when the tick's stream was not complete in time; [`Self::wait`] goes on waiting.
    /// [`ClientError::Denied`] when the scene is not led by members, or the tick lies too far ahead.
    pub fn advance(&mut self, depth: PipelineDepth) -> Result<Tick, ClientError> {
        self.check_open()?;
        self.denied = None;
        self.requested = self.config.publish_schedule.next_published(self.requested);
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
    pub fn wait(&mut self, depth: PipelineDepth) -> Result<Tick, ClientError> {
        let wanted = self
            .requested
            .before(self.published_ticks(depth))
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
        self.refresh(RenderTime::at(tick), false);
        Ok(tick)
    }

    /// Takes in what has arrived from a free-running scene and shows it as of now. Does not wait.
    ///
    /// # Errors
    ///
    /// [`ClientError::Ended`] when the connection is over.
    pub fn poll(&mut self) -> Result<RenderTime, ClientError> {
        self.check_open()?;
        self.pump.turn(Instant::ZERO);
        self.take_events();
        self.check_open()?;
        let now = self.pump.now();
        let step = self.config.integrator.rate.step().seconds();
        let stream = self.replica().map(Replica::stream);
        let known = stream.map_or(0.0, |stream| stream.watermark_tick().value() as f64);
        let silent = stream.map_or(0.0, |stream| stream.silent_ticks() as f64);
        // The next watermark is due when the silence has doubled, or has gone on for as long as any may, and at a tick that is
        // spoken of.
        let due = silent.min(f64::from(SILENCE_MS_MAX) / (1e3 * step));
        let publish_schedule = self.config.publish_schedule;
        let due = due.max(f64::from(publish_schedule.publish_interval.get()));
        let limit = known + due + PREDICT_SECONDS / step;
        let shown = self.clock.show(now, self.delay_ticks(), known, limit);
        let at = if self.whole_ticks {
            RenderTime::at(shown.tick)
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
        self.delay_ticks + f64::from(self.config.publish_schedule.lookahead.count())
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
            self.check_open()?;
        }
        Ok(())
    }

    /// Asks how the scene is, and waits for the answer.
    ///
    /// # Errors
    ///
    /// [`ClientError::Timeout`] when there is none in time.
    pub fn inspect(&mut self) -> Result<Inspection, ClientError> {
        self.check_open()?;
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
        self.check_open()?;
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
        self.close_connection();
    }

    fn close_connection(&mut self) {
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
            watermark_tick: stream.map(Subscriber::watermark_tick).unwrap_or_default(),
            complete: self.complete(),
            behind_ticks: server
                .zip(self.view.time())
                .map(|(server, shown)| server - shown.ticks()),
        }
    }

    /// Hands every piece of the control stream and every datagram to `tap` as it passes, for recording.
    pub fn record(&mut self, tap: impl FnMut(TapChannel, &[u8]) + Send + 'static) {
        self.pump.tap(Box::new(tap));
    }

    fn complete(&self) -> Tick {
        self.replica()
            .map_or(Tick::ZERO, |replica| replica.stream().complete())
    }

    /// The ticks from one that is spoken of to the one so many later.
    fn published_ticks(&self, depth: PipelineDepth) -> Ticks {
        Ticks::new(
            depth
                .ticks()
                .saturating_mul(self.config.publish_schedule.publish_interval.get()),
        )
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
            return Err(ClientError::Timeout { awaited, patience });
        }
        self.pump.turn(deadline);
        self.take_events();
        self.check_open()
    }

    fn check_open(&self) -> Result<(), ClientError> {
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
            let client_event = match event {
                Event::Applied { through, tick } => ClientEvent::Applied { through, tick },
                Event::Refused { number, error } => ClientEvent::Refused { number, error },
                Event::BodyPlaced(id) => ClientEvent::BodyPlaced(id),
                Event::BodyRemoved { id, cause } => ClientEvent::BodyRemoved { id, cause },
                Event::Amended(id) => ClientEvent::Amended(id),
                Event::Reserved(range) => ClientEvent::Reserved(range),
                Event::SubscriptionChanged(choice) => ClientEvent::SubscriptionChanged(choice),
                Event::TierChanged { to, cause } => ClientEvent::TierChanged { to, cause },
                Event::AuthorityGrant(bodies) => ClientEvent::AuthorityGrant(bodies),
                Event::AuthorityDenied(error) => ClientEvent::AuthorityDenied(error),
                Event::Denied(denial) => {
                    self.denied = Some(denial);
                    ClientEvent::Denied(denial)
                }
                other => {
                    self.take_state(&other);
                    continue;
                }
            };
            if self.client_events.len() == EVENTS_KEPT {
                self.client_events.pop_front();
            }
            self.client_events.push_back(client_event);
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
                self.upstream_clock.sample(at, tick, since_tick, round_trip);
            }
            Event::SceneFaulted(tick) => self.faulted = Some(tick),
            Event::Deleted => self.deleted = true,
            Event::Ended(ending) => self.ended = Some(ending),
            _ => {}
        }
    }

    fn refresh(&mut self, at: RenderTime, smooth: bool) {
        let now = Seconds::new(self.pump.now().as_nanos() as f64 / 1e9);
        let Some(replica) = self.pump.session.replica_mut() else {
            return;
        };
        let render_params = RenderParams { at, now, smooth };
        self.view.refresh(replica.stream_mut(), &render_params);
    }
}

impl Drop for Client {
    fn drop(&mut self) {
        self.close_connection();
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
            return Err(ClientError::Timeout { awaited, patience });
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
