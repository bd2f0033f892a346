//! A thread that keeps a server's claims, and one that takes their files over.
//!
//! The dispatcher never waits for them: questions go in by a queue, events come back by another. Before a scene is said to be
//! owned, its files have become this server's.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;
use std::{io, thread};

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Instant, Span};
use rhumb_transport::io_runtime;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::time::sleep;

use super::claims::{
    ANSWER, ClaimEvent, DirectoryAnswer, Epoch, LeaseSeconds, RequestId, SceneClaims, ServerPlace,
};
use super::etcd::{Endpoints, Etcd};
use super::handovers::{Board, FilesSeen, HandoverStep, Handovers, Notice};
use crate::durable::{DataDir, DataError, Generation};

/// The dispatcher's handle. When it is dropped, all claims are given up.
pub(crate) struct Keeper {
    asks: Option<UnboundedSender<Ask>>,
    events: Receiver<DirectoryEvent>,
    /// The moment from which nothing may be published, in nanoseconds.
    until: Arc<AtomicU64>,
    drained: Arc<AtomicBool>,
    clock: FenceClock,
    thread: Option<JoinHandle<()>>,
}

enum Ask {
    Claim(SceneName),
    Release(SceneName),
    Ready(SceneName),
}

/// News of the directory for the dispatcher.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum DirectoryEvent {
    /// The scene is this server's, and its files have this number from now on.
    Owned(SceneName, Generation),
    /// The thread knows that a scene was given up; what it said before was older.
    Released(SceneName),
    /// Another server has the scene.
    Elsewhere(SceneName, ServerPlace),
    /// The directory does not say, or the files cannot be had.
    Unknown(SceneName),
    /// The lease is over, and all that the server owned.
    Lost,
    Handover(HandoverStep),
}

/// An answer of the directory for the keeper, or of the thread of files.
enum DirectoryNews {
    Request(RequestId, DirectoryAnswer),
    Files(FilesNews),
    /// `None` without an answer.
    Board(Option<Board>),
}

/// Time between two looks at the board.
const BOARD: Span = Span::from_millis(500);
/// The same while a scene comes or goes.
const BUSY_BOARD: Span = Span::from_millis(50);
/// Time between two claims of a scene that its server is about to give up.
const AWAITED: Span = Span::from_millis(15);

/// Time for the directory to take the end of the claims.
const END: Duration = Duration::from_millis(500);

impl Keeper {
    /// Starts the thread. `wake` is called when there are events.
    ///
    /// # Errors
    ///
    /// The system's, if it has no thread or no event queue.
    pub(crate) fn start(
        (endpoints, place, lease): (Endpoints, ServerPlace, LeaseSeconds),
        data: DataDir,
        clock: FenceClock,
        wake: impl Fn() + Send + 'static,
    ) -> io::Result<Self> {
        let runtime = io_runtime()?;
        let (asks, asked) = unbounded_channel();
        let (to, events) = channel();
        let until = Arc::new(AtomicU64::new(0));
        let drained = Arc::new(AtomicBool::new(false));
        let (answers, answered) = unbounded_channel();
        let taken = answers.clone();
        let take = move |files| {
            // A keeper that has ended needs none.
            let _ = taken.send(DirectoryNews::Files(files));
        };
        let keeping = Keeping {
            wanted: start_file_thread(data, Arc::clone(&clock), take)?,
            claims: SceneClaims::new(clock(), place.clone(), lease),
            handovers: Handovers::new(place.clone()),
            place,
            etcd: Arc::new(Etcd::new(endpoints)),
            answers,
            board_at: Some(clock()),
            claims_at: Instant::ZERO,
            taken: BTreeMap::new(),
            clock: Arc::clone(&clock),
            until: Arc::clone(&until),
            drained: Arc::clone(&drained),
            events: to,
            wake: Box::new(wake),
        };
        let thread = thread::Builder::new()
            .name("rhumb-directory".to_owned())
            .spawn(move || runtime.block_on(keeping.run(asked, answered)))?;
        Ok(Self {
            asks: Some(asks),
            events,
            until,
            drained,
            clock,
            thread: Some(thread),
        })
    }

