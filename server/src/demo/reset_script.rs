//! A script that begins anew, again and again.
//!
//! A reset puts the script's bodies back where they began and removes all others. Bodies keep their ids, so that what
//! members know of them holds.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Command};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_sims::Script;

use crate::provided::SceneScript;
use crate::scene::Scene;

/// A script without end: its first commands, its controller, and a reset every so many seconds of the scene's time.
pub(super) fn reset_script(mut script: Box<dyn Script>, seconds: u32) -> SceneScript {
    let mut controller = script.controller();
    let mut resets: Option<Resets> = None;
    SceneScript::new(move |scene: &Scene, out: &mut Vec<Command>| {
        let tick = scene.tick();
        match &mut resets {
            None => {
                script.commands(Tick::ZERO, out);
                resets = Some(Resets::new(out, scene, seconds));
            }
            Some(resets) if resets.is_due(tick) => resets.reset(scene, out),
            Some(_) => {
                let motion = |id| scene.observation(id).map(|observation| observation.motion);
                if let Some(controller) = &mut controller {
                    controller.before_step(tick, &motion, out);
                }
            }
        }
    })
}

/// Where the script's bodies began.
struct Resets {
    began: BTreeMap<BodyId, (BodyKind, BodyState)>,
    /// Ticks from one reset to the next.
    period: u64,
    /// Tick of the last reset.
    last: Tick,
}

impl Resets {
    fn new(commands: &[Command], scene: &Scene, seconds: u32) -> Self {
        let began = commands.iter().filter_map(|command| match command {
            Command::AddBody { desc, motion } => Some((desc.id, (desc.kind, *motion))),
            _ => None,
        });
        let step_ns = scene.config().integrator.rate.step_ns();
        Self {
            began: began.collect(),
            period: (u64::from(seconds) * 1_000_000_000 / step_ns).max(1),
            last: scene.tick(),
        }
    }

    fn is_due(&self, tick: Tick) -> bool {
        tick.value().saturating_sub(self.last.value()) >= self.period
    }

    fn reset(&mut self, scene: &Scene, out: &mut Vec<Command>) {
        self.last = scene.tick();
        for body in scene.bodies() {
            let id = body.id;
            match self.began.get(&id) {
                None => out.push(Command::RemoveBody { id }),
                Some((BodyKind::Dynamic, motion)) => out.extend(put_back(id, motion)),
                // The controller moves kinematic bodies; fixed ones have not moved.
                Some((BodyKind::Fixed | BodyKind::Kinematic, _)) => {}
            }
        }
    }
}

fn put_back(id: BodyId, motion: &BodyState) -> [Command; 2] {
    let parts = motion.parts();
    let vector = |from: usize| Vec3::from_slice(&parts[from..from + 3]);
    [
        Command::SetPose {
            id,
            position: vector(0),
            rotation: Quat::from_slice(&parts[3..7]),
        },
        Command::SetVelocity {
            id,
            linear: vector(7),
            angular: vector(10),
        },
    ]
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::scene::{BodyDesc, ShapeId};
    use rhumb_sims::{BallPit, Cubes};

    use super::*;

    fn run(script: &mut SceneScript, scene: &mut Scene) {
        for command in script.commands(scene) {
            scene.apply(&command).unwrap();
        }
    }

    fn states(scene: &Scene) -> Vec<(BodyId, BodyState)> {
        let dynamic = scene.bodies().filter(|body| body.kind == BodyKind::Dynamic);
        let state = |id| scene.observation(id).unwrap().motion;
        dynamic.map(|body| (body.id, state(body.id))).collect()
    }

    #[test]
    fn a_reset_puts_the_scripts_bodies_back_and_removes_all_others() {
        let first = Box::new(BallPit::new(20, 1, 3));
        let mut scene = Scene::new(first.config()).unwrap();
        let mut script = reset_script(first, 1);
        run(&mut script, &mut scene);
        let began = states(&scene);
        assert_eq!(began.len(), 20);
        scene.step().unwrap();
        let other = BodyId::new(90_000, 0);
        let desc = BodyDesc::plain(other, BodyKind::Dynamic, ShapeId(11));
        let motion = began[0].1;
        scene.apply(&Command::AddBody { desc, motion }).unwrap();
        for _ in 1..60 {
            run(&mut script, &mut scene);
            scene.step().unwrap();
        }
        assert_ne!(states(&scene), began);
        assert!(scene.body(other).is_some());
        run(&mut script, &mut scene);
        assert_eq!(states(&scene), began);
        assert!(scene.body(other).is_none());
        scene.step().unwrap();
        run(&mut script, &mut scene);
        assert_ne!(states(&scene), began, "the next reset is later");
    }

    #[test]
    fn a_player_moves_only_when_a_member_pushes_it() {
        let cubes = Box::new(Cubes::new(2, 1).driven_by_a_member());
        let mut scene = Scene::new(cubes.config()).unwrap();
        let mut script = reset_script(cubes, 60);
        for _ in 0..600 {
            run(&mut script, &mut scene);
            scene.step().unwrap();
        }
        let player = scene.observation(Cubes::PLAYER).unwrap().motion;
        let velocity = Vec3::from_slice(&player.parts()[7..10]);
        assert!(velocity.length() < 0.1, "{player:?}");
        let impulse = Vec3::X * 20.0;
        let id = Cubes::PLAYER;
        scene.apply(&Command::Impulse { id, impulse }).unwrap();
        run(&mut script, &mut scene);
        scene.step().unwrap();
        let pushed = scene.observation(Cubes::PLAYER).unwrap().motion;
        assert!(pushed.parts()[7] > 1.0, "{pushed:?}");
    }
}
