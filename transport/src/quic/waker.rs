//! Wakes the server thread from other threads.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;

use super::input::Input;

/// Wakes the server thread, which drains its endpoint then; all clones are one.
#[derive(Clone, Debug)]
pub struct Waker {
    inputs: Sender<Input>,
    /// True if a wake-up waits already: many before the thread wakes are one.
    waiting: Arc<AtomicBool>,
}

impl Waker {
    pub(super) fn new(inputs: Sender<Input>) -> Self {
        Self {
            inputs,
            waiting: Arc::new(AtomicBool::new(false)),
        }
    }

    /// Wakes the server thread.
    pub fn wake(&self) {
        if !self.waiting.swap(true, Ordering::AcqRel) {
            // If the server thread has ended, there is nothing to wake.
            let _ = self.inputs.send(Input::Wake);
        }
    }

    /// The server thread is awake.
    pub(super) fn note_woken(&self) {
        self.waiting.store(false, Ordering::Release);
    }
}
