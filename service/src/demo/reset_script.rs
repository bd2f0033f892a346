//! A script that begins anew, again and again.
//!
//! A reset puts the script's bodies back where they began and removes all others. Bodies keep their ids, so that what
//! members know of them holds. It comes after so many seconds, or when nothing has been seen to move for some.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Command};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_scene::{Scene, SceneScript};
use rhumb_sims::Script;

/// When a scene begins anew, in seconds of its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ResetAfter {
    /// Since the last beginning.
    pub(super) seconds: u32,
    /// Since nothing is seen to move; `None` for a scene that stands still until a member moves something.
    pub(super) still_seconds: Option<u32>,
}

/// A script without end: its first commands, its controller, and resets.
pub(super) fn reset_script(mut script: Box<dyn Script>, after: ResetAfter) -> SceneScript {
    let mut controller = script.controller();
    let mut resets: Option<Resets> = None;
    SceneScript::new(move |scene: &Scene, out: &mut Vec<Command>| {
        let tick = scene.tick();
        match &mut resets {
            None => {
                script.commands(Tick::ZERO, out);
                resets = Some(Resets::new(out, scene, after));
            }
            Some(resets) => {
                let motion = |id| scene.observation(id).map(|observation| observation.motion);
                if resets.is_due(scene) {
                    resets.reset(scene, out);
                } else if let Some(controller) = &mut controller {
                    controller.before_step(tick, &motion, out);
                }
            }
        }
    })
}

/// The places of the script's bodies at its begin.
struct Resets {
    began: BTreeMap<BodyId, (BodyKind, BodyState)>,
    /// Ticks from one reset to the next.
    period: u64,
    /// Ticks of stillness before a reset.
    still_period: Option<u64>,
    /// Tick of the last reset.
    last: Tick,
    /// The last tick at which something was seen to move.
    moved: Tick,
}

/// Speed in m/s of the fastest body of a scene that counts as still: slower motion is hardly seen.
const STILL_SPEED: f32 = 0.1;

impl Resets {
    fn new(commands: &[Command], scene: &Scene, after: ResetAfter) -> Self {
        let began = commands.iter().filter_map(|command| match command {
            Command::AddBody { desc, motion } => Some((desc.id, (desc.kind, *motion))),
            _ => None,
        });
        let step_ns = scene.config().integrator.rate.step_ns();
        let ticks = |seconds: u32| (u64::from(seconds) * 1_000_000_000 / step_ns).max(1);
        Self {
            began: began.collect(),
            period: ticks(after.seconds),
            still_period: after.still_seconds.map(ticks),
            last: scene.tick(),
            moved: scene.tick(),
        }
    }

    /// Notes whether the scene moves; true if it is to begin anew.
    fn is_due(&mut self, scene: &Scene) -> bool {
        let tick = scene.tick();
        let moves = |seen: &Observation| {
            let velocity = Vec3::from_slice(&seen.motion.parts()[7..10]);
            velocity.length() > STILL_SPEED
        };
        if scene.observations().iter().any(moves) {
            self.moved = tick;
        }
        let since = |then: Tick| tick.value().saturating_sub(then.value());
        let is_still = self
            .still_period
            .is_some_and(|period| since(self.moved) >= period);
        is_still || since(self.last) >= self.period
    }

    fn reset(&mut self, scene: &Scene, out: &mut Vec<Command>) {
        self.last = scene.tick();
        self.moved = scene.tick();
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

    const fn every(seconds: u32) -> ResetAfter {
        ResetAfter {
            seconds,
            still_seconds: None,
        }
    }

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
        let mut script = reset_script(first, every(1));
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
    fn a_scene_that_stands_still_begins_anew() {
        let pit = Box::new(BallPit::new(20, 1, 3));
        let mut scene = Scene::new(pit.config()).unwrap();
        let after = ResetAfter {
            seconds: 3_600,
            still_seconds: Some(2),
        };
        let mut script = reset_script(pit, after);
        run(&mut script, &mut scene);
        let began = states(&scene);
        let speed = |state: &BodyState| Vec3::from_slice(&state.parts()[7..10]).length();
        let mut still = 0;
        for _ in 0..3_600 {
            scene.step().unwrap();
            let fastest = states(&scene)
                .iter()
                .map(|(_, state)| speed(state))
                .fold(0.0, f32::max);
            still = if fastest > STILL_SPEED { 0 } else { still + 1 };
            run(&mut script, &mut scene);
            if states(&scene) == began {
                assert_eq!(
                    still, 120,
                    "two seconds after the last ball was seen to move"
                );
                return;
            }
        }
        panic!("the balls lie still and are not dropped again");
    }

    #[test]
    fn a_player_moves_only_when_a_member_pushes_it() {
        let cubes = Box::new(Cubes::new(2, 1).driven_by_a_member());
        let mut scene = Scene::new(cubes.config()).unwrap();
        let mut script = reset_script(cubes, every(60));
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
