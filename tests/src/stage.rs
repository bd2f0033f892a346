//! A server and sessions over simulated links, in virtual time.
//!
//! The first member sends the commands of a script; the claims of all members are stored every few milliseconds. No
//! checks are made here. Runs with the same seed are bit-identical.

use rhumb_netsim::{LinkConfig, SimNetwork};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{Command, SceneConfig, Stepping};
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tick;
use rhumb_scene::{SceneRouter, SceneSettings};
use rhumb_sims::Script;

use crate::observation_history::ObservationHistory;
use crate::truth::{MemberRecord, SceneTruth};

/// Index of the member that creates the scene and sends commands.
pub const COMMANDER: usize = 0;
/// Duration of one tick at 60 Hz.
pub const TICK: Span = Span::from_nanos(1_000_000_000 / 60);

/// Interval between stored claims: several per tick, so that partially received ticks are covered too.
const CLAIM_INTERVAL: Span = Span::from_millis(4);
/// Longest virtual time for an answer over the worst link: several retries at 20 % loss and 300 ms.
const ANSWER_TIME_LIMIT: Span = Span::from_millis(600_000);

/// A scene with its members.
pub struct Stage {
    /// The network, for operations without a method here.
    pub network: SimNetwork<SceneRouter, ClientSession>,
    /// The history of each member.
    pub histories: Vec<ObservationHistory>,
    config: SceneConfig,
    script: Box<dyn Script>,
    scripted: Tick,
    commands: Vec<Command>,
}

impl Stage {
    /// A scene of this script, created and joined by the commander.
    #[must_use]
    pub fn new(
        script: Box<dyn Script>,
        stepping: Stepping,
        choice: StreamChoice,
        links: LinkConfig,
        seed: u64,
    ) -> Self {
        let config = SceneConfig {
            stepping,
            ..script.config()
        };
        Self::of(script, config, choice, links, seed)
    }

    /// The same with another configuration than the script's.
    #[must_use]
    pub fn of(
        script: Box<dyn Script>,
        config: SceneConfig,
        choice: StreamChoice,
        links: LinkConfig,
        seed: u64,
    ) -> Self {
        let mut stage = Self {
            network: SimNetwork::new(
                SceneRouter::new(SceneSettings::new(|| Instant::ZERO)),
                links,
                seed,
            ),
            histories: Vec::new(),
            config,
            script,
            scripted: Tick::ZERO,
            commands: Vec::new(),
        };
        let commander = stage.connect();
        stage
            .network
            .client_mut(commander)
            .create(config)
            .expect("a client in the lobby may create a scene");
        stage.run_until("the scene", |stage| stage.histories[COMMANDER].created > 0);
        stage.join(commander, choice);
        stage
    }

    /// The configuration of the scene.
    #[must_use]
    pub const fn config(&self) -> SceneConfig {
        self.config
    }

    /// Connects a client and waits for its welcome.
    pub fn connect(&mut self) -> usize {
        let name = "stage".parse().expect("a valid scene name");
        let index = self.network.connect(ClientSession::new(name));
        self.histories.push(ObservationHistory::default());
        self.run_until("a welcome", |stage| stage.histories[index].welcomes > 0);
        index
    }

    /// Makes a connected client a member.
    pub fn join(&mut self, index: usize, choice: StreamChoice) {
        self.network
            .client_mut(index)
            .join(choice)
            .expect("a client in the lobby may join");
        self.run_until("a membership", |stage| {
            stage.histories[index].granted.is_some()
        });
    }

    /// Connects a client and makes it a member.
    pub fn enter(&mut self, choice: StreamChoice) -> usize {
        let index = self.connect();
        self.join(index, choice);
        index
    }

    /// A member's copy.
    ///
    /// # Panics
    ///
    /// If the client is not a member.
    #[must_use]
    pub fn copy(&self, index: usize) -> &Replica {
        self.network
            .client(index)
            .replica()
            .expect("a member has a copy")
    }

    /// The commander sends the next commands of its script, and `more`.
    pub fn command(&mut self, more: &[Command]) {
        let mut commands = Vec::new();
        self.script.commands(self.scripted, &mut commands);
        self.scripted = self.scripted.next();
        commands.extend_from_slice(more);
        for command in &commands {
            let number = self
                .network
                .client_mut(COMMANDER)
                .command(command.clone())
                .expect("scripts send valid commands");
            assert_eq!(number, self.commands.len() as u64);
            self.commands.push(command.clone());
        }
    }

