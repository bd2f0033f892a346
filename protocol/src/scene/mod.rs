//! The nouns of a scene as clients and servers name them.
mod body;
mod checks;
mod command;
mod ids;
mod material;
mod name;
mod shape;
mod terms;

pub use body::{BodyKind, BodyTerms};
pub use checks::{Invalid, Quantity};
pub use command::{Command, CommandError};
pub use ids::IdRange;
pub use material::Material;
pub use name::{InvalidSceneName, SceneName};
pub use shape::{Shape, ShapeId};
pub use terms::{Pace, SceneTerms};
