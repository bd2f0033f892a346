//! Recorded bit-exact results of some scenes in this project's physics engine.
//!
//! `tests/conformance/data/truths.json` has checksums of the motion of each dynamic body, at chosen ticks, by the index
//! of the body in its member's id range. The checksums are computed in this process without a connection, so that a
//! server and its packets are compared with the engine alone. A test compares the file with a new computation;
//! `UPDATE_VECTORS=1 cargo test -p rhumb-conformance --lib truths` writes it.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Material, SceneConfig, Shape, ShapeId, Sleep, SleepThresholds,
};
use rhumb_reckoning::{BodyId, BodyState, Damping, Motion, Tick};
use rhumb_sims::{FreeFall, Script, by_name};
use serde_json::Value;

use crate::fnv::Fnv;

/// Checksums of the bodies of a scene at a tick, by index in the id range.
pub type BodyDigests = BTreeMap<u32, u64>;

/// A scene with recorded results.
#[derive(Clone, Copy, Debug)]
pub struct ReferenceScene {
    /// Name of its script.
    pub name: &'static str,
    /// Number of bodies given to the script.
    bodies: u32,
}

/// Ticks at which motion is recorded: the effect of one step, and the growth of single-bit errors over seconds.
pub const TICKS: [u64; 6] = [1, 2, 10, 60, 120, 240];

/// Balls that fall on a floor: the minimum that a server must support.
pub const GROUND: ReferenceScene = ReferenceScene::of("balls on ground", 9);
/// A pit of balls.
pub const PIT: ReferenceScene = ReferenceScene::of("ball-pit", 30);

/// Seed of the scripts.
const SEED: u64 = 1;

impl ReferenceScene {
    /// All reference scenes.
    pub const ALL: [Self; 10] = [
        GROUND,
        PIT,
        Self::of("stack", 10),
        Self::of("cubes", 12),
        Self::of("ragdolls", 4),
        Self::of("dominoes", 12),
        Self::of("asteroids", 8),
        Self::of("asteroids-plain", 8),
        Self::of("rain", 12),
        Self::of("zoo", 12),
    ];

    const fn of(name: &'static str, bodies: u32) -> Self {
        Self { name, bodies }
    }

    /// The commands of the scene.
    ///
    /// # Panics
    ///
    /// Never: the names are those of existing scripts.
    #[must_use]
    pub fn script(&self) -> Box<dyn Script> {
        if self.name == GROUND.name {
            return Box::new(BallsOnGround { balls: self.bodies });
        }
        by_name(self.name, self.bodies, SEED).expect("an existing script")
    }

    /// The recorded motion of each body; `None` if the tick was not recorded.
    #[must_use]
    pub fn recorded(&self, tick: Tick) -> Option<BodyDigests> {
        let recorded: Value = serde_json::from_str(RECORDED).ok()?;
        let bodies = recorded["scenes"][self.name][tick.value().to_string()].as_str()?;
        let body = |text: &str| {
            let (place, checksums) = text.split_once(':')?;
            Some((
                place.parse().ok()?,
                u64::from_str_radix(checksums, 16).ok()?,
            ))
        };
        bodies.split(' ').map(body).collect()
    }
}

const RECORDED: &str = include_str!("../data/truths.json");

/// Checksum of a motion, as recorded.
#[must_use]
pub fn checksums(motion: &Motion) -> u64 {
    let mut checksums = Fnv::START;
    checksums.fold_motion(motion);
    checksums.value()
}

/// Balls that fall obliquely on a floor, roll, touch and come to rest; all with the default material of the scene.
#[derive(Clone, Copy, Debug)]
struct BallsOnGround {
    balls: u32,
}

