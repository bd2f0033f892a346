//! A real server, with a case between it and the client under test.
//!
//! An undisturbed session of this project, the mirror, subscribes to the same stream. Its replica is what the client
//! must hold, bit for bit.

mod unjudged;

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use rhumb_netsim::RawPeerEnd;
use rhumb_protocol::message::{ClientMessage, Frames, StreamChoice};
use rhumb_protocol::packet::{Head, LossReport, PacketKind};
use rhumb_protocol::scene::{Command, PublishSchedule, SceneConfig, Stepping};
use rhumb_protocol::session::{ClientSession, Event, Replica};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{Tick, Ticks};
use rhumb_scene::{SceneRouter as Server, SceneSettings};
use rhumb_sims::{Script, by_name};
use serde_json::Value;

use super::datagram;
use super::host::RawServer;
use super::setting::Setting;
use super::stream_history::StreamHistory;
use crate::grammar::hex;
use crate::outcome::{CaseResult, Stop};
use crate::testee::TesteeTask;

/// One unit of data sent to the client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// Bytes of the control stream.
    Control(Vec<u8>),
    /// A datagram.
    State(Vec<u8>),
}

type TamperFn = Box<dyn FnMut(Delivery) -> Vec<Delivery>>;

/// A real server, the mirror, and the client under test.
pub struct Interceptor {
    /// The raw server that holds the connection with the client.
    pub raw_server: RawServer,
    /// The client's loss reports with the time of receipt.
    pub loss_reports: Vec<(Instant, LossReport)>,
    /// The client's reports.
    pub reported: Vec<Value>,
    pub(crate) server: Server,
    mirror: ClientSession,
    script: Box<dyn Script>,
    scripted: Tick,
    config: SceneConfig,
    tamper: TamperFn,
    stream_history: StreamHistory,
    events: Vec<Event>,
    /// Kinds of the most recently sent datagrams.
    sent: VecDeque<PacketKind>,
    /// Number of the newest packet of the mirror's stream, plus one.
    next: u64,
    /// Messages of the client.
    pub messages: Vec<ClientMessage>,
    frames: Frames,
}

/// The longest wait for the client's report of a tick before the next one is sent. The client may have lost data that
/// it needs, so the wait is bounded.
const LANES: Span = Span::from_millis(200);

const MIRROR: Peer = Peer(0);
const CLIENT: Peer = Peer(1);
const SERVER: Peer = Peer(0);

impl Interceptor {
    pub(crate) fn begin(
        raw_server: RawServer,
        scene: &str,
        setting: &Setting,
    ) -> Result<Self, Stop> {
        let errs = |what: &str| Stop::Inconclusive(format!("error of the suite: {what}"));
        let script = by_name(setting.script, setting.bodies, 1).ok_or_else(|| errs("no script"))?;
        let task = TesteeTask::read(&setting.task).ok_or_else(|| errs("no task"))?;
        let name = scene.parse().map_err(|_| errs("no name"))?;
        let config = SceneConfig {
            stepping: setting.stepping,
            publish_schedule: PublishSchedule {
                publish_interval: setting.publish_interval,
                ..PublishSchedule::EACH_TICK
            },
            ..script.config()
        };
        let mut interceptor = Self {
            raw_server,
            loss_reports: Vec::new(),
            reported: Vec::new(),
            server: Server::new(SceneSettings::new(|| Instant::ZERO)),
            mirror: ClientSession::new(name),
            script,
            scripted: Tick::ZERO,
            config,
            tamper: Box::new(|delivery| vec![delivery]),
            stream_history: StreamHistory::default(),
            events: Vec::new(),
            sent: VecDeque::new(),
            next: 0,
            messages: Vec::new(),
            frames: Frames::new(),
        };
        interceptor.server.handle_opened(interceptor.now(), MIRROR);
        interceptor.mirror.handle_opened(interceptor.now(), SERVER);
        interceptor.exchange()?;
        interceptor.task(|mirror, _| mirror.create(config))?;
        interceptor.task(|mirror, _| mirror.join(task.choice()))?;
        if setting.stepping == Stepping::Lockstep {
            for _ in 0..setting.before {
                interceptor.step_alone()?;
            }
        }
        interceptor.server.handle_opened(interceptor.now(), CLIENT);
        Ok(interceptor)
    }

    /// The current time of the server.
    fn now(&self) -> Instant {
        self.raw_server.now()
    }

    /// Replaces each delivery to the client by others from now on.
    pub fn tamper(&mut self, tamper: impl FnMut(Delivery) -> Vec<Delivery> + 'static) {
        self.tamper = Box::new(tamper);
    }

