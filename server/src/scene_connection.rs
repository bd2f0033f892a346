//! The server loop's state of one connection.

use std::sync::Arc;

use rhumb_protocol::message::{ClientMessage, SessionRequest};
use rhumb_protocol::scene::SceneName;

use crate::baking::Bake;
use crate::rights::Permit;

/// A connection: its scene, its rights, and its membership.
#[derive(Debug)]
pub(crate) struct SceneConnection {
    pub(crate) scene: Option<SceneName>,
    /// True if its client is a member of the scene.
    pub(crate) member: bool,
    pub(crate) permit: Arc<Permit>,
    /// A join that waits until the link has taken the snapshot before it, or a shape whose solid is being made.
    pub(crate) held: Option<ClientMessage>,
    /// The solid of the held shape.
    pub(crate) bake: Option<Bake>,
    /// The session of its next join.
    pub(crate) session: Option<SessionRequest>,
}

impl Default for SceneConnection {
    /// A connection that may do everything.
    fn default() -> Self {
        Self {
            scene: None,
            member: false,
            permit: Arc::new(Permit::OPEN),
            held: None,
            bake: None,
            session: None,
        }
    }
}
