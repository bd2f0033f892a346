//! The physics engine behind a trait.

mod engines;
mod interface;
mod kinematic_target;
mod rapier;
mod rapier_body;
mod rapier_characters;
mod rapier_contacts;
mod rapier_joints;
mod rapier_query;
mod rapier_solid;
mod rapier_vehicles;
mod rapier_workers;

pub use engines::Engines;
pub use interface::{
    BakedShape, Baker, BodyProperties, Engine, EngineFault, FrozenEngine, Push, UnanswerableQuery,
    UnusableShape,
};
pub use rapier::RapierEngine;
#[cfg(feature = "app")]
pub(crate) use rapier_solid::bulk;
pub use rapier_workers::{Workers, WorkersError};
