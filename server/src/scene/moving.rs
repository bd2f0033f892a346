//! Commands that move bodies: velocities, impulses, characters, vehicles.
//!
//! Invariant: no command makes a body faster than a velocity that can be set, along any axis, unless the body was faster
//! already. A command that exceeds that is refused, never shortened.

use glam::{DVec3, Vec3};
use rhumb_protocol::limits::{ANGULAR_MAX, LINEAR_MAX};
use rhumb_protocol::scene::{
    BodyKind, CommandError, Invalid, JumpFrom, Locomotion, Quantity, WheelInput,
};
use rhumb_reckoning::{BodyId, Twist};

use super::Scene;
use crate::engine::{EnginePart, Push};

/// Share by which rounding may lift a velocity above its limit: an impulse over a mass has three roundings of f32.
const ROUNDING: f64 = 1e-6;

impl Scene {
    pub(super) fn set_velocity(
        &mut self,
        id: BodyId,
        linear: Vec3,
        angular: Vec3,
    ) -> Result<(), CommandError> {
        let kind = self.enabled(id)?.kind;
        let twist = Twist {
            linear: linear.as_dvec3(),
            angular: angular.as_dvec3(),
        };
        match kind {
            BodyKind::Fixed => return Err(CommandError::NotPushable(id)),
            BodyKind::Dynamic => {
                let then = sum(twist, self.engine.pending(id));
                check_speed(self.coming(id), then)?;
            }
            BodyKind::Kinematic => {}
        }
        self.engine.set_velocity(id, twist);
        Ok(())
    }

    pub(super) fn push(&mut self, id: BodyId, push: Push) -> Result<(), CommandError> {
        self.pushable(id)?;
        if let Some(effect) = self.engine.effect(id, push) {
            let now = self.coming(id);
            check_speed(now, sum(now, effect))?;
        }
        self.engine.push(id, push);
        Ok(())
    }

    /// The velocities of a body at the end of the next step, if nothing but the commands until now moved it.
    fn coming(&self, id: BodyId) -> Twist {
        let observed = self.engine.observe_one(id);
        let now = observed.map_or(Twist::ZERO, |body| body.motion.motion().twist());
        sum(now, self.engine.pending(id))
    }
}

/// Refuses velocities beyond the limits, unless they were as far beyond them before.
fn check_speed(before: Twist, after: Twist) -> Result<(), CommandError> {
    let parts = [
        (before.linear, after.linear, LINEAR_MAX, Quantity::Linear),
        (
            before.angular,
            after.angular,
            ANGULAR_MAX,
            Quantity::Angular,
        ),
    ];
    for (before, after, most, quantity) in parts {
        let most = before.abs().max(DVec3::splat(f64::from(most))) * (1.0 + ROUNDING);
        if !after.is_finite() || after.abs().cmpgt(most).any() {
            return Err(CommandError::Invalid(Invalid::out_of_range(quantity)));
        }
    }
    Ok(())
}

fn sum(one: Twist, other: Twist) -> Twist {
    Twist {
        linear: one.linear + other.linear,
        angular: one.angular + other.angular,
    }
}

impl Scene {
    /// The locomotion of a body that is a character or a vehicle.
    #[must_use]
    pub fn locomotion(&self, id: BodyId) -> Option<&Locomotion> {
        self.registry.locomotion(id)
    }

    /// Every locomotion of a body, in the order of ids.
    pub(crate) fn locomotions(&self) -> impl Iterator<Item = &Locomotion> {
        self.registry.locomotions()
    }

    pub(super) fn set_locomotion(
        &mut self,
        id: BodyId,
        locomotion: &Locomotion,
    ) -> Result<(), CommandError> {
        self.supported(EnginePart::Locomotion(locomotion))?;
        self.registry.set_locomotion(id, locomotion)?;
        self.engine.set_locomotion(id, locomotion);
        Ok(())
    }

    /// Refuses what the engine does not have.
    pub(super) fn supported(&self, part: EnginePart<'_>) -> Result<(), CommandError> {
        let supports = self.engine.supports(part);
        supports.then_some(()).ok_or(CommandError::Unsupported)
    }

    pub(super) fn jump(
        &mut self,
        id: BodyId,
        speed: f32,
        from: JumpFrom,
    ) -> Result<(), CommandError> {
        self.enabled(id)?;
        match self.locomotion(id) {
            Some(Locomotion::Character(_)) => {
                self.engine.jump(id, speed, from);
                Ok(())
            }
            _ => Err(CommandError::NotCharacter(id)),
        }
    }

    pub(super) fn set_wheels(
        &mut self,
        id: BodyId,
        inputs: &[WheelInput],
    ) -> Result<(), CommandError> {
        self.enabled(id)?;
        self.registry.check_wheels(id, inputs.len())?;
        self.engine.set_wheels(id, inputs);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};
    use rhumb_protocol::limits::RATE_MAX;
    use rhumb_protocol::scene::{
        BodyDesc, BodyEvent, Character, Command, SceneConfig, Shape, ShapeId, Vehicle, Wheel,
    };
    use rhumb_reckoning::Rate;