    /// Replaces each datagram to the client by others from now on.
    pub fn filter_datagrams(&mut self, mut filter: impl FnMut(Vec<u8>) -> Vec<Vec<u8>> + 'static) {
        self.tamper(move |delivery| match delivery {
            Delivery::State(bytes) => filter(bytes).into_iter().map(Delivery::State).collect(),
            control @ Delivery::Control(_) => vec![control],
        });
    }

    /// Delivers everything unchanged from now on.
    pub fn stop_tampering(&mut self) {
        self.tamper(|delivery| vec![delivery]);
    }

    /// Makes the server send data on the control stream, so that a tamper function that delays data releases it: the
    /// answers to many pings that the client did not send.
    ///
    /// # Errors
    ///
    /// As [`Self::step`].
    pub fn flush_control(&mut self) -> CaseResult {
        for sent in 0..400 {
            let mut bytes = Vec::new();
            let sent = Instant::from_nanos(sent);
            ClientMessage::Ping { sent }.encode(&mut bytes);
            self.speak_for_client(&bytes)?;
        }
        Ok(())
    }

    /// The replica of the undisturbed session.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when there is none.
    pub fn mirror(&self) -> Result<&Replica, Stop> {
        let none = || Stop::Inconclusive("the suite has no copy".into());
        self.mirror.replica().ok_or_else(none)
    }

    /// Calls the mirror's session.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when the session refuses the call.
    pub fn task<T, E: fmt::Display>(
        &mut self,
        task: impl FnOnce(&mut ClientSession, Instant) -> Result<T, E>,
    ) -> CaseResult {
        let now = self.now();
        let done = task(&mut self.mirror, now);
        done.map_err(|error| Stop::Inconclusive(format!("error of the suite: {error}")))?;
        self.exchange()
    }

    /// Sends a command as the mirror.
    ///
    /// # Errors
    ///
    /// As [`Self::task`].
    pub fn command(&mut self, command: Command) -> CaseResult {
        self.task(|mirror, _| mirror.command(command))
    }

    /// Sends bytes to the server in the name of the client.
    pub fn speak_for_client(&mut self, bytes: &[u8]) -> CaseResult {
        let now = self.now();
        self.server.handle_control(now, CLIENT, bytes);
        self.exchange()
    }

    /// Waits until the client has become a member.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not happen in time.
    pub fn enter(&mut self) -> CaseResult {
        let is = |reported: &Value| reported["is"] == "joined";
        self.until("copy of the client's", |interceptor| {
            interceptor.reported.iter().any(is)
        })
    }

    /// Sends the script's commands and steps to the next published tick, without the client.
    fn step_alone(&mut self) -> CaseResult {
        let mut commands = Vec::new();
        self.script.commands(self.scripted, &mut commands);
        self.scripted = self.scripted.next();
        if !commands.is_empty() {
            self.await_report()?;
        }
        for command in commands {
            self.command(command)?;
        }
        let publish_interval = Ticks::new(self.config.publish_schedule.publish_interval.get());
        let to = self.mirror()?.stream().watermark_tick() + publish_interval;
        self.task(|mirror, now| mirror.advance(now, to))?;
        if self.mirror()?.stream().complete() >= to {
            Ok(())
        } else {
            Err(Stop::Inconclusive(format!(
                "the server does not reach tick {to}"
            )))
        }
    }

    /// Waits for a bounded time until the client has reported the last tick. The lanes have no order between them. So
    /// scene events of the next tick may overtake the packets of this one, and the client would report a state that
    /// never existed.
    fn await_report(&mut self) -> CaseResult {
        let tick = self.mirror()?.stream().complete().value();
        let end = self.now() + LANES;
        let is_reported = |interceptor: &Self| {
            let last = interceptor
                .reported
                .iter()
                .rev()
                .find(|reported| reported["is"] == "tick");
            last.is_none_or(|reported| reported["tick"] == tick)
        };
        while !is_reported(self) && self.now() < end && self.raw_server.ended.is_none() {
            self.turn(end)?;
        }
        Ok(())
    }

    /// Steps this number of ticks, a few milliseconds apart.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when the client sends malformed bytes, or reports a wrong state.
    pub fn step(&mut self, ticks: u64) -> CaseResult {
        for _ in 0..ticks {
            self.step_alone()?;
            self.run(Duration::from_millis(2))?;
        }
        Ok(())
    }

