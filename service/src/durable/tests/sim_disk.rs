//! A disk in memory that crashes, for tests.
//!
//! A crash keeps what was synchronised, and of the rest what a seed decides: each unsynchronised append is kept,
//! lost, or cut, and each unsynchronised name is kept or lost, and so is each new name of a directory.

use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use crate::durable::disk::{Disk, LogFile};

/// A disk in memory; all clones are one.
#[derive(Clone, Default)]
pub(super) struct SimDisk {
    state: Arc<Mutex<State>>,
    /// Notified when synchronisations are not held any more.
    released: Arc<Condvar>,
}

/// Keeps every synchronisation of a file from returning, until it is dropped.
pub(super) struct HeldSyncs(SimDisk);

#[derive(Default)]
struct State {
    files: BTreeMap<u64, Contents>,
    /// Names as they are now.
    names: BTreeMap<PathBuf, u64>,
    /// Names as a crash leaves them at least.
    durable_names: BTreeMap<PathBuf, u64>,
    /// Directories; true for a name that a crash leaves.
    directories: BTreeMap<PathBuf, bool>,
    /// Old and new names of directories, which a crash may take back.
    renamed: Vec<(PathBuf, PathBuf)>,
    next: u64,
    /// Changes that are still made before the power fails; `None` for all.
    changes: Option<usize>,
    /// Bytes that may still be written before the disk is full.
    room: Option<usize>,
    /// True if no file can be synchronised.
    is_failing: bool,
    /// A file that cannot be read.
    unreadable: Option<PathBuf>,
    /// True if no directory can be made.
    is_refusing_directories: bool,
    /// True if no synchronisation of a file returns.
    is_holding: bool,
    /// Synchronisations that wait.
    held: usize,
}

#[derive(Default)]
struct Contents {
    durable: Vec<u8>,
    appended: Vec<Vec<u8>>,
    /// Writes over bytes, each with its place.
    overwritten: Vec<(usize, Vec<u8>)>,
}

struct SimFile {
    disk: SimDisk,
    id: u64,
}

impl State {
    /// True if the directory of a file exists.
    fn has_directory_of(&self, path: &Path) -> bool {
        let above = path.parent();
        above.is_some_and(|above| self.directories.contains_key(above))
    }

    /// Refuses a change after the power has failed.
    fn change(&mut self) -> io::Result<()> {
        match &mut self.changes {
            Some(0) => return Err(io::Error::other("the power has failed")),
            Some(left) => *left -= 1,
            None => {}
        }
        Ok(())
    }

    /// Gives a directory another name, with everything in it.
    fn move_directory(&mut self, from: &Path, to: &Path) {
        fn moved<T>(paths: &mut BTreeMap<PathBuf, T>, from: &Path, to: &Path) {
            *paths = std::mem::take(paths)
                .into_iter()
                .map(|(path, value)| match path.strip_prefix(from) {
                    Ok(below) if below.as_os_str().is_empty() => (to.to_owned(), value),
                    Ok(below) => (to.join(below), value),
                    Err(_) => (path, value),
                })
                .collect();
        }
        moved(&mut self.names, from, to);
        moved(&mut self.durable_names, from, to);
        moved(&mut self.directories, from, to);
    }
}

impl Contents {
    /// Makes everything durable.
    fn sync(&mut self) {
        let appended = std::mem::take(&mut self.appended).concat();
        self.durable.extend(appended);
        for (place, bytes) in std::mem::take(&mut self.overwritten) {
            overwrite(&mut self.durable, place, &bytes);
        }
    }
}

/// Writes over bytes, as far as there are any.
fn overwrite(bytes: &mut [u8], place: usize, with: &[u8]) {
    for (byte, new) in bytes.iter_mut().skip(place).zip(with) {
        *byte = *new;
    }
}

impl SimDisk {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Fills the disk after so many more bytes; `None` frees it.
    pub(super) fn set_room(&self, room: Option<usize>) {
        self.state().room = room;
    }

