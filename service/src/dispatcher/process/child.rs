//! A worker process: the scenes of one tenant, and a stream to the dispatcher.
//!
//! The main thread reads what the dispatcher sends. The scenes' threads write their outputs themselves. A thread of its
//! own gives a sign of life, whatever the scenes do. The process has no sockets and no keys of tokens, and ends with
//! the dispatcher.

use std::collections::BTreeMap;
use std::error::Error;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::{CellGrid, SceneName};
use rhumb_protocol::{Instant, Span};
use rhumb_scene::engine::{Engines, StepThreads};
use rhumb_scene::{Admission, Hooks, SceneSettings};
use rhumb_transport::{Clock, ParentSender, parent_stream};

use super::super::message::{FromProcess, FromWorker, ToProcess, Vitals, WorkerId, WorkerInput};
use super::super::worker::{BakePool, ThreadWorker, Watched};

use super::codec::{WorkerSetup, decode_to, encode_from};
use crate::dispatcher::recorders::SceneRecorders;
use crate::dispatcher::worker::WorkerThreads;
use crate::durable::DataDir;
use crate::flight::{FlightRecorders, ForwardedFlight};
use crate::log;
use crate::metrics::Metrics;
#[cfg(feature = "record")]
use crate::recording::{Recorder, RecordingLimits, SceneTaps};
use crate::signals;

/// Time between two signs of life.
const INTERVAL: Duration = Duration::from_millis(250);
/// Time that threads have to end when the process is to end.
const END: Duration = Duration::from_millis(500);
/// Bytes of a scene's entries that wait to be handed to the dispatcher.
const FLIGHT_BYTES_WAITING_MAX: usize = 64 << 10;

/// Runs a worker process, which a dispatcher has started, until the dispatcher needs it no longer. `seconds`: the
/// system's time since 1970.
///
/// # Errors
///
/// If no dispatcher is at the other end of standard input, and if the process cannot get what its settings name.
pub(crate) fn run(hooks: Option<Hooks>, seconds: fn() -> i64) -> Result<(), Box<dyn Error>> {
    let clock = Clock::start();
    let (to_dispatcher, mut from_dispatcher) = parent_stream()?;
    let setup = from_dispatcher.receive()?;
    let setup = setup.ok_or("a worker process is started by its server only")?;
    let setup: WorkerSetup = postcard::from_bytes(&setup)?;
    super::end_with_dispatcher(setup.dispatcher)?;
    super::limit_memory(setup.limits.worker_memory_mib)?;
    let _last_lines = log::start(setup.log.parse()?, setup.limits.log_lines_per_second);
    // A terminal and a service manager signal all processes: the dispatcher ends this one in order.
    signals::watch(|_| ())?;
    let begun = Span::from_nanos(setup.now_ns);
    let time = move || clock.now() + begun;
    let mut process = WorkerProcess::new(&setup, hooks, time, Arc::new(to_dispatcher))?;
    process.record(&setup, seconds);
    let (stop, stopped) = channel();
    let life = process.life.clone();
    let living = thread::Builder::new()
        .name("rhumb-worker-life".to_owned())
        .spawn(move || life.show_until(&stopped))?;
    while let Some(frame) = from_dispatcher.receive()? {
        let message =
            decode_to(&frame).map_err(|cause| format!("a frame of the dispatcher: {cause:?}"))?;
        process.handle(message);
    }
    process.end();
    drop(stop);
    // A panic of the thread was logged.
    let _ = living.join();
    Ok(())
}

struct WorkerProcess {
    scenes: SceneSettings,
    data: Option<DataDir>,
    /// Hand the states of its scenes to the recorder.
    #[cfg(feature = "record")]
    taps: SceneTaps,
    threads: WorkerThreads,
    workers: BTreeMap<WorkerId, ThreadWorker>,
    life: Life,
    /// Workers whose threads have ended.
    over: Receiver<WorkerId>,
    /// Records the scenes; it ends after the workers.
    #[cfg(feature = "record")]
    recorder: Option<Recorder>,
}

/// The threads of a process's workers.
type WatchedWorkers = Arc<Mutex<BTreeMap<WorkerId, Watched>>>;

/// The contents of a sign of life; all clones are one.
#[derive(Clone)]
struct Life {
    admission: Admission,
    watched: WatchedWorkers,
    metrics: Metrics,
    flights: FlightRecorders,
    outlet: Outlet,
}

/// The way to the dispatcher; all clones are one.
#[derive(Clone)]
struct Outlet(Arc<ParentSender>);

impl Outlet {
    /// Sends a message; false if the dispatcher has ended.
    fn send(&self, message: &FromProcess) -> bool {
        encode_from(message, &mut |frame| self.0.send(frame).is_ok())
    }
}

