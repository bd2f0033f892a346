//! A data directory: its lock, its key, its scenes' directories, and its room.
//!
//! The room is what one tenant's scenes, and all, may take.
//! Each log looks for itself, on its own thread, so that processes need not tell each other. Between two looks a log grows by
//! [`LOOK_BYTES`] at most.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rhumb_protocol::scene::SceneName;
use rhumb_scene::{Limits, tenant_of};
use rhumb_transport::DevelopmentPem;
use ring::hmac;
use ring::rand::{SecureRandom, SystemRandom};

use super::disk::{Damage, DataError, Disk, SystemDisk, parent};
use super::scene_files::{
    DAMAGED, Generation, Numbered, SceneFiles, directories_by_scene, directory_name,
    newest_directories, next_number, older_directories, parse_deleted_directory, parse_directory,
    scene_of,
};

const LOCK: &str = "lock";
const KEY: &str = "key";
const CERTIFICATE: &str = "certificate.pem";
const CERTIFICATE_KEY: &str = "certificate-key.pem";
const SCENES: &str = "scenes";
const KEY_BYTES: usize = 32;

/// A data directory that this process alone uses, or with servers of one directory of scenes; all clones are one.
#[derive(Clone)]
pub struct DataDir(Arc<Opened>);

struct Opened {
    disk: Arc<dyn Disk>,
    path: PathBuf,
    scenes: PathBuf,
    key: hmac::Key,
    /// Number of the next creation.
    next: AtomicU64,
    /// True if other processes make scenes there too.
    is_shared: bool,
    /// Held for its lock; `None` in a worker process, which has inherited it.
    lock: Option<File>,
}

impl DataDir {
    /// Opens a directory, and makes it if it does not exist.
    ///
    /// # Errors
    ///
    /// [`DataError`] for a directory that cannot be written, or that another process uses.
    pub fn open(path: &Path) -> Result<Self, DataError> {
        Self::open_alone(path)
    }

    /// Opens a directory that other servers use at the same time, each scene by one of them.
    ///
    /// # Errors
    ///
    /// [`DataError`] for a directory that cannot be written, or that a process uses alone, if only for a moment: a server that
    /// starts clears up first.
    pub fn open_shared(path: &Path) -> Result<Self, DataError> {
        std::fs::create_dir_all(path).map_err(DataError::io(path, "make the directory"))?;
        match Self::open_alone(path) {
            Ok(alone) => drop(alone.development_certificate()?),
            // Its others have done so.
            Err(DataError::InUse { .. }) => {}
            Err(other) => return Err(other),
        }
        let file = path.join(LOCK);
        let lock = File::open(&file).map_err(DataError::io(&file, "open"))?;
        let lock = taken(lock.try_lock_shared(), lock, path, &file)?;
        let opened = Self::of_worker(path)?;
        let Opened {
            disk, scenes, key, ..
        } = &*opened.0;
        Ok(Self(Arc::new(Opened {
            disk: Arc::clone(disk),
            path: path.to_owned(),
            scenes: scenes.clone(),
            key: key.clone(),
            next: AtomicU64::new(0),
            is_shared: true,
            lock: Some(lock),
        })))
    }

    fn open_alone(path: &Path) -> Result<Self, DataError> {
        let scenes = path.join(SCENES);
        std::fs::create_dir_all(&scenes).map_err(DataError::io(&scenes, "make the directory"))?;
        let lock = lock(path)?;
        let key = read_or_make_key(path)?;
        let disk: Arc<dyn Disk> = Arc::new(SystemDisk);
        let names = (disk.list(&scenes)).map_err(DataError::io(&scenes, "list"))?;
        for name in names
            .iter()
            .filter(|name| parse_deleted_directory(name).is_some())
        {
            let directory = scenes.join(name);
            if !directory.is_dir() {
                // A file of someone else.
                continue;
            }
            (disk.remove_directory(&directory)).map_err(DataError::io(&directory, "remove"))?;
        }
        let directories = names.iter().filter(|name| scenes.join(name).is_dir());
        let directories: Vec<String> = directories.cloned().collect();
        let older = older_directories(&directories);
        for name in &older {
            let (from, to) = (scenes.join(name), scenes.join(format!("{name}.{DAMAGED}")));
            disk.rename(&from, &to)
                .map_err(DataError::io(&from, "rename"))?;
        }
        if !older.is_empty() {
            (disk.sync_directory(&scenes)).map_err(DataError::io(&scenes, "synchronise"))?;
        }
        Ok(Self(Arc::new(Opened {
            disk,
            path: path.to_owned(),
            scenes,
            key,
            next: AtomicU64::new(next_number(&names)),
            is_shared: false,
            lock: Some(lock),
        })))
    }

