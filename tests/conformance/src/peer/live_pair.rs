//! A client under test in a scene of a server under test.
//!
//! A session of this project leads the scene and subscribes to the same stream as the client. The copy of the client
//! must equal the copy of this leader, bit for bit.

use std::time::Duration;

use rhumb_netsim::UdpRelay;
use rhumb_protocol::Span;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{SceneConfig, Stepping};
use rhumb_reckoning::Tick;
use rhumb_sims::{Script, by_name};
use rhumb_transport::Trust;
use serde_json::Value;

use super::client_process::{ClientEnvironment, ClientProcess, reported};
use super::lossy_client::LossyClient;
use super::setting::Setting;
use super::stream_history::StreamHistory;
use crate::conditions::Subject;
use crate::outcome::{CaseResult, Stop};
use crate::testee::TesteeTask;
use crate::trial::Trial;

/// The leading session, and the client under test.
pub struct LivePair {
    /// The client's reports.
    pub reported: Vec<Value>,
    leader: LossyClient,
    client: ClientProcess,
    script: Box<dyn Script>,
    scripted: Tick,
    choice: StreamChoice,
    stream_history: StreamHistory,
    timeout: Duration,
    /// Kept alive for its thread.
    _relay: Option<UdpRelay>,
}

impl LivePair {
    /// Advances the scene to the tick of the setting, and waits until the client has joined.
    pub(crate) fn begin(
        trial: &mut Trial<'_>,
        setting: &Setting,
        choice: Option<StreamChoice>,
    ) -> Result<Self, Stop> {
        let errs = |what: &str| Stop::Inconclusive(format!("error of the suite: {what}"));
        let task = TesteeTask::read(&setting.task).ok_or_else(|| errs("no task"))?;
        let script = by_name(setting.script, setting.bodies, 1).ok_or_else(|| errs("no script"))?;
        let choice = choice.unwrap_or_else(|| task.choice());
        let mut leader = trial.subscriber()?;
        leader.create(SceneConfig {
            stepping: Stepping::Lockstep,
            ..script.config()
        })?;
        leader.join(choice)?;
        let (server, relay) = trial.behind_the_link()?;
        let Subject::Pair { trust, exec, .. } = &trial.conditions.subject else {
            return Err(errs("no pair"));
        };
        let Trust::Fingerprint(fingerprint) = *trust else {
            return Err(errs("no fingerprint"));
        };
        let environment = ClientEnvironment {
            server,
            fingerprint,
            scene: leader.scene.to_string(),
            task: &setting.task,
            case: trial.id(),
            seed: trial.conditions.seed,
            token: trial.conditions.token.as_ref(),
        };
        let cannot = |error: std::io::Error| Stop::Inconclusive(error.to_string());
        let mut pair = Self {
            reported: Vec::new(),
            client: ClientProcess::start(exec, &environment, trial.log()).map_err(cannot)?,
            leader,
            script,
            scripted: Tick::ZERO,
            choice,
            stream_history: StreamHistory::default(),
            timeout: trial.timeout(),
            _relay: relay,
        };
        for _ in 0..setting.before {
            pair.step()?;
        }
        pair.until("copy of the client's", |pair| pair.has_reported("joined"))?;
        Ok(pair)
    }

    /// True if the client wrote a report of this kind.
    #[must_use]
    pub fn has_reported(&self, is: &str) -> bool {
        self.reported.iter().any(|reported| reported["is"] == is)
    }

    /// The newest tick in the client's reports.
    #[must_use]
    pub fn newest(&self) -> u64 {
        let ticks = self
            .reported
            .iter()
            .filter_map(|reported| reported["tick"].as_u64());
        ticks.max().unwrap_or_default()
    }

    /// The complete tick of the leader's copy.
    fn complete(&self) -> Result<u64, Stop> {
        let copy = self.leader.replica()?;
        Ok(copy.stream().complete().value())
    }

    /// Sends the script's commands and advances the scene by one tick.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when the tick does not come.
    pub fn step(&mut self) -> CaseResult {
        self.command()?;
        let to = self.leader.replica()?.stream().watermark_tick().next();
        self.leader.ask_for(to)?;
        let stream_history = &mut self.stream_history;
        self.leader.turn_until("requested tick", |leader| {
            let Some(copy) = leader.copy() else {
                return false;
            };
            stream_history.keep_in_lockstep(copy);
            copy.stream().complete() >= to
        })?;
        self.read_reports()
    }

    /// Sends the script's commands of the next tick, without advancing the scene.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when the leader is not a member.
    pub fn command(&mut self) -> CaseResult {
        let mut commands = Vec::new();
        self.script.commands(self.scripted, &mut commands);
        self.scripted = self.scripted.next();
        for command in commands {
            self.leader.task(|session| session.command(command))?;
        }
        Ok(())
    }

    /// Runs until a condition holds.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not hold in time; [`Stop::Unsupported`] when the client declares the task
    /// unsupported.
    pub fn until(&mut self, what: &str, is: impl Fn(&Self) -> bool) -> CaseResult {
        // The limit is five times the normal one: the client's process must start, and may wait for timers of its own.
        let nanos = u64::try_from(self.timeout.as_nanos() * 5).unwrap_or(u64::MAX);
        let clock = rhumb_transport::Clock::start();
        let end = clock.now() + Span::from_nanos(nanos);
        while !is(self) {
            if let Some(stop) = self.client.gave_up() {
                return Err(stop);
            }
            if clock.now() >= end || self.client.has_ended() {
                return Stop::fail(format!("no {what}"));
            }
            let stream_history = &mut self.stream_history;
            let look = |copy: &_| stream_history.keep_in_lockstep(copy);
            self.leader
                .turn_for_and_look(Duration::from_millis(5), look);
            self.read_reports()?;
        }
        Ok(())
    }

    fn read_reports(&mut self) -> CaseResult {
        for line in self.client.lines.try_iter() {
            self.reported.push(reported(&line)?);
        }
        Ok(())
    }

    /// Skips the check of all reports so far: they belong to another stream than the leader's.
    pub fn pass_over(&mut self) {
        self.stream_history.pass_over(&self.reported);
    }

    /// Waits until the client reaches the leader's tick, and checks all its reports.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] otherwise.
    pub fn must_follow(&mut self) -> CaseResult {
        let tick = self.complete()?;
        let what = format!("copy of the client's at {tick}");
        self.until(&what, |pair| pair.newest() >= tick)?;
        // A client that advances the scene itself may report a tick that the leader has not received yet.
        let newest = self.newest();
        let what = format!("tick {newest} that the client reports");
        self.until(&what, |pair| {
            pair.complete().is_ok_and(|complete| complete >= newest)
        })?;
        self.stream_history.judge(&self.reported, Some(self.choice))
    }
}

impl std::fmt::Debug for LivePair {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LivePair")
            .field("leader", &self.leader)
            .finish_non_exhaustive()
    }
}
