//! Cubes on a floor, and a player cube that pushes and gathers them.
//!
//! The public demo of networked physics (G. Fiedler), as far as its parameters are known: 30 × 30 cubes of 0.4 m at a
//! spacing of one metre and a player cube of 1.5 m. Gravity 20 m/s², density 1 kg/m³, friction 1, no bounce; damping
//! of a hundredth per step, 0.6038 1/s; speed limits 32 m/s and 16 rad/s. A body sleeps after 0.1 s with no point
//! faster than 0.25 m/s. A force of 120 N drives the player along the floor, up to 6 m/s. The player's behaviour is
//! ours:
//!
//! - It heads for a goal within 12 m of the centre and changes it every two seconds; it starts by falling from 3 m.
//! - It alternates between three actions of four seconds each. It rolls. It pushes: cubes within 2 m accelerate away
//!   by up to 60 m/s². It gathers: cubes within 1.8 m are carried along and drawn in, by up to 120 m/s².

use glam::{DVec3, Vec3};
use rhumb_protocol::scene::{BodyKind, Command, SceneConfig, Shape, Sleep, SleepThresholds};
use rhumb_reckoning::{BodyId, BodyState, Damping, Tick};

use crate::script::{Controller, SceneBuilder, SceneRng, Script, flight, still, surface};

/// Cubes and a player.
#[derive(Clone, Debug)]
pub struct Cubes {
    bodies: u32,
    seed: u64,
    driver: Driver,
}

/// The one that moves the player along the floor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Driver {
    /// The scene's controller.
    Goals,
    /// A member, by its commands.
    Member,
}

impl Cubes {
    /// Number of bodies, the player included.
    pub const BODIES: u32 = 901;
    /// The player.
    pub const PLAYER: BodyId = PLAYER;

    /// A scene of `bodies` bodies, one of them the player.
    #[must_use]
    pub fn new(bodies: u32, seed: u64) -> Self {
        Self {
            bodies: bodies.max(1),
            seed,
            driver: Driver::Goals,
        }
    }

    /// The same scene with a player that a member drives; its actions on the cubes around it remain.
    #[must_use]
    pub const fn driven_by_a_member(self) -> Self {
        Self {
            driver: Driver::Member,
            ..self
        }
    }
}

impl Script for Cubes {
    fn name(&self) -> &'static str {
        "cubes"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig {
            gravity: Vec3::new(0.0, -20.0, 0.0),
            material: surface(1.0, DENSITY),
            damping: Damping {
                linear: 0.6038,
                angular: 0.6038,
            },
            sleep: Sleep::Below(SleepThresholds::by_speed(0.25, 0.1)),
            ..SceneConfig::default()
        }
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let mut builder = SceneBuilder::default();
        builder.floor(200.0, out);
        let cube = |half| Shape::Cuboid {
            half_extents: Vec3::splat(half),
        };
        let (large, small) = (
            builder.shape(cube(PLAYER_HALF), out),
            builder.shape(cube(CUBE_HALF), out),
        );
        let above = still(Vec3::new(0.0, 3.0, 0.0));
        let player = builder.body(BodyKind::Dynamic, large, above, out);
        debug_assert_eq!(player, PLAYER, "the player comes after the floor");
        let cubes = self.bodies - 1;
        let side = (1..).find(|side: &u32| side * side >= cubes).unwrap_or(1);
        let middle = (side - 1) as f32 * 0.5;
        for place in 0..cubes {
            let (x, z) = (
                (place % side) as f32 - middle,
                (place / side) as f32 - middle,
            );
            let place = still(Vec3::new(x, CUBE_HALF, z));
            builder.body(BodyKind::Dynamic, small, place, out);
        }
    }

    fn controller(&self) -> Option<Box<dyn Controller>> {
        Some(Box::new(PlayerController {
            bodies: self.bodies,
            driver: self.driver,
            rng: SceneRng::new(self.seed),
            goal: Vec3::ZERO,
        }))
    }
}

/// Action of the player on the cubes around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PlayerAction {
    Roll,
    Push,
    Gather,
}

impl PlayerAction {
    fn at(tick: Tick) -> Self {
        match tick.value() / ACTION_TICKS % 3 {
            0 => Self::Roll,
            1 => Self::Push,
            _ => Self::Gather,
        }
    }
}

/// Moves the player's cube, acts on the cubes around it, and enforces the speed limits.
struct PlayerController {
    bodies: u32,
    driver: Driver,
    rng: SceneRng,
    goal: Vec3,
}

impl Controller for PlayerController {
    fn before_step(
        &mut self,
        tick: Tick,
        motion: &dyn Fn(BodyId) -> Option<BodyState>,
        out: &mut Vec<Command>,
    ) {
        if tick.value().is_multiple_of(GOAL_TICKS) {
            self.goal = self.rng.vector() * Vec3::new(12.0, 0.0, 12.0);
        }
        let Some(player) = motion(PLAYER) else { return };
        let (position, velocity) = flight(&player);
        let direction = (self.goal - position) * Vec3::new(1.0, 0.0, 1.0);
        let length = length(direction);
        let heads_for_goal = self.driver == Driver::Goals && length > 0.5;
        if heads_for_goal && velocity.dot(direction) < CRUISE * length {
            out.push(Command::Force {
                id: PLAYER,
                force: direction * (DRIVE / length),
            });
        }
        let action = PlayerAction::at(tick);
        for index in 0..self.bodies {
            let id = BodyId::new(PLAYER.index() + index, 0);
            let Some(cube) = motion(id) else { continue };
            out.extend(capped(id, &cube));
            let acceleration = if id == PLAYER {
                None
            } else {
                acceleration(action, &player, &cube)
            };
            if let Some(acceleration) = acceleration {
                let force = acceleration * CUBE_MASS;
                out.push(Command::Force { id, force });
            }
        }
    }
}