    /// Lets the power fail after so many more changes.
    pub(super) fn set_changes(&self, changes: Option<usize>) {
        self.state().changes = changes;
    }

    /// Makes every synchronisation of a file fail, or none.
    pub(super) fn set_failing(&self, is_failing: bool) {
        self.state().is_failing = is_failing;
    }

    /// Refuses to read a file.
    pub(super) fn refuse_to_read(&self, path: &Path) {
        self.state().unreadable = Some(path.to_owned());
    }

    /// Refuses every directory, or none.
    pub(super) fn set_refusing_directories(&self, is_refusing: bool) {
        self.state().is_refusing_directories = is_refusing;
    }

    /// Makes the disk hang.
    pub(super) fn hold_syncs(&self) -> HeldSyncs {
        self.state().is_holding = true;
        HeldSyncs(self.clone())
    }

    /// Changes the bytes of a file.
    pub(super) fn damage(&self, path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
        let mut state = self.state();
        let id = state.names[path];
        let contents = state.files.entry(id).or_default();
        contents.sync();
        change(&mut contents.durable);
    }

    /// All paths of files.
    pub(super) fn paths(&self) -> Vec<PathBuf> {
        self.state().names.keys().cloned().collect()
    }

    /// Crashes: `chance(n)` gives a number below n.
    pub(super) fn crash(&self, mut chance: impl FnMut(usize) -> usize) {
        let mut state = self.state();
        state.changes = None;
        for (from, to) in std::mem::take(&mut state.renamed).into_iter().rev() {
            if chance(2) == 0 {
                state.move_directory(&to, &from);
            }
        }
        let mut names = state.durable_names.clone();
        for (path, id) in &state.names {
            if chance(2) == 0 {
                names.insert(path.clone(), *id);
            }
        }
        state.directories.retain(|_, is_durable| {
            *is_durable = *is_durable || chance(2) == 0;
            *is_durable
        });
        names.retain(|path, _| state.has_directory_of(path));
        for contents in state.files.values_mut() {
            for append in std::mem::take(&mut contents.appended) {
                let kept = match chance(3) {
                    0 => append,
                    // The place of a lost write may be filled by a later one.
                    1 => vec![0; append.len()],
                    _ => {
                        let cut = chance(append.len() + 1);
                        contents.durable.extend_from_slice(&append[..cut]);
                        break;
                    }
                };
                contents.durable.extend(kept);
            }
            for (place, bytes) in std::mem::take(&mut contents.overwritten) {
                let kept = match chance(3) {
                    0 => bytes.len(),
                    1 => 0,
                    _ => chance(bytes.len() + 1),
                };
                overwrite(&mut contents.durable, place, &bytes[..kept]);
            }
        }
        state.names.clone_from(&names);
        state.durable_names = names;
    }
}

impl HeldSyncs {
    /// True if a synchronisation waits.
    pub(super) fn has_one(&self) -> bool {
        self.0.state().held > 0
    }
}

impl Drop for HeldSyncs {
    fn drop(&mut self) {
        self.0.state().is_holding = false;
        self.0.released.notify_all();
    }
}

fn not_found() -> io::Error {
    io::ErrorKind::NotFound.into()
}

impl Disk for SimDisk {
    fn list(&self, directory: &Path) -> io::Result<Vec<String>> {
        let state = self.state();
        let below = state.names.keys().chain(state.directories.keys());
        let mut names: Vec<String> = below
            .filter_map(|path| path.strip_prefix(directory).ok()?.iter().next())
            .filter_map(|name| name.to_str().map(str::to_owned))
            .collect();
        names.sort();
        names.dedup();
        Ok(names)
    }

