//! Workers that do not answer: found, and quarantined.
//!
//! A thread cannot be killed. A quarantined one is left to itself with the lowest priority; its clients are
//! closed, and its scene's name is free again when it ends by itself: the scene is lost, or comes back from the data
//! directory without the commands after its last step. Invariant: at most `quarantined_scenes` threads are quarantined
//! before new scenes are refused, of which one account counts for its part alone.

use std::time::Duration;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Instant, Span};

use super::message::{FromWorker, WorkerId, WorkerReport};
use super::worker;
use super::{Dispatcher, Place};
use crate::durable::LogTail;
use crate::flight::FlightCause;

/// Time between two looks at the workers.
const INTERVAL: Span = Span::from_millis(250);
/// The time without a sign of life that a process has, beside that of a thread: a busy machine may starve its own thread.
const PROCESS_SILENCE: u64 = 3;
/// Time that threads have to end when the dispatcher ends.
const END: Duration = Duration::from_millis(500);
/// Time that processes have, whose threads have as long.
const END_OF_PROCESSES: Duration = Duration::from_millis(800);
/// Time after which processes that did not end by themselves are killed and gone.
const KILLED: Duration = Duration::from_millis(1_200);

impl Dispatcher {
    /// The time of the next check of the workers; never if there are none.
    pub(super) fn next_watch(&self) -> Option<Instant> {
        let processes = self.processes.as_ref();
        let has_process = processes.is_some_and(|processes| !processes.is_empty());
        let watches = !self.workers.is_empty() || has_process;
        watches.then_some(self.watchdog.next)
    }

    /// Quarantines the workers that have not answered for too long.
    pub(super) fn watch(&mut self, now: Instant) {
        if now < self.watchdog.next {
            return;
        }
        self.watchdog.next = now + INTERVAL;
        let stuck_for = self.settings.scenes.limits.stuck();
        if let Some(processes) = &mut self.processes {
            let looks = PROCESS_SILENCE * stuck_for.as_nanos() / INTERVAL.as_nanos() + 2;
            processes.look(u32::try_from(looks).unwrap_or(u32::MAX));
        }
        let stuck = self.workers.iter_mut();
        let stuck = stuck.filter_map(|(id, worker)| match &mut worker.place {
            Place::Thread(thread) => (thread.watched.worked_for() > stuck_for).then_some(*id),
            // A process watches its threads itself.
            Place::Process(_) => None,
        });
        let stuck: Vec<WorkerId> = stuck.collect();
        for id in stuck {
            self.quarantine(id);
        }
    }

    fn quarantine(&mut self, id: WorkerId) {
        if self.standbys.values().any(|standby| *standby == id) {
            // It was only followed: it is not this server's.
            return self.drop_worker(id);
        }
        self.close_connections_of(id, CloseCode::SCENE_QUARANTINED);
        let Some(worker) = self.workers.remove(&id) else {
            return;
        };
        let (scene, account) = (worker.scene, worker.account);
        let is_quarantined = |name: &SceneName| *name == scene;
        (self.settings.recorders.flights).write_where(is_quarantined, FlightCause::Quarantined);
        if let Place::Thread(thread) = &worker.place {
            worker::lower(Some(&thread.watched.thread_id), worker::LOWEST);
            // The scene comes back as it was before the step, which may still end.
            thread.watched.heartbeat.abandon();
        }
        let quarantined = (scene.clone(), account);
        self.watchdog.quarantined.insert(id, quarantined);
        let quarantined = self.watchdog.quarantined.len();
        self.settings.recorders.metrics.set_quarantined(quarantined);
        tracing::error!(%scene, worker = id.0, quarantined, "a scene does not answer and is quarantined");
    }

