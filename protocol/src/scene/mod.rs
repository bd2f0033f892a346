//! The nouns of a scene as clients and servers name them.
mod body;
mod cadence;
mod checks;
mod command;
mod hull;
mod ids;
mod joint;
mod joints;
mod material;
mod name;
mod shape;
mod terms;

pub use body::{BodyKind, BodyTerms};
pub use cadence::Cadence;
pub use checks::{Invalid, Quantity};
pub use command::{Command, CommandError};
pub use hull::Hull;
pub use ids::IdRange;
pub use joint::{Joint, JointFrame, JointId, JointKind, JointLimits};
pub use joints::Joints;
pub use material::Material;
pub use name::{InvalidSceneName, SceneName};
pub use shape::{Shape, ShapeId};
pub use terms::{Pace, SceneTerms, SleepTerms};
