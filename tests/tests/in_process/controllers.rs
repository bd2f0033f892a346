//! A controller has the same effect in a hosted scene as in a local one.
//!
//! The server and its member are real. The truth is a scene of this thread with the same script and the same hook. The
//! checksum over all observations is equal only if every push had its effect at its tick.

use glam::Vec3;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{BodyKind, Command, CommandError};
use rhumb_protocol::session::Event;
use rhumb_reckoning::{BodyId, Tick};
use rhumb_scene::{Hook, HookError, Hooks, Scene};
use rhumb_sims::{Controller, NAMES, Script, by_name};
use rhumb_tests::Table;

const TICKS: u64 = 240;

fn hook(mut controller: Box<dyn Controller>) -> Hook {
    Hook::new(move |scene: &Scene, out| {
        let motion = |id| scene.observation(id).map(|observation| observation.motion);
        controller.before_step(scene.tick(), &motion, out);
    })
}

fn script(name: &str) -> Box<dyn Script> {
    by_name(name, 20, 4).expect("an existing script")
}

/// Checksum of a script's run in this thread, with or without its controller.
fn alone(name: &str, controlled: bool) -> u64 {
    let mut script = script(name);
    let mut scene = Scene::new(script.config()).expect("a valid configuration");
    let mut hook = script.controller().filter(|_| controlled).map(hook);
    let mut commands = Vec::new();
    for tick in 0..TICKS {
        commands.clear();
        script.commands(Tick::new(tick), &mut commands);
        for command in &commands {
            scene.apply(command).expect("a valid command");
        }
        if let Some(hook) = &mut hook {
            assert_eq!(hook.act(&mut scene), [], "{name} at {}", scene.tick());
        }
        scene.step().expect("the engine does not fail");
    }
    scene.digest().value()
}

/// Checksum of the same run at a server, and the number of commands that were sent.
fn hosted(name: &'static str) -> (u64, usize) {
    let twin = script(name);
    let mut script = script(name);
    let hooks = Hooks::new(move |_, _| twin.controller().map(hook));
    let mut table = Table::with_hooks(hooks);
    let peer = table.create("played", script.config(), StreamChoice::Full);
    let (mut commands, mut sent) = (Vec::new(), 0);
    for tick in 0..TICKS {
        commands.clear();
        script.commands(Tick::new(tick), &mut commands);
        let now = table.now();
        let session = table.session(peer);
        sent += commands.len();
        for command in commands.drain(..) {
            session.command(command).expect("a member");
        }
        session.advance(now, Tick::new(tick + 1)).expect("a member");
        table.run_until_idle();
    }
    let session = table.session(peer);
    session.inspect().expect("a member");
    table.run_until_idle();
    let session = table.session(peer);
    let inspected = |event| match event {
        Event::Inspected(inspection) => Some(inspection.truth),
        _ => None,
    };
    let truth = std::iter::from_fn(|| session.poll_event()).find_map(inspected);
    (truth.expect("an inspection was requested"), sent)
}

#[test]
fn a_script_with_its_controller_has_one_result_hosted_or_local() {
    let mut controlled = 0;
    for name in NAMES {
        let (truth, _) = hosted(name);
        assert_eq!(truth, alone(name, true), "{name}");
        if script(name).controller().is_some() {
            assert_ne!(truth, alone(name, false), "{name} has an idle controller");
            controlled += 1;
        }
    }
    assert!(controlled >= 2);
}

#[test]
fn a_controller_sends_no_commands() {
    let mut script = script("asteroids");
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    assert_eq!(hosted("asteroids").1, commands.len());
}

#[test]
fn a_hook_moves_bodies_and_nothing_else() {
    let mut script = script("zoo");
    let mut scene = Scene::new(script.config()).expect("a valid configuration");
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    for command in &commands {
        scene.apply(command).expect("a valid command");
    }
    let dynamic = scene
        .bodies()
        .filter(|body| body.kind == BodyKind::Dynamic)
        .last()
        .map(|body| body.id)
        .expect("the zoo has dynamic bodies");
    let missing = BodyId::new(9_999, 0);
    let (up, none) = (Vec3::new(0.0, 9.0, 0.0), Vec3::ZERO);
    let mut hook = Hook::new(move |_: &Scene, out| {
        out.push(Command::RemoveBody { id: dynamic });
        out.push(Command::SetGravity { gravity: none });
        out.push(Command::Force {
            id: missing,
            force: up,
        });
        out.push(Command::SetVelocity {
            id: dynamic,
            linear: up,
            angular: none,
        });
    });
    let gravity = scene.gravity();
    let refused = hook.act(&mut scene);
    scene.step().expect("the engine does not fail");
    let unknown = HookError::Refused(CommandError::UnknownBody(missing));
    let expected = [HookError::NotAMotion, HookError::NotAMotion, unknown];
    assert_eq!(refused, expected);
    assert_eq!(scene.gravity(), gravity);
    let motion = scene.observation(dynamic).expect("an existing body").motion;
    assert!(motion.parts()[8] > 5.0, "{motion:?}");
}
