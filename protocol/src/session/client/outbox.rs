//! The outbox of a client: messages in order, commands that are kept, pings.
//!
//! Invariant: a control message leaves before everything that was sent after it. Commands and advances are kept in the
//! order of sending, until the server has what the scene promises: a scene with a command log has them when they are
//! durable, another one when they are done. Invariant: no command is dropped that the server may ask for again.
//!
//! Pings sample the clock of a scene. Only a free-running scene has a clock; in lockstep its members set the time.
//! Reads no clock itself. Two clocks drift apart slowly, so pings are rare. The stream also shows the server's time;
//! the next ping comes sooner only if that time contradicts the last sample.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;
use rhumb_reckoning::{Rate, Tick, Ticks};

use crate::endpoint::{Instant, Peer, Span, Transmit, Wake, WakeReason};
use crate::message::{ClientMessage, SessionKey, SessionRequest, SessionState, StreamChoice};
use crate::scene::{Command, SceneConfig, Stepping};
use crate::session::{CloseCode, Event};

/// The output of one connection.
#[derive(Debug)]
pub(super) struct ClientOutbox {
    peer: Peer,
    /// Control bytes that are not in `out` yet.
    unsent: Vec<u8>,
    out: VecDeque<Transmit>,
}

impl ClientOutbox {
    pub(super) const fn new() -> Self {
        Self {
            peer: Peer(0),
            unsent: Vec::new(),
            out: VecDeque::new(),
        }
    }

    /// Names the server.
    pub(super) const fn open(&mut self, peer: Peer) {
        self.peer = peer;
    }

    /// Sends a message.
    pub(super) fn send(&mut self, message: &ClientMessage) {
        message.encode(&mut self.unsent);
    }

    /// Sends framed bytes that are no message of this version.
    pub(super) fn send_framed(&mut self, encode: impl FnOnce(&mut Vec<u8>)) {
        encode(&mut self.unsent);
    }

    /// Sends datagrams.
    pub(super) fn send_states(&mut self, datagrams: Vec<Bytes>) {
        let to = self.peer;
        let states = datagrams.into_iter();
        self.out
            .extend(states.map(|bytes| Transmit::State { to, bytes }));
    }

    /// Sends packets of an upstream: as datagrams, or in lockstep before the advance that needs them.
    pub(super) fn send_upstream(&mut self, stepping: Stepping, packets: Vec<Bytes>) {
        match stepping {
            Stepping::FreeRunning => self.send_states(packets),
            Stepping::Lockstep => {
                for packet in packets {
                    self.send(&ClientMessage::Upstream(packet.to_vec()));
                }
            }
        }
    }

    /// Closes the connection after everything sent so far.
    pub(super) fn close(&mut self, code: CloseCode) {
        self.flush();
        self.out.push_back(Transmit::Close {
            to: self.peer,
            code: code.0,
        });
    }

    /// The next output, oldest first.
    pub(super) fn poll(&mut self) -> Option<Transmit> {
        if self.out.is_empty() {
            self.flush();
        }
        self.out.pop_front()
    }

    fn flush(&mut self) {
        if !self.unsent.is_empty() {
            let bytes = Bytes::from(core::mem::take(&mut self.unsent));
            self.out.push_back(Transmit::Control {
                to: self.peer,
                bytes,
            });
        }
    }
}

/// The session, and what is not finished of it.
#[derive(Debug, Default)]
pub(super) struct Resumption {
    key: Option<SessionKey>,
    /// True if the scene has a command log.
    durable: bool,
    /// The number of commands of the membership.
    commands: u64,
    /// Commands known to be done.
    answered: u64,
    unfinished: VecDeque<Unfinished>,
    /// The stream to join again, between two connections.
    rejoin: Option<StreamChoice>,
    /// The state from which the session resumes, until the snapshot is complete.
    state: Option<SessionState>,
}

/// A message that may have to be sent again.
#[derive(Debug)]
enum Unfinished {
    Command(u64, Command),
    Advance(Tick),
}

impl Resumption {
    /// Begins a session with the next join; returns the request for it.
    pub(super) fn begin(&mut self, key: SessionKey) -> SessionRequest {
        self.end();
        self.key = Some(key);
        SessionRequest { key, answered: 0 }
    }