    /// True while the server gives all scenes away, and takes none.
    pub(crate) fn drained(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.drained)
    }

    /// Asks for a scene; an event says what comes of it.
    pub(crate) fn claim(&self, scene: &SceneName) {
        self.ask(Ask::Claim(scene.clone()));
    }

    /// Gives a scene up that is served no more.
    pub(crate) fn release(&self, scene: &SceneName) {
        self.ask(Ask::Release(scene.clone()));
    }

    /// Says that a scene which is to come could be taken at once.
    pub(crate) fn ready(&self, scene: &SceneName) {
        self.ask(Ask::Ready(scene.clone()));
    }

    /// The next event.
    pub(crate) fn poll_event(&self) -> Option<DirectoryEvent> {
        self.events.try_recv().ok()
    }

    /// The moment from which nothing may be published that the server owned when this moment was asked for.
    pub(crate) fn publishes_until(&self) -> Instant {
        Instant::from_nanos(self.until.load(Ordering::Acquire))
    }

    /// True before a moment of the clock of leases.
    pub(crate) fn is_before(&self, moment: Instant) -> bool {
        (self.clock)() < moment
    }

    fn ask(&self, ask: Ask) {
        if let Some(asks) = &self.asks
            && asks.send(ask).is_err()
        {
            tracing::error!("the thread of the directory has ended: no scene is claimed any more");
        }
    }
}

impl Drop for Keeper {
    fn drop(&mut self) {
        self.asks = None;
        if self
            .thread
            .take()
            .is_some_and(|thread| thread.join().is_err())
        {
            tracing::error!("the thread of the directory panicked");
        }
    }
}

struct Keeping {
    claims: SceneClaims,
    handovers: Handovers,
    place: ServerPlace,
    etcd: Arc<Etcd>,
    answers: UnboundedSender<DirectoryNews>,
    /// When the board is read next; `None` while it is.
    board_at: Option<Instant>,
    /// When the awaited scenes are asked for next.
    claims_at: Instant,
    /// To the thread of files.
    wanted: Sender<FilesAsk>,
    /// The claims with which the files of scenes are taken over, and what these have become; `None` as long as that is
    /// awaited.
    taken: BTreeMap<SceneName, (Epoch, Option<Generation>)>,
    clock: FenceClock,
    until: Arc<AtomicU64>,
    drained: Arc<AtomicBool>,
    events: Sender<DirectoryEvent>,
    wake: Box<dyn Fn() + Send>,
}

impl Keeping {
    async fn run(
        mut self,
        mut asked: UnboundedReceiver<Ask>,
        mut answered: UnboundedReceiver<DirectoryNews>,
    ) {
        loop {
            let now = (self.clock)();
            self.claims.handle_timeout(now);
            self.claim_awaited(now);
            self.look_at_board(now);
            self.settle();
            let now = (self.clock)();
            let wait = self.next_wake().map_or(ANSWER, |next| next.since(now));
            tokio::select! {
                ask = asked.recv() => match ask {
                    Some(ask) => self.take(ask),
                    None => return self.end().await,
                },
                Some(answered) = answered.recv() => self.take_answer(answered),
                () = sleep(Duration::from_nanos(wait.as_nanos())) => {}
            }
        }
    }

    fn next_wake(&self) -> Option<Instant> {
        let awaits = self.handovers.awaited().next().is_some();
        let claims = awaits.then_some(self.claims_at);
        let wakes = [self.claims.poll_timeout(), self.board_at, claims];
        wakes.into_iter().flatten().min()
    }

    fn take(&mut self, ask: Ask) {
        let now = (self.clock)();
        match ask {
            Ask::Claim(scene) => match self.handovers.instead().cloned() {
                Some(other) if !self.claims.owns(&scene) => {
                    self.tell(DirectoryEvent::Elsewhere(scene, other));
                    (self.wake)();
                }
                _ => self.claims.claim(now, &scene),
            },
            Ask::Release(scene) => {
                self.taken.remove(&scene);
                self.claims.release(now, &scene);
                self.tell(DirectoryEvent::Released(scene));
            }
            Ask::Ready(scene) => {
                if let Some(notice) = self.handovers.note_ready(&scene) {
                    self.post(notice);
                }
            }
        }
    }

