//! A scene worker: the loop of a scene on a thread; threads for all solids.
//!
//! A worker never waits for another one; its thread waits for the dispatcher only if many of its outputs lie unread.
//!
//! Solids of large shapes are made beside the steps, for all scenes of a process. As many jobs run at a time as there may be
//! threads, at a low priority: a step comes before a solid. Those that wait are taken in turn from the tenants that gave them,
//! so that one with many waits for itself. Invariants: a thread ends when nothing waits; a job is run once; one for which no
//! thread could be started waits for the next thread.

use std::collections::{BTreeMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;
use std::{io, thread};

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Endpoint, Instant, Peer, Span, Transmit};
use rhumb_scene::{Bakers, Heartbeat, SceneLoop, SceneSettings, SharedClock, tenant_of};

use super::message::{FromWorker, Question, WorkerId, WorkerInput, WorkerOutput, WorkerReport};
use crate::durable::{DataDir, Followed, Generation, LogTail, StoredScenes, Wake};

/// Inputs of one turn, before outputs and ticks.
const INPUTS_PER_TURN: usize = 256;
/// Time of one turn's inputs, and of its steps, beyond which no further one begins.
const TURN_TIME: Span = Span::from_millis(1);
/// Stack of a worker's thread: what a main thread has.
const STACK_BYTES: usize = 8 << 20;

/// The scene of a worker, and the control bytes that it has not handled.
struct WorkerScene {
    scene: SceneLoop,
    /// Control bytes received and not yet reported as handled.
    unhandled: BTreeMap<Peer, usize>,
    inputs: u64,
    /// The data directory, if there is one.
    stored: Option<Arc<StoredScenes>>,
    /// The scene of another server that it is to take.
    standby: Option<Standby>,
    settings: Arc<SceneSettings>,
}

/// A scene of another server whose log a worker follows.
struct Standby {
    /// `None` before its files are read.
    followed: Option<Followed>,
    /// When its log is read next.
    next: Instant,
    /// True once a look at the log took no longer than [`BEHIND_MAX`].
    is_ready: bool,
}

/// Time between two looks at the log of a scene that is followed: what is left to be done when it comes.
const LOOK: Span = Span::from_millis(20);

/// Time of such a look with which the scene may come: a scene that is stepped without a pause is never nearer.
const BEHIND_MAX: Span = Span::from_millis(80);

/// An input of a worker's thread.
enum ThreadInput {
    Input(WorkerInput),
    Question(Question),
}

/// The dispatcher's handle of a worker on a thread of its own.
pub(super) struct ThreadWorker {
    inputs: Sender<ThreadInput>,
    pub(super) watched: Watched,
}

/// The thread of a worker, as a watchdog sees it.
#[derive(Clone)]
pub(super) struct Watched {
    pub(super) heartbeat: Heartbeat,
    pub(super) thread_id: ThreadId,
    seen: Option<SeenWork>,
}

/// The piece of work of a thread that was seen last, at the first look at it.
#[derive(Clone, Copy)]
struct SeenWork {
    since: Instant,
    /// The time that the thread had waited for a core since it began.
    waited: Span,
    /// The time of the piece of work that does not count.
    uncounted: Span,
}

/// Longest time of a piece of work that counts at the first look at it: nothing tells how long the thread waited, and if the
/// looker is late, it got no core itself.
const UNSEEN_MAX: Span = Span::from_millis(250);

impl Watched {
    /// The time of the present piece of work so far, without that for which the thread waited for a core: other threads had
    /// them all. Of the time before the first look, [`UNSEEN_MAX`] counts at most.
    pub(super) fn worked_for(&mut self) -> Span {
        let Some(since) = self.heartbeat.busy_since() else {
            self.seen = None;
            return Span::ZERO;
        };
        let waited = waited_for_core(&self.thread_id);
        let busy = self.heartbeat.busy_for().as_nanos();
        let seen = *match &mut self.seen {
            Some(seen) if seen.since == since => seen,
            seen => seen.insert(SeenWork {
                since,
                waited,
                uncounted: Span::from_nanos(busy.saturating_sub(UNSEEN_MAX.as_nanos())),
            }),
        };
        let waited = waited.as_nanos().saturating_sub(seen.waited.as_nanos());
        Span::from_nanos(busy.saturating_sub(seen.uncounted.as_nanos() + waited))
    }
}

