//! Each test scene behaves as intended: it rests, falls, turns or flies.
//!
//! Proved by runs in this process, from the observations of bodies; recorded digests are elsewhere.

use glam::{DQuat, DVec3, Vec3};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command};
use rhumb_reckoning::BodyId;
use rhumb_scene::{Hook, Scene};
use rhumb_sims::{Script, by_name, default_bodies};

/// A scene with its script, and the motion at the start.
struct Played {
    script: Box<dyn Script>,
    scene: Scene,
    hook: Option<Hook>,
}

impl Played {
    fn new(name: &str, bodies: u32, seed: u64) -> Self {
        let script = by_name(name, bodies, seed).expect("the scene exists");
        let scene = Scene::new(script.config()).expect("scripts have good config");
        let hook = script.controller().map(|mut controller| {
            Hook::new(move |scene: &Scene, out| {
                let motion = |id| scene.observation(id).map(|observation| observation.motion);
                controller.before_step(scene.tick(), &motion, out);
            })
        });
        Self {
            script,
            scene,
            hook,
        }
    }

    fn usual(name: &str) -> Self {
        let bodies = default_bodies(name).expect("the scene exists")[0];
        Self::new(name, bodies, 1)
    }

    fn run(&mut self, ticks: u32) {
        let mut commands = Vec::new();
        for _ in 0..ticks {
            commands.clear();
            self.script.commands(self.scene.tick(), &mut commands);
            for command in &commands {
                let answer = self.scene.apply(command);
                assert_eq!(answer, Ok(()), "{command:?}");
            }
            if let Some(hook) = &mut self.hook {
                assert_eq!(hook.act(&mut self.scene), []);
            }
            let stepped = self.scene.step().expect("the engine does not fail");
            assert_eq!(stepped.removed, []);
        }
    }

    fn dynamic(&self) -> Vec<BodyId> {
        let moved = |desc: &&BodyDesc| desc.kind == BodyKind::Dynamic;
        let bodies = self.scene.bodies().filter(moved);
        bodies.map(|desc| desc.id).collect()
    }

    fn parts(&self, id: BodyId) -> [f32; 13] {
        let observation = self.scene.observation(id).expect("it is there");
        observation.motion.parts()
    }

    fn place(&self, id: BodyId) -> Vec3 {
        Vec3::from_slice(&self.parts(id)[..3])
    }

    fn velocity(&self, id: BodyId) -> Vec3 {
        Vec3::from_slice(&self.parts(id)[7..10])
    }

    /// Upward component of a body's own upward axis, from one to minus one.
    fn upright(&self, id: BodyId) -> f32 {
        let [_, _, _, x, _, z, ..] = self.parts(id);
        1.0 - 2.0 * (x * x + z * z)
    }
}

#[test]
fn ten_thousand_bodies_sleep_within_a_second() {
    let mut played = Played::usual("rest-10k");
    played.run(1);
    assert_eq!(played.scene.awake_count(), 10_000);
    played.run(59);
    assert_eq!(played.scene.awake_count(), 0);
    for id in played.dynamic() {
        assert!(played.upright(id) > 0.999, "{id} fell over");
    }
}

#[test]
fn a_player_gathers_cubes_and_the_others_sleep() {
    let mut played = Played::usual("cubes");
    let player = BodyId::new(1, 0);
    let mut most_near = 0;
    for second in 1..=24 {
        played.run(60);
        let cubes = played.dynamic();
        assert_eq!(cubes.len(), 901);
        for id in &cubes {
            assert!(played.velocity(*id).length() < 33.0 && played.place(*id).y > 0.0);
        }
        // Only bodies near the player are awake.
        let awake = played.scene.awake_count();
        assert!((1..200).contains(&awake), "{awake} awake at {second} s");
        let (at, velocity) = (played.place(player), played.velocity(player));
        let carried = |id: &&BodyId| {
            let near = played.place(**id).distance(at) < 1.8;
            near && played.velocity(**id).distance(velocity) < 10.0
        };
        if second % 12 > 8 {
            most_near = cubes.iter().filter(carried).count().max(most_near);
        }
    }
    assert!(most_near > 15, "{most_near} gathered at most");
}

#[test]
fn ragdolls_hold_together_and_most_sleep() {
    let mut played = Played::usual("ragdolls");
    assert_eq!(played.dynamic().len(), 0);
    for _ in 0..10 {
        played.run(60);
        for (id, joint) in played.scene.joints().iter() {
            let ends = [0, 1].map(|end| {
                let parts = played.parts(joint.bodies[end]).map(f64::from);
                let [x, y, z, qx, qy, qz, qw, ..] = parts;
                let turn = DQuat::from_xyzw(qx, qy, qz, qw);
                DVec3::new(x, y, z) + turn * joint.frames[end].anchor.as_dvec3()
            });
            let apart = ends[0].distance(ends[1]);
            assert!(apart < 0.05, "{id} is {apart} m apart");
        }
    }
    assert_eq!(played.scene.joints().iter().count(), 9 * 20);
    assert_eq!(played.dynamic().len(), 10 * 20);
    // A limb that lies across another may keep twitching.
    assert!(
        played.scene.awake_count() <= 60,
        "{}",
        played.scene.awake_count()
    );
}

