//! Common to the bindings of all languages: coordinates, bodies, a scene.
//!
//! A binding turns the values of its language into the types of this crate and back. Nothing here knows a language, and
//! nothing here is `unsafe`.
//!
//! Every position, velocity, force and length of this crate is in the [`Coordinates`] of its scene. This crate alone
//! converts between them and Rhumb's own: right-handed, y up, metres.
#![forbid(unsafe_code)]

mod cells;
mod coordinates;
mod descriptions;
mod error;
#[cfg(feature = "local")]
mod feeding;
#[cfg(feature = "files")]
mod files;
mod generated;
mod joining;
#[cfg(feature = "serve")]
mod own_server;
mod records;
mod remote_scene;
mod view;

pub use cells::{CellBand, CellChoice, CellRecord, TakenState};
pub use coordinates::Coordinates;
pub use descriptions::{BodyParams, JointFreedom, JointParams, StateRecord};
pub use error::{BindingError, ErrorKind};
#[cfg(feature = "local")]
pub use feeding::{FedArrays, OpenRequests, RequestRecord, Rows};
#[cfg(feature = "files")]
pub use files::{Base, FileSettings, LoadParams, LoadedFile, NamedBody, NamedJoint, OwnContacts};
pub use generated::{EventKind, RequestKind};
pub use joining::{JoinCondition, JoinParams, address_with, server_of};
#[cfg(feature = "serve")]
pub use own_server::{OwnServer, Reach, ServedScenes};
pub use records::{
    ContactRecord, EventRecord, HitRecord, InvalidPackedId, RefusalRecord, packed_id,
    parse_packed_id,
};
pub use remote_scene::RemoteScene;
pub use rhumb_client;
pub use view::{ObjectChange, SceneFollower};
