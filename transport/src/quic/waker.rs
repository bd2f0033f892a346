//! Wakes the thread of a server for a listener of another protocol.

use std::sync::mpsc::Sender;

use super::input::Input;

/// Wakes the thread that runs a server.
#[derive(Clone, Debug)]
pub struct Waker(pub(super) Sender<Input>);

impl Waker {
    /// Has the thread call the listener soon. A server that has ended is not woken.
    pub fn wake(&self) {
        // An error means that the server loop has ended.
        let _ = self.0.send(Input::Wake);
    }
}