    /// Opens, in a worker process, the directory of its dispatcher. The dispatcher sees to it that a scene's files have
    /// one process at a time, and the directory stays locked until the last process of its server has ended.
    pub(crate) fn of_worker(path: &Path) -> Result<Self, DataError> {
        let (scenes, file) = (path.join(SCENES), path.join(KEY));
        let bytes = std::fs::read(&file).map_err(DataError::io(&file, "read"))?;
        let disk: Arc<dyn Disk> = Arc::new(SystemDisk);
        let names = (disk.list(&scenes)).map_err(DataError::io(&scenes, "list"))?;
        Ok(Self(Arc::new(Opened {
            disk,
            path: path.to_owned(),
            scenes,
            key: key_of(&bytes, &file)?,
            next: AtomicU64::new(next_number(&names)),
            is_shared: true,
            lock: None,
        })))
    }

    /// The directory's path.
    pub(crate) fn path(&self) -> &Path {
        &self.0.path
    }

    /// A copy of the lock's file, for a process that is to inherit the lock.
    pub(crate) fn lock_to_inherit(&self) -> io::Result<Option<File>> {
        self.0.lock.as_ref().map(File::try_clone).transpose()
    }

    /// Opens a directory that exists, and writes nothing.
    ///
    /// # Errors
    ///
    /// [`DataError`] for a directory that cannot be read, that is none of a server, or that a process uses.
    pub fn open_to_read(path: &Path) -> Result<Self, DataError> {
        let file = path.join(LOCK);
        let lock = File::open(&file).map_err(DataError::io(&file, "open"))?;
        let lock = take(lock, path, &file)?;
        let file = path.join(KEY);
        let bytes = std::fs::read(&file).map_err(DataError::io(&file, "read"))?;
        Ok(Self(Arc::new(Opened {
            disk: Arc::new(SystemDisk),
            path: path.to_owned(),
            scenes: path.join(SCENES),
            key: key_of(&bytes, &file)?,
            next: AtomicU64::new(0),
            is_shared: false,
            lock: Some(lock),
        })))
    }

    /// The files of the directory's own certificate for development and of its key, made at the first call: clients that
    /// pin the certificate find the server again after a restart.
    ///
    /// # Errors
    ///
    /// [`DataError::Io`] if they cannot be written.
    pub fn development_certificate(&self) -> Result<(PathBuf, PathBuf), DataError> {
        let certificate = self.0.path.join(CERTIFICATE);
        let key = self.0.path.join(CERTIFICATE_KEY);
        // The key goes first: a certificate has a key, and one without is made anew.
        if !certificate.exists() {
            let made = DevelopmentPem::new(["localhost"]).map_err(DataError::Certificate)?;
            write_secret(&key, made.key.as_bytes()).map_err(DataError::io(&key, "write"))?;
            let written = write_secret(&certificate, made.certificate.as_bytes());
            written.map_err(DataError::io(&certificate, "write"))?;
        }
        Ok((certificate, key))
    }

    /// The scenes that it has.
    ///
    /// # Errors
    ///
    /// [`DataError::Io`] if the directory cannot be read.
    pub(crate) fn scenes(&self) -> Result<Vec<(SceneName, SceneFiles)>, DataError> {
        let scenes = &self.0.scenes;
        let names = (self.0.disk.list(scenes)).map_err(DataError::io(scenes, "list"))?;
        let files = newest_directories(&names).into_iter();
        Ok(files
            .map(|(scene, (_, name))| (scene, self.files(name)))
            .collect())
    }

    /// Bytes of all scenes, and of the files of others among them: of those that can be read.
    pub(crate) fn bytes(&self) -> io::Result<u64> {
        let Opened { disk, scenes, .. } = &*self.0;
        let bytes = disk.list(scenes)?.into_iter().map(|name| {
            let is_own = parse_directory(&name)
                .or_else(|| parse_deleted_directory(&name))
                .is_some();
            match disk.bytes_in(&scenes.join(&name)) {
                // It was deleted meanwhile.
                Err(cause) if cause.kind() == io::ErrorKind::NotFound => Ok(0),
                Err(_) if !is_own => Ok(0),
                bytes => bytes,
            }
        });
        bytes.sum()
    }