/// Acceleration of a cube by the player's action, m/s².
fn acceleration(action: PlayerAction, player: &BodyState, cube: &BodyState) -> Option<Vec3> {
    let ((position, velocity), (other, its_velocity)) = (flight(player), flight(cube));
    let away = other - position;
    let distance = length(away);
    match action {
        PlayerAction::Push if distance < PUSH_RADIUS && distance > 0.0 => {
            let share = 1.0 - distance / PUSH_RADIUS;
            Some(away * (PUSH * share / distance))
        }
        PlayerAction::Gather if distance < GATHER_RADIUS && distance > 0.0 => {
            // Target: the velocity of a point that is fixed to the player and moves inward slowly.
            let spin = Vec3::from_slice(&player.parts()[10..]);
            let carried = velocity + spin.cross(away) - away * (DRAW / distance);
            let acceleration = (carried - its_velocity) * GRIP;
            let size = length(acceleration);
            Some(if size > GATHER {
                acceleration * (GATHER / size)
            } else {
                acceleration
            })
        }
        PlayerAction::Roll | PlayerAction::Push | PlayerAction::Gather => None,
    }
}

/// A command that reduces a velocity above the limits.
fn capped(id: BodyId, motion: &BodyState) -> Option<Command> {
    let (_, linear) = flight(motion);
    let angular = Vec3::from_slice(&motion.parts()[10..]);
    let share = |vector: Vec3, most: f32| (most / length(vector)).min(1.0);
    let (slow, calm) = (share(linear, LINEAR_MOST), share(angular, ANGULAR_MOST));
    (slow < 1.0 || calm < 1.0).then(|| Command::SetVelocity {
        id,
        linear: linear * slow,
        angular: angular * calm,
    })
}

/// Length of a vector, rounded alike on every platform.
fn length(vector: Vec3) -> f32 {
    let wide: DVec3 = vector.as_dvec3();
    libm::sqrt(wide.length_squared()) as f32
}

/// The first body after the floor.
const PLAYER: BodyId = BodyId::new(1, 0);
/// Density, kg/m³.
const DENSITY: f32 = 1.0;
/// Half the edges of cubes and player, metres.
const CUBE_HALF: f32 = 0.2;
const PLAYER_HALF: f32 = 0.75;
/// Mass of a cube, kg.
const CUBE_MASS: f32 = 8.0 * CUBE_HALF * CUBE_HALF * CUBE_HALF * DENSITY;
/// Largest speed of the player towards its goal, m/s.
const CRUISE: f32 = 6.0;
/// Force on the player along the floor, N.
const DRIVE: f32 = 120.0;
/// Radius of a push in metres, and its acceleration at the centre in m/s².
const PUSH_RADIUS: f32 = 2.0;
const PUSH: f32 = 60.0;
/// Radius of gathering in metres, and its largest acceleration in m/s².
const GATHER_RADIUS: f32 = 1.8;
const GATHER: f32 = 120.0;
/// Speed at which gathered cubes move inward, m/s.
const DRAW: f32 = 1.0;
/// Rate at which a gathered cube's velocity approaches its target, 1/s.
const GRIP: f32 = 20.0;
/// Speed limits, m/s and rad/s.
const LINEAR_MOST: f32 = 32.0;
const ANGULAR_MOST: f32 = 16.0;
/// Ticks between changes of the goal, and between changes of the action.
const GOAL_TICKS: u64 = 120;
const ACTION_TICKS: u64 = 240;

#[cfg(test)]
mod tests {
    use glam::Quat;

    use super::*;
    use crate::script::motion;

    #[test]
    fn a_push_accelerates_outward_and_gathering_carries_along() {
        let moving = |position, linear| motion(position, Quat::IDENTITY, linear, Vec3::ZERO);
        let player = moving(Vec3::ZERO, Vec3::Z);
        let near = moving(Vec3::X, Vec3::ZERO);
        let far = moving(Vec3::X * 2.5, Vec3::ZERO);
        assert_eq!(
            acceleration(PlayerAction::Push, &player, &near),
            Some(Vec3::X * 30.0)
        );
        let gathered = acceleration(PlayerAction::Gather, &player, &near).expect("it is near");
        assert_eq!(gathered, Vec3::new(-20.0, 0.0, 20.0));
        for action in [PlayerAction::Roll, PlayerAction::Push, PlayerAction::Gather] {
            assert_eq!(acceleration(action, &player, &far), None);
        }
        let fast = moving(Vec3::ZERO, Vec3::X * 64.0);
        let slowed = capped(PLAYER, &fast);
        let expected = Command::SetVelocity {
            id: PLAYER,
            linear: Vec3::X * 32.0,
            angular: Vec3::ZERO,
        };
        assert_eq!(slowed, Some(expected));
        assert_eq!(capped(PLAYER, &player), None);
    }
}