    /// Steps this number of ticks with hardly any time between them.
    ///
    /// # Errors
    ///
    /// As [`Self::step`].
    pub fn step_fast(&mut self, ticks: u64) -> CaseResult {
        for _ in 0..ticks {
            self.step_alone()?;
        }
        self.run(Duration::from_millis(20))
    }

    /// Runs for this time.
    ///
    /// # Errors
    ///
    /// As [`Self::step`].
    pub fn run(&mut self, time: Duration) -> CaseResult {
        let end = self.raw_server.now() + span(time);
        while self.raw_server.now() < end && self.raw_server.ended.is_none() {
            self.turn(end)?;
        }
        Ok(())
    }

    /// Runs until a condition holds.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not hold in time.
    pub fn until(&mut self, what: &str, is: impl FnMut(&mut Self) -> bool) -> CaseResult {
        self.until_for(Duration::ZERO, what, is)
    }

    /// The same with an extended time limit.
    ///
    /// # Errors
    ///
    /// As [`Self::until`].
    pub fn until_for(
        &mut self,
        longer: Duration,
        what: &str,
        mut is: impl FnMut(&mut Self) -> bool,
    ) -> CaseResult {
        let end = self.raw_server.time_limit() + span(longer);
        while !is(self) {
            if self.raw_server.now() >= end || self.raw_server.ended.is_some() {
                self.raw_server.must_be_supported()?;
                return Stop::fail(format!("no {what}: {:?}", self.raw_server.ended));
            }
            let soon = self.raw_server.now() + Span::from_millis(5);
            self.turn(soon.min(end))?;
        }
        Ok(())
    }

    /// Subscribes the mirror to another stream, which the client is expected to choose too.
    pub fn change_mirror_to(&mut self, choice: StreamChoice) {
        self.stream_history.forget();
        // The mirror may already be changing its stream.
        let _ = self.task(|mirror, _| mirror.subscribe(choice));
    }

    /// The number of the stream's next packet.
    #[must_use]
    pub fn next_number(&self) -> u64 {
        self.next
    }

    /// Steps until the last sent datagram is a repair symbol, so that no later packet can be lost.
    ///
    /// # Errors
    ///
    /// As [`Self::step`].
    pub fn step_until_repair_symbol(&mut self, ticks: u64) -> CaseResult {
        self.step(ticks)?;
        for _ in 0..60 {
            if self.sent.back() == Some(&PacketKind::RepairSymbol) {
                break;
            }
            self.step(1)?;
        }
        Ok(())
    }

    /// Waits until the client's copy equals the mirror's: the same tick, checksum and motions, bit for bit.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when this does not happen in time, or when any report differed from the stream.
    pub fn must_follow(&mut self) -> CaseResult {
        let tick = self.mirror()?.stream().complete().value();
        let what = format!("copy at {tick} equal to the stream");
        self.until(&what, |interceptor| {
            interceptor
                .reported
                .iter()
                .rev()
                .any(|reported| reported["is"] == "tick" && reported["tick"] == tick)
        })?;
        self.judge()
    }

    /// Number of ticks that the client reported.
    #[must_use]
    pub fn ticks_reported(&self) -> usize {
        self.reported
            .iter()
            .filter(|reported| reported["is"] == "tick")
            .count()
    }

    /// Checks the client's reports against the stream.
    fn judge(&mut self) -> CaseResult {
        let choice = self.choice().ok();
        self.stream_history.judge(&self.reported, choice)
    }

    /// The mirror's events that were not taken yet.
    pub fn events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Processes at most one event of the client until a moment.
    fn turn(&mut self, until: Instant) -> CaseResult {
        let wakes = [self.server.poll_timeout(), self.mirror.poll_timeout()];
        let next = wakes.into_iter().flatten().map(|wake| wake.at).min();
        let soon = next.map_or(until, |next| {
            let wait = next.since(self.now());
            (self.raw_server.now() + wait).min(until)
        });
        self.raw_server.take_in(soon)?;
        while let Some(bytes) = self.raw_server.control_bytes.pop_front() {
            let now = self.now();
            self.server.handle_control(now, CLIENT, &bytes);
            self.frames.push(&bytes);
            while let Ok(Some(framed)) = self.frames.next_frame() {
                self.messages
                    .extend(ClientMessage::decode(&framed).ok().flatten());
            }
        }
        while let Some(bytes) = self.raw_server.datagrams.pop_front() {
            self.receive_datagram(&bytes);
        }
        if let Some(end) = &self.raw_server.ended {
            let ending = match end {
                RawPeerEnd::Closed(code) => {
                    Ending::Closed(u32::try_from(*code).unwrap_or(u32::MAX))
                }
                _ => Ending::Broken,
            };
            let now = self.now();
            self.server.handle_ended(now, CLIENT, ending);
        }
        let lines = self.raw_server.lines_written()?;
        self.reported.extend(lines);
        self.exchange()
    }

