//! Membership in a scene: the way in, its client and its nodes, the way out.
//!
//! The node of the scene and those of its bodies share it. Invariant: nothing that may run a script is called while it is
//! borrowed, so that a script may call any node at any time.
//!
//! A scene is joined and left on threads of their own, so that no frame waits. A client that is dropped waits until its last
//! messages have left, half a second at most. Godot waits for those threads when it unloads the extension.

use std::ops::{Deref, DerefMut};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use godot::global::{Error, godot_error};
use rhumb_bindings::{BindingError, JoinParams, SceneFollower, server_of};
use rhumb_client::scene::Command;
use rhumb_client::{Client, ClientError};

use crate::conversion::AXES;

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
        | ClientError::Feed(_)
        | ClientError::Refused(_) => Error::ERR_INVALID_PARAMETER,
        ClientError::Timeout { .. } => Error::ERR_TIMEOUT,
        ClientError::Denied(_) => Error::ERR_UNAUTHORIZED,
        ClientError::TooManyShapes => Error::ERR_OUT_OF_MEMORY,
        ClientError::Ended(_) | ClientError::SceneDeleted | ClientError::SceneFaulted(_) => {
            Error::ERR_CONNECTION_ERROR
        }
    }
}

/// A server, its scene, and how to join it.
pub(crate) struct JoinRequest {
    pub(crate) address: String,
    pub(crate) fingerprint: String,
    pub(crate) roots: String,
    pub(crate) token: String,
    pub(crate) scene: String,
    pub(crate) params: JoinParams,
}

/// A client on its way into a scene.
pub(crate) struct PendingJoin {
    thread: JoinHandle<Result<Client, BindingError>>,
}

impl PendingJoin {
    pub(crate) fn start(request: JoinRequest) -> std::io::Result<Self> {
        let thread = thread::Builder::new().name("rhumb-godot-join".to_owned());
        Ok(Self {
            thread: thread.spawn(move || join(&request))?,
        })
    }

    pub(crate) fn is_finished(&self) -> bool {
        self.thread.is_finished()
    }

    /// The client, or a sentence that says why there is none.
    pub(crate) fn take(self) -> Result<Client, String> {
        match self.thread.join() {
            Ok(joined) => joined.map_err(|error| error.to_string()),
            Err(_) => {
                Err("the thread that joins panicked; its message is on standard error".to_owned())
            }
        }
    }
}

fn join(request: &JoinRequest) -> Result<Client, BindingError> {
    let given = |text: &str| (!text.is_empty()).then(|| text.to_owned());
    let (fingerprint, roots) = (given(&request.fingerprint), given(&request.roots));
    let roots = roots.as_deref().map(Path::new);
    let (address, trust) = server_of(&request.address, fingerprint.as_deref(), roots)?;
    let mut connection = Client::connect(address, trust)?;
    if let Some(token) = given(&request.token) {
        connection = connection.token(&token);
    }
    Ok(connection.join_with(&request.scene, request.params.options()?)?)
}

static LEAVING: Mutex<Vec<JoinHandle<()>>> = Mutex::new(Vec::new());

/// A client that is dropped on a thread of its own.
pub(crate) struct LeavingClient {
    /// `None` only while it is dropped.
    client: Option<Client>,
}

impl LeavingClient {
    const fn new(client: Client) -> Self {
        Self {
            client: Some(client),
        }
    }
}

impl Deref for LeavingClient {
    type Target = Client;

    fn deref(&self) -> &Client {
        self.client
            .as_ref()
            .expect("it is there until it is dropped")
    }
}

impl DerefMut for LeavingClient {
    fn deref_mut(&mut self) -> &mut Client {
        self.client
            .as_mut()
            .expect("it is there until it is dropped")
    }
}

impl Drop for LeavingClient {
    fn drop(&mut self) {
        let client = self.client.take();
        let thread = thread::Builder::new().name("rhumb-godot-leave".to_owned());
        // Without a thread the closure is dropped here, and the frame waits.
        if let Ok(thread) = thread.spawn(move || drop(client)) {
            let mut leaving = LEAVING.lock().unwrap_or_else(PoisonError::into_inner);
            leaving.retain(|other| !other.is_finished());
            leaving.push(thread);
        }
    }
}

/// Waits until all scenes are left.
pub(crate) fn wait_for_all() {
    let leaving = std::mem::take(&mut *LEAVING.lock().unwrap_or_else(PoisonError::into_inner));
    for thread in leaving {
        // A panic there has been printed.
        let _ = thread.join();
    }
}