#[test]
fn a_tower_stands_while_a_wall_falls() {
    let mut played = Played::usual("stack");
    played.run(119);
    assert_eq!(played.scene.awake_count(), 0);
    let bodies = played.dynamic();
    assert_eq!(bodies.len(), 120);
    let before: Vec<_> = bodies.iter().map(|id| played.place(*id)).collect();
    played.run(12 * 60);
    assert_eq!(played.scene.awake_count(), 0);
    let moved = |(id, before): (&BodyId, &Vec3)| played.place(*id).distance(*before);
    let moved: Vec<_> = bodies.iter().zip(&before).map(moved).collect();
    assert!(moved[..20].iter().all(|far| *far < 0.02), "the tower moved");
    let struck = moved[20..].iter().filter(|far| **far > 0.3).count();
    assert!(struck > 30, "{struck} bricks moved");
}

#[test]
fn every_domino_falls_and_rests() {
    let mut played = Played::new("dominoes", 40, 1);
    played.run(29);
    let stones = played.dynamic();
    assert!(stones.iter().all(|id| played.upright(*id) > 0.99));
    played.run(15 * 60);
    assert!(stones.iter().all(|id| played.upright(*id) < 0.6));
    assert_eq!(played.scene.awake_count(), 0);
}

#[test]
fn a_drum_keeps_turning_and_loses_no_body() {
    let mut played = Played::usual("tumbler");
    for _ in 0..14 {
        played.run(60);
        let bodies = played.dynamic();
        assert_eq!(played.scene.awake_count(), bodies.len() + 14);
        let mut speeds = 0.0;
        for id in &bodies {
            let [x, y, z] = played.place(*id).to_array();
            assert!(
                (x * x + y * y).sqrt() < 4.15 && z.abs() < 3.0,
                "{id} got out"
            );
            speeds += played.velocity(*id).length();
        }
        assert!(speeds / bodies.len() as f32 > 0.5);
    }
}

#[test]
fn rain_falls_freely_between_throws() {
    let mut played = Played::usual("rain");
    for _ in 0..10 {
        played.run(60);
        let bodies = played.dynamic();
        assert_eq!(played.scene.awake_count(), bodies.len());
        let before: Vec<_> = bodies.iter().map(|id| played.velocity(*id)).collect();
        played.run(1);
        let pull = Vec3::new(0.0, -9.806_65 / 60.0, 0.0);
        let free =
            |(id, before): (&BodyId, Vec3)| (played.velocity(*id) - before - pull).length() < 1e-3;
        let free = bodies.iter().zip(before).filter(|pair| free(*pair)).count();
        assert!(
            free * 10 > bodies.len() * 9,
            "{free} of {} fly",
            bodies.len()
        );
    }
}

#[test]
fn asteroids_keep_their_speed_within_bounds() {
    for name in ["asteroids", "asteroids-plain"] {
        let mut played = Played::usual(name);
        for _ in 0..10 {
            played.run(60);
            let rocks = played.dynamic();
            assert_eq!(played.scene.awake_count(), 250);
            let far = |id: &BodyId| played.place(*id).length() < 31.5 + 2.0;
            assert!(rocks.iter().all(far), "{name} flies away");
            let speeds = rocks.iter().map(|id| played.velocity(*id).length());
            let mean = speeds.sum::<f32>() / rocks.len() as f32;
            assert!((2.3..2.7).contains(&mean), "{name}: {mean} m/s");
        }
    }
}

#[test]
fn the_mass_of_a_rock_is_the_cube_of_its_scale() {
    let mut played = Played::usual("asteroids-plain");
    played.run(1);
    let rocks = played.dynamic();
    let before: Vec<_> = rocks.iter().map(|id| played.velocity(*id)).collect();
    for id in &rocks {
        let (id, impulse) = (*id, Vec3::Y);
        let push = Command::Impulse { id, impulse };
        played.scene.apply(&push).expect("rocks can be pushed");
    }
    for (id, before) in rocks.iter().zip(before) {
        let mass = 1.0 / (played.velocity(*id) - before).y;
        assert!(
            (0.25_f32.powi(3) * 0.999..1.001).contains(&mass),
            "{mass} kg"
        );
        let radius = played.scene.bounding_radius(*id).expect("it has a shape");
        let scale = mass.cbrt();
        let whole = radius.metres() / f64::from(scale);
        assert!((1.4..1.95).contains(&whole), "{whole} m at scale one");
    }
}
