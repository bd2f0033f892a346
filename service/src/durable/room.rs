//! The room of a data directory: what one tenant's scenes, and all, may take.
//!
//! Each log looks for itself, on its own thread, so that processes need not tell each other. Between two looks a log grows by
//! [`LOOK_BYTES`] at most.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

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
    /// True once the log names something of others that cannot be measured.
    has_warned: Arc<AtomicBool>,
}

impl Room {
    pub(super) fn new((disk, scenes): (Arc<dyn Disk>, PathBuf), limits: &Limits) -> Self {
        Self {
            disk,
            scenes,
            tenant_bytes: limits.tenant_data_mib << 20,
            all_bytes: limits.data_mib << 20,
            has_warned: Arc::default(),
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

    /// The bytes of a name that cannot be measured: what others left there breaks no log.
    fn pass_over(&self, path: &Path, cause: &io::Error) -> u64 {
        if !self.has_warned.swap(true, Ordering::Relaxed) {
            let path = path.display();
            tracing::warn!(%path, %cause, "cannot be measured, and counts for nothing in the data directory");
        }
        0
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
            let bytes = match self.disk.bytes_in(&directory) {
                Err(cause) if !is_own => self.pass_over(&directory, &cause),
                bytes => bytes.map_err(DataError::io(&directory, "measure"))?,
            };
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::durable::disk::SystemDisk;

    const MIB: usize = 1 << 20;

    /// A directory of scenes, each with a file of so many bytes.
    fn scenes(of: &[(&str, usize)]) -> tempfile::TempDir {
        let scenes = tempfile::tempdir().unwrap();
        for (name, bytes) in of {
            std::fs::create_dir(scenes.path().join(name)).unwrap();
            std::fs::write(
                scenes.path().join(name).join("00000000.log"),
                vec![0; *bytes],
            )
            .unwrap();
        }
        scenes
    }

    fn room(scenes: &Path, (tenant_data_mib, data_mib): (u64, u64)) -> Room {
        let limits = Limits {
            tenant_data_mib,
            data_mib,
            ..Limits::default()
        };
        Room::new((Arc::new(SystemDisk), scenes.to_owned()), &limits)
    }

    /// The limits that refuse a scene, with its own files and without them.
    fn refusing(room: &Room, own: &str) -> [Option<&'static str>; 2] {
        let own = room.scenes.join(own);
        [room.check(&own), room.check_others(&own)].map(|checked| match checked {
            Ok(()) => None,
            Err(DataError::Full { limit, .. }) => Some(limit),
            Err(other) => panic!("{other}"),
        })
    }

    #[test]
    fn a_tenant_has_its_part_and_the_scenes_of_others_do_not_count_in_it() {
        let of = [
            ("team%2fa.0", MIB),
            ("team%2fb.1", 9),
            ("shop%2fa.2", 9),
            ("pit.3", 9),
        ];
        let scenes = scenes(&of);
        let room = room(scenes.path(), (1, 2));
        let part = Some("tenant_data_mib");
        assert_eq!(refusing(&room, "team%2fa.0"), [part, None]);
        assert_eq!(
            refusing(&room, "team%2fb.1"),
            [part, part],
            "its tenant's other scene"
        );
        assert_eq!(refusing(&room, "shop%2fa.2"), [None; 2]);
        assert_eq!(refusing(&room, "pit.3"), [None; 2], "it has no tenant");
    }

    #[test]
    fn all_scenes_together_have_the_directory_s_part() {
        let scenes = scenes(&[("team%2fa.0", MIB), ("pit.3", 9)]);
        let room = room(scenes.path(), (2, 1));
        assert_eq!(refusing(&room, "pit.3"), [Some("data_mib"); 2]);
        assert_eq!(refusing(&room, "team%2fa.0"), [Some("data_mib"), None]);
    }

    #[test]
    fn a_plain_file_among_the_scenes_counts_and_breaks_no_log() {
        let scenes = scenes(&[("pit.0", 9)]);
        let room = room(scenes.path(), (2, 1));
        let notes = scenes.path().join("notes.txt");
        std::fs::write(&notes, "of an operator").unwrap();
        assert_eq!(refusing(&room, "pit.0"), [None; 2]);
        std::fs::write(&notes, vec![0; MIB]).unwrap();
        assert_eq!(refusing(&room, "pit.0"), [Some("data_mib"); 2]);
    }

    /// A link to itself cannot be read by anyone, not even by root.
    #[cfg(unix)]
    #[test]
    fn what_others_left_and_none_can_read_breaks_no_log() {
        let scenes = scenes(&[("pit.0", 9)]);
        let room = room(scenes.path(), (1, 1));
        for name in ["loop", "other.7"] {
            std::os::unix::fs::symlink(name, scenes.path().join(name)).unwrap();
        }
        assert!(SystemDisk.bytes_in(&scenes.path().join("loop")).is_err());
        assert_eq!(refusing(&room, "pit.0"), [None; 2]);
        // A scene whose own files cannot be read is not durable.
        let own = scenes.path().join("other.7");
        assert!(matches!(room.check(&own), Err(DataError::Io { .. })));
    }
}