    fn take_answer(&mut self, answered: DirectoryNews) {
        let now = (self.clock)();
        match answered {
            DirectoryNews::Request(id, answer) => self.claims.handle_answer(now, id, answer),
            DirectoryNews::Files(FilesNews::Taken(files)) => self.take_files(files),
            DirectoryNews::Files(FilesNews::Seen(scene, seen)) => {
                self.handovers.note_files(&scene, seen);
            }
            DirectoryNews::Board(None) => self.board_at = Some(now + BOARD),
            DirectoryNews::Board(Some(board)) => self.take_board(now, &board),
        }
    }

    fn take_board(&mut self, now: Instant, board: &Board) {
        let owns = |scene: &SceneName| self.claims.owns(scene);
        let steps = (self.handovers).take_board(board, self.claims.lease(), owns);
        self.drained
            .store(self.handovers.is_drained(), Ordering::Relaxed);
        for useless in self.handovers.useless(board, owns) {
            self.remove(useless);
        }
        if let Some(lease) = self.claims.lease() {
            for notice in self.handovers.missing(board, lease) {
                self.post(notice);
            }
        }
        // A server without a lease is not on the board yet.
        let pause = match self.handovers.is_busy() || self.claims.lease().is_none() {
            true => BUSY_BOARD,
            false => BOARD,
        };
        self.board_at = Some(now + pause);
        self.hand_on(steps);
        for scene in self.handovers.sought() {
            // Without its thread no scene comes, which is said where one is claimed.
            let _ = self.wanted.send(FilesAsk::Look(scene.clone()));
        }
    }

    fn hand_on(&mut self, steps: Vec<HandoverStep>) {
        let any = !steps.is_empty();
        for step in steps {
            self.tell(DirectoryEvent::Handover(step));
        }
        if any {
            (self.wake)();
        }
    }

    /// Claims the scenes that their servers are about to give up.
    fn claim_awaited(&mut self, now: Instant) {
        if now < self.claims_at {
            return;
        }
        let awaited: Vec<_> = self.handovers.awaited().cloned().collect();
        for scene in &awaited {
            self.claims.claim(now, scene);
        }
        self.claims_at = now + AWAITED;
    }

    fn look_at_board(&mut self, now: Instant) {
        if self.board_at.is_none_or(|at| now < at) {
            return;
        }
        self.board_at = None;
        let (etcd, answers) = (Arc::clone(&self.etcd), self.answers.clone());
        tokio::spawn(async move {
            // A keeper that has ended needs none.
            let _ = answers.send(DirectoryNews::Board(etcd.read_board().await));
        });
    }

    /// Posts a notice. One that is lost is missed at the next look at the board.
    fn post(&self, notice: Notice) {
        let (etcd, lease) = (Arc::clone(&self.etcd), self.claims.lease());
        if let Some(lease) = lease {
            tokio::spawn(async move { etcd.post(lease, &notice).await });
        }
    }

    /// Takes a notice off the board. If that is lost, the notice ends with its lease.
    fn remove(&self, notice: Notice) {
        let etcd = Arc::clone(&self.etcd);
        tokio::spawn(async move { etcd.remove(&notice).await });
    }

    /// A dispatcher that has ended needs no news.
    fn tell(&self, event: DirectoryEvent) {
        let _ = self.events.send(event);
    }

    /// Sends requests, and hands events on.
    fn settle(&mut self) {
        while let Some((id, request)) = self.claims.poll_request() {
            let (etcd, answers) = (Arc::clone(&self.etcd), self.answers.clone());
            let place = self.place.clone();
            tokio::spawn(async move {
                let limit = Duration::from_nanos(ANSWER.as_nanos());
                let answer = etcd.answer(&place, &request, limit).await;
                // A keeper that has ended needs none.
                let _ = answers.send(DirectoryNews::Request(id, answer));
            });
        }
        let until = self.claims.publishes_until().since(Instant::ZERO);
        self.until.store(until.as_nanos(), Ordering::Release);
        while let Some(event) = self.claims.poll_event() {
            self.take_claim(event);
        }
    }

