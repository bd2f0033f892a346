//! Robots and scenes from files: URDF, MJCF, glTF, meshes and Rhumb's JSON.
//!
//! A file becomes a [`LoadedScene`]: shapes, bodies and joints as ordinary commands, so that the wire does not know of
//! files. A part of a file that a scene cannot have is listed in its [`Report`]; nothing is dropped in silence. The crate
//! opens no file itself: it asks a [`Files`]. Invariants: no input panics; depth, sizes and numbers are bounded; an
//! error names the file and the line.
#![forbid(unsafe_code)]

mod assemble;
mod files;
mod gltf;
mod inertia;
mod json;
mod json_joints;
mod load;
mod mesh;
mod mjcf;
mod model;
mod overlap;
mod report;
mod solid;
mod urdf;
mod xml;

pub use assemble::{FreeIds, LoadedBody, LoadedJoint, LoadedScene};
pub use files::{FileError, Files, Folder, MemoryFiles};
pub use json::{SceneFile, SceneFileBody, SceneFilePart, SceneFileShape, SceneFileSleep};
pub use json_joints::{SceneFileFrame, SceneFileJoint, SceneFileJointKind, SceneFileMotor};
pub use load::{FileScript, NotAFile, load, load_text};
pub use model::{Base, LoadOptions, OwnContacts, UpAxis};
pub use report::{Effect, LoadError, Note, Place, Problem, Report};
