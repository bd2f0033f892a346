//! Walking avatars under a member's authority, and the check of their states.
//!
//! The member publishes over a simulated link; a subscriber to the full stream knows the server's states. At each tick
//! whose upstream arrived completely in time, these must be within the tolerance of the published states.

use std::collections::VecDeque;

use rhumb_netsim::{Direction, Lane, LinkConfig};
use rhumb_protocol::message::{AuthorityError, StreamChoice};
use rhumb_protocol::scene::Stepping;
use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::{
    BodyId, BodyState, Divergence, Metres, Motion, Tick, Ticks, Tolerance, ToleranceScale,
};
use rhumb_scene::UpstreamStatistics;

use crate::avatar::Avatars;
use crate::stage::{COMMANDER, Stage, TICK};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
/// Tolerance of the upstream; avatars have half of it by their tolerance scale.
const CLOSE: Tolerance = Tolerance::FINE;
/// The bounding radius of an avatar.
const RADIUS: Metres = Metres::new(0.8);
/// Allowance for rounding to the engine's f32, as a fraction of the tolerance.
const ROUNDING: f64 = 0.001;

/// A scene in which the commander moves avatars, and a watcher receives the full stream.
pub struct Walk {
    /// The scene and its members.
    pub stage: Stage,
    avatars: u32,
    /// Index of the watcher.
    pub watcher: usize,
    lead: u64,
    /// The published states of each tick that the session accepted.
    pub published: Vec<(Tick, Vec<(BodyId, BodyState)>)>,
    /// The server's states of the avatars at ticks whose upstream is not complete yet.
    server_states: VecDeque<(Tick, Vec<Motion>)>,
    noted: Tick,
    /// Number of checked body-ticks.
    pub judged: u64,
    /// The greatest error so far, as a fraction of the tolerance.
    pub worst: f64,
}

impl Walk {
    /// A scene with this number of avatars under authority; in a free-running scene the member publishes `lead` ticks
    /// ahead.
    ///
    /// # Panics
    ///
    /// When authority is denied.
    pub fn new(stepping: Stepping, avatars: u32, lead: u64, seed: u64) -> Self {
        let script = Box::new(Avatars(avatars));
        let mut stage = Stage::new(script, stepping, NORMAL, LinkConfig::PERFECT, seed);
        let watcher = stage.enter(StreamChoice::Full);
        stage.command(&[]);
        stage.run(TICK);
        let mut walk = Self {
            stage,
            avatars,
            watcher,
            lead,
            published: Vec::new(),
            server_states: VecDeque::new(),
            noted: Tick::ZERO,
            judged: 0,
            worst: 0.0,
        };
        let ids = walk.ids();
        assert_eq!(walk.take_authority(&ids), Ok(ids));
        walk
    }

    fn ids(&self) -> Vec<BodyId> {
        (0..self.avatars).map(Avatars::id).collect()
    }

    /// The commander requests authority, and waits for the answer.
    ///
    /// # Errors
    ///
    /// The reason of a denial.
    pub fn take_authority(&mut self, ids: &[BodyId]) -> Result<Vec<BodyId>, AuthorityError> {
        take_authority(&mut self.stage, COMMANDER, ids)
    }

    /// Sets the simulated network of the commander's link only.
    ///
    /// # Panics
    ///
    /// When the configuration cannot be parsed.
    pub fn set_link(&mut self, config: &str) {
        let config: LinkConfig = config.parse().expect("a valid link configuration");
        for direction in [Direction::Up, Direction::Down] {
            self.stage
                .network
                .set_config_of(COMMANDER, direction, config);
        }
    }

    /// The newest tick of the server.
    #[must_use]
    pub fn newest(&self) -> Tick {
        self.stage.copy(self.watcher).stream().complete()
    }

    /// Statistics of the commander's upstream at the server.
    #[must_use]
    pub fn statistics(&self) -> Option<UpstreamStatistics> {
        let scene = "stage".parse().expect("a valid scene name");
        let mut upstreams = self.stage.network.server().upstreams(&scene);
        upstreams.find(|status| status.member == Peer(0))
    }

