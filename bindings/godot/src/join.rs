//! Joins a scene on a thread of its own, so that no frame waits for a server.

use std::path::Path;
use std::thread::{self, JoinHandle};

use rhumb_bindings::{BindingError, JoinParams, server_of};
use rhumb_client::Client;

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
