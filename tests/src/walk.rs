//! Avatars that a member walks about, and where the server has them.
//!
//! A member drives them over a simulated link, and one that hears every state of every tick tells where the server had
//! them. At each tick of which the server knew all in time, they must be within the tolerance of what was said.

use std::collections::VecDeque;

use rhumb_protocol::message::{AuthorityError, StreamChoice};
use rhumb_protocol::scene::Stepping;
use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::{
    BodyId, BodyState, Divergence, Metres, Motion, Tick, Ticks, Tolerance, ToleranceScale,
};
use rhumb_server::UpstreamStatistics;
use rhumb_transport::{Direction, Lane, LinkConfig};

use crate::avatar::Avatars;
use crate::stage::{COMMANDER, Stage, TICK};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
/// How closely the server is to know where bodies are that are driven; avatars, by their tolerance_scale, half as far off.
const CLOSE: Tolerance = Tolerance::FINE;
/// The bounding radius of an avatar.
const RADIUS: Metres = Metres::new(0.8);
/// What rounding to the engine's f32 may add to a tolerance, as a share of it.
const ROUNDING: f64 = 0.001;

/// A scene in which the commander drives avatars, and somebody sees every state of every tick.
pub struct Walk {
    /// The scene and its members.
    pub stage: Stage,
    avatars: u32,
    /// Who sees every state of every tick.
    pub watcher: usize,
    lead: u64,
    /// What was said of each tick that the session took.
    pub said: Vec<(Tick, Vec<(BodyId, BodyState)>)>,
    /// Where the server had the avatars, of ticks that are not watermark_tick for yet.
    seen: VecDeque<(Tick, Vec<Motion>)>,
    noted: Tick,
    /// How many body-ticks were judged.
    pub judged: u64,
    /// The greatest share of the tolerance that was found.
    pub worst: f64,
}

impl Walk {
    /// A scene of so many avatars, and what drives them; free running, it speaks of so many ticks ahead.
    ///
    /// # Panics
    ///
    /// When it may not drive.
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
            said: Vec::new(),
            seen: VecDeque::new(),
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

    /// The commander asks to drive, and waits for the answer.
    ///
    /// # Errors
    ///
    /// Why it may not.
    pub fn take_authority(&mut self, ids: &[BodyId]) -> Result<Vec<BodyId>, AuthorityError> {
        take_authority(&mut self.stage, COMMANDER, ids)
    }

    /// Terms of the commander's link alone.
    ///
    /// # Panics
    ///
    /// When they cannot be read.
    pub fn over(&mut self, config: &str) {
        let config: LinkConfig = config.parse().expect("the tests write links well");
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

    /// How the commander's drive is doing.
    #[must_use]
    pub fn statistics(&self) -> Option<UpstreamStatistics> {
        let scene = "stage".parse().expect("a scene's name");
        let mut drives = self.stage.network.server().drives(&scene);
        drives.find(|drive| drive.driver == Peer(0))
    }

    /// The simulator's frame: says where the avatars are at a tick.
    ///
    /// # Panics
    ///
    /// When they are not driven.
    pub fn say(&mut self, tick: Tick) {
        let motions: Vec<(BodyId, BodyState)> = (0..self.avatars)
            .map(|place| (Avatars::id(place), Avatars::walk(place, tick)))
            .collect();
        let session = self.stage.network.client_mut(COMMANDER);
        if session
            .publish(tick, &motions)
            .expect("the commander drives")
        {
            self.said.push((tick, motions));
        }
    }

    /// A frame of a free-running scene, and a tick's time.
    pub fn frame(&mut self) {
        let present = self.newest() + Ticks::new(self.lead as u32);
        self.say(present);
        for _ in 0..4 {
            self.stage.run(Span::from_nanos(TICK.as_nanos() / 4));
            self.judge();
        }
    }

    /// Where the server had a body at the newest tick.
    ///
    /// # Panics
    ///
    /// When there is none.
    #[must_use]
    pub fn at(&self, id: BodyId) -> Motion {
        let stream = self.stage.copy(self.watcher).stream();
        stream
            .predicted_motion(id, stream.complete())
            .expect("a body of the scene")
    }

    /// Notes where the avatars are, and holds what was noted against what was said once it is known what was.
    fn judge(&mut self) {
        let (newest, avatars) = (self.newest(), self.ids());
        if newest > self.noted {
            self.noted = newest;
            let motions = avatars.iter().map(|id| self.at(*id)).collect();
            self.seen.push_back((newest, motions));
        }
        let Some(drive) = self.statistics() else {
            return;
        };
        while let Some((tick, motions)) = self
            .seen
            .pop_front_if(|(tick, _)| *tick <= drive.watermark_tick)
        {
            let said = self.said.iter().rev().find(|(of, _)| *of == tick);
            if let Some((_, said)) = said.filter(|_| drive.was_complete_at(tick)) {
                for ((id, said), had) in said.clone().iter().zip(&motions) {
                    self.hold(*id, tick, said, had);
                }
            }
        }
    }

    /// Holds where the server had a body against what was said of it.
    ///
    /// # Panics
    ///
    /// When they are farther apart than the tolerance.
    pub fn hold(&mut self, id: BodyId, tick: Tick, said: &BodyState, had: &Motion) {
        let apart = Divergence::between(&said.motion().pose(), &had.pose());
        let share = CLOSE.scaled(ToleranceScale::AVATAR).share(&apart, RADIUS);
        assert!(
            share <= 1.0 + ROUNDING,
            "{id} is off by {share} tolerances at {tick}"
        );
        self.judged += 1;
        self.worst = self.worst.max(share);
    }

    /// Bytes that the commander sent so far, on either lane.
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

/// A member asks to drive, and waits for the answer.
///
/// # Errors
///
/// Why it may not.
///
/// # Panics
///
/// When there is no answer.
pub fn take_authority(
    stage: &mut Stage,
    member: usize,
    ids: &[BodyId],
) -> Result<Vec<BodyId>, AuthorityError> {
    let answers = stage.witnesses[member].drives.len();
    let session = stage.network.client_mut(member);
    session
        .take_authority(CLOSE, ids)
        .expect("a member may ask");
    stage.run_until_or(Span::from_millis(60_000), |stage| {
        stage.witnesses[member].drives.len() > answers
    });
    stage.witnesses[member].drives[answers].clone()
}