    fn receive_datagram(&mut self, bytes: &[u8]) {
        let mut reader = Reader::new(bytes);
        if let Ok(head) = Head::decode(&mut reader)
            && head.kind == PacketKind::LossReport
            && let Ok(loss_report) = LossReport::decode(reader)
        {
            self.loss_reports.push((self.raw_server.now(), loss_report));
        }
        let now = self.now();
        self.server.handle_datagram(now, CLIENT, bytes);
    }

    /// Exchanges data between server and mirror until both are idle; the client receives what the case lets through.
    fn exchange(&mut self) -> CaseResult {
        loop {
            let mut progress = false;
            while let Some(transmit) = self.mirror.poll_transmit() {
                progress = true;
                let now = self.now();
                match transmit {
                    Transmit::Control { bytes, .. } => {
                        self.server.handle_control(now, MIRROR, &bytes);
                    }
                    Transmit::State { bytes, .. } => {
                        self.server.handle_datagram(now, MIRROR, &bytes);
                    }
                    Transmit::Close { code, .. } => {
                        return Err(Stop::Inconclusive(format!("the suite closes with {code}")));
                    }
                }
            }
            while let Some(transmit) = self.server.poll_transmit() {
                progress = true;
                self.pass_on(transmit)?;
            }
            while let Some(event) = self.mirror.poll_event() {
                self.events.push(event);
            }
            if !progress && !self.wake() {
                return Ok(());
            }
        }
    }

    /// Fires the timeouts that are due; `false` when none is.
    fn wake(&mut self) -> bool {
        let now = self.now();
        let due =
            |endpoint: &dyn Endpoint| endpoint.poll_timeout().is_some_and(|wake| wake.at <= now);
        let (server, mirror) = (due(&self.server), due(&self.mirror));
        if server {
            self.server.handle_timeout(now);
        }
        if mirror {
            self.mirror.handle_timeout(now);
        }
        server || mirror
    }

    fn pass_on(&mut self, transmit: Transmit) -> CaseResult {
        let now = self.now();
        match transmit {
            Transmit::Control { to: MIRROR, bytes } => {
                self.mirror.handle_control(now, SERVER, &bytes);
                self.keep();
            }
            Transmit::State { to: MIRROR, bytes } => {
                if datagram::is_packet(&bytes) {
                    self.next += 1;
                }
                self.mirror.handle_datagram(now, SERVER, &bytes);
                self.keep();
            }
            Transmit::Control { bytes, .. } => self.send(Delivery::Control(bytes.to_vec())),
            Transmit::State { bytes, .. } => self.send(Delivery::State(bytes.to_vec())),
            Transmit::Close { to, code } => {
                if to == MIRROR {
                    return Err(Stop::Inconclusive(format!(
                        "the suite's server closes with {code}"
                    )));
                }
                return Stop::fail(format!("the server closes the client's connection: {code}"));
            }
        }
        Ok(())
    }

    fn send(&mut self, delivery: Delivery) {
        for delivery in (self.tamper)(delivery) {
            match delivery {
                Delivery::Control(bytes) => {
                    self.raw_server.note(format!("> {}", hex(&bytes)));
                    self.raw_server.connection.send_control(bytes);
                }
                Delivery::State(bytes) => {
                    self.sent.extend(datagram::kind(&bytes));
                    if self.sent.len() > 8 {
                        self.sent.pop_front();
                    }
                    self.raw_server.note(format!("> datagram {}", hex(&bytes)));
                    // A datagram that QUIC cannot send now is lost, which datagrams allow.
                    let _ = self.raw_server.connection.send_datagram(bytes);
                }
            }
        }
    }

    fn keep(&mut self) {
        if let Some(copy) = self.mirror.replica() {
            self.stream_history.keep(copy);
        }
    }

    /// The configuration of the scene.
    #[must_use]
    pub const fn config(&self) -> SceneConfig {
        self.config
    }

    /// The choice of the followed stream.
    ///
    /// # Errors
    ///
    /// As [`Self::mirror`].
    pub fn choice(&self) -> Result<StreamChoice, Stop> {
        self.mirror().map(Replica::choice)
    }
}

impl fmt::Debug for Interceptor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Interceptor")
            .field("raw_server", &self.raw_server)
            .finish_non_exhaustive()
    }
}

fn span(time: Duration) -> Span {
    Span::from_nanos(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX))
}
