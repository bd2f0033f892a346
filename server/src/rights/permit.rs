//! The rights of one connection.

use std::sync::Arc;

use rhumb_protocol::message::Role;

/// The name of a client in its tokens. It owns what it adds to a scene, over all its connections.
pub type ClientName = Arc<str>;

/// The rights of one connection.
#[derive(Clone, Debug, PartialEq)]
pub struct Permit {
    /// `None` without a token: then nothing in a scene belongs to the client.
    pub client: Option<ClientName>,
    /// What kind of requests it may make.
    pub role: Role,
    /// How much of the scene it may take.
    pub quotas: Quotas,
}

/// Limits of one client in one scene; `None` leaves the server's own limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Quotas {
    /// Bodies at one time.
    pub bodies: Option<u32>,
    /// Commands in a second, on average over a second. A faster client waits.
    pub commands: Option<u32>,
    /// Body steps in a second: ticks times substeps times the client's bodies.
    pub load: Option<u64>,
    /// Members at one time.
    pub members: Option<u32>,
}

impl Permit {
    /// The rights of every client of an open server.
    pub const OPEN: Self = Self {
        client: None,
        role: Role::Owner,
        quotas: Quotas {
            bodies: None,
            commands: None,
            load: None,
            members: None,
        },
    };
}