impl Script for BallsOnGround {
    fn name(&self) -> &'static str {
        GROUND.name
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            material: Material {
                friction: 0.5,
                restitution: 0.25,
                density: 1_000.0,
            },
            damping: Damping {
                linear: 1.0,
                angular: 4.0,
            },
            sleep: Sleep::Below(SleepThresholds::by_speed(0.2, 0.5)),
            ..FreeFall::new(0, SEED).config()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let (ball, floor) = (ShapeId(0), ShapeId(1));
        let half_extents = Vec3::new(20.0, 1.0, 20.0);
        let shapes = [
            (ball, Shape::Ball { radius: 0.5 }),
            (floor, Shape::Cuboid { half_extents }),
        ];
        out.extend(shapes.map(|(id, shape)| Command::AddShape { id, shape }));
        let mut add = |index, kind, shape, place: Vec3, linear: Vec3| {
            let id = BodyId::new(index, 0);
            let turn = Quat::IDENTITY.to_array();
            let motion = BodyState::new(place.to_array(), turn, linear.to_array(), [0.0; 3]);
            out.push(Command::AddBody {
                desc: BodyDesc::plain(id, kind, shape),
                motion: motion.expect("a finite state"),
            });
        };
        let below = Vec3::new(0.0, -1.0, 0.0);
        add(0, BodyKind::Fixed, floor, below, Vec3::ZERO);
        for number in 1..=self.balls {
            let (column, row) = ((number % 3) as f32, (number / 3) as f32);
            let place = Vec3::new(1.1 * column, 0.6 + 0.3 * row, 1.3 * row);
            let linear = Vec3::new(1.0 - column, -0.5, 0.7 - 0.4 * row);
            add(number, BodyKind::Dynamic, ball, place, linear);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use rhumb_scene::Scene;
    use serde_json::json;

    use super::*;

    impl ReferenceScene {
        /// The motion of each dynamic body at the chosen ticks, computed by the engine of this build.
        fn computed(&self) -> BTreeMap<u64, BodyDigests> {
            let mut script = self.script();
            let mut scene =
                Scene::new(script.config()).expect("the configuration of a script is valid");
            let mut commands = Vec::new();
            // The initial motion, until the engine reports another.
            let mut motions = BTreeMap::new();
            let mut ticks = BTreeMap::new();
            for tick in 1..=TICKS[TICKS.len() - 1] {
                commands.clear();
                script.commands(scene.tick(), &mut commands);
                for command in &commands {
                    scene
                        .apply(command)
                        .expect("the commands of a script are valid");
                    if let Command::AddBody { desc, motion } = command {
                        motions.insert(desc.id, *motion);
                    }
                }
                scene.step().expect("the engine steps scripted scenes");
                for observation in scene.observations() {
                    motions.insert(observation.id, observation.motion);
                }
                if TICKS.contains(&tick) {
                    let can_move = |desc: &&BodyDesc| desc.kind != BodyKind::Fixed;
                    let bodies = scene.bodies().filter(can_move);
                    let bodies = bodies.map(|desc| {
                        let motion = motions[&desc.id].motion();
                        (desc.id.index(), checksums(&motion))
                    });
                    ticks.insert(tick, bodies.collect());
                }
            }
            ticks
        }
    }

    /// The content of the file, computed by the engine of this build.
    fn truths(engine: &str) -> String {
        let mut scenes = BTreeMap::new();
        for subject in ReferenceScene::ALL {
            let ticks = subject.computed().into_iter().map(|(tick, bodies)| {
                let mut text = String::new();
                for (place, checksums) in bodies {
                    let space = if text.is_empty() { "" } else { " " };
                    write!(text, "{space}{place}:{checksums:016x}").expect("writing to memory");
                }
                (tick.to_string(), Value::String(text))
            });
            scenes.insert(subject.name, Value::Object(ticks.collect()));
        }
        let record = json!({ "engine": engine, "scenes": scenes });
        let mut text = serde_json::to_string_pretty(&record).expect("it is JSON");
        text.push('\n');
        text
    }

    /// The engine's name and version, from the text of the workspace's lock file.
    fn engine(lock: &str) -> String {
        let mut lines = lock
            .lines()
            .skip_while(|line| *line != "name = \"rapier3d\"");
        let version = lines.nth(1).and_then(|line| line.split('"').nth(1));
        format!(
            "rapier3d {}",
            version.expect("the lock file contains the engine")
        )
    }

    #[test]
    fn the_recorded_checksums_match_the_engine() {
        let computed = truths(&engine(include_str!("../../../Cargo.lock")));
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/data/truths.json");
        if std::env::var_os("UPDATE_VECTORS").is_some() {
            std::fs::write(path, &computed).expect("the checkout can be written");
        }
        let recorded = std::fs::read_to_string(path).expect("the record is in the checkout");
        for (number, (is, was)) in computed.lines().zip(recorded.lines()).enumerate() {
            assert_eq!(
                is,
                was,
                "line {} of tests/conformance/data/truths.json",
                number + 1
            );
        }
        assert_eq!(computed.len(), recorded.len());
    }

    #[test]
    fn each_scene_is_recorded_at_each_tick_and_moves_in_between() {
        for subject in ReferenceScene::ALL {
            let recorded = |tick: u64| {
                let bodies = subject.recorded(Tick::new(tick));
                bodies.unwrap_or_else(|| panic!("{subject:?} at {tick}"))
            };
            // Some scenes are at rest later on.
            for (before, after) in [(1, 2), (2, 10), (10, 60)] {
                let (before, after) = (recorded(before), recorded(after));
                assert_ne!(before, after, "{subject:?}");
            }
            assert!(recorded(120).len() >= 8 && recorded(240).len() >= 8);
            assert!(recorded(60).len() >= 8, "{subject:?}");
        }
        assert_eq!(GROUND.recorded(Tick::new(3)), None);
    }
}
