//! Requests about the scene, whose answers a call waits for.
//!
//! Each denial goes to the call that it answers: one of a stream fails no step.

use rhumb_protocol::message::{Denial, Inspection};

use super::Client;
use crate::error::ClientError;

impl Client {
    /// Requests an inspection of the scene, and waits for the answer. A scene that stands still answers, too.
    ///
    /// # Errors
    ///
    /// [`ClientError::Timeout`] when no answer arrives in time.
    pub fn inspect(&mut self) -> Result<Inspection, ClientError> {
        self.check_member()?;
        self.inspected = None;
        self.pump.session.inspect()?;
        let deadline = self.deadline();
        loop {
            if let Some(inspection) = self.inspected.take() {
                return Ok(inspection);
            }
            match self.turn(deadline, "inspection") {
                Ok(()) | Err(ClientError::SceneFaulted(_)) => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Deletes the scene for all members, and waits for the answer. One that stands still can be deleted, too.
    ///
    /// # Errors
    ///
    /// [`ClientError::Denied`] when the scene no longer exists.
    pub fn delete(&mut self) -> Result<(), ClientError> {
        self.check_member()?;
        self.pump.session.delete()?;
        self.denied = None;
        let deadline = self.deadline();
        while !self.deleted {
            if let Some(denial) = self.denied.take() {
                return Err(ClientError::Denied(denial));
            }
            match self.turn(deadline, "answer") {
                Ok(()) | Err(ClientError::SceneDeleted | ClientError::SceneFaulted(_)) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    /// Keeps a denial for the call that it answers (PROTOCOL 4.7-1).
    pub(super) const fn note_denial(&mut self, denial: Denial) {
        match denial {
            Denial::NotLockstep
            | Denial::TooFarAhead
            | Denial::AdvanceNotAllowed
            | Denial::SceneFaulted => self.denied_advance = Some(denial),
            Denial::Owned | Denial::Other(_) => {
                self.denied_advance = Some(denial);
                self.denied = Some(denial);
            }
            // No call waits for a stream.
            Denial::TooManyStreams => {}
            _ => self.denied = Some(denial),
        }
    }
}
