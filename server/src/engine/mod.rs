//! The physics engine behind a trait.

mod interface;
mod kinematic_target;
mod rapier;
mod rapier_body;
mod rapier_solid;
mod rapier_workers;

pub use interface::{Bulk, Contact, Engine, EngineFault, NewBody, Push, UnusableShape};
pub use rapier::RapierEngine;
pub use rapier_solid::{bulk, hull_of};
pub use rapier_workers::{Workers, WorkersError};
