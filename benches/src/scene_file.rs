//! `rhumb-bench dev scene`: a script's bodies as JSON, for other engines.
//!
//! Writes bodies, their initial states and the shared config; no joints, no forces, no controller. A script that needs
//! those is refused with the reason, since another engine would run a different scene.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use rhumb_protocol::scene::{BodyKind, Command, Shape};
use rhumb_reckoning::Tick;
use serde::Serialize;

use crate::output;
use crate::task::{Failure, ended};

/// Arguments: which scene, and where to write it.
#[derive(Clone, Debug, Args)]
pub struct SceneArguments {
    /// Name of the script.
    #[arg(default_value = "ball-pit", value_parser = clap::builder::PossibleValuesParser::new(rhumb_sims::NAMES))]
    scene: String,
    /// Number of bodies.
    #[arg(long, default_value_t = 500, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    bodies: u32,
    /// Number of ticks in which the script may place bodies.
    #[arg(long, default_value_t = 600)]
    ticks: u32,
    /// Seed of the script.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Output file.
    #[arg(long, default_value = "results/scene.json")]
    out: PathBuf,
}

/// `scene.json`: metres, seconds, kilograms; rotations are quaternions x, y, z, w.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct SceneFile {
    scene: String,
    seed: u64,
    gravity: [f32; 3],
    /// Duration of a tick, seconds.
    step_s: f64,
    friction: f32,
    restitution: f32,
    density: f32,
    linear_damping: f32,
    angular_damping: f32,
    bodies: Vec<SceneFileBody>,
}

/// A body and its initial state.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct SceneFileBody {
    /// The body is placed before the step that follows this tick.
    tick: u64,
    /// True if the engine moves it; other bodies are static.
    dynamic: bool,
    shape: SceneFileShape,
    position: [f32; 3],
    rotation: [f32; 4],
    linear: [f32; 3],
    angular: [f32; 3],
}

/// Shapes that the file can describe.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
enum SceneFileShape {
    Ball { radius: f32 },
    Cuboid { half_extents: [f32; 3] },
    Capsule { half_height: f32, radius: f32 },
    Cylinder { half_height: f32, radius: f32 },
    Hull { points: Vec<[f32; 3]> },
}

/// Writes a scene. Exit code 0 when it was written, 1 otherwise.
pub fn scene(arguments: &SceneArguments) -> ExitCode {
    ended(write(arguments))
}

fn write(arguments: &SceneArguments) -> Result<(), Failure> {
    let file = SceneFile::of(arguments)?;
    let folder = arguments.out.parent().unwrap_or(&arguments.out);
    output::make_folder(folder)?;
    output::write_json(&arguments.out, &file)?;
    let line = format!(
        "{} bodies: {}\n",
        file.bodies.len(),
        arguments.out.display()
    );
    Ok(output::print_text(&line)?)
}

impl SceneFile {
    fn of(arguments: &SceneArguments) -> Result<Self, String> {
        // The script does more than place bodies.
        let more = |what| {
            let scene = &arguments.scene;
            format!("{scene} cannot be described by bodies alone: it has {what}")
        };
        let script = rhumb_sims::by_name(&arguments.scene, arguments.bodies, arguments.seed);
        let mut script = script.expect("the parser accepts only known names");
        if script.controller().is_some() {
            return Err(more("a controller"));
        }
        let config = script.config();
        let (mut shapes, mut bodies) = (Vec::new(), Vec::new());
        let mut commands = Vec::new();
        for tick in 0..=u64::from(arguments.ticks) {
            commands.clear();
            script.commands(Tick::new(tick), &mut commands);
            for command in &commands {
                match command {
                    Command::AddShape { id, shape } => {
                        shapes.push((*id, SceneFileShape::of(shape)));
                    }
                    Command::AddBody { desc, motion } => {
                        if desc.material.is_some() || desc.damping.is_some() {
                            return Err(more("bodies with their own material or damping"));
                        }
                        let dynamic = match desc.kind {
                            BodyKind::Dynamic => true,
                            BodyKind::Fixed => false,
                            BodyKind::Kinematic => return Err(more("kinematic bodies")),
                        };
                        let shape = shapes.iter().rev().find(|(id, _)| *id == desc.shape);
                        let shape = shape.and_then(|(_, solid)| solid.clone());
                        let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = motion.parts();
                        bodies.push(SceneFileBody {
                            tick,
                            dynamic,
                            shape: shape.ok_or_else(|| more("ground, meshes or compounds"))?,
                            position: [px, py, pz],
                            rotation: [x, y, z, w],
                            linear: [vx, vy, vz],
                            angular: [wx, wy, wz],
                        });
                    }
                    _ => return Err(more("commands that do more than place bodies")),
                }
            }
        }
        Ok(Self {
            scene: arguments.scene.clone(),
            seed: arguments.seed,
            gravity: config.gravity.to_array(),
            step_s: config.integrator.rate.step().seconds(),
            friction: config.material.friction,
            restitution: config.material.restitution,
            density: config.material.density,
            linear_damping: config.damping.linear,
            angular_damping: config.damping.angular,
            bodies,
        })
    }
}

impl SceneFileShape {
    fn of(shape: &Shape) -> Option<Self> {
        Some(match shape {
            Shape::Ball { radius } => Self::Ball { radius: *radius },
            Shape::Cuboid { half_extents } => Self::Cuboid {
                half_extents: half_extents.to_array(),
            },
            Shape::Capsule {
                half_height,
                radius,
            } => Self::Capsule {
                half_height: *half_height,
                radius: *radius,
            },
            Shape::Cylinder {
                half_height,
                radius,
            } => Self::Cylinder {
                half_height: *half_height,
                radius: *radius,
            },
            Shape::Hull(hull) => Self::Hull {
                points: hull.points().iter().map(glam::Vec3::to_array).collect(),
            },
            Shape::Heights(_)
            | Shape::Mesh(_)
            | Shape::Compound(_)
            | Shape::RoundedCuboid { .. }
            | Shape::Cone { .. }
            | Shape::HalfSpace { .. } => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(scene: &str) -> Result<SceneFile, String> {
        SceneFile::of(&SceneArguments {
            scene: scene.to_owned(),
            bodies: 20,
            ticks: 10,
            seed: 1,
            out: PathBuf::new(),
        })
    }

    #[test]
    fn a_ball_pit_consists_of_walls_and_balls() {
        let pit = of("ball-pit").unwrap();
        let balls = pit.bodies.iter().filter(|body| body.dynamic);
        assert!(
            balls
                .clone()
                .all(|ball| ball.shape == SceneFileShape::Ball { radius: 0.5 })
        );
        assert_eq!(balls.count(), 20);
        assert!(pit.bodies.len() > 100);
        assert_eq!((pit.friction, pit.angular_damping), (0.2, 0.05));
    }

    #[test]
    fn a_scene_with_more_than_bodies_is_refused_with_the_reason() {
        for (scene, what) in [
            ("asteroids", "a controller"),
            ("ragdolls", "more than place bodies"),
            ("zoo", "zoo"),
        ] {
            let message = of(scene).unwrap_err();
            assert!(message.contains(what), "{message}");
        }
    }
}
