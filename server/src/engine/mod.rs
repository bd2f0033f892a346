//! The physics engine behind a trait.

#[cfg(feature = "box3d")]
mod box3d;
#[cfg(feature = "box3d")]
mod box3d_body;
#[cfg(feature = "box3d")]
mod box3d_contacts;
#[cfg(feature = "box3d")]
mod box3d_joints;
#[cfg(feature = "box3d")]
mod box3d_native;
#[cfg(feature = "box3d")]
mod box3d_shapes;
mod engine_kind;
mod engines;
mod interface;
mod kinematic_target;
mod rapier;
mod rapier_body;
mod rapier_characters;
mod rapier_contacts;
mod rapier_drives;
mod rapier_ease;
mod rapier_held_joint;
mod rapier_joints;
mod rapier_motor_law;
mod rapier_motors;
mod rapier_query;
mod rapier_rest;
mod rapier_solid;
mod rapier_spin;
mod rapier_threads;
mod rapier_vehicles;

#[cfg(feature = "box3d")]
pub use box3d::Box3dEngine;
pub use engine_kind::{EngineKind, UnknownEngine};
pub use engines::Engines;
pub use interface::{
    BakedShape, Baker, BodyProperties, Engine, EngineFault, EnginePart, FrozenEngine, NoEngine,
    Push, UnanswerableQuery, UnusableShape,
};
pub use rapier::RapierEngine;
#[doc(hidden)]
pub use rapier_solid::{ShapeVolume, shape_volume};
pub use rapier_threads::{StepThreads, StepThreadsError};