    /// Ends the session. Commands are numbered on until the next membership begins.
    pub(super) fn end(&mut self) {
        *self = Self {
            commands: self.commands,
            ..Self::default()
        };
    }

    /// Begins a membership without earlier commands.
    pub(super) const fn begin_membership(&mut self) {
        self.commands = 0;
    }

    /// True if the session's scene survives its server.
    pub(super) const fn is_durable(&self) -> bool {
        self.key.is_some() && self.durable
    }

    /// True if another connection could resume the session.
    pub(super) const fn can_reconnect(&self) -> bool {
        self.key.is_some() && self.rejoin.is_some()
    }

    /// The number of commands that may have to be sent again.
    pub(super) fn unfinished_commands(&self) -> usize {
        let unfinished = self.unfinished.iter();
        let commands = unfinished.filter(|message| matches!(message, Unfinished::Command(..)));
        commands.count()
    }

    /// The stream that a later connection joins.
    pub(super) const fn note_choice(&mut self, choice: StreamChoice) {
        self.rejoin = Some(choice);
    }

    /// Counts a command and returns its number.
    pub(super) fn note_command(&mut self, command: &Command) -> u64 {
        let number = self.commands;
        self.commands += 1;
        if self.key.is_some() {
            let command = command.clone();
            self.unfinished
                .push_back(Unfinished::Command(number, command));
        }
        number
    }

    pub(super) fn note_advance(&mut self, to: Tick) {
        if self.key.is_none() {
            return;
        }
        // Without a command between them, the later of two advances is enough.
        match self.unfinished.back_mut() {
            Some(Unfinished::Advance(last)) => *last = (*last).max(to),
            _ => self.unfinished.push_back(Unfinished::Advance(to)),
        }
    }

    /// Notes that all commands up to this number are done, and that the scene is at this tick.
    pub(super) fn note_applied(&mut self, through: u64, tick: Tick) {
        self.answered = self.answered.max(through + 1);
        if !self.durable {
            self.finish(through + 1, tick);
        }
    }

    /// Notes that the server keeps this number of commands, and the scene up to this tick.
    pub(super) fn finish(&mut self, commands: u64, tick: Tick) {
        self.unfinished.drain(..self.done(commands, tick));
    }

    /// Takes the session up after the welcome of another connection.
    pub(super) fn rejoin(&self, outbox: &mut ClientOutbox) {
        if let (Some(key), Some(choice)) = (self.key, self.rejoin) {
            let answered = self.answered;
            outbox.send(&ClientMessage::Session(SessionRequest { key, answered }));
            outbox.send(&ClientMessage::Join(choice));
        }
    }

    /// Takes the state from which the session resumes. A server that does not know it has lost commands; the session
    /// then ends, and so does the connection.
    pub(super) fn handle_state(
        &mut self,
        state: SessionState,
        events: &mut VecDeque<Event>,
    ) -> Result<(), CloseCode> {
        if self.key.is_none() {
            return Err(CloseCode::VIOLATION);
        }
        let is_new = self.rejoin.is_none();
        if is_new && state.commands == 0 {
            self.durable = state.durable;
            return Ok(());
        }
        if !state.resumed || !self.has_from(state.commands) {
            self.end();
            events.push_back(Event::SessionLost(state));
            return Err(CloseCode::DONE);
        }
        self.durable = state.durable;
        if !state.durable {
            self.finish(state.commands, state.tick);
        }
        self.state = Some(state);
        Ok(())
    }

    /// Sends again what was not done, after the snapshot of a resumed session; `None` for another one. Returns where
    /// the session resumes, and the last tick that was requested again.
    pub(super) fn resume(&mut self, outbox: &mut ClientOutbox) -> Option<(SessionState, Tick)> {
        let state = self.state.take()?;
        // Commands that are done but not yet durable are kept: the server may ask for them if it fails again.
        let done = self.done(state.commands, state.tick);
        let mut awaited = Tick::ZERO;
        for message in self.unfinished.iter().skip(done) {
            match message {
                Unfinished::Command(_, command) => {
                    outbox.send(&ClientMessage::Command(command.clone()));
                }
                Unfinished::Advance(to) => {
                    awaited = awaited.max(*to);
                    outbox.send(&ClientMessage::Advance { to: *to });
                }
            }
        }
        Some((state, awaited))
    }

