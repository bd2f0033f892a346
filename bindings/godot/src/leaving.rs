//! Leaves scenes on threads of their own, so that no frame waits.
//!
//! A client that is dropped waits until its last messages have left, half a second at most. Godot waits for those threads
//! when it unloads the extension.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};
use std::thread::{self, JoinHandle};

use rhumb_client::Client;

static LEAVING: Mutex<Vec<JoinHandle<()>>> = Mutex::new(Vec::new());

/// A client that is dropped on a thread of its own.
pub(crate) struct LeavingClient {
    /// `None` only while it is dropped.
    client: Option<Client>,
}

impl LeavingClient {
    pub(crate) const fn new(client: Client) -> Self {
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