impl WorkerScene {
    /// `data`: the directory that keeps its scene. `wake` has the worker report what has become durable.
    fn new(
        scene: SceneName,
        (scenes, data): (&SceneSettings, Option<&DataDir>),
        wake: Wake,
    ) -> Self {
        let mut settings = scenes.clone();
        let stored = data.map(|data| {
            let threads = settings.threads.clone();
            Arc::new(StoredScenes::new(
                (data.clone(), &settings.limits),
                threads,
                wake,
            ))
        });
        if let Some(stored) = stored.clone() {
            settings.store = Some(stored);
        }
        let settings = Arc::new(settings);
        Self {
            scene: SceneLoop::new(scene, Arc::clone(&settings)),
            unhandled: BTreeMap::new(),
            inputs: 0,
            stored,
            standby: None,
            settings,
        }
    }

    /// When it has something to do without an input.
    fn next_wake(&self) -> Option<Instant> {
        let scene = self.scene.poll_timeout().map(|wake| wake.at);
        let standby = self.standby.as_ref().map(|standby| standby.next);
        scene.into_iter().chain(standby).min()
    }

    /// Looks at the log of the scene that it follows, if that is due.
    fn follow(&mut self, now: Instant) {
        let (Some(stored), Some(standby)) = (&self.stored, &mut self.standby) else {
            return;
        };
        if now < standby.next {
            return;
        }
        let (clock, heartbeat) = (&*self.settings.clock, &self.settings.heartbeat);
        let was_read = standby.followed.is_some();
        let followed = standby.followed.take();
        let name = self.scene.name();
        standby.followed = stored.follow(name, followed, clock, &mut || heartbeat.beat());
        let end = clock();
        standby.is_ready |= was_read && standby.followed.is_some() && end.since(now) <= BEHIND_MAX;
        standby.next = end + LOOK;
    }

    fn handle(&mut self, now: Instant, input: ThreadInput) {
        let input = match input {
            ThreadInput::Input(input) => input,
            ThreadInput::Question(question) => {
                self.inputs += 1;
                return question.answer(now, &mut self.scene);
            }
        };
        match &input {
            WorkerInput::Control(peer, bytes) => {
                *self.unhandled.entry(*peer).or_insert(0) += bytes.len();
            }
            WorkerInput::Ended(peer, _) => {
                self.unhandled.remove(peer);
            }
            _ => {}
        }
        if input != WorkerInput::Wake {
            self.inputs += 1;
        }
        match input {
            WorkerInput::Restore(tail, generation) => self.restore(tail, generation),
            WorkerInput::Follow => {
                self.standby = Some(Standby {
                    followed: None,
                    next: now,
                    is_ready: false,
                });
            }
            input => input.apply(now, &mut self.scene),
        }
    }

    /// Restores the scene from the data directory, if it is there.
    fn restore(&mut self, tail: LogTail, generation: Option<Generation>) {
        if let (Some(stored), Some(generation)) = (&self.stored, generation) {
            stored.take(generation);
        }
        let (clock, heartbeat) = (&*self.settings.clock, &self.settings.heartbeat);
        let name = self.scene.name();
        let followed = self.standby.take().and_then(|standby| standby.followed);
        let from = (tail, followed);
        let restored = (self.stored.as_ref())
            .and_then(|stored| stored.restore(name, from, clock, &mut || heartbeat.beat()));
        if let Some(restored) = restored {
            self.scene.add_restored(restored);
        }
    }

