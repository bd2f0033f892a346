//! The true states of a scene, computed by replaying its commands.
//!
//! Each command is applied at the tick that the server stated. The engine is the same, so a correct server has the
//! same checksum bit for bit.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_reckoning::{BodyId, BodyState, Divergence, Metres, Pose, Tick};
use rhumb_scene::Scene;

/// The commands of one member, and the server's answers.
#[derive(Clone, Debug, Default)]
pub struct MemberRecord {
    /// The commands, by number.
    pub commands: Vec<Command>,
    /// Commands up to this number were applied before the step of this tick.
    pub applied: Vec<(u64, Tick)>,
}

/// The pose of every body at every tick.
#[derive(Debug, Default)]
pub struct SceneTruth {
    bodies: BTreeMap<BodyId, PoseHistory>,
    /// Checksum of the scene after each tick.
    checksums: Vec<u64>,
}

/// The poses of one body, each with the tick of its change; `None` from its removal on.
#[derive(Debug)]
struct PoseHistory {
    radius: Metres,
    poses: Vec<(Tick, Option<BodyState>)>,
}

impl PoseHistory {
    fn pose(&self, tick: Tick) -> Option<Pose> {
        let after = self.poses.partition_point(|(since, _)| *since <= tick);
        let (_, pose) = self.poses[..after].last()?;
        pose.map(|body_state| body_state.motion().pose())
    }
}

impl SceneTruth {
    /// Replays a record up to a tick.
    ///
    /// # Panics
    ///
    /// When a command is refused, or when the record does not answer each command once and in order.
    #[must_use]
    pub fn replay(config: SceneConfig, record: &MemberRecord, until: Tick) -> Self {
        let mut scene = Scene::new(config).expect("a valid configuration");
        let mut truth = Self::default();
        truth.checksums.push(scene.digest().value());
        let mut applied = record.applied.iter().peekable();
        let mut next = 0;
        loop {
            while let Some((through, _)) = applied.next_if(|(_, tick)| *tick == scene.tick()) {
                assert!(*through >= next, "command {through} is answered twice");
                for command in &record.commands[next as usize..=*through as usize] {
                    truth.apply(&mut scene, command);
                }
                next = through + 1;
            }
            if scene.tick() >= until {
                break;
            }
            truth.step(&mut scene);
        }
        assert!(
            applied.next().is_none(),
            "commands are answered out of order, or after {until}"
        );
        truth
    }

    fn apply(&mut self, scene: &mut Scene, command: &Command) {
        scene
            .apply(command)
            .expect("a command that the server applied is valid");
        match *command {
            Command::AddBody { desc, motion } => {
                let radius = scene
                    .bounding_radius(desc.id)
                    .expect("the added body exists");
                let poses = vec![(scene.tick(), Some(motion))];
                self.bodies.insert(desc.id, PoseHistory { radius, poses });
            }
            Command::RemoveBody { id } => self.note(id, scene.tick().next(), None),
            _ => {}
        }
    }

    fn step(&mut self, scene: &mut Scene) {
        let stepped = scene.step().expect("the engine steps the scene");
        for (id, _) in stepped.removed {
            self.note(id, stepped.tick, None);
        }
        for observation in scene.observations() {
            self.note(observation.id, stepped.tick, Some(observation.motion));
        }
        self.checksums.push(scene.digest().value());
    }

    fn note(&mut self, id: BodyId, tick: Tick, pose: Option<BodyState>) {
        let history = self.bodies.get_mut(&id).expect("the body was added before");
        history.poses.push((tick, pose));
    }

    /// The scene's checksum after a tick.
    #[must_use]
    pub fn digest(&self, tick: Tick) -> Option<u64> {
        self.checksums.get(tick.value() as usize).copied()
    }

    /// The pose of a body after a tick; `None` before its placement and after its removal.
    #[must_use]
    pub fn pose(&self, id: BodyId, tick: Tick) -> Option<Pose> {
        self.bodies.get(&id)?.pose(tick)
    }

    /// Distance of a body with this bounding radius from a claimed pose; `None` if it did not exist.
    #[must_use]
    pub fn apart(
        &self,
        id: BodyId,
        tick: Tick,
        predicted_motion: &Pose,
    ) -> Option<(Divergence, Metres)> {
        let radius = self.bodies.get(&id)?.radius;
        let pose = self.pose(id, tick)?;
        Some((Divergence::between(&pose, predicted_motion), radius))
    }

    /// Possible numbers of bodies between a tick and the next: commands in between remove some and add some.
    #[must_use]
    pub fn counts(&self, tick: Tick) -> RangeInclusive<usize> {
        let is_there = |history: &&PoseHistory| history.pose(tick).is_some();
        let stays = |history: &&PoseHistory| {
            let added_now = history
                .poses
                .first()
                .is_some_and(|(since, _)| *since == tick);
            !added_now && is_there(history) && history.pose(tick.next()).is_some()
        };
        let courses = || self.bodies.values();
        courses().filter(stays).count()..=courses().filter(is_there).count()
    }
}