    fn take_claim(&mut self, event: ClaimEvent) {
        let event = match event {
            ClaimEvent::Elsewhere(scene, _) | ClaimEvent::Unknown(scene)
                if self.handovers.awaits(&scene) =>
            {
                // It is asked for again in a moment.
                return;
            }
            ClaimEvent::Elsewhere(scene, place) => DirectoryEvent::Elsewhere(scene, place),
            ClaimEvent::Unknown(scene) => DirectoryEvent::Unknown(scene),
            ClaimEvent::Owned(scene, epoch) => match self.taken.get(&scene) {
                Some((taken, None)) if *taken == epoch => return,
                // Another client has asked, and the scene may be served already.
                Some((taken, Some(generation))) if *taken == epoch => {
                    DirectoryEvent::Owned(scene, *generation)
                }
                _ => return self.want_files(scene, epoch),
            },
            ClaimEvent::Lost => {
                for (scene, (_, generation)) in std::mem::take(&mut self.taken) {
                    if generation.is_none() {
                        self.tell(DirectoryEvent::Unknown(scene));
                    }
                }
                let steps = self.handovers.lose();
                self.hand_on(steps);
                DirectoryEvent::Lost
            }
        };
        self.tell(event);
        (self.wake)();
    }

    /// Requests that the files of an owned scene become this server's: from then on an earlier owner finds them no more.
    fn want_files(&mut self, scene: SceneName, epoch: Epoch) {
        self.taken.insert(scene.clone(), (epoch, None));
        let until = self.claims.publishes_until();
        let wanted = FilesWanted {
            scene,
            epoch,
            until,
        };
        let of_claim = (wanted.scene.clone(), wanted.epoch);
        if self.wanted.send(FilesAsk::Take(wanted)).is_err() {
            tracing::error!("the thread that takes files over has ended: no scene comes any more");
            let (scene, epoch) = of_claim;
            self.take_files(FilesTaken {
                scene,
                epoch,
                generation: None,
            });
        }
    }

    fn take_files(&mut self, files: FilesTaken) {
        let FilesTaken {
            scene,
            epoch,
            generation,
        } = files;
        if self.taken.get(&scene) != Some(&(epoch, None)) {
            // That claim is over.
            return;
        }
        if let Some(generation) = generation {
            tracing::info!(%scene, epoch = epoch.0, files = generation.0, "the directory gives this server the scene");
            for notice in self.handovers.note_owned(&scene) {
                self.remove(notice);
            }
            self.taken.insert(scene.clone(), (epoch, Some(generation)));
            self.tell(DirectoryEvent::Owned(scene, generation));
        } else {
            self.taken.remove(&scene);
            self.claims.release((self.clock)(), &scene);
            self.tell(DirectoryEvent::Unknown(scene));
        }
        (self.wake)();
    }

    /// Gives all claims up, once nothing is published any more.
    async fn end(mut self) {
        self.claims.end((self.clock)());
        let requests = std::iter::from_fn(|| self.claims.poll_request());
        for (_, request) in requests.collect::<Vec<_>>() {
            if self.etcd.answer(&self.place, &request, END).await != DirectoryAnswer::Revoked {
                tracing::warn!(
                    "the directory does not know that this server ends: its scenes are free when its lease ends"
                );
            }
        }
    }
}

#[cfg(test)]
pub(super) mod puppet {
    use super::*;

    /// The other end of a keeper without a thread: the test says what the directory says.
    pub(crate) struct Puppet {
        pub(crate) events: Sender<DirectoryEvent>,
        pub(crate) until: Arc<AtomicU64>,
        asks: UnboundedReceiver<Ask>,
    }

    impl Puppet {
        /// A keeper whose clock stands, and its other end.
        pub(crate) fn new(clock: Instant) -> (Keeper, Self) {
            let (asks, asked) = unbounded_channel();
            let (to, events) = channel();
            let until = Arc::new(AtomicU64::new(0));
            let keeper = Keeper {
                asks: Some(asks),
                events,
                until: Arc::clone(&until),
                drained: Arc::default(),
                clock: Arc::new(move || clock),
                thread: None,
            };
            let puppet = Self {
                events: to,
                until,
                asks: asked,
            };
            (keeper, puppet)
        }

        /// The scenes that were given up since the last call.
        pub(crate) fn released(&mut self) -> Vec<SceneName> {
            let asks = std::iter::from_fn(|| self.asks.try_recv().ok());
            asks.filter_map(|ask| match ask {
                Ask::Release(scene) => Some(scene),
                Ask::Claim(_) | Ask::Ready(_) => None,
            })
            .collect()
        }
    }
}