    /// Everything that there is to transmit, and what was handled.
    fn output(&mut self) -> WorkerOutput {
        let scene = &mut self.scene;
        scene.report_durable();
        let transmits: Vec<Transmit> = std::iter::from_fn(|| scene.poll_transmit()).collect();
        let mut handled = Vec::new();
        self.unhandled.retain(|peer, bytes| {
            let unread = scene.unread_bytes(*peer).min(*bytes);
            if unread < *bytes {
                handled.push((*peer, *bytes - unread));
            }
            *bytes = unread;
            unread > 0
        });
        WorkerOutput {
            transmits,
            handled,
            inputs: self.inputs,
            has_scene: scene.exists() || scene.is_damaged(),
            is_ready: (self.standby.as_ref()).is_some_and(|standby| standby.is_ready),
        }
    }
}

impl ThreadWorker {
    /// Starts the thread of a worker, which takes its inputs from a queue.
    pub(super) fn start(
        (id, scene): (WorkerId, SceneName),
        (scenes, data): (&SceneSettings, Option<&DataDir>),
        threads: &WorkerThreads,
    ) -> io::Result<Self> {
        let (sender, inputs) = channel();
        let clock = SharedClock::clone(&threads.clock);
        let heartbeat = {
            let clock = SharedClock::clone(&clock);
            Heartbeat::new(move || clock())
        };
        let wake = sender.clone();
        let wake = move || {
            // A thread that has ended needs no waking.
            let _ = wake.send(ThreadInput::Input(WorkerInput::Wake));
        };
        let wake: Arc<dyn Fn() + Send + Sync> = Arc::new(wake);
        let scenes = SceneSettings {
            bakers: threads.bake_pool.bakers(&scene, Arc::clone(&wake)),
            heartbeat: heartbeat.clone(),
            ..scenes.clone()
        };
        let worker = WorkerScene::new(scene, (&scenes, data), wake);
        let send = Arc::clone(&threads.send);
        let thread_id = ThreadId::default();
        let (on_thread, own_id) = (heartbeat.clone(), thread_id.clone());
        thread::Builder::new()
            .name(format!("rhumb-scene-{}", id.0))
            .stack_size(STACK_BYTES)
            .spawn(move || {
                note(&own_id);
                let send = |message| send(id, message);
                let run = || run(worker, &inputs, &send, &on_thread, &clock);
                if catch_unwind(AssertUnwindSafe(run)).is_err() {
                    tracing::error!(worker = id.0, "the thread of a scene panicked");
                }
                on_thread.rest();
                send(FromWorker::Over);
            })?;
        Ok(Self {
            inputs: sender,
            watched: Watched {
                heartbeat,
                thread_id,
                seen: None,
            },
        })
    }

    /// Queues an input. The end of the thread is reported elsewhere.
    pub(super) fn send(&self, input: WorkerInput) {
        let _ = self.inputs.send(ThreadInput::Input(input));
    }

    /// Queues a question. If the thread has ended, its caller gets an error.
    pub(super) fn ask(&self, question: Question) {
        let _ = self.inputs.send(ThreadInput::Question(question));
    }
}

impl Drop for ThreadWorker {
    fn drop(&mut self) {
        self.send(WorkerInput::End);
    }
}

/// Runs a worker until the dispatcher drops it.
fn run(
    mut worker: WorkerScene,
    inputs: &Receiver<ThreadInput>,
    send: &dyn Fn(FromWorker) -> bool,
    heartbeat: &Heartbeat,
    clock: &SharedClock,
) {
    let mut reported = (0, false, false);
    loop {
        let output = worker.output();
        heartbeat.rest();
        let state = (output.inputs, output.has_scene, output.is_ready);
        let has_news =
            !output.transmits.is_empty() || !output.handled.is_empty() || state != reported;
        reported = state;
        if has_news && !send(FromWorker::Output(output)) {
            return;
        }
        let first = match worker.next_wake() {
            None => inputs.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(wake) => {
                let until = Duration::from_nanos(wake.since(clock()).as_nanos());
                inputs.recv_timeout(until)
            }
        };
        heartbeat.beat();
        match first {
            Ok(ThreadInput::Input(WorkerInput::End)) | Err(RecvTimeoutError::Disconnected) => {
                return;
            }
            Err(RecvTimeoutError::Timeout) => {}
            Ok(input) => {
                let begun = clock();
                worker.handle(begun, input);
                for input in inputs.try_iter().take(INPUTS_PER_TURN) {
                    if matches!(input, ThreadInput::Input(WorkerInput::End)) {
                        return;
                    }
                    heartbeat.beat();
                    let now = clock();
                    worker.handle(now, input);
                    if now > begun + TURN_TIME {
                        break;
                    }
                }
            }
        }
        run_due(&mut worker.scene, heartbeat, clock);
        worker.follow(clock());
    }
}