    /// The disk, and the directory of all scenes on it.
    pub(super) fn scenes_on_disk(&self) -> (Arc<dyn Disk>, PathBuf) {
        (Arc::clone(&self.0.disk), self.0.scenes.clone())
    }

    /// The files of a scene that is created now.
    pub(crate) fn create(&self, scene: &SceneName) -> SceneFiles {
        if self.0.is_shared
            && let Ok(names) = self.0.disk.list(&self.0.scenes)
        {
            self.0
                .next
                .fetch_max(next_number(&names), Ordering::Relaxed);
        }
        let number = self.0.next.fetch_add(1, Ordering::Relaxed);
        self.files(&directory_name(scene, number))
    }

    /// Gives the files of claimed scenes, where there are any, to this server alone: each has them in a directory named by its
    /// claim's epoch, or by a greater number. Another server, which had them, finds them no more, and what it still appends to
    /// an open file comes after the end that is read here. `is_held`: true while no other server can have claimed the scenes.
    pub(crate) fn take_over(
        &self,
        claims: &[(SceneName, u64)],
        is_held: &dyn Fn() -> bool,
    ) -> Result<Vec<Result<Generation, DataError>>, DataError> {
        let Opened { disk, scenes, .. } = &*self.0;
        let names = disk.list(scenes).map_err(DataError::io(scenes, "list"))?;
        // If the claims are over, the names may be those of another server's claims.
        let is_held = is_held();
        let numbered = directories_by_scene(&names);
        let none = Vec::new();
        let take = |(scene, epoch): &(SceneName, u64)| {
            let directories = numbered.get(scene).unwrap_or(&none);
            self.take_one((scene, *epoch), directories, is_held)
        };
        let taken = claims.iter().map(take).collect();
        disk.sync_directory(scenes)
            .map_err(DataError::io(scenes, "synchronise"))?;
        Ok(taken)
    }

