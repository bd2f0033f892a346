//! Common to the bindings of all languages: coordinates, bodies, a scene.
//!
//! A binding turns the values of its language into the types of this crate and back. Nothing here knows a language, and
//! nothing here is `unsafe`.
//!
//! Every position, velocity, force and length of this crate is in the [`Coordinates`] of its scene. This crate alone
//! converts between them and Rhumb's own: right-handed, y up, metres.
#![forbid(unsafe_code)]

mod body_params;
mod contacts;
mod converted_view;
mod coordinates;
#[cfg(feature = "serve")]
mod door;
mod error;
mod event_record;
#[cfg(feature = "files")]
mod files;
mod generated;
mod join_params;
mod joint_params;
#[cfg(feature = "serve")]
mod own_server;
mod packed_id;
mod refusal_record;
mod remote_scene;
mod scene_follower;
mod trust;

pub use body_params::BodyParams;
pub use contacts::ContactRecord;
pub use coordinates::Coordinates;
pub use error::{BindingError, ErrorKind};
pub use event_record::EventRecord;
#[cfg(feature = "files")]
pub use files::{Base, FileSettings, LoadParams, LoadedFile, NamedBody, NamedJoint, OwnContacts};
pub use generated::EventKind;
pub use join_params::{JoinCondition, JoinParams};
pub use joint_params::{JointFreedom, JointParams};
#[cfg(feature = "serve")]
pub use own_server::{OwnServer, Reach, ServedScenes};
pub use packed_id::{InvalidPackedId, packed_id, parse_packed_id};
pub use refusal_record::RefusalRecord;
pub use remote_scene::{HitRecord, RemoteScene, StateRecord};
pub use rhumb_client;
pub use scene_follower::{ObjectChange, SceneFollower};
pub use trust::{address_with, server_of};
