//! The server's recordings of scenes, and their viewers.

#[cfg(feature = "foxglove")]
use std::net::SocketAddr;
use std::path::PathBuf;

#[cfg(feature = "foxglove")]
use rhumb_transport::Origins;

use super::{RunError, Server, seconds_since_1970};
use crate::recording::{Recorder, RecordingLimits, SceneTaps};

/// The threads that read the scenes' states; dropping them ends them.
pub(super) struct Observers {
    _recorder: Option<Recorder>,
    #[cfg(feature = "foxglove")]
    _viewers: Option<crate::recording::LiveViewers>,
}

impl Server {
    /// Records every scene in MCAP files of this directory, which is made if it is missing.
    pub fn record_scenes(&mut self, directory: PathBuf) {
        self.record = Some(directory);
    }

    /// Shows every scene to Foxglove's viewers, over WebSockets at a TCP address, which is returned. It has no tokens:
    /// bind it where only those reach it who may see all scenes. Web pages pass if they are of this machine, of Foxglove,
    /// or among `pages`.
    ///
    /// # Errors
    ///
    /// [`RunError::Foxglove`] for an address that cannot be used.
    #[cfg(feature = "foxglove")]
    pub fn show_in_foxglove(
        &mut self,
        address: SocketAddr,
        pages: Origins,
    ) -> Result<SocketAddr, RunError> {
        let bound = crate::recording::BoundViewers::bind(address, pages);
        let viewers = bound.map_err(RunError::Foxglove)?;
        let local = viewers.address();
        self.foxglove = Some(viewers);
        Ok(local)
    }

    /// Starts the threads that read the states of later scenes.
    pub(super) fn start_observers(&mut self, taps: &SceneTaps) -> Result<Observers, RunError> {
        let limits = RecordingLimits::of(&self.scenes.limits);
        let recorder = match self.record.take() {
            None => None,
            Some(directory) => {
                let started = Recorder::start(directory.clone(), limits, seconds_since_1970, taps);
                let failed = |cause| RunError::Record { directory, cause };
                Some(started.map_err(failed)?)
            }
        };
        #[cfg(feature = "foxglove")]
        let viewers = match self.foxglove.take() {
            None => None,
            Some(bound) => Some(bound.start(limits, taps).map_err(RunError::Thread)?),
        };
        Ok(Observers {
            _recorder: recorder,
            #[cfg(feature = "foxglove")]
            _viewers: viewers,
        })
    }
}