/// Does what is due: one step, and more as long as all are short, so that the steps of a frame wake their receivers once.
fn run_due(scene: &mut SceneLoop, heartbeat: &Heartbeat, clock: &SharedClock) {
    let begun = clock();
    let mut now = begun;
    while scene.poll_timeout().is_some_and(|wake| wake.at <= now) && now <= begun + TURN_TIME {
        heartbeat.beat();
        scene.handle_timeout(now);
        now = clock();
    }
}

/// Hands a message of a worker's thread over; false if the receiver has ended.
pub(super) type SendFromWorker = Arc<dyn Fn(WorkerId, FromWorker) -> bool + Send + Sync>;

/// Messages that wait for the dispatcher, of all workers; beyond them a worker waits.
const REPORTS_WAITING_MAX: usize = 1_024;

/// Needs of a worker's thread.
#[derive(Clone)]
pub(super) struct WorkerThreads {
    pub(super) clock: SharedClock,
    pub(super) send: SendFromWorker,
    pub(super) bake_pool: BakePool,
}

/// The way back from the workers' threads and processes to the dispatcher.
pub(super) struct Threads {
    pub(super) workers: WorkerThreads,
    pub(super) received: Receiver<WorkerReport>,
    pub(super) reports: ReportSender,
}

/// Hands reports to the dispatcher, and wakes it.
#[derive(Clone)]
pub(super) struct ReportSender {
    reports: SyncSender<WorkerReport>,
    waker: Arc<dyn Fn() + Send + Sync>,
}

impl ReportSender {
    /// Hands a report over; false if the dispatcher has ended.
    pub(super) fn send(&self, report: WorkerReport) -> bool {
        // A dispatcher that has ended needs no output.
        let sent = self.reports.send(report).is_ok();
        (self.waker)();
        sent
    }
}

impl Threads {
    pub(super) fn new(clock: SharedClock, waker: impl Fn() + Send + Sync + 'static) -> Self {
        let (reports, received) = sync_channel(REPORTS_WAITING_MAX);
        let reports = ReportSender {
            reports,
            waker: Arc::new(waker),
        };
        let of_workers = reports.clone();
        let send = move |id, message| of_workers.send(WorkerReport::Worker(id, message));
        Self {
            workers: WorkerThreads {
                clock,
                send: Arc::new(send),
                bake_pool: BakePool::of_cores(),
            },
            received,
            reports,
        }
    }
}

/// The system's number of a thread, once it runs.
#[cfg(target_os = "linux")]
pub(super) type ThreadId = Arc<OnceLock<rustix::process::Pid>>;

/// The system's number of a thread, where it is not known.
#[cfg(not(target_os = "linux"))]
pub(super) type ThreadId = Arc<OnceLock<()>>;

/// Notes the number of the calling thread.
#[cfg(target_os = "linux")]
pub(super) fn note(id: &ThreadId) {
    id.get_or_init(rustix::thread::gettid);
}