    /// The number of the oldest unfinished messages that are done, once this number of commands is done and the scene
    /// is at this tick. A command is done after everything before it.
    fn done(&self, commands: u64, tick: Tick) -> usize {
        let (mut through, mut reached) = (0, true);
        // From the front, which is what is done: many more may be unfinished.
        for (place, message) in self.unfinished.iter().enumerate() {
            match message {
                Unfinished::Command(number, _) if *number >= commands => break,
                Unfinished::Command(..) => (through, reached) = (place + 1, true),
                Unfinished::Advance(to) if reached && *to <= tick => through = place + 1,
                Unfinished::Advance(_) => reached = false,
            }
        }
        through
    }

    /// True if the first unfinished command is the one that the server wants next.
    fn has_from(&self, commands: u64) -> bool {
        let mut unfinished = self.unfinished.iter();
        let first = unfinished.find_map(|message| match message {
            Unfinished::Command(number, _) => Some(*number),
            Unfinished::Advance(_) => None,
        });
        first.unwrap_or(self.commands) <= commands && commands <= self.commands
    }
}

/// The round trip and the schedule of pings.
#[derive(Debug)]
pub(super) struct ClockSampler {
    pings: Pings,
    round_trip: Span,
}

impl ClockSampler {
    /// A schedule with no ping due, and the round trip that counts until one is measured.
    pub(super) const fn new(round_trip: Span) -> Self {
        Self {
            pings: Pings::new(),
            round_trip,
        }
    }

    /// Begins the schedule of a membership. The caller sends the first ping now.
    pub(super) fn begin(&mut self, now: Instant) {
        self.pings.begin(now);
    }

    /// Ends the schedule together with the membership.
    pub(super) fn end(&mut self) {
        self.pings.end();
    }

    /// True if a ping is due, which the caller then sends.
    pub(super) fn take_due(&mut self, now: Instant, config: Option<&SceneConfig>) -> bool {
        let is_due = self.due(config).is_some_and(|due| due.at <= now);
        if is_due {
            self.pings.note_sent(now);
        }
        is_due
    }

    /// Takes in the answer to the ping of `sent`: the newest tick, and the time since it. Measures the round trip, and
    /// for a member the clock of its scene. Before the client joined, the scene may not have existed; its clock then
    /// has no meaning.
    ///
    /// `scene`: the config of a member's scene.
    pub(super) fn handle_pong(
        &mut self,
        now: Instant,
        sent: Instant,
        (tick, since_tick): (Tick, Span),
        scene: Option<&SceneConfig>,
    ) -> Option<Event> {
        if sent > now {
            return None;
        }
        let round_trip = now.since(sent);
        self.round_trip = round_trip;
        let scene = scene?;
        let at = sent + Span::from_nanos(round_trip.as_nanos() / 2);
        if let Some(rate) = free_rate(Some(scene)) {
            self.pings
                .note_sample(at, tick, since_tick, round_trip, rate);
        }
        Some(Event::ClockSeen {
            at,
            tick,
            since_tick,
            round_trip,
        })
    }

    /// Notes that the stream has just reached a tick.
    pub(super) fn note_shown(&mut self, now: Instant, tick: Tick, config: Option<&SceneConfig>) {
        if let (Some(rate), Some(config)) = (free_rate(config), config) {
            let reached = tick + config.publish_schedule.lookahead;
            let slack = Ticks::new(config.publish_schedule.publish_interval.get());
            self.pings.shown(now, reached, slack, rate);
        }
    }

    /// The next ping. None in a lockstep scene, whose members set the time.
    pub(super) fn due(&self, config: Option<&SceneConfig>) -> Option<Wake> {
        let at = free_rate(config).and(self.pings.due())?;
        let reason = WakeReason::Ping;
        Some(Wake { at, reason })
    }

    /// The latest measured round trip.
    pub(super) const fn round_trip(&self) -> Span {
        self.round_trip
    }
}

/// The tick rate of a free-running scene; None in a lockstep scene.
fn free_rate(config: Option<&SceneConfig>) -> Option<Rate> {
    let config = config.filter(|config| config.stepping == Stepping::FreeRunning);
    config.map(|config| config.integrator.rate)
}

