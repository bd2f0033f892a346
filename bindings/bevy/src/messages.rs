//! Messages that the plug-in writes: events of the scene, and its end.
//!
//! Read them with Bevy's `MessageReader`.

use std::error::Error;

use bevy_ecs::message::Message;
use rhumb_client::{ClientError, Event, Tick};

/// An event of the scene: a contact, a refused command, a removed body, an interrupted connection.
#[derive(Clone, Debug, PartialEq, Message)]
pub struct RhumbMessage {
    /// The newest complete tick when the data with which it arrived was read. States of later ticks show its effect.
    pub after: Tick,
    /// The event.
    pub event: Event,
}

/// The scene has ended: its connection is lost, it was deleted, its engine failed, or the server denied a step.
///
/// Written once for a scene. Its entities stay where they are until [`RhumbClient`](crate::RhumbClient) is removed.
#[derive(Debug, Message)]
pub struct RhumbEnded {
    /// The reason.
    pub error: ClientError,
}

/// A [`RhumbJoin`](crate::RhumbJoin) did not join its scene.
#[derive(Debug, Message)]
pub struct RhumbJoinFailed {
    /// The reason, such as an [`OpenError`](rhumb_client::OpenError).
    pub error: Box<dyn Error + Send + Sync>,
}
