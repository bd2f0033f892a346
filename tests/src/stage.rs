//! A real host and real sessions over simulated links, in virtual time.
//!
//! The first member commands by a script; all that members claim is noted every few milliseconds. Nothing is judged
//! here. The same seed gives the same run, to the bit.

use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{Command, SceneConfig, Stepping};
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tick;
use rhumb_server::ServerLoop;
use rhumb_sims::Script;
use rhumb_transport::{LinkConfig, SimNetwork};

use crate::truth::{MemberRecord, SceneTruth};
use crate::witness::ObservationHistory;

/// The member that creates the scene and commands in it.
pub const COMMANDER: usize = 0;
/// One tick at 60 Hz.
pub const TICK: Span = Span::from_nanos(1_000_000_000 / 60);

/// How often claims are noted: a few times a tick, so that half-heard ticks are seen too.
const LOOK_EVERY: Span = Span::from_millis(4);
/// Longest virtual time for an answer over the worst link: some retries of 20 % loss at 300 ms.
const ANSWER_PATIENCE: Span = Span::from_millis(600_000);

/// A scene with its members.
pub struct Stage {
    /// The network; for what the methods here do not do.
    pub network: SimNetwork<ServerLoop, ClientSession>,
    /// One account a member.
    pub witnesses: Vec<ObservationHistory>,
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

    /// A scene of this script with other config than its own, created and joined by the commander.
    #[must_use]
    pub fn of(
        script: Box<dyn Script>,
        config: SceneConfig,
        choice: StreamChoice,
        links: LinkConfig,
        seed: u64,
    ) -> Self {
        let mut stage = Self {
            network: SimNetwork::new(ServerLoop::new(|| Instant::ZERO), links, seed),
            witnesses: Vec::new(),
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
            .expect("a client in the lobby may create");
        stage.run_until("the scene", |stage| stage.witnesses[COMMANDER].created > 0);
        stage.join(commander, choice);
        stage
    }

    /// What the scene was created with.
    #[must_use]
    pub const fn config(&self) -> SceneConfig {
        self.config
    }

    /// Connects a client and waits for its welcome.
    pub fn connect(&mut self) -> usize {
        let name = "stage".parse().expect("a short word is a scene's name");
        let index = self.network.connect(ClientSession::new(name));
        self.witnesses.push(ObservationHistory::default());
        self.run_until("a welcome", |stage| stage.witnesses[index].welcomes > 0);
        index
    }

    /// Makes a connected client a member.
    pub fn join(&mut self, index: usize, choice: StreamChoice) {
        self.network
            .client_mut(index)
            .join(choice)
            .expect("a client in the lobby may join");
        self.run_until("a membership", |stage| {
            stage.witnesses[index].granted.is_some()
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
    /// If it is no member.
    #[must_use]
    pub fn copy(&self, index: usize) -> &Replica {
        self.network
            .client(index)
            .replica()
            .expect("a member has a copy")
    }

    /// The commander says what its script says next, and this.
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
                .expect("scripts command what may be");
            assert_eq!(number, self.commands.len() as u64);
            self.commands.push(command.clone());
        }
    }

    /// In lockstep: the script's commands, one tick, and patience until it is complete for a member.
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

    /// Lets time pass, in small pieces, with everybody looking.
    pub fn run(&mut self, span: Span) {
        let end = self.network.now() + span;
        while self.network.now() < end {
            let next = (self.network.now() + LOOK_EVERY).min(end);
            self.network.run_until(next);
            self.look();
        }
    }

    /// The script at 60 commands' bursts a second, for so long.
    pub fn take_authority(&mut self, span: Span) {
        let end = self.network.now() + span;
        while self.network.now() < end {
            self.command(&[]);
            self.run(TICK);
        }
    }

    fn run_until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let deadline = self.network.now() + ANSWER_PATIENCE;
        self.network.run_until(self.network.now());
        self.look();
        while !done(self) {
            assert!(
                self.network.now() < deadline,
                "no {what} within {ANSWER_PATIENCE}"
            );
            self.run(LOOK_EVERY);
        }
    }

    /// Lets time pass until something holds, or for so long.
    pub fn run_until_or(&mut self, most: Span, done: impl Fn(&Self) -> bool) {
        let end = self.network.now() + most;
        while self.network.now() < end && !done(self) {
            self.run(LOOK_EVERY);
        }
    }

    /// How many of the commander's commands have no answer yet.
    #[must_use]
    pub fn unanswered(&self) -> u64 {
        let answered = self.witnesses[COMMANDER]
            .applied
            .last()
            .map_or(0, |(through, _)| through + 1);
        self.commands.len() as u64 - answered
    }

    fn look(&mut self) {
        for (index, witness) in self.witnesses.iter_mut().enumerate() {
            witness.listen(self.network.client_mut(index));
            witness.look(self.network.client(index));
        }
    }

    /// What happened, up to the newest tick that anybody claims something of; and that the server agrees.
    ///
    /// # Panics
    ///
    /// When the server's digest is another: then some command was not applied once, in order, at the tick it named.
    pub fn truth(&mut self) -> SceneTruth {
        self.network
            .client_mut(COMMANDER)
            .inspect()
            .expect("the commander is a member");
        let before = self.witnesses[COMMANDER].inspections.len();
        self.run_until("an inspection", |stage| {
            stage.witnesses[COMMANDER].inspections.len() > before
        });
        // Free running, somebody may be ahead of the answer by now.
        let inspected = self.witnesses[COMMANDER].inspections[before];
        let newest =
            (0..self.network.clients()).filter_map(|index| self.network.client(index).replica());
        let newest = newest
            .map(|copy| copy.stream().watermark_tick())
            .max()
            .unwrap_or_default();
        for (index, witness) in self.witnesses.iter().enumerate() {
            let copy = self.network.client(index).replica();
            let mismatches = copy.map_or(0, |copy| copy.stream().statistics().mismatches);
            assert_eq!((mismatches, witness.mismatches), (0, 0), "member {index}");
        }
        assert_eq!(inspected.mismatches, 0);
        let witness = &self.witnesses[COMMANDER];
        assert_eq!(witness.refused, []);
        assert_eq!(self.unanswered(), 0, "not every command was answered");
        let record = MemberRecord {
            commands: self.commands.clone(),
            applied: witness.applied.clone(),
        };
        let truth = SceneTruth::replay(self.config, &record, newest.max(inspected.tick));
        assert_eq!(
            truth.digest(inspected.tick),
            Some(inspected.truth),
            "the server did something else"
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