/// A new member pings a few times in quick succession, so that one outlier does no harm.
const FIRST_PINGS: u32 = 5;
/// The pause between two of the first pings.
const FIRST_PAUSE: Span = Span::from_millis(50);
/// The pause between two pings while clock and stream agree. Clocks that differ by 100 ppm drift apart by 6 ms
/// meanwhile.
const PAUSE: Span = Span::from_millis(60_000);
/// The pause between two pings while the stream's time contradicts the last sample.
const PAUSE_WHILE_OFF: Span = Span::from_millis(1_000);
/// The allowed difference, seconds, between the stream's time and the sample: reordering, jitter, publication delay.
const SLACK_SECONDS: f64 = 0.1;

/// The ping schedule of one membership in a free-running scene.
#[derive(Clone, Debug)]
struct Pings {
    due: Option<Instant>,
    left: u32,
    last_sent: Instant,
    sample: Option<ClockSample>,
}

/// The latest sample of the server's clock.
#[derive(Clone, Copy, Debug)]
struct ClockSample {
    at: Instant,
    ticks: f64,
    /// The one-way delay that the sample includes.
    one_way: Span,
}

impl Pings {
    /// A schedule with no ping due.
    const fn new() -> Self {
        Self {
            due: None,
            left: 0,
            last_sent: Instant::ZERO,
            sample: None,
        }
    }

    /// The time of the next ping; None outside a membership.
    const fn due(&self) -> Option<Instant> {
        self.due
    }

    /// Starts the schedule of a membership. The caller sends the first ping now.
    fn begin(&mut self, now: Instant) {
        self.left = FIRST_PINGS;
        self.sample = None;
        self.note_sent(now);
    }

    /// Ends the schedule together with the membership.
    fn end(&mut self) {
        *self = Self::new();
    }

    /// Notes that a ping was sent.
    fn note_sent(&mut self, now: Instant) {
        self.last_sent = now;
        self.left = self.left.saturating_sub(1);
        let pause = if self.left > 0 { FIRST_PAUSE } else { PAUSE };
        self.due = Some(now + pause);
    }

    /// Takes a sample: at `at`, the server had reached its newest tick `since_tick` before.
    fn note_sample(
        &mut self,
        at: Instant,
        tick: Tick,
        since_tick: Span,
        round_trip: Span,
        rate: Rate,
    ) {
        let step = rate.step().seconds();
        let sample = ClockSample {
            at,
            ticks: tick.value() as f64 + since_tick.as_nanos() as f64 / 1e9 / step,
            one_way: Span::from_nanos(round_trip.as_nanos() / 2),
        };
        let is_off = |last: ClockSample| {
            let passed = at.as_nanos() as f64 - last.at.as_nanos() as f64;
            let expected = last.ticks + passed / 1e9 / step;
            (expected - sample.ticks).abs() * step > SLACK_SECONDS
        };
        // The answer may have waited for a member that polled late: others tell whether the clock itself has slipped.
        if self.sample.is_some_and(is_off) {
            self.left = FIRST_PINGS;
            let soon = self.last_sent + FIRST_PAUSE;
            self.due = Some(self.due.map_or(soon, |due| due.min(soon)));
        }
        self.sample = Some(sample);
    }

