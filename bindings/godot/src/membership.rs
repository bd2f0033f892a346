//! A scene that was joined: its client, and the node of each of its bodies.
//!
//! The node of the scene and those of its bodies share it. Invariant: nothing that may run a script is called while it is
//! borrowed, so that a script may call any node at any time.

use godot::global::{Error, godot_error};
use rhumb_bindings::SceneFollower;
use rhumb_client::scene::Command;
use rhumb_client::{Client, ClientError};

use crate::axes::AXES;
use crate::leaving::LeavingClient;

/// The client, and the node of each body; `N` is the type of the nodes.
pub(crate) struct SceneMembership<N> {
    pub(crate) client: LeavingClient,
    pub(crate) follower: SceneFollower<N>,
}

impl<N> SceneMembership<N> {
    pub(crate) fn new(client: Client) -> Self {
        Self {
            follower: SceneFollower::new(&client, AXES),
            client: LeavingClient::new(client),
        }
    }

    /// Queues a command, whose vectors are in Godot's axes.
    pub(crate) fn command(&mut self, command: Command) -> Result<(), ClientError> {
        self.client.command(AXES.command_in(command)).map(drop)
    }
}

/// Logs why a call failed, and returns Godot's name for it.
pub(crate) fn outcome(call: &str, result: Result<(), ClientError>) -> Error {
    let Err(error) = result else {
        return Error::OK;
    };
    godot_error!("{call}: {error}");
    match error {
        ClientError::Misuse(_)
        | ClientError::Id(_)
        | ClientError::OffCentre(_)
        | ClientError::Ticks(_)
        | ClientError::Refused(_) => Error::ERR_INVALID_PARAMETER,
        ClientError::Timeout { .. } => Error::ERR_TIMEOUT,
        ClientError::Denied(_) => Error::ERR_UNAUTHORIZED,
        ClientError::TooManyShapes => Error::ERR_OUT_OF_MEMORY,
        ClientError::Ended(_) | ClientError::SceneDeleted | ClientError::SceneFaulted(_) => {
            Error::ERR_CONNECTION_ERROR
        }
    }
}