/// The time that a thread of this process has waited for a core since it began; zero if the system does not count it.
#[cfg(target_os = "linux")]
fn waited_for_core(id: &ThreadId) -> Span {
    let Some(id) = id.get() else {
        return Span::ZERO;
    };
    // Nanoseconds on a core, nanoseconds in its queue, and the number of turns.
    let path = format!("/proc/self/task/{}/schedstat", id.as_raw_nonzero());
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let waited = text.split_ascii_whitespace().nth(1);
    Span::from_nanos(waited.and_then(|waited| waited.parse().ok()).unwrap_or(0))
}

/// This system's count is not used.
#[cfg(not(target_os = "linux"))]
fn waited_for_core(_: &ThreadId) -> Span {
    Span::ZERO
}

/// Notes nothing: this system's number is not used.
#[cfg(not(target_os = "linux"))]
pub(super) fn note(_: &ThreadId) {}

/// Lowest priority: a quarantined thread gets the processor time that no other thread wants.
pub(super) const LOWEST: i32 = 19;
/// Priority of a thread that makes solids, between that of other threads and the lowest: steps and messages come first.
const OF_SOLIDS: i32 = 10;

/// Lowers the priority of a thread, without a number that of the calling one. A thread that does not run yet keeps its own.
#[cfg(target_os = "linux")]
pub(super) fn lower(id: Option<&ThreadId>, priority: i32) {
    let thread = match id.map(|id| id.get().copied()) {
        Some(None) => return,
        running => running.flatten(),
    };
    // On Linux the call concerns the one thread.
    if let Err(cause) = rustix::process::setpriority_process(thread, priority) {
        tracing::warn!(%cause, priority, "cannot lower the priority of a thread");
    }
}

/// Does nothing: this system has no such call.
#[cfg(not(target_os = "linux"))]
pub(super) const fn lower(_: Option<&ThreadId>, _: i32) {}

/// The threads; all clones are one.
#[derive(Clone)]
pub(crate) struct BakePool(Arc<Mutex<Queues>>);

struct Queues {
    /// Waiting work by tenant; the first is the next one's.
    waiting: VecDeque<(String, VecDeque<Baking>)>,
    running: usize,
    most: usize,
}

/// A solid to be made, and what is called after it.
struct Baking {
    make: Box<dyn FnOnce() + Send>,
    wake: Wake,
}

impl BakePool {
    /// A pool of at most so many threads.
    pub(crate) fn of(most: usize) -> Self {
        Self(Arc::new(Mutex::new(Queues {
            waiting: VecDeque::new(),
            running: 0,
            most: most.max(1),
        })))
    }

    /// A pool of half of the processor cores: the other half is left for steps.
    pub(crate) fn of_cores() -> Self {
        Self::of(thread::available_parallelism().map_or(1, |cores| cores.get() / 2))
    }

    /// The bakers of a scene. `wake` is called after each job.
    pub(super) fn bakers(&self, scene: &SceneName, wake: Wake) -> Bakers {
        let (pool, tenant) = (self.clone(), tenant_of(scene).unwrap_or(scene.as_str()));
        let tenant = tenant.to_owned();
        Bakers::new(move |bake| {
            let (make, wake) = (Box::new(|| bake.run()), Wake::clone(&wake));
            pool.take(&tenant, Baking { make, wake });
        })
    }

    fn take(&self, tenant: &str, job: Baking) {
        {
            let mut queues = self.lock();
            queues.push(tenant, job);
            if queues.running == queues.most {
                return;
            }
            queues.running += 1;
        }
        let pool = self.clone();
        let thread = thread::Builder::new().name("rhumb-bake".to_owned());
        if let Err(cause) = thread.spawn(move || pool.run()) {
            // The next thread takes its job, which is refused when its time is over all the same.
            self.lock().running -= 1;
            tracing::error!(%cause, "no thread for the solid of a shape");
        }
    }

    /// Runs what waits.
    fn run(&self) {
        lower(None, OF_SOLIDS);
        while let Some(Baking { make, wake }) = self.next() {
            make();
            wake();
        }
    }

    /// The next job; `None` if none waits: then the thread ends.
    fn next(&self) -> Option<Baking> {
        let mut queues = self.lock();
        let job = queues.pop();
        if job.is_none() {
            queues.running -= 1;
        }
        job
    }

