//! A client under test in a scene of a server under test.
//!
//! A session of this house leads the scene and is a member of the stream that the client follows: what it holds of it is
//! what the client must hold, bit for bit.

use std::time::Duration;

use rhumb_protocol::Span;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{SceneConfig, Stepping};
use rhumb_reckoning::Tick;
use rhumb_sims::{Script, by_name};
use rhumb_transport::{Trust, UdpRelay};
use serde_json::Value;

use super::client_process::{ClientOrders, ClientProcess, reported};
use super::lossy_client::LossyClient;
use super::setting::Setting;
use super::stream_history::StreamHistory;
use crate::conformance::outcome::{CaseResult, Stop};
use crate::conformance::trial::{Subject, Trial};
use crate::testee::TesteeTask;

/// A leader, and the client under test.
pub struct LivePair {
    /// What the client reported.
    pub reported: Vec<Value>,
    leader: LossyClient,
    client: ClientProcess,
    script: Box<dyn Script>,
    scripted: Tick,
    choice: StreamChoice,
    stream_history: StreamHistory,
    timeout: Duration,
    /// Kept for its thread.
    _relay: Option<UdpRelay>,
}

impl LivePair {
    /// The scene stands at the setting's tick, and the client has joined it.
    pub(in crate::conformance) fn begin(
        trial: &mut Trial<'_>,
        setting: &Setting,
        choice: Option<StreamChoice>,
    ) -> Result<Self, Stop> {
        let errs = |what: &str| Stop::Inconclusive(format!("the suite errs: {what}"));
        let task = TesteeTask::read(&setting.task).ok_or_else(|| errs("no task"))?;
        let script = by_name(setting.script, setting.bodies, 1).ok_or_else(|| errs("no script"))?;
        let choice = choice.unwrap_or_else(|| task.choice());
        let mut leader = trial.follower()?;
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
        let orders = ClientOrders {
            server,
            fingerprint,
            scene: leader.scene.to_string(),
            task: &setting.task,
            case: trial.id(),
            seed: trial.conditions.seed,
        };
        let cannot = |error: std::io::Error| Stop::Inconclusive(error.to_string());
        let mut couple = Self {
            reported: Vec::new(),
            client: ClientProcess::start(exec, &orders, trial.log()).map_err(cannot)?,
            leader,
            script,
            scripted: Tick::ZERO,
            choice,
            stream_history: StreamHistory::default(),
            timeout: trial.timeout(),
            _relay: relay,
        };
        for _ in 0..setting.before {
            couple.step()?;
        }
        couple.until("copy of the client's", |couple| couple.has_told("joined"))?;
        Ok(couple)
    }

    /// Whether the client reported so.
    #[must_use]
    pub fn has_told(&self, is: &str) -> bool {
        self.reported.iter().any(|reported| reported["is"] == is)
    }

    /// The newest tick that the client reported of.
    #[must_use]
    pub fn newest(&self) -> u64 {
        let ticks = self
            .reported
            .iter()
            .filter_map(|reported| reported["tick"].as_u64());
        ticks.max().unwrap_or_default()
    }

    /// The tick for which the leader's copy is complete.
    fn complete(&self) -> Result<u64, Stop> {
        let copy = self.leader.replica()?;
        Ok(copy.stream().complete().value())
    }

    /// The script's commands and the next tick.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not come.
    pub fn step(&mut self) -> CaseResult {
        self.command()?;
        let to = self.leader.replica()?.stream().watermark_tick().next();
        self.leader.ask_for(to)?;
        let stream_history = &mut self.stream_history;
        self.leader
            .turn_until("tick that was asked for", |leader| {
                let Some(copy) = leader.copy() else {
                    return false;
                };
                stream_history.keep(copy);
                copy.stream().complete() >= to
            })?;
        self.hear()
    }

    /// The script's commands of the next tick, whoever asks for it.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when the leader is no member.
    pub fn command(&mut self) -> CaseResult {
        let mut commands = Vec::new();
        self.script.commands(self.scripted, &mut commands);
        self.scripted = self.scripted.next();
        for command in commands {
            self.leader.task(|session| session.command(command))?;
        }
        Ok(())
    }

    /// Goes on until something is so.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] when it does not become so in time; [`Stop::Unsupported`] when the client says that it has not this.
    pub fn until(&mut self, what: &str, is: impl Fn(&Self) -> bool) -> CaseResult {
        // A client is started, and may have to be patient itself.
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
            let look = |copy: &_| stream_history.keep(copy);
            self.leader
                .turn_for_and_look(Duration::from_millis(5), look);
            self.hear()?;
        }
        Ok(())
    }

    fn hear(&mut self) -> CaseResult {
        for line in self.client.lines.try_iter() {
            self.reported.push(reported(&line)?);
        }
        Ok(())
    }

    /// Whatever the client reported so far is of another stream than the leader's.
    pub fn pass_over(&mut self) {
        self.stream_history.pass_over(&self.reported);
    }

    /// That the client comes to the leader's tick, and never reported what was not so.
    ///
    /// # Errors
    ///
    /// [`Stop::Fail`] otherwise.
    pub fn must_follow(&mut self) -> CaseResult {
        let tick = self.complete()?;
        let what = format!("copy of the client's at {tick}");
        self.until(&what, |couple| couple.newest() >= tick)?;
        // Who asked for ticks itself may have reported of one that the leader is still to hear of.
        let newest = self.newest();
        let what = format!("tick {newest} of which the client tells");
        self.until(&what, |couple| {
            couple.complete().is_ok_and(|complete| complete >= newest)
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