impl WorkerProcess {
    fn new(
        setup: &WorkerSetup,
        hooks: Option<Hooks>,
        clock: impl Fn() -> Instant + Send + Sync + Clone + 'static,
        to_dispatcher: Arc<ParentSender>,
    ) -> Result<Self, Box<dyn Error>> {
        let outlet = Outlet(to_dispatcher);
        let mut recorders = SceneRecorders::default();
        if setup.records_flights {
            recorders.flights = forwarded_flights(outlet.clone());
        }
        let scenes = SceneSettings {
            hooks,
            limits: setup.limits,
            engines: Engines::of(setup.engine),
            threads: StepThreads::new(Some(setup.threads))?,
            largest_packet: LargestPacket::new(setup.largest_packet)
                .ok_or("no size of a packet")?,
            cells: setup.cells.and_then(CellGrid::new),
            observers: Arc::new(recorders.clone()),
            ..SceneSettings::new(clock.clone())
        };
        let data = (setup.data.as_deref())
            .map(DataDir::of_worker)
            .transpose()?;
        let watched = WatchedWorkers::default();
        let (ended, over) = channel();
        let threads = WorkerThreads {
            clock: Arc::new(clock),
            send: Arc::new(sending(outlet.clone(), Arc::clone(&watched), ended)),
            bake_pool: BakePool::of_cores(),
        };
        let life = Life {
            admission: scenes.admission.clone(),
            watched,
            metrics: recorders.metrics.clone(),
            flights: recorders.flights.clone(),
            outlet,
        };
        Ok(Self {
            scenes,
            data,
            #[cfg(feature = "record")]
            taps: recorders.taps,
            threads,
            workers: BTreeMap::new(),
            life,
            over,
            #[cfg(feature = "record")]
            recorder: None,
        })
    }

    /// Records the scenes that begin from now on, if a directory is named. A directory that takes no files costs the
    /// recording, and no scene.
    #[cfg(feature = "record")]
    fn record(&mut self, setup: &WorkerSetup, seconds: fn() -> i64) {
        let Some(directory) = setup.record.clone() else {
            return;
        };
        let limits = RecordingLimits::of(&setup.limits);
        let taps = &self.taps;
        match Recorder::start(directory.clone(), limits, seconds, taps) {
            Ok(recorder) => self.recorder = Some(recorder),
            Err(cause) => {
                let directory = directory.display();
                tracing::error!(%directory, %cause, "the scenes of a worker process are not recorded");
            }
        }
    }

    /// A start without this feature refuses recordings.
    #[cfg(not(feature = "record"))]
    fn record(&mut self, _: &WorkerSetup, _: fn() -> i64) {}

    fn handle(&mut self, message: ToProcess) {
        match message {
            ToProcess::Begin(id, scene) => self.begin(id, scene),
            ToProcess::Input(id, input) => {
                let is_end = input == WorkerInput::End;
                if let Some(worker) = self.workers.get(&id) {
                    worker.send(input);
                }
                if is_end {
                    self.workers.remove(&id);
                }
            }
            ToProcess::Elsewhere { scenes, load } => {
                let scenes = usize::try_from(scenes).unwrap_or(usize::MAX);
                self.scenes.admission.slots.set_elsewhere(scenes);
                self.scenes.admission.load.set_elsewhere(load);
            }
        }
    }

    fn begin(&mut self, id: WorkerId, scene: SceneName) {
        let scenes = (&self.scenes, self.data.as_ref());
        match ThreadWorker::start((id, scene), scenes, &self.threads) {
            Ok(worker) => {
                lock(&self.life.watched).insert(id, worker.watched.clone());
                self.workers.insert(id, worker);
            }
            Err(cause) => {
                tracing::error!(%cause, "no thread for a scene");
                (self.threads.send)(id, FromWorker::Over);
            }
        }
    }

    /// Ends all workers, and waits for their threads as long as that may take: logs are written to their ends.
    fn end(&mut self) {
        let running: Vec<WorkerId> = lock(&self.life.watched).keys().copied().collect();
        self.workers.clear();
        let started = (self.threads.clock)();
        let mut left = running.len();
        while left > 0 {
            let waited = Duration::from_nanos((self.threads.clock)().since(started).as_nanos());
            match self.over.recv_timeout(END.saturating_sub(waited)) {
                Ok(id) => left -= usize::from(running.contains(&id)),
                Err(_) => return tracing::warn!(left, "threads of scenes did not end in time"),
            }
        }
    }
}

/// The call by which the workers' threads hand over their outputs.
fn sending(
    outlet: Outlet,
    watched: WatchedWorkers,
    ended: Sender<WorkerId>,
) -> impl Fn(WorkerId, FromWorker) -> bool + Send + Sync {
    let ended = Mutex::new(ended);
    move |id, message| {
        let is_over = message == FromWorker::Over;
        let sent = outlet.send(&FromProcess::Worker(id, message));
        if is_over {
            lock(&watched).remove(&id);
            // After the end of the process nothing waits for it.
            let _ = lock(&ended).send(id);
        }
        sent
    }
}

fn forwarded_flights(outlet: Outlet) -> FlightRecorders {
    let forward = move |scene: &SceneName, flight| {
        let scene = scene.clone();
        outlet.send(&match flight {
            ForwardedFlight::Entries(entries) => FromProcess::Flight(scene, Bytes::from(entries)),
            ForwardedFlight::Write(cause) => FromProcess::WriteFlight(scene, cause),
        });
    };
    FlightRecorders::forwarding(Arc::new(forward), FLIGHT_BYTES_WAITING_MAX)
}

impl Life {
    /// Shows that the process lives, until the other end of the channel is gone.
    fn show_until(&self, stopped: &Receiver<()>) {
        while let Err(RecvTimeoutError::Timeout) = stopped.recv_timeout(INTERVAL) {
            // The entries go first: a dispatcher that finds the process stuck has them.
            self.flights.forward_all();
            let busy = lock(&self.watched)
                .iter_mut()
                .map(|(id, worker)| (*id, worker.worked_for()))
                .max_by_key(|(_, busy)| *busy);
            let metrics = FromProcess::Metrics(self.metrics.scene_values());
            let vitals = FromProcess::Alive(Vitals {
                busiest: busy,
                scenes: self.admission.slots.here() as u64,
                load: self.admission.load.here(),
            });
            if !self.outlet.send(&metrics) || !self.outlet.send(&vitals) {
                return;
            }
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Locked data are changed in one piece.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
