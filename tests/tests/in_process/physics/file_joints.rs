//! Joints of files, for some seconds beside closed forms.
//!
//! Of glTF, a pendulum on a hinge and one on two, a load on a slide with a drive, a sign that is fixed to a post; of URDF, a load on
//! a slide with damping and dry friction. No shapes, so that joints alone act.

use glam::DVec3;
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

fn loaded(name: &str, text: &str) -> LoadedScene {
    let mut files = MemoryFiles::default();
    files.insert(name, text);
    load(&files, name, &LoadOptions::default()).expect("a scene")
}

fn place(loaded: &LoadedScene, name: &str) -> BodyId {
    let mut bodies = loaded.bodies.iter();
    let place = bodies.position(|body| body.name == name);
    BodyId::new(place.expect("the file has it") as u32, 0)
}

fn made(loaded: &LoadedScene) -> Scene {
    let mut scene = Scene::new(loaded.config).expect("sound");
    for command in loaded.commands(FreeIds::default()).expect("few bodies") {
        scene.apply(&command).expect("sound");
    }
    scene
}

fn at(scene: &Scene, id: BodyId) -> DVec3 {
    let observation = scene.observation(id).expect("it is there");
    observation.motion.motion().pose().position
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
    // The pendulum swings alike where a second turn is left to it.
    let universal = FILE.replace("\"angularAxes\": [0, 1], ", "\"angularAxes\": [1], ");
    assert_ne!(universal, FILE);
    for text in [FILE, &universal] {
        compare(&loaded("joints.gltf", text));
    }
}

fn compare(loaded: &LoadedScene) {
    let [bob, load, sign] = ["bob", "load", "sign"].map(|name| place(loaded, name));
    let mut scene = made(loaded);
    let rate = loaded.config.integrator.rate;
    let gravity = f64::from(-loaded.config.gravity.y);
    let mut swings = swings(gravity, rate.step().seconds());
    let mut off = [0.0_f64; 3];
    for tick in 1..=SECONDS * rate.ticks() / rate.seconds() {
        scene.step().expect("no fault");
        let at = |id| at(&scene, id);
        let seconds = f64::from(tick) * rate.step().seconds();
        let swing = swings.next().expect("endless");
        off[0] = off[0].max((at(bob).x - swing).abs());
        off[1] = off[1].max((at(load).x - 5.0 - displacement(seconds)).abs());
        off[2] = off[2].max(at(sign).distance(DVec3::new(10.0, 1.0, 0.0)));
    }
    let [pendulum, slide, fixed] = off;
    assert!(pendulum < 0.005, "the pendulum is {pendulum} m off");
    assert!(slide < 0.01, "the load is {slide} m off");
    assert!(fixed < 0.001, "the sign is {fixed} m off");
}

/// m·v' = m·g − F − c·v, at rest at first.
#[test]
fn a_slide_with_damping_and_dry_friction_falls_as_its_closed_form_and_holds_what_friction_can() {
    for friction in [4.0, 12.0] {
        let text = format!(
            "<robot name='r'><link name='world'/><link name='load'><inertial><mass value='1'/>\
             <inertia ixx='.1' iyy='.1' izz='.1'/></inertial></link><joint name='slide' type='prismatic'>\
             <parent link='world'/><child link='load'/><axis xyz='0 0 1'/><limit lower='-20' upper='20'/>\
             <dynamics damping='2' friction='{friction}'/></joint></robot>"
        );
        let loaded = loaded("slide.urdf", &text);
        let load = place(&loaded, "load");
        let gravity = f64::from(-loaded.config.gravity.z);
        let last = (gravity - friction).max(0.0) / 2.0;
        let mut scene = made(&loaded);
        for tick in 1..=120 {
            scene.step().expect("no fault");
            let seconds = f64::from(tick) / 60.0;
            let fallen = last * (seconds - 0.5 * (1.0 - (-2.0 * seconds).exp()));
            let off = (at(&scene, load).z + fallen).abs();
            assert!(
                off < 0.03,
                "{off} m off after {seconds} s with {friction} N"
            );
        }
    }
}