    /// In lockstep: sends the script's commands, steps once, and waits until a member has the complete tick.
    pub fn tick(&mut self) -> Tick {
        self.command(&[]);
        self.advance(COMMANDER)
    }

    /// A member lets the scene step once, and waits until the tick is complete.
    pub fn advance(&mut self, index: usize) -> Tick {
        let wanted = self.copy(index).stream().complete().next();
        let now = self.network.now();
        self.network
            .client_mut(index)
            .advance(now, wanted)
            .expect("a member may advance");
        self.run_until("a tick", |stage| {
            stage.copy(index).stream().complete() >= wanted
        });
        wanted
    }

    /// Lets time pass in small steps; all claims are stored at each.
    pub fn run(&mut self, span: Span) {
        let end = self.network.now() + span;
        while self.network.now() < end {
            let next = (self.network.now() + CLAIM_INTERVAL).min(end);
            self.network.run_until(next);
            self.store_claims();
        }
    }

    /// Runs the script for this time, with one set of commands per tick.
    pub fn run_script(&mut self, span: Span) {
        let end = self.network.now() + span;
        while self.network.now() < end {
            self.command(&[]);
            self.run(TICK);
        }
    }

    fn run_until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let deadline = self.network.now() + ANSWER_TIME_LIMIT;
        self.network.run_until(self.network.now());
        self.store_claims();
        while !done(self) {
            assert!(
                self.network.now() < deadline,
                "no {what} within {ANSWER_TIME_LIMIT}"
            );
            self.run(CLAIM_INTERVAL);
        }
    }

    /// Lets time pass until a condition holds, at most this long.
    pub fn run_until_or(&mut self, most: Span, done: impl Fn(&Self) -> bool) {
        let end = self.network.now() + most;
        while self.network.now() < end && !done(self) {
            self.run(CLAIM_INTERVAL);
        }
    }

    /// Number of the commander's commands without an answer.
    #[must_use]
    pub fn unanswered(&self) -> u64 {
        let answered = self.histories[COMMANDER]
            .applied
            .last()
            .map_or(0, |(through, _)| through + 1);
        self.commands.len() as u64 - answered
    }

    fn store_claims(&mut self) {
        for (index, history) in self.histories.iter_mut().enumerate() {
            history.take_events(self.network.client_mut(index));
            history.store_claims(self.network.client(index));
        }
    }

    /// The truth up to the newest tick with a claim, after checking that the server agrees with it.
    ///
    /// # Panics
    ///
    /// When the server's checksum differs: then a command was not applied exactly once, in order, at the stated tick.
    pub fn truth(&mut self) -> SceneTruth {
        self.network
            .client_mut(COMMANDER)
            .inspect()
            .expect("the commander is a member");
        let before = self.histories[COMMANDER].inspections.len();
        self.run_until("an inspection", |stage| {
            stage.histories[COMMANDER].inspections.len() > before
        });
        // In a free-running scene a member may be ahead of the answer.
        let inspected = self.histories[COMMANDER].inspections[before];
        let newest =
            (0..self.network.clients()).filter_map(|index| self.network.client(index).replica());
        let newest = newest
            .map(|copy| copy.stream().watermark_tick())
            .max()
            .unwrap_or_default();
        for (index, history) in self.histories.iter().enumerate() {
            let copy = self.network.client(index).replica();
            let mismatches = copy.map_or(0, |copy| copy.stream().statistics().mismatches);
            assert_eq!(
                (mismatches, history.mismatches),
                (0, 0),
                "member {index} has a checksum mismatch"
            );
        }
        assert_eq!(inspected.mismatches, 0);
        let history = &self.histories[COMMANDER];
        assert_eq!(history.refused, []);
        assert_eq!(self.unanswered(), 0, "some commands have no answer");
        let record = MemberRecord {
            commands: self.commands.clone(),
            applied: history.applied.clone(),
        };
        let truth = SceneTruth::replay(self.config, &record, newest.max(inspected.tick));
        assert_eq!(
            truth.digest(inspected.tick),
            Some(inspected.truth),
            "the server's checksum differs from the truth"
        );
        let counts = truth.counts(inspected.tick);
        assert!(
            counts.contains(&(inspected.bodies as usize)),
            "{} bodies of {counts:?}",
            inspected.bodies
        );
        truth
    }
}