    /// The thread of a worker has ended: by itself if it is no worker any more, else by a panic.
    pub(super) fn note_over(&mut self, id: WorkerId) {
        if let Some((scene, account)) = self.watchdog.quarantined.remove(&id) {
            tracing::warn!(%scene, worker = id.0, "a quarantined thread has ended");
            // If not, the directory has given the scene to another server meanwhile, or to another worker of this one.
            let is_its = self.by_scene.get(&scene) == Some(&id);
            if is_its {
                self.by_scene.remove(&scene);
            }
            (self.settings.recorders.metrics).set_quarantined(self.watchdog.quarantined.len());
            if is_its
                && self.settings.data.is_some()
                && let Err(code) = self.start_worker((scene.clone(), account), LogTail::LeftOut)
            {
                tracing::error!(%scene, %code, "the scene stays in the data directory");
                self.release(&scene);
            }
        }
        if self.has_left(id) {
            return self.end_leaving(id);
        }
        if self.workers.contains_key(&id) {
            self.close_connections_of(id, CloseCode::SCENE_QUARANTINED);
            self.drop_worker(id);
        }
    }

    /// Ends all workers; waits a little for the threads that are not quarantined, and for all processes.
    pub fn shut_down(&mut self) {
        let is_thread = |worker: &super::Worker| matches!(worker.place, Place::Thread(_));
        let of_threads = self.workers.iter();
        let mut left: Vec<WorkerId> = of_threads
            .filter(|(_, worker)| is_thread(worker))
            .map(|(id, _)| *id)
            .collect();
        self.workers.clear();
        let threads = &self.threads;
        let mut processes = self.processes.as_mut();
        let mut running = processes
            .as_mut()
            .map_or(0, |processes| processes.end_all());
        let mut until = if running > 0 { END_OF_PROCESSES } else { END };
        let started = (threads.workers.clock)();
        while !left.is_empty() || running > 0 {
            let waited = (threads.workers.clock)().since(started);
            let waited = Duration::from_nanos(waited.as_nanos());
            match threads.received.recv_timeout(until.saturating_sub(waited)) {
                Ok(WorkerReport::Worker(id, FromWorker::Over)) => left.retain(|other| *other != id),
                Ok(WorkerReport::ProcessOver(..)) => running -= 1,
                Ok(WorkerReport::Worker(..) | WorkerReport::Process(..)) => {}
                Err(_) if running > 0 && until < KILLED => {
                    tracing::warn!(running, "worker processes did not end in time");
                    until = KILLED;
                    processes
                        .iter_mut()
                        .for_each(|processes| processes.kill_all());
                }
                Err(_) => {
                    let threads = left.len();
                    return tracing::warn!(threads, "threads of scenes did not end in time");
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::mpsc::{Receiver, Sender, channel};
    use std::sync::{Arc, Mutex};

    use rhumb_protocol::message::{
        ClientMessage, Extensions, Frames, Inspection, ServerMessage, StreamChoice, VERSIONS,
    };
    use rhumb_protocol::scene::SceneConfig;
    use rhumb_protocol::{Endpoint, Peer, Transmit};
    use rhumb_reckoning::{Tick, Tolerance};
    use rhumb_scene::{Hook, Hooks};

    use super::*;
    use crate::DispatcherSettings;
    use crate::durable::DataDir;

    const LONG: Duration = Duration::from_secs(30);
    const JOIN: ClientMessage = ClientMessage::Join(StreamChoice::Within(Tolerance::NORMAL));

    /// A dispatcher whose scenes wait before their third step until the sender is dropped.
    struct Stuck {
        dispatcher: Dispatcher,
        clock: Arc<AtomicU64>,
        woken: Receiver<()>,
        entered: Receiver<()>,
    }

    impl Stuck {
        fn new(data: DataDir) -> (Self, Sender<()>) {
            let clock = Arc::new(AtomicU64::new(0));
            let time = Arc::clone(&clock);
            let (wake, woken) = channel();
            let (wake, (release, gate)) = (Mutex::new(wake), channel::<()>());
            let gate = Arc::new(Mutex::new(gate));
            let (enter, entered) = channel();
            let hooks = Hooks::new(move |_, _| {
                let (gate, enter) = (Arc::clone(&gate), enter.clone());
                Some(Hook::new(move |scene, _| {
                    if scene.tick() == Tick::new(2) {
                        // A hook that does not return stands for a step that does not end.
                        let _ = enter.send(());
                        let _ = gate.lock().unwrap().recv();
                    }
                }))
            });
            let now = move || Instant::from_nanos(time.load(Ordering::SeqCst));
            let mut settings = DispatcherSettings::new(now);
            settings.scenes.hooks = Some(hooks);
            settings.data = Some(data);
            let dispatcher = Dispatcher::new(settings, move || {
                // After the test the receiver is gone.
                let _ = wake.lock().unwrap().send(());
            });
            let stuck = Self {
                dispatcher,
                clock,
                woken,
                entered,
            };
            (stuck, release)
        }

        fn open(&mut self, peer: Peer, messages: &[ClientMessage]) {
            let now = Instant::from_nanos(self.clock.load(Ordering::SeqCst));
            self.dispatcher.handle_opened(now, peer);
            let mut bytes = Vec::new();
            let hello = ClientMessage::Hello {
                versions: VERSIONS.to_vec(),
                scene: "stuck".parse().unwrap(),
                extensions: Extensions::NONE,
            };
            hello.encode(&mut bytes);
            messages
                .iter()
                .for_each(|message| message.encode(&mut bytes));
            self.dispatcher.handle_control(now, peer, &bytes);
        }

        /// The answer to `Inspect`.
        fn inspection(&mut self, peer: Peer) -> Inspection {
            let mut frames = Frames::default();
            loop {
                while let Some(transmit) = self.dispatcher.poll_transmit() {
                    if let Transmit::Control { to, bytes } = transmit
                        && to == peer
                    {
                        frames.push(&bytes);
                    }
                }
                while let Some(frame) = frames.next_frame().unwrap() {
                    match ServerMessage::decode(&frame).unwrap() {
                        Some(ServerMessage::Inspection(inspection)) => return inspection,
                        Some(ServerMessage::Denied(denial)) => panic!("{denial}"),
                        _ => {}
                    }
                }
                self.woken.recv_timeout(LONG).expect("the scene answers");
            }
        }
    }

    #[test]
    fn a_durable_scene_comes_back_as_it_was_before_the_step_at_which_it_was_given_up() {
        let directory = tempfile::tempdir().unwrap();
        let data = DataDir::open(directory.path()).unwrap();
        let (mut stuck, release) = Stuck::new(data);
        let (first, second) = (Peer(1), Peer(2));
        let create = ClientMessage::Create(SceneConfig::default());
        let advance = ClientMessage::Advance { to: Tick::new(3) };
        stuck.open(first, &[create, JOIN, advance]);
        stuck.entered.recv_timeout(LONG).expect("the step begins");
        for ms in [250, 2_300] {
            let look = Instant::ZERO + Span::from_millis(ms);
            stuck.clock.store(look.as_nanos(), Ordering::SeqCst);
            stuck.dispatcher.handle_timeout(look);
        }
        let code = CloseCode::SCENE_QUARANTINED.0;
        let mut transmits = std::iter::from_fn(|| stuck.dispatcher.poll_transmit());
        assert!(transmits.any(|transmit| transmit == Transmit::Close { to: first, code }));
        drop(release);
        while stuck.dispatcher.watchdog.quarantined.len() == 1 {
            stuck.woken.recv_timeout(LONG).expect("the thread ends");
            while stuck.dispatcher.poll_transmit().is_some() {}
        }
        stuck.open(second, &[JOIN, ClientMessage::Inspect]);
        let inspection = stuck.inspection(second);
        assert_eq!(inspection.tick, Tick::new(2), "the step is left out");
        stuck.dispatcher.shut_down();
    }
}