/// A clock that also counts while the machine sleeps.
pub(crate) type FenceClock = Arc<dyn Fn() -> Instant + Send + Sync>;

/// A question to the thread of files.
enum FilesAsk {
    Take(FilesWanted),
    /// Looks whether a scene has files.
    Look(SceneName),
}

/// Actions and observations of the thread.
enum FilesNews {
    Taken(FilesTaken),
    Seen(SceneName, FilesSeen),
}

/// A claim whose files are to be taken over.
struct FilesWanted {
    scene: SceneName,
    epoch: Epoch,
    /// The moment to which no other server can have the scene, by the newest renewal.
    until: Instant,
}

/// The end of a taking-over.
struct FilesTaken {
    scene: SceneName,
    epoch: Epoch,
    /// The number of the files; `None` if they could not be taken, which the log says.
    generation: Option<Generation>,
}

/// Starts the thread that takes the files of claimed scenes over, and looks for those of scenes that are to come. It ends
/// with the sender, and nothing waits for it: what it does late harms no other server.
///
/// A file system may be slow, or hang, and no renewal of a lease waits for it. It looks at the directory of all scenes once
/// for all claims that have come meanwhile.
fn start_file_thread(
    data: DataDir,
    clock: FenceClock,
    tell: impl Fn(FilesNews) + Send + 'static,
) -> io::Result<Sender<FilesAsk>> {
    let (asks, asked) = channel();
    thread::Builder::new()
        .name("rhumb-takeover".to_owned())
        .spawn(move || answer_files(&asked, (&data, &clock), &tell))?;
    Ok(asks)
}

fn answer_files(
    asked: &Receiver<FilesAsk>,
    (data, clock): (&DataDir, &FenceClock),
    tell: &dyn Fn(FilesNews),
) {
    while let Ok(first) = asked.recv() {
        let (mut take, mut seek) = (Vec::new(), BTreeSet::new());
        for ask in std::iter::once(first).chain(asked.try_iter()) {
            match ask {
                FilesAsk::Take(wanted) => take.push(wanted),
                FilesAsk::Look(scene) => drop(seek.insert(scene)),
            }
        }
        if !take.is_empty() {
            take_all(take, (data, clock), tell);
        }
        if !seek.is_empty() {
            look_for(seek, data, tell);
        }
    }
}

/// A directory that cannot be read says nothing about a scene.
fn look_for(scenes: BTreeSet<SceneName>, data: &DataDir, tell: &dyn Fn(FilesNews)) {
    match data.scenes() {
        Ok(there) => {
            let there: BTreeSet<_> = there.into_iter().map(|(scene, _)| scene).collect();
            for scene in scenes {
                let seen = match there.contains(&scene) {
                    true => FilesSeen::There,
                    false => FilesSeen::Missing,
                };
                tell(FilesNews::Seen(scene, seen));
            }
        }
        Err(error) => tracing::warn!(%error, "the files of scenes that are to come are not seen"),
    }
}

fn take_all(
    all: Vec<FilesWanted>,
    (data, clock): (&DataDir, &FenceClock),
    tell: &dyn Fn(FilesNews),
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
        tell(FilesNews::Taken(FilesTaken {
            scene: of.scene,
            epoch: of.epoch,
            generation,
        }));
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
        let wanted = start_file_thread(data, Arc::new(|| Instant::ZERO), tell).unwrap();
        for n in 0..1_000 {
            let wants = FilesWanted {
                scene: format!("s{n}").parse().unwrap(),
                epoch: Epoch(n + 2),
                until: Instant::from_nanos(1),
            };
            wanted.send(FilesAsk::Take(wants)).unwrap();
        }
        drop(wanted);
        let taken = ended.iter().filter_map(|news| match news {
            FilesNews::Taken(files) => Some((files.scene, files.generation)),
            FilesNews::Seen(..) => None,
        });
        let taken: BTreeMap<_, _> = taken.collect();
        for n in 0..1_000 {
            let scene: SceneName = format!("s{n}").parse().unwrap();
            assert_eq!(taken[&scene], Some(Generation(n + 2)));
            assert!(scenes.join(format!("s{n}.{}", n + 2)).exists());
        }
    }
}
