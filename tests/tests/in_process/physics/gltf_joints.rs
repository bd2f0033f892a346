//! Joints of a glTF file, for ten seconds beside closed forms.
//!
//! A pendulum on a hinge, a load on a slide with a drive, a sign that is fixed to a post: no shapes, so that joints alone act.

use rhumb_reckoning::BodyId;
use rhumb_scene::Scene;
use rhumb_scene_files::{FreeIds, LoadOptions, LoadedScene, MemoryFiles, load};

/// Bodies of 2 kg. The pendulum of 0.5 m begins 0.15 m to the side, the load 0.3 m beside the rest of its drive.
const FILE: &str = r#"{"asset": {"version": "2.0"}, "nodes": [
    {"name": "bob", "translation": [0.15, -0.4769696, 0], "children": [1],
        "extensions": {"KHR_physics_rigid_bodies": {"motion": {"mass": 2, "inertiaDiagonal": [0.1, 0.1, 0.1]}}}},
    {"name": "eye", "translation": [-0.15, 0.4769696, 0]},
    {"name": "hook", "extensions": {"KHR_physics_rigid_bodies": {"joint": {"joint": 0, "connectedNode": 1}}}},
    {"name": "load", "translation": [5.3, 0, 0],
        "extensions": {"KHR_physics_rigid_bodies": {"motion": {"mass": 2, "inertiaDiagonal": [0.1, 0.1, 0.1]}}}},
    {"name": "rail", "translation": [5, 0, 0],
        "extensions": {"KHR_physics_rigid_bodies": {"joint": {"joint": 1, "connectedNode": 3}}}},
    {"name": "sign", "translation": [10, 1, 0],
        "extensions": {"KHR_physics_rigid_bodies": {"motion": {"mass": 2, "inertiaDiagonal": [0.1, 0.1, 0.1]}}}},
    {"name": "post", "translation": [10, 1, 0],
        "extensions": {"KHR_physics_rigid_bodies": {"joint": {"joint": 2, "connectedNode": 5}}}}],
    "extensions": {"KHR_physics_rigid_bodies": {"physicsJoints": [
        {"limits": [{"linearAxes": [0, 1, 2], "min": 0, "max": 0}, {"angularAxes": [0, 1], "min": 0, "max": 0}]},
        {"limits": [{"linearAxes": [1, 2], "min": 0, "max": 0}, {"angularAxes": [0, 1, 2], "min": 0, "max": 0}],
            "drives": [{"type": "linear", "mode": "force", "axis": 0, "stiffness": 8, "damping": 0.4}]},
        {"limits": [{"linearAxes": [0, 1, 2], "min": 0, "max": 0}, {"angularAxes": [0, 1, 2], "min": 0, "max": 0}]}]}}}"#;

const SECONDS: u32 = 10;

fn loaded() -> LoadedScene {
    let mut files = MemoryFiles::default();
    files.insert("joints.gltf", FILE);
    load(&files, "joints.gltf", &LoadOptions::default()).expect("a scene")
}

/// Place of the pendulum's centre to the side after each tick: θ'' = −(m·g·l / (I + m·l²)) sin θ by Runge and Kutta's method.
fn swings(gravity: f64, step: f64) -> impl Iterator<Item = f64> {
    let (mass, arm, moment) = (2.0, 0.5, 0.1);
    let rate = mass * gravity * arm / (moment + mass * arm * arm);
    let change = move |[angle, speed]: [f64; 2]| [speed, -rate * angle.sin()];
    let moved = |[a, b]: [f64; 2], [x, y]: [f64; 2], by: f64| [a + x * by, b + y * by];
    let mut state = [f64::asin(0.15 / arm), 0.0];
    std::iter::repeat_with(move || {
        const PARTS: u32 = 16;
        let part = step / f64::from(PARTS);
        for _ in 0..PARTS {
            let one = change(state);
            let two = change(moved(state, one, part / 2.0));
            let three = change(moved(state, two, part / 2.0));
            let four = change(moved(state, three, part));
            for (slope, weight) in [(one, 1.0), (two, 2.0), (three, 2.0), (four, 1.0)] {
                state = moved(state, slope, part * weight / 6.0);
            }
        }
        arm * state[0].sin()
    })
}

/// Distance of the load from the rest of its drive: m·x'' + c·x' + k·x = 0, at rest at 0.3 m.
fn displacement(seconds: f64) -> f64 {
    let (mass, stiffness, damping) = (2.0, 8.0, 0.4);
    let decay: f64 = damping / (2.0 * mass);
    let rate = (stiffness / mass - decay * decay).sqrt();
    let phase = rate * seconds;
    0.3 * (-decay * seconds).exp() * (phase.cos() + decay / rate * phase.sin())
}

#[test]
fn joints_of_gltf_move_as_closed_forms_for_ten_seconds() {
    let loaded = loaded();
    let place = |name: &str| {
        let is_it = |body: &rhumb_scene_files::LoadedBody| body.name == name;
        let place = loaded.bodies.iter().position(is_it);
        BodyId::new(place.expect("the file has it") as u32, 0)
    };
    let [bob, load, sign] = ["bob", "load", "sign"].map(place);
    let mut scene = Scene::new(loaded.config).expect("sound");
    for command in loaded.commands(FreeIds::default()).expect("few bodies") {
        scene.apply(&command).expect("sound");
    }
    let rate = loaded.config.integrator.rate;
    let gravity = f64::from(-loaded.config.gravity.y);
    let mut swings = swings(gravity, rate.step().seconds());
    let mut off = [0.0_f64; 3];
    for tick in 1..=SECONDS * rate.ticks() / rate.seconds() {
        scene.step().expect("no fault");
        let at = |id| {
            let observation = scene.observation(id).expect("it is there");
            observation.motion.motion().pose().position
        };
        let seconds = f64::from(tick) * rate.step().seconds();
        let swing = swings.next().expect("endless");
        off[0] = off[0].max((at(bob).x - swing).abs());
        off[1] = off[1].max((at(load).x - 5.0 - displacement(seconds)).abs());
        off[2] = off[2].max(at(sign).distance(glam::DVec3::new(10.0, 1.0, 0.0)));
    }
    let [pendulum, slide, fixed] = off;
    assert!(pendulum < 0.005, "the pendulum is {pendulum} m off");
    assert!(slide < 0.01, "the load is {slide} m off");
    assert!(fixed < 0.001, "the sign is {fixed} m off");
}