    use super::*;
    use crate::engine::StepThreads;

    const CAR: BodyId = BodyId::new(1, 0);
    const WALKER: BodyId = BodyId::new(2, 0);

    /// A floor, a car of four wheels on it, and a character beside the car.
    fn scene(config: SceneConfig) -> Scene {
        let mut scene = Scene::new(config).unwrap();
        let places = [(-0.8, -1.2), (0.8, -1.2), (-0.8, 1.2), (0.8, 1.2)];
        let wheels = places.map(|(x, z)| Wheel::at(Vec3::new(x, -0.1, z), 0.3));
        let bodies = [
            BodyDesc::fixed(Shape::cuboid(50.0, 1.0, 50.0)).at(0.0, -1.0, 0.0),
            BodyDesc::dynamic(Shape::cuboid(0.8, 0.2, 1.6)).at(0.0, 0.7, 0.0),
            BodyDesc::kinematic(Shape::capsule(0.6, 0.3)).at(3.0, 0.92, 0.0),
        ];
        for (index, body) in (0..).zip(&bodies) {
            let shape = body.shape().clone();
            let id = ShapeId(index);
            scene.apply(&Command::AddShape { id, shape }).unwrap();
            let desc = body.desc(BodyId::new(index, 0), id);
            let motion = body.state().unwrap();
            scene.apply(&Command::AddBody { desc, motion }).unwrap();
        }
        for (id, locomotion) in [
            (
                CAR,
                Vehicle {
                    wheels: wheels.to_vec(),
                }
                .into(),
            ),
            (WALKER, Character::default().into()),
        ] {
            let locomotion = Box::new(locomotion);
            scene
                .apply(&Command::SetLocomotion { id, locomotion })
                .unwrap();
        }
        scene
    }

    fn steer(steering: f32) -> Command {
        let input = WheelInput {
            steering,
            force: 500.0,
            brake: 0.0,
        };
        Command::SetWheels {
            id: CAR,
            inputs: vec![input; 4],
        }
    }

    #[test]
    fn a_jump_and_a_drive_go_on_from_an_image_and_from_a_copy_to_the_same_bits() {
        let mut scene = scene(SceneConfig::default());
        for tick in 0..60 {
            if tick == 20 {
                scene.apply(&steer(0.2)).unwrap();
            }
            if tick == 50 {
                let (speed, from) = (5.0, JumpFrom::Ground);
                let id = WALKER;
                scene.apply(&Command::Jump { id, speed, from }).unwrap();
            }
            scene.step().unwrap();
        }
        let image = scene.freeze().unwrap().encode().unwrap();
        let at = (scene.tick(), scene.digest());
        let restored =
            Scene::from_image(*scene.config(), &StepThreads::default(), at, &image).unwrap();
        let mut others = [restored, scene.copy().unwrap()];
        let mut landed = false;
        for tick in 0..120 {
            if tick == 30 {
                scene.apply(&steer(-0.3)).unwrap();
                others
                    .iter_mut()
                    .for_each(|other| other.apply(&steer(-0.3)).unwrap());
            }
            let stepped = scene.step().unwrap();
            landed |= stepped
                .happened
                .events
                .contains(&BodyEvent::ReachedGround(WALKER));
            for other in &mut others {
                assert_eq!(other.step().unwrap(), stepped);
                assert_eq!(other.digest(), scene.digest());
                assert_eq!(other.locomotion(CAR), scene.locomotion(CAR));
            }
        }
        assert!(landed, "the character was in the air");
    }

    #[test]
    fn a_character_that_is_held_in_the_air_hangs_there_and_then_falls_however_short_a_tick_is() {
        let mut config = SceneConfig::default();
        config.integrator.rate = Rate::new(RATE_MAX, 1).unwrap();
        let mut scene = scene(config);
        let put = Command::SetPose {
            id: WALKER,
            position: Vec3::new(3.0, 5.0, 0.0),
            rotation: Quat::IDENTITY,
        };
        let height = |scene: &Scene| scene.observation(WALKER).unwrap().motion.position()[1];
        let mut events = Vec::new();
        for tick in 0..200 {
            if (50..100).contains(&tick) {
                scene.apply(&put).unwrap();
            }
            events.extend(scene.step().unwrap().happened.events);
            if (50..100).contains(&tick) {
                assert_eq!(height(&scene), 5.0);
            }
        }
        let walker = [
            BodyEvent::ReachedGround(WALKER),
            BodyEvent::LeftGround(WALKER),
        ];
        events.retain(|event| walker.contains(event));
        assert_eq!(events, walker);
        // A tenth of a second.
        let fallen = 5.0 - height(&scene);
        assert!((0.04..0.06).contains(&fallen), "{fallen}");
    }
}