    /// Publishes the avatars' states of a tick.
    ///
    /// # Panics
    ///
    /// When they are not under authority.
    pub fn publish(&mut self, tick: Tick) {
        let motions: Vec<(BodyId, BodyState)> = (0..self.avatars)
            .map(|place| (Avatars::id(place), Avatars::walk(place, tick)))
            .collect();
        let session = self.stage.network.client_mut(COMMANDER);
        if session
            .publish(tick, &motions)
            .expect("the commander has authority")
        {
            self.published.push((tick, motions));
        }
    }

    /// Publishes one frame of a free-running scene, and lets one tick pass.
    pub fn frame(&mut self) {
        let present = self.newest() + Ticks::new(self.lead as u32);
        self.publish(present);
        for _ in 0..4 {
            self.stage.run(Span::from_nanos(TICK.as_nanos() / 4));
            self.judge();
        }
    }

    /// The server's state of a body at the newest tick.
    ///
    /// # Panics
    ///
    /// When the body does not exist.
    #[must_use]
    pub fn at(&self, id: BodyId) -> Motion {
        let stream = self.stage.copy(self.watcher).stream();
        stream
            .predicted_motion(id, stream.complete())
            .expect("a body of the scene")
    }

    /// Stores the server's states of the avatars, and checks stored states whose upstream is complete.
    fn judge(&mut self) {
        let (newest, avatars) = (self.newest(), self.ids());
        if newest > self.noted {
            self.noted = newest;
            let motions = avatars.iter().map(|id| self.at(*id)).collect();
            self.server_states.push_back((newest, motions));
        }
        let Some(status) = self.statistics() else {
            return;
        };
        while let Some((tick, motions)) = self
            .server_states
            .pop_front_if(|(tick, _)| *tick <= status.watermark_tick)
        {
            let published = self.published.iter().rev().find(|(of, _)| *of == tick);
            if let Some((_, published)) = published.filter(|_| status.was_complete_at(tick)) {
                for ((id, published), had) in published.clone().iter().zip(&motions) {
                    self.check(*id, tick, published, had);
                }
            }
        }
    }

    /// Checks the server's state of a body against the published one.
    ///
    /// # Panics
    ///
    /// When the error exceeds the tolerance.
    pub fn check(&mut self, id: BodyId, tick: Tick, published: &BodyState, had: &Motion) {
        let apart = Divergence::between(&published.motion().pose(), &had.pose());
        let share = CLOSE.scaled(ToleranceScale::AVATAR).share(&apart, RADIUS);
        assert!(
            share <= 1.0 + ROUNDING,
            "{id} at {tick} has an error of {share} tolerances"
        );
        self.judged += 1;
        self.worst = self.worst.max(share);
    }

    /// Bytes that the commander sent so far, on both lanes.
    #[must_use]
    pub fn bytes_up(&self) -> u64 {
        let lanes = [Lane::Control, Lane::State];
        let count = |lane| {
            self.stage
                .network
                .counts(COMMANDER, Direction::Up, lane)
                .pushed
                .bytes
        };
        lanes.into_iter().map(count).sum()
    }
}

/// A member requests authority, and waits for the answer.
///
/// # Errors
///
/// The reason of a denial.
///
/// # Panics
///
/// When there is no answer.
pub fn take_authority(
    stage: &mut Stage,
    member: usize,
    ids: &[BodyId],
) -> Result<Vec<BodyId>, AuthorityError> {
    let answers = stage.histories[member].authority_answers.len();
    let session = stage.network.client_mut(member);
    session
        .take_authority(CLOSE, ids)
        .expect("a member may request authority");
    stage.run_until_or(Span::from_millis(60_000), |stage| {
        stage.histories[member].authority_answers.len() > answers
    });
    stage.histories[member].authority_answers[answers].clone()
}