    fn lock(&self) -> MutexGuard<'_, Queues> {
        // A queue changes in one piece.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Queues {
    fn push(&mut self, tenant: &str, job: Baking) {
        match self.waiting.iter_mut().find(|(of, _)| of == tenant) {
            Some((_, jobs)) => jobs.push_back(job),
            None => {
                let jobs = VecDeque::from([job]);
                self.waiting.push_back((tenant.to_owned(), jobs));
            }
        }
    }

    /// The first job of the first tenant, which goes to the end if it has more.
    fn pop(&mut self) -> Option<Baking> {
        let (tenant, mut jobs) = self.waiting.pop_front()?;
        let job = jobs.pop_front();
        if !jobs.is_empty() {
            self.waiting.push_back((tenant, jobs));
        }
        job
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn of_the_time_before_the_first_look_a_quarter_of_a_second_counts_at_most() {
        let clock = Arc::new(AtomicU64::new(0));
        let time = Arc::clone(&clock);
        let heartbeat = Heartbeat::new(move || Instant::from_nanos(time.load(Ordering::SeqCst)));
        let mut watched = Watched {
            heartbeat: heartbeat.clone(),
            // No thread, which waits for no core.
            thread_id: ThreadId::default(),
            seen: None,
        };
        let pass = |ms: u64| {
            clock.fetch_add(ms * 1_000_000, Ordering::SeqCst);
        };
        heartbeat.beat();
        pass(3_000);
        assert_eq!(watched.worked_for(), UNSEEN_MAX, "the looker was late");
        pass(1_900);
        assert_eq!(watched.worked_for(), Span::from_millis(2_150));
        heartbeat.beat();
        pass(100);
        assert_eq!(watched.worked_for(), Span::from_millis(100));
        pass(2_000);
        assert_eq!(watched.worked_for(), Span::from_millis(2_100));
        heartbeat.rest();
        assert_eq!(watched.worked_for(), Span::ZERO);
    }

    #[test]
    fn tenants_take_turns_whatever_waits_for_one_of_them() {
        let mut queues = Queues {
            waiting: VecDeque::new(),
            running: 0,
            most: 1,
        };
        let (done, order) = channel();
        let job = |name: &'static str| {
            let (done, wake): (_, Wake) = (done.clone(), Arc::new(|| {}));
            let make = Box::new(move || done.send(name).unwrap());
            Baking { make, wake }
        };
        for name in ["a", "a", "a"] {
            queues.push("a", job(name));
        }
        queues.push("b", job("b"));
        while let Some(Baking { make, .. }) = queues.pop() {
            make();
        }
        drop((done, queues));
        assert_eq!(order.iter().collect::<String>(), "abaa");
    }

    #[test]
    fn no_more_jobs_run_at_a_time_than_the_pool_has_threads() {
        let pool = BakePool::of(2);
        let (started, begun) = channel();
        let (release, gate) = channel::<()>();
        let (gate, released) = (Arc::new(Mutex::new(gate)), Arc::new(Mutex::new(release)));
        for number in 0..6 {
            let (started, gate) = (started.clone(), Arc::clone(&gate));
            let make = Box::new(move || {
                started.send(number).unwrap();
                let _ = gate.lock().unwrap().recv();
            });
            let wake: Wake = Arc::new(|| {});
            pool.take("a", Baking { make, wake });
        }
        // Either of two threads may be the first to say what it has begun.
        let next = |count: usize| {
            let mut numbers: Vec<_> = begun.iter().take(count).collect();
            numbers.sort_unstable();
            numbers
        };
        assert_eq!(next(2), [0, 1]);
        assert_eq!(pool.lock().running, 2);
        assert!(begun.try_recv().is_err(), "the others wait");
        for _ in 0..6 {
            released.lock().unwrap().send(()).unwrap();
        }
        assert_eq!(next(4), [2, 3, 4, 5]);
    }
}
