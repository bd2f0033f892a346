//! A thread that keeps a server's claims, and what the dispatcher asks of it.
//!
//! The dispatcher never waits for it: questions go in by a queue, events come back by another. Before a scene is said to be
//! owned, its files have become this server's.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rhumb_protocol::Instant;
use rhumb_protocol::scene::SceneName;
use rhumb_transport::io_runtime;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::time::{sleep, timeout};

use super::claims::{ANSWER, ClaimEvent, DirectoryAnswer, RequestId, SceneClaims, ServerPlace};
use super::etcd::{Endpoints, Etcd};
use crate::durable::DataDir;

/// A clock that also counts while the machine sleeps.
pub(crate) type FenceClock = Arc<dyn Fn() -> Instant + Send + Sync>;

/// The dispatcher's handle. When it is dropped, all claims are given up.
pub(crate) struct Keeper {
    asks: Option<UnboundedSender<Ask>>,
    events: Receiver<ClaimEvent>,
    /// The moment from which nothing may be published, in nanoseconds.
    until: Arc<AtomicU64>,
    clock: FenceClock,
    thread: Option<JoinHandle<()>>,
}

enum Ask {
    Claim(SceneName),
    Release(SceneName),
}

/// Time for the directory to take the end of the claims.
const END: Duration = Duration::from_millis(500);

impl Keeper {
    /// Starts the thread. `wake` is called when there are events.
    ///
    /// # Errors
    ///
    /// The system's, if it has no thread or no event queue.
    pub(crate) fn start(
        (endpoints, place): (Endpoints, ServerPlace),
        data: DataDir,
        clock: FenceClock,
        wake: impl Fn() + Send + 'static,
    ) -> io::Result<Self> {
        let runtime = io_runtime()?;
        let (asks, asked) = unbounded_channel();
        let (to, events) = channel();
        let until = Arc::new(AtomicU64::new(0));
        let keeping = Keeping {
            claims: SceneClaims::new(clock(), place.clone()),
            etcd: Arc::new(Etcd::new(endpoints, place)),
            data,
            clock: Arc::clone(&clock),
            until: Arc::clone(&until),
            events: to,
            wake: Box::new(wake),
        };
        let thread = thread::Builder::new()
            .name("rhumb-directory".to_owned())
            .spawn(move || runtime.block_on(keeping.run(asked)))?;
        Ok(Self {
            asks: Some(asks),
            events,
            until,
            clock,
            thread: Some(thread),
        })
    }

    /// Asks for a scene; an event says what comes of it.
    pub(crate) fn claim(&self, scene: &SceneName) {
        self.ask(Ask::Claim(scene.clone()));
    }

    /// Gives a scene up that is served no more.
    pub(crate) fn release(&self, scene: &SceneName) {
        self.ask(Ask::Release(scene.clone()));
    }

    /// The next event.
    pub(crate) fn poll_event(&self) -> Option<ClaimEvent> {
        self.events.try_recv().ok()
    }

    /// True if what the server owns may be published at this moment.
    pub(crate) fn may_publish(&self) -> bool {
        let until = Instant::from_nanos(self.until.load(Ordering::Acquire));
        (self.clock)() < until
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
    etcd: Arc<Etcd>,
    data: DataDir,
    clock: FenceClock,
    until: Arc<AtomicU64>,
    events: Sender<ClaimEvent>,
    wake: Box<dyn Fn() + Send>,
}

impl Keeping {
    async fn run(mut self, mut asked: UnboundedReceiver<Ask>) {
        let (answers, mut answered) = unbounded_channel();
        loop {
            let now = (self.clock)();
            self.claims.handle_timeout(now);
            self.settle(&answers);
            let next = self.claims.poll_timeout();
            let wait = next.map_or(ANSWER, |next| next.since((self.clock)()));
            tokio::select! {
                ask = asked.recv() => match ask {
                    Some(Ask::Claim(scene)) => self.claims.claim((self.clock)(), &scene),
                    Some(Ask::Release(scene)) => self.claims.release((self.clock)(), &scene),
                    None => return self.end().await,
                },
                Some((id, answer)) = answered.recv() => {
                    self.claims.handle_answer((self.clock)(), id, answer);
                }
                () = sleep(Duration::from_nanos(wait.as_nanos())) => {}
            }
        }
    }

    /// Sends requests, and hands events on.
    fn settle(&mut self, answers: &UnboundedSender<(RequestId, DirectoryAnswer)>) {
        while let Some((id, request)) = self.claims.poll_request() {
            let (etcd, answers) = (Arc::clone(&self.etcd), answers.clone());
            tokio::spawn(async move {
                let limit = Duration::from_nanos(ANSWER.as_nanos());
                let answer = timeout(limit, etcd.answer(&request)).await;
                // A keeper that has ended needs none.
                let _ = answers.send((id, answer.unwrap_or(DirectoryAnswer::Failed)));
            });
        }
        let until = self.claims.publishes_until().since(Instant::ZERO);
        self.until.store(until.as_nanos(), Ordering::Release);
        let mut has_events = false;
        while let Some(event) = self.claims.poll_event() {
            has_events = true;
            let event = self.take_files(event);
            // A dispatcher that has ended needs none.
            let _ = self.events.send(event);
        }
        if has_events {
            (self.wake)();
        }
    }

    /// Makes the files of an owned scene this server's: from then on an earlier owner finds them no more.
    fn take_files(&mut self, event: ClaimEvent) -> ClaimEvent {
        let ClaimEvent::Owned(scene, epoch) = event else {
            return event;
        };
        match self.data.take_over(&scene) {
            Ok(()) => {
                tracing::info!(%scene, epoch = epoch.0, "the directory gives this server the scene");
                ClaimEvent::Owned(scene, epoch)
            }
            Err(error) => {
                tracing::error!(%scene, %error, "the files of the scene cannot be taken over");
                self.claims.release((self.clock)(), &scene);
                ClaimEvent::Unknown(scene)
            }
        }
    }

    /// Gives all claims up, once nothing is published any more.
    async fn end(mut self) {
        self.claims.end((self.clock)());
        let requests = std::iter::from_fn(|| self.claims.poll_request());
        for (_, request) in requests.collect::<Vec<_>>() {
            if timeout(END, self.etcd.answer(&request)).await != Ok(DirectoryAnswer::Revoked) {
                tracing::warn!(
                    "the directory does not know that this server ends: its scenes are free when its lease ends"
                );
            }
        }
    }
}