    fn take_one(
        &self,
        (scene, epoch): (&SceneName, u64),
        directories: &[Numbered<'_>],
        is_held: bool,
    ) -> Result<Generation, DataError> {
        let Opened { disk, scenes, .. } = &*self.0;
        let greatest = directories.iter().map(|of| of.number).max();
        let own = match greatest.filter(|greatest| *greatest >= epoch) {
            None => epoch,
            Some(greatest) if is_held => {
                tracing::warn!(%scene, epoch, greatest, "the scene's directory has a greater number than its claim, as after a new beginning of etcd: its directory gets the next number");
                greatest + 1
            }
            Some(greatest) => {
                let path = scenes.join(directory_name(scene, greatest));
                return Err(DataError::TakenOver { path });
            }
        };
        let mut of_scene: Vec<_> = directories.iter().filter(|of| of.is_scene).collect();
        of_scene.sort_by_key(|of| of.number);
        let Some(newest) = of_scene.pop() else {
            return Ok(Generation(own));
        };
        let rename = |from: &str, to: String| {
            let from = scenes.join(from);
            let renamed = disk.rename(&from, &scenes.join(to));
            renamed.map_err(DataError::io(&from, "rename"))
        };
        rename(newest.name, directory_name(scene, own))?;
        for older in of_scene {
            // Of an owner that woke late: the scene must not continue from there if the newest is deleted.
            rename(older.name, format!("{}.{DAMAGED}", older.name))?;
        }
        Ok(Generation(own))
    }

    /// The files of a scene that was taken over: `None` if it has none.
    pub(super) fn files_of(
        &self,
        scene: &SceneName,
        generation: Generation,
    ) -> Result<Option<SceneFiles>, DataError> {
        let files = self.files_to_make(scene, generation);
        let names = self.0.disk.list(&files.directory);
        let names = names.map_err(DataError::io(&files.directory, "list"))?;
        Ok((!names.is_empty()).then(|| SceneFiles {
            is_there: Some(Arc::new(AtomicBool::new(true))),
            ..files
        }))
    }

    /// The files of a scene that was taken over without any, and is created now.
    pub(super) fn files_to_make(&self, scene: &SceneName, generation: Generation) -> SceneFiles {
        SceneFiles {
            is_there: Some(Arc::default()),
            ..self.files(&directory_name(scene, generation.0))
        }
    }

    /// The files of a scene that takes the place of an earlier one of its name, in a directory that no server uses.
    pub(crate) fn replace(&self, scene: &SceneName) -> Result<SceneFiles, DataError> {
        let Opened { disk, scenes, .. } = &*self.0;
        let names = disk.list(scenes).map_err(DataError::io(scenes, "list"))?;
        let number = next_number(&names);
        Ok(self.files(&directory_name(scene, number)))
    }

    fn files(&self, directory: &str) -> SceneFiles {
        SceneFiles {
            disk: Arc::clone(&self.0.disk),
            directory: self.0.scenes.join(directory),
            key: self.0.key.clone(),
            is_there: None,
        }
    }
}

fn lock(path: &Path) -> Result<File, DataError> {
    let file = path.join(LOCK);
    let lock = (OpenOptions::new().write(true).create(true).truncate(false))
        .open(&file)
        .map_err(DataError::io(&file, "open"))?;
    take(lock, path, &file)
}

/// Locks a directory by its file, until the file is closed.
fn take(lock: File, path: &Path, file: &Path) -> Result<File, DataError> {
    taken(lock.try_lock(), lock, path, file)
}

fn taken(
    tried: Result<(), TryLockError>,
    lock: File,
    path: &Path,
    file: &Path,
) -> Result<File, DataError> {
    match tried {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(DataError::InUse {
            path: path.to_owned(),
        }),
        Err(TryLockError::Error(cause)) => Err(DataError::io(file, "lock")(cause)),
    }
}

/// The key of the directory's snapshots: only files that were written with it are trusted.
fn read_or_make_key(path: &Path) -> Result<hmac::Key, DataError> {
    let file = path.join(KEY);
    let bytes = match std::fs::read(&file) {
        Err(cause) if cause.kind() == io::ErrorKind::NotFound => {
            let made = make_key(&file);
            made.map_err(DataError::io(&file, "write"))?.to_vec()
        }
        read => read.map_err(DataError::io(&file, "read"))?,
    };
    key_of(&bytes, &file)
}

fn key_of(bytes: &[u8], file: &Path) -> Result<hmac::Key, DataError> {
    if bytes.len() != KEY_BYTES {
        return Err(DataError::damaged(file, Damage::Beginning));
    }
    Ok(hmac::Key::new(hmac::HMAC_SHA256, bytes))
}

fn make_key(path: &Path) -> io::Result<[u8; KEY_BYTES]> {
    let mut key = [0; KEY_BYTES];
    (SystemRandom::new().fill(&mut key)).map_err(|_| io::Error::from(io::ErrorKind::Other))?;
    write_secret(path, &key)?;
    Ok(key)
}

/// Writes a file that its owner alone may read, as a whole.
fn write_secret(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let temporary = path.with_extension("tmp");
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        options.mode(0o600);
    }
    let mut file = options.open(&temporary)?;
    file.write_all(bytes)?;
    file.sync_all()?;
    std::fs::rename(&temporary, path)?;
    SystemDisk.sync_directory(&parent(path))
}

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

    #[test]
    fn an_older_directory_of_a_scene_stays_beside_the_newest_and_never_is_the_scene_again() {
        let folder = format!("rhumb-older-{}", std::process::id());
        let folder = std::env::temp_dir().join(folder);
        drop(DataDir::open(&folder).unwrap());
        for number in [0, 1] {
            std::fs::create_dir(folder.join(SCENES).join(format!("pit.{number}"))).unwrap();
        }
        let data = DataDir::open(&folder).unwrap();
        let names = SystemDisk.list(&folder.join(SCENES)).unwrap();
        assert_eq!(names, ["pit.0.damaged", "pit.1"]);
        let (_, files) = data.scenes().unwrap().pop().unwrap();
        files.delete().unwrap();
        assert!(data.scenes().unwrap().is_empty());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// A directory of several servers with these directories of scenes, each with a file.
    fn shared(names: &[&str]) -> (tempfile::TempDir, DataDir) {
        let directory = tempfile::tempdir().unwrap();
        let data = DataDir::open_shared(directory.path()).unwrap();
        for name in names {
            let scene = directory.path().join(SCENES).join(name);
            std::fs::create_dir(&scene).unwrap();
            std::fs::write(scene.join("head"), name).unwrap();
        }
        (directory, data)
    }

    fn names(directory: &tempfile::TempDir) -> Vec<String> {
        SystemDisk.list(&directory.path().join(SCENES)).unwrap()
    }

    fn take(data: &DataDir, epoch: u64, is_held: bool) -> Result<Generation, DataError> {
        let claims = [("pit".parse().unwrap(), epoch)];
        data.take_over(&claims, &|| is_held).unwrap().pop().unwrap()
    }

    #[test]
    fn files_that_are_taken_over_have_the_epoch_of_the_claim_and_earlier_owners_find_none() {
        let (directory, data) = shared(&["pit.0", "hall.3"]);
        let scene = "pit".parse().unwrap();
        assert_eq!(take(&data, 7, true).unwrap(), Generation(7));
        assert_eq!(take(&data, 9, true).unwrap(), Generation(9));
        assert_eq!(names(&directory), ["hall.3", "pit.9"]);
        assert!(data.files_of(&scene, Generation(7)).unwrap().is_none());
        assert!(data.files_of(&scene, Generation(9)).unwrap().is_some());
    }

    #[test]
    fn a_claim_that_is_over_takes_no_newer_files() {
        let (directory, data) = shared(&["pit.6"]);
        let refused = take(&data, 5, false);
        assert!(matches!(refused, Err(DataError::TakenOver { .. })));
        assert_eq!(names(&directory), ["pit.6"]);
    }

    #[test]
    fn after_a_new_beginning_of_etcd_the_newest_files_stay_the_newest() {
        let (directory, data) = shared(&["pit.900", "pit.904.deleted"]);
        assert_eq!(take(&data, 3, true).unwrap(), Generation(905));
        assert_eq!(names(&directory), ["pit.904.deleted", "pit.905"]);
    }

    #[test]
    fn a_scene_that_a_late_owner_creates_is_never_the_newest() {
        let (directory, stale) = shared(&[]);
        let owner = DataDir::open_shared(directory.path()).unwrap();
        let scene: SceneName = "pit".parse().unwrap();
        let late = take(&stale, 5, true).unwrap();
        // Frozen here; its lease ends.
        let now = take(&owner, 6, true).unwrap();
        let files = [(&owner, now), (&stale, late)];
        for (data, generation) in files {
            let files = data.files_to_make(&scene, generation);
            files.make_directory().unwrap();
            std::fs::write(files.head_path(), generation.0.to_string()).unwrap();
        }
        let next = take(&owner, 8, true).unwrap();
        let files = owner.files_of(&scene, next).unwrap().unwrap();
        assert_eq!(std::fs::read(files.head_path()).unwrap(), b"6");
        assert_eq!(names(&directory), ["pit.5.damaged", "pit.8"]);
    }

    #[test]
    fn a_directory_keeps_its_certificate_and_only_its_owner_reads_the_key() {
        let directory = tempfile::tempdir().unwrap();
        let read = || {
            let data = DataDir::open(directory.path()).unwrap();
            let (certificate, key) = data.development_certificate().unwrap();
            #[cfg(unix)]
            {
                use std::os::unix::fs::PermissionsExt;
                let mode = std::fs::metadata(&key).unwrap().permissions().mode();
                assert_eq!(mode & 0o777, 0o600);
            }
            rhumb_transport::Certificate::from_pem_files(certificate, key).unwrap()
        };
        assert_eq!(read().fingerprint(), read().fingerprint());
    }

    #[test]
    fn files_of_others_among_the_scenes_stop_nothing() {
        let directory = tempfile::tempdir().unwrap();
        drop(DataDir::open(directory.path()).unwrap());
        let scenes = directory.path().join(SCENES);
        for name in ["notes.txt", "notes.deleted", "team.3.deleted"] {
            std::fs::write(scenes.join(name), "five!").unwrap();
        }
        #[cfg(unix)]
        std::os::unix::fs::symlink("loop", scenes.join("loop")).unwrap();
        let ours = scenes.join("pit.4.deleted");
        std::fs::create_dir(&ours).unwrap();
        let data = DataDir::open(directory.path()).unwrap();
        assert_eq!(data.bytes().unwrap(), 3 * 5);
        assert!(data.scenes().unwrap().is_empty());
        assert!(!ours.exists());
        for name in ["notes.deleted", "team.3.deleted"] {
            assert!(scenes.join(name).exists(), "{name}");
        }
    }

    #[test]
    fn one_process_at_a_time_uses_a_directory() {
        let directory = tempfile::tempdir().unwrap();
        let first = DataDir::open(directory.path()).unwrap();
        let second = DataDir::open(directory.path()).err();
        assert!(matches!(second, Some(DataError::InUse { .. })));
        drop(first);
        assert!(DataDir::open(directory.path()).is_ok());
    }

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
