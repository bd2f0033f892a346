//! The room of a data directory: what one tenant's scenes, and all, may take.
//!
//! Each log looks for itself, on its own thread, so that processes need not tell each other. Between two looks a log grows by
//! [`LOOK_BYTES`] at most.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rhumb_scene::{Limits, tenant_of};

use super::data_dir::scene_of;
use super::disk::Disk;
use super::error::DataError;

/// Bytes of a log after which the room is looked at again.
pub(super) const LOOK_BYTES: usize = 4 << 20;

/// The bounds of a data directory.
#[derive(Clone)]
pub(crate) struct Room {
    disk: Arc<dyn Disk>,
    /// The directory of all scenes.
    scenes: PathBuf,
    tenant_bytes: u64,
    all_bytes: u64,
}

impl Room {
    pub(super) fn new((disk, scenes): (Arc<dyn Disk>, PathBuf), limits: &Limits) -> Self {
        Self {
            disk,
            scenes,
            tenant_bytes: limits.tenant_data_mib << 20,
            all_bytes: limits.data_mib << 20,
        }
    }

    /// Refuses if the tenant of the scene with this directory, or all scenes, have as much as they may.
    pub(super) fn check(&self, own: &Path) -> Result<(), DataError> {
        self.check_without(own, false)
    }

    /// The same as if the scene's own files were gone, which a snapshot replaces.
    pub(super) fn check_others(&self, own: &Path) -> Result<(), DataError> {
        self.check_without(own, true)
    }

    fn check_without(&self, own: &Path, leaves_out_own: bool) -> Result<(), DataError> {
        let list = DataError::io(&self.scenes, "list");
        let names = self.disk.list(&self.scenes).map_err(list)?;
        let own_name = own
            .file_name()
            .and_then(|name| name.to_str())
            .unwrap_or_default();
        let own_scene = scene_of(own_name);
        let own_tenant = own_scene.as_ref().and_then(tenant_of);
        let (mut of_tenant, mut of_all) = (0, 0);
        for name in &names {
            let is_own = name == own_name;
            if is_own && leaves_out_own {
                continue;
            }
            let directory = self.scenes.join(name);
            let bytes = self.disk.bytes_in(&directory);
            let bytes = bytes.map_err(DataError::io(&directory, "measure"))?;
            of_all += bytes;
            let scene = scene_of(name);
            let tenant = scene.as_ref().and_then(tenant_of);
            if is_own || tenant.is_some() && tenant == own_tenant {
                of_tenant += bytes;
            }
        }
        let full = |limit, bytes, most| {
            Err(DataError::Full {
                path: self.scenes.clone(),
                limit,
                bytes,
                most,
            })
        };
        match (of_tenant >= self.tenant_bytes, of_all >= self.all_bytes) {
            (true, _) => full("tenant_data_mib", of_tenant, self.tenant_bytes),
            (_, true) => full("data_mib", of_all, self.all_bytes),
            _ => Ok(()),
        }
    }
}
