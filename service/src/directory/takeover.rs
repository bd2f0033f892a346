//! A thread that takes the files of claimed scenes over.
//!
//! A file system may be slow, or hang, and no renewal of a lease waits for it. It looks at the directory of all scenes once for
//! all claims that have come meanwhile.

use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread;

use rhumb_protocol::Instant;
use rhumb_protocol::scene::SceneName;

use super::claims::Epoch;
use crate::durable::{DataDir, DataError, Generation};

/// A clock that also counts while the machine sleeps.
pub(crate) type FenceClock = Arc<dyn Fn() -> Instant + Send + Sync>;

/// A claim whose files are to be taken over.
pub(super) struct FilesWanted {
    pub(super) scene: SceneName,
    pub(super) epoch: Epoch,
    /// The moment to which no other server can have the scene, by the newest renewal.
    pub(super) until: Instant,
}

/// The end of a taking-over.
pub(super) struct FilesTaken {
    pub(super) scene: SceneName,
    pub(super) epoch: Epoch,
    /// The number of the files; `None` if they could not be taken, which the log says.
    pub(super) generation: Option<Generation>,
}

/// Starts the thread. It ends with the sender, and nothing waits for it: what it does late harms no other server.
pub(super) fn start(
    data: DataDir,
    clock: FenceClock,
    tell: impl Fn(FilesTaken) + Send + 'static,
) -> io::Result<Sender<FilesWanted>> {
    let (wanted, asked) = channel();
    thread::Builder::new()
        .name("rhumb-takeover".to_owned())
        .spawn(move || run(&asked, (&data, &clock), &tell))?;
    Ok(wanted)
}

fn run(
    asked: &Receiver<FilesWanted>,
    (data, clock): (&DataDir, &FenceClock),
    tell: &dyn Fn(FilesTaken),
) {
    while let Ok(first) = asked.recv() {
        let all: Vec<_> = std::iter::once(first).chain(asked.try_iter()).collect();
        take_all(all, (data, clock), tell);
    }
}

fn take_all(
    all: Vec<FilesWanted>,
    (data, clock): (&DataDir, &FenceClock),
    tell: &dyn Fn(FilesTaken),
) {
    let claims: Vec<_> = (all.iter())
        .map(|of| (of.scene.clone(), of.epoch.0))
        .collect();
    let is_held = || all.iter().all(|of| clock() < of.until);
    let generations: Vec<_> = match data.take_over(&claims, &is_held) {
        Ok(taken) => taken.into_iter().map(generation_of).collect(),
        Err(error) => {
            tracing::error!(scenes = claims.len(), %error, "no scene can be taken over");
            vec![None; claims.len()]
        }
    };
    for (of, generation) in all.into_iter().zip(generations) {
        tell(FilesTaken {
            scene: of.scene,
            epoch: of.epoch,
            generation,
        });
    }
}

fn generation_of(taken: Result<Generation, DataError>) -> Option<Generation> {
    taken
        .inspect_err(|error| tracing::error!(%error, "a scene's files cannot be taken over"))
        .ok()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn a_thousand_scenes_that_are_claimed_at_once_are_taken_over() {
        let directory = tempfile::tempdir().unwrap();
        let data = DataDir::open_shared(directory.path()).unwrap();
        let scenes = directory.path().join("scenes");
        for n in 0..1_000 {
            std::fs::create_dir(scenes.join(format!("s{n}.0"))).unwrap();
        }
        let (tell, ended) = channel();
        let tell = move |files| tell.send(files).unwrap();
        let wanted = start(data, Arc::new(|| Instant::ZERO), tell).unwrap();
        for n in 0..1_000 {
            let wants = FilesWanted {
                scene: format!("s{n}").parse().unwrap(),
                epoch: Epoch(n + 2),
                until: Instant::from_nanos(1),
            };
            wanted.send(wants).unwrap();
        }
        drop(wanted);
        let taken = ended.iter().map(|files| (files.scene, files.generation));
        let taken: BTreeMap<_, _> = taken.collect();
        for n in 0..1_000 {
            let scene: SceneName = format!("s{n}").parse().unwrap();
            assert_eq!(taken[&scene], Some(Generation(n + 2)));
            assert!(scenes.join(format!("s{n}.{}", n + 2)).exists());
        }
    }
}
