//! A script's run depends only on its name, body count and seed.
//!
//! Proved by runs in this process, compared with each other and with recorded digests.

use rhumb_protocol::scene::{BodyDesc, BodyKind};
use rhumb_scene::{Digest, Hook, Scene};
use rhumb_sims::{NAMES, Script, by_name};

/// Runs a script and hands each tick's observations to `check`.
fn run(script: &mut dyn Script, ticks: u32, mut check: impl FnMut(&Scene)) -> Scene {
    let mut scene = Scene::new(script.config()).expect("the test makes it valid");
    let mut hook = script.controller().map(|mut controller| {
        Hook::new(move |scene: &Scene, out| {
            let motion = |id| scene.observation(id).map(|observation| observation.motion);
            controller.before_step(scene.tick(), &motion, out);
        })
    });
    let mut commands = Vec::new();
    for _ in 0..ticks {
        commands.clear();
        script.commands(scene.tick(), &mut commands);
        for command in &commands {
            let answer = scene.apply(command);
            assert_eq!(answer, Ok(()), "{command:?} at {}", scene.tick());
        }
        if let Some(hook) = &mut hook {
            hook.act(&mut scene);
        }
        assert_eq!(
            scene
                .step()
                .expect("an engine of Rapier steps what it was given")
                .removed,
            []
        );
        check(&scene);
    }
    scene
}

#[test]
fn equal_seeds_give_equal_runs_and_traces_give_their_digests() {
    for name in NAMES {
        let script = |seed| by_name(name, 30, seed).unwrap();
        let mut traced = Digest::START;
        let scene = run(script(1).as_mut(), 400, |scene| {
            traced.fold_tick(scene.tick(), scene.observations());
            let ids = scene.observations().iter().map(|one| one.id);
            assert!(ids.is_sorted_by(|a, b| a < b));
        });
        assert_eq!(scene.digest(), traced);
        let again = run(script(1).as_mut(), 400, |_| {});
        assert_eq!(scene.digest(), again.digest(), "{name}");
        let other = run(script(2).as_mut(), 400, |_| {});
        assert_ne!(scene.digest(), other.digest(), "{name}");
    }
}

/// Measured once; another value means that this build disagrees with every recorded trace and every other machine.
#[test]
fn runs_are_equal_to_the_bit_in_every_build() {
    let mut other = Vec::new();
    for (name, digest) in [
        ("ball-pit", 0x1761_74c9_5f0f_5f77),
        ("asteroids", 0xe7d7_5609_183d_2927),
        ("asteroids-plain", 0x1739_8353_208a_2c9e),
        ("rest-10k", 0x0101_f5a5_de09_9d44),
        ("cubes", 0x1672_7a3c_7f35_1741),
        ("ragdolls", 0xc66d_440f_ae3a_0960),
        ("stack", 0x2fc0_7311_ed7d_b00e),
        ("dominoes", 0xccbc_423a_f79b_0813),
        ("tumbler", 0xdb44_ad25_839b_1d2c),
        ("rain", 0x9f05_a0ec_d3a8_02d0),
        ("free-fall", 0xa75d_beac_460e_79f0),
        ("zoo", 0xa9f7_bb5b_4c6d_45d6),
    ] {
        let scene = run(by_name(name, 50, 1).unwrap().as_mut(), 600, |_| {});
        if scene.digest().value() != digest {
            other.push((name, scene.digest().to_string()));
        }
    }
    assert_eq!(other, []);
}

#[test]
fn unobserved_bodies_have_not_changed() {
    let mut known = std::collections::BTreeMap::new();
    let mut script = by_name("zoo", 20, 5).unwrap();
    run(script.as_mut(), 1_500, |scene| {
        for one in scene.observations() {
            known.insert(one.id, one.motion);
        }
        let mut all = Vec::new();
        scene.observe_all(&mut all);
        assert_eq!(all.len(), scene.body_count());
        for one in all {
            let before = *known.entry(one.id).or_insert(one.motion);
            assert_eq!(before, one.motion, "{} at {}", one.id, scene.tick());
        }
    });
}

#[test]
fn no_ball_leaves_the_pit() {
    let mut script = by_name("ball-pit", 500, 11).unwrap();
    let balls = |scene: &Scene| {
        let dynamic = |desc: &&BodyDesc| desc.kind == BodyKind::Dynamic;
        scene.bodies().filter(dynamic).count()
    };
    let scene = run(script.as_mut(), 1_800, |_| {});
    assert_eq!(balls(&scene), 500);
    let mut all = Vec::new();
    scene.observe_all(&mut all);
    for one in all {
        if scene.body(one.id).unwrap().kind == BodyKind::Dynamic {
            let [x, y, z] = one.motion.position();
            assert!(x.abs() < 105.0 && z.abs() < 105.0 && y > -1.0);
        }
    }
}
