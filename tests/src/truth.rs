//! What really happened in a scene: its commands applied again.
//!
//! Each acts at the tick that the server named. The same engine steps them, so that a server that applied each command
//! once, in order and where it said, has the same digest to the bit.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_reckoning::{BodyId, BodyState, Divergence, Metres, Pose, Tick};
use rhumb_server::Scene;

/// What one member commanded, and what the server said of it.
#[derive(Clone, Debug, Default)]
pub struct MemberRecord {
    /// By number.
    pub commands: Vec<Command>,
    /// Commands up to a number, and the tick before whose step they acted.
    pub applied: Vec<(u64, Tick)>,
}

/// Where every body was at every tick.
#[derive(Debug, Default)]
pub struct SceneTruth {
    bodies: BTreeMap<BodyId, PoseHistory>,
    /// Of the scene after each tick.
    checksum_packets: Vec<u64>,
}

/// One body's poses from the ticks on at which they changed; `None` once it is gone.
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
    /// When a command is refused, or the record does not tell of each command once and in order.
    #[must_use]
    pub fn replay(config: SceneConfig, record: &MemberRecord, until: Tick) -> Self {
        let mut scene = Scene::new(config).expect("the config were those of a scene");
        let mut truth = Self::default();
        truth.checksum_packets.push(scene.digest().value());
        let mut applied = record.applied.iter().peekable();
        let mut next = 0;
        loop {
            while let Some((through, _)) = applied.next_if(|(_, tick)| *tick == scene.tick()) {
                assert!(
                    *through >= next,
                    "command {through} was applied a second time"
                );
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
            "commands were applied at ticks out of order, or later than {until}"
        );
        truth
    }

    fn apply(&mut self, scene: &mut Scene, command: &Command) {
        scene
            .apply(command)
            .expect("what the server applied can be applied again");
        match *command {
            Command::AddBody { desc, motion } => {
                let radius = scene
                    .bounding_radius(desc.id)
                    .expect("the body was just added");
                let poses = vec![(scene.tick(), Some(motion))];
                self.bodies.insert(desc.id, PoseHistory { radius, poses });
            }
            Command::RemoveBody { id } => self.note(id, scene.tick().next(), None),
            _ => {}
        }
    }

    fn step(&mut self, scene: &mut Scene) {
        let stepped = scene
            .step()
            .expect("the engine of the server did not fail either");
        for (id, _) in stepped.removed {
            self.note(id, stepped.tick, None);
        }
        for observation in scene.observations() {
            self.note(observation.id, stepped.tick, Some(observation.motion));
        }
        self.checksum_packets.push(scene.digest().value());
    }

    fn note(&mut self, id: BodyId, tick: Tick, pose: Option<BodyState>) {
        let course = self
            .bodies
            .get_mut(&id)
            .expect("only bodies that were added move or go");
        course.poses.push((tick, pose));
    }

    /// The scene's digest after a tick.
    #[must_use]
    pub fn digest(&self, tick: Tick) -> Option<u64> {
        self.checksum_packets.get(tick.value() as usize).copied()
    }

    /// Where a body was after a tick; `None` before it came and after it went.
    #[must_use]
    pub fn pose(&self, id: BodyId, tick: Tick) -> Option<Pose> {
        self.bodies.get(&id)?.pose(tick)
    }

    /// How far a body, of this bounding radius, was from where it is predicted_motion to have been; `None` where it was not at
    /// all.
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

    /// How many bodies there may have been after a tick and before the next: commands take some away and add some between.
    #[must_use]
    pub fn counts(&self, tick: Tick) -> RangeInclusive<usize> {
        let is_there = |course: &&PoseHistory| course.pose(tick).is_some();
        let stays = |course: &&PoseHistory| {
            let added_now = course
                .poses
                .first()
                .is_some_and(|(since, _)| *since == tick);
            !added_now && is_there(course) && course.pose(tick.next()).is_some()
        };
        let courses = || self.bodies.values();
        courses().filter(stays).count()..=courses().filter(is_there).count()
    }
}