    /// Notes that the stream shows a tick, reached now or at most `slack` ticks before.
    fn shown(&mut self, now: Instant, tick: Tick, slack: Ticks, rate: Rate) {
        let Some(sample) = self.sample else {
            return;
        };
        let passed = now.since(sample.at).as_nanos() as f64 - sample.one_way.as_nanos() as f64;
        let step = rate.step().seconds();
        let expected = sample.ticks + passed / 1e9 / step;
        let off = (expected - tick.value() as f64).abs() * step;
        if off > SLACK_SECONDS + f64::from(slack.count()) * step {
            let soon = (self.last_sent + PAUSE_WHILE_OFF).max(now);
            self.due = Some(self.due.map_or(soon, |due| due.min(soon)));
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    #[test]
    fn control_messages_leave_together_and_before_a_close() {
        let mut outbox = ClientOutbox::new();
        let to = Peer(7);
        outbox.open(to);
        outbox.send(&ClientMessage::Leave);
        outbox.send(&ClientMessage::Delete);
        outbox.close(CloseCode::DONE);
        let mut expected = Vec::new();
        ClientMessage::Leave.encode(&mut expected);
        ClientMessage::Delete.encode(&mut expected);
        let bytes = Bytes::from(expected);
        assert_eq!(outbox.poll(), Some(Transmit::Control { to, bytes }));
        let code = CloseCode::DONE.0;
        assert_eq!(outbox.poll(), Some(Transmit::Close { to, code }));
        assert_eq!(outbox.poll(), None);
    }

    #[test]
    fn an_upstream_goes_on_the_control_stream_in_lockstep_only() {
        for (stepping, is_control) in [(Stepping::Lockstep, true), (Stepping::FreeRunning, false)] {
            let mut outbox = ClientOutbox::new();
            outbox.send_upstream(stepping, alloc::vec![Bytes::from_static(&[1, 2])]);
            let sent = outbox.poll();
            assert_eq!(matches!(sent, Some(Transmit::Control { .. })), is_control);
            assert_eq!(matches!(sent, Some(Transmit::State { .. })), !is_control);
        }
    }

    fn resumption(durable: bool) -> Resumption {
        let mut resumption = Resumption {
            key: Some(SessionKey([1; 16])),
            durable,
            ..Resumption::default()
        };
        let gravity = Command::SetGravity { gravity: Vec3::X };
        for (number, advance) in [(0, 1), (1, 2), (2, 3)] {
            assert_eq!(resumption.note_command(&gravity), number);
            resumption.note_advance(Tick::new(advance));
        }
        resumption
    }

    #[test]
    fn a_command_is_kept_until_it_is_done_or_durable() {
        let mut plain = resumption(false);
        plain.note_applied(1, Tick::new(2));
        assert!(plain.has_from(2) && !plain.has_from(1));
        let mut durable = resumption(true);
        durable.note_applied(1, Tick::new(2));
        assert!(durable.has_from(0));
        durable.finish(2, Tick::new(2));
        assert!(durable.has_from(2) && !durable.has_from(1));
    }

    #[test]
    fn what_is_done_lies_before_the_first_command_that_the_server_wants() {
        let resumption = resumption(true);
        assert_eq!(resumption.done(0, Tick::ZERO), 0);
        assert_eq!(resumption.done(1, Tick::ZERO), 1);
        assert_eq!(resumption.done(1, Tick::new(1)), 2);
        assert_eq!(resumption.done(3, Tick::new(2)), 5);
        assert_eq!(resumption.done(3, Tick::new(3)), 6);
    }

    #[test]
    fn advances_without_a_command_between_them_are_one() {
        let mut resumption = resumption(true);
        for tick in 4..100 {
            resumption.note_advance(Tick::new(tick));
        }
        assert_eq!(resumption.unfinished.len(), 6);
    }

    #[test]
    fn a_server_that_is_ahead_of_the_client_has_another_session() {
        assert!(resumption(true).has_from(3));
        assert!(!resumption(true).has_from(4));
    }

    #[test]
    fn a_resumed_session_sends_again_what_was_not_done() {
        let mut resumption = resumption(false);
        let choice = StreamChoice::Full;
        resumption.note_choice(choice);
        assert!(resumption.can_reconnect());
        let state = SessionState {
            resumed: true,
            durable: false,
            commands: 2,
            tick: Tick::new(1),
        };
        let mut events = VecDeque::new();
        assert_eq!(resumption.handle_state(state, &mut events), Ok(()));
        assert_eq!(resumption.unfinished_commands(), 1);
        let mut outbox = ClientOutbox::new();
        let resumed = resumption.resume(&mut outbox);
        assert_eq!(resumed, Some((state, Tick::new(3))));
        assert!(outbox.poll().is_some());
        assert_eq!(resumption.resume(&mut outbox), None);
    }

    #[test]
    fn a_session_that_the_server_does_not_know_ends() {
        let mut resumption = resumption(true);
        resumption.note_choice(StreamChoice::Full);
        let state = SessionState {
            resumed: false,
            durable: true,
            commands: 0,
            tick: Tick::ZERO,
        };
        let mut events = VecDeque::new();
        let lost = resumption.handle_state(state, &mut events);
        assert_eq!((lost, events.len()), (Err(CloseCode::DONE), 1));
        assert!(!resumption.can_reconnect());
        assert_eq!(
            resumption.note_command(&Command::SetGravity { gravity: Vec3::X }),
            3
        );
    }

    fn at(ms: u64) -> Instant {
        Instant::ZERO + Span::from_millis(ms)
    }

    fn scene(stepping: Stepping) -> SceneConfig {
        SceneConfig {
            stepping,
            ..SceneConfig::default()
        }
    }

    #[test]
    fn an_answer_measures_the_round_trip_and_for_a_member_the_clock_halfway() {
        let mut clock = ClockSampler::new(Span::from_millis(20));
        let (sent, tick, since_tick) = (at(100), Tick::new(5), Span::from_millis(3));
        let handle = |clock: &mut ClockSampler, now, scene| {
            clock.handle_pong(now, sent, (tick, since_tick), scene)
        };
        assert_eq!(handle(&mut clock, at(130), None), None);
        assert_eq!(clock.round_trip(), Span::from_millis(30));
        let scene = scene(Stepping::FreeRunning);
        let seen = handle(&mut clock, at(140), Some(&scene));
        let expected = Event::ClockSeen {
            at: at(120),
            tick,
            since_tick,
            round_trip: Span::from_millis(40),
        };
        assert_eq!(seen, Some(expected));
        // An answer from before the ping counts for nothing.
        assert_eq!(handle(&mut clock, at(99), Some(&scene)), None);
        assert_eq!(clock.round_trip(), Span::from_millis(40));
    }

    #[test]
    fn a_ping_is_due_only_in_a_free_running_scene() {
        for (stepping, pings) in [(Stepping::Lockstep, false), (Stepping::FreeRunning, true)] {
            let (mut clock, scene) = (ClockSampler::new(Span::ZERO), scene(stepping));
            clock.begin(at(0));
            assert_eq!(clock.due(Some(&scene)).is_some(), pings);
            assert_eq!(clock.take_due(at(10_000), Some(&scene)), pings);
            assert!(!clock.take_due(at(10_000), Some(&scene)));
            clock.end();
            assert_eq!(clock.due(Some(&scene)), None);
        }
    }

    const ONE: Ticks = Ticks::new(1);

    fn seconds(count: u64) -> Instant {
        Instant::from_nanos(count * 1_000_000_000)
    }

    fn converged() -> Pings {
        let mut pings = Pings::new();
        pings.begin(Instant::ZERO);
        for ping in 1..FIRST_PINGS {
            let due = pings.due().unwrap();
            assert_eq!(due, Instant::ZERO + Span::from_millis(u64::from(ping) * 50));
            pings.note_sent(due);
        }
        let (one_way, none) = (Span::from_millis(20), Span::ZERO);
        pings.note_sample(seconds(1), Tick::new(60), none, one_way, Rate::HZ_60);
        pings
    }

    #[test]
    fn a_steady_clock_is_pinged_rarely() {
        let mut pings = converged();
        let due = pings.due().unwrap();
        for second in 2..60 {
            pings.shown(seconds(second), Tick::new(60 * second), ONE, Rate::HZ_60);
        }
        assert_eq!(pings.due(), Some(due));
        assert!(due > seconds(60));
    }

    #[test]
    fn a_sample_that_contradicts_the_last_one_is_followed_by_others_at_once() {
        let mut pings = converged();
        pings.note_sent(seconds(10));
        let answer = |pings: &mut Pings, at, tick, round_trip| {
            pings.note_sample(at, Tick::new(tick), Span::ZERO, round_trip, Rate::HZ_60);
        };
        // 9 s after tick 60 the server is at tick 570 only, or the answer waited.
        answer(&mut pings, seconds(10), 570, Span::from_millis(900));
        for ping in 1..=FIRST_PINGS {
            let due = seconds(10) + Span::from_millis(u64::from(ping) * 50);
            assert_eq!(pings.due(), Some(due));
            pings.note_sent(due);
            answer(
                &mut pings,
                due,
                570 + 3 * u64::from(ping),
                Span::from_millis(1),
            );
        }
        assert!(pings.due() > Some(seconds(60)));
    }

    #[test]
    fn a_slowed_clock_is_pinged_again() {
        let mut pings = converged();
        pings.shown(seconds(10), Tick::new(570), ONE, Rate::HZ_60);
        assert_eq!(pings.due(), Some(seconds(10)));
        pings.note_sent(seconds(10));
        pings.shown(seconds(10), Tick::new(570), ONE, Rate::HZ_60);
        assert_eq!(pings.due(), Some(seconds(11)));
    }
}
