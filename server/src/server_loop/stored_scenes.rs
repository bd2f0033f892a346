//! The data directory of a server loop.
//!
//! A scene whose files are damaged is not served, and keeps its
//! name until a client deletes it.

use std::collections::BTreeMap;
use std::sync::Arc;

use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::SceneName;

use crate::durable::{DataDir, Origin, SceneFiles, SceneLog, Wake};

/// The data directory, and the scenes in it that cannot be served.
#[derive(Default)]
pub(super) struct StoredScenes {
    pub(super) data: Option<DataDir>,
    pub(super) wake: Option<Wake>,
    pub(super) damaged: BTreeMap<SceneName, SceneFiles>,
}

impl StoredScenes {
    /// Reason why a scene without a runner cannot be joined.
    pub(super) fn denial(&self, name: &SceneName) -> Denial {
        if self.damaged.contains_key(name) {
            Denial::SceneFaulted
        } else {
            Denial::NoSuchScene
        }
    }

    /// Removes the files of a damaged scene; `false` for any other scene, and if they cannot be removed.
    pub(super) fn delete_damaged(&mut self, name: &SceneName) -> bool {
        let Some(files) = self.damaged.get(name) else {
            return false;
        };
        if let Err(error) = files.delete() {
            tracing::error!(scene = %name, %error, "a damaged scene stays");
            return false;
        }
        self.damaged.remove(name);
        true
    }

    pub(super) fn start(&self, files: SceneFiles, origin: Origin) -> Option<SceneLog> {
        let scene = origin.name.clone();
        let wake = (self.wake.clone()).unwrap_or_else(|| Arc::new(|| {}));
        match SceneLog::start(files, origin, wake) {
            Ok(log) => Some(log),
            Err(cause) => {
                tracing::error!(%scene, %cause, "no thread for a command log; nothing is durable");
                None
            }
        }
    }
}
