//! Threads that make the solids of large shapes, for all scenes of a process.
//!
//! As many jobs run at a time as there may be threads, at a low priority: a step comes before a solid. Those that wait are
//! taken in turn from the tenants that gave them, so that one with many waits for itself. Invariants: a thread ends when
//! nothing waits; a job is run once; one for which no thread could be started waits for the next thread.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use rhumb_protocol::scene::SceneName;
use rhumb_scene::{Bakers, tenant_of};

use crate::durable::Wake;

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
        lower();
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

/// Gives the calling thread a low priority: steps and messages come first.
#[cfg(target_os = "linux")]
fn lower() {
    /// Between that of other threads and the lowest.
    const NICE: i32 = 10;
    // On Linux the call concerns the one thread.
    if let Err(cause) = rustix::process::setpriority_process(None, NICE) {
        tracing::warn!(%cause, "cannot lower the priority of a thread that makes solids");
    }
}

/// Does nothing: this system has no such call.
#[cfg(not(target_os = "linux"))]
const fn lower() {}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

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
