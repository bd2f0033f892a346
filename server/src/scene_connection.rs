//! The state of one connection in the loop of its scene.

use std::sync::Arc;

use rhumb_protocol::message::{ClientMessage, SessionRequest};

use crate::baking::Bake;
use crate::rights::Permit;

/// A connection: its rights, and its membership.
#[derive(Debug)]
pub(crate) struct SceneConnection {
    /// True once its client has said hello.
    pub(crate) is_greeted: bool,
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
            is_greeted: false,
            member: false,
            permit: Arc::new(Permit::OPEN),
            held: None,
            bake: None,
            session: None,
        }
    }
}