    fn read(&self, path: &Path) -> io::Result<Vec<u8>> {
        let state = self.state();
        if state.unreadable.as_deref() == Some(path) {
            return Err(io::Error::other("input or output failed"));
        }
        let id = state.names.get(path).ok_or_else(not_found)?;
        let contents = &state.files[id];
        let mut bytes = contents.durable.clone();
        contents
            .appended
            .iter()
            .for_each(|more| bytes.extend_from_slice(more));
        for (place, more) in &contents.overwritten {
            overwrite(&mut bytes, *place, more);
        }
        Ok(bytes)
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn LogFile>> {
        let mut state = self.state();
        state.change()?;
        if state.names.contains_key(path) {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        if !state.has_directory_of(path) {
            return Err(not_found());
        }
        let id = state.next;
        state.next += 1;
        state.files.insert(id, Contents::default());
        state.names.insert(path.to_owned(), id);
        let disk = self.clone();
        Ok(Box::new(SimFile { disk, id }))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.change()?;
        if !state.directories.contains_key(from) {
            let id = state.names.remove(from).ok_or_else(not_found)?;
            state.names.insert(to.to_owned(), id);
            return Ok(());
        }
        if state.names.keys().any(|path| path.starts_with(to)) {
            return Err(io::ErrorKind::DirectoryNotEmpty.into());
        }
        state.move_directory(from, to);
        state.renamed.push((from.to_owned(), to.to_owned()));
        Ok(())
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.change()?;
        state.names.remove(path).map(drop).ok_or_else(not_found)
    }

    fn make_directory(&self, directory: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.change()?;
        if state.is_refusing_directories {
            return Err(io::ErrorKind::StorageFull.into());
        }
        state
            .directories
            .entry(directory.to_owned())
            .or_insert(false);
        Ok(())
    }

    fn remove_directory(&self, directory: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.change()?;
        state.names.retain(|path, _| !path.starts_with(directory));
        state
            .directories
            .retain(|path, _| !path.starts_with(directory));
        Ok(())
    }

    fn bytes_in(&self, directory: &Path) -> io::Result<u64> {
        let state = self.state();
        let names = (state.names.iter()).filter(|(path, _)| path.parent() == Some(directory));
        let bytes = names.map(|(_, id)| {
            let contents = &state.files[id];
            let appended: usize = contents.appended.iter().map(Vec::len).sum();
            (contents.durable.len() + appended) as u64
        });
        Ok(bytes.sum())
    }

    fn sync_directory(&self, directory: &Path) -> io::Result<()> {
        let mut state = self.state();
        state.change()?;
        let is_in = |path: &Path| path.parent() == Some(directory);
        state.durable_names.retain(|path, _| !is_in(path));
        let names = state.names.clone();
        let durable = names.into_iter().filter(|(path, _)| is_in(path));
        state.durable_names.extend(durable);
        for (path, is_durable) in &mut state.directories {
            *is_durable = *is_durable || is_in(path);
        }
        state.renamed.retain(|(_, to)| !is_in(to));
        Ok(())
    }
}

impl LogFile for SimFile {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        let mut state = self.disk.state();
        state.change()?;
        let room = state.room.unwrap_or(usize::MAX);
        let written = bytes.len().min(room);
        if let Some(left) = &mut state.room {
            *left -= written;
        }
        let contents = state.files.entry(self.id).or_default();
        contents.appended.push(bytes[..written].to_vec());
        if written < bytes.len() {
            return Err(io::ErrorKind::StorageFull.into());
        }
        Ok(())
    }

    fn write_at(&mut self, place: u64, bytes: &[u8]) -> io::Result<()> {
        let mut state = self.disk.state();
        let contents = state.files.entry(self.id).or_default();
        contents.overwritten.push((place as usize, bytes.to_vec()));
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        let mut state = self.disk.state();
        state.change()?;
        state.held += 1;
        let released = (self.disk.released).wait_while(state, |state| state.is_holding);
        let mut state = released.unwrap_or_else(PoisonError::into_inner);
        state.held -= 1;
        if state.is_failing {
            return Err(io::Error::other("input or output failed"));
        }
        state.files.entry(self.id).or_default().sync();
        Ok(())
    }
}
