//! Scenes that are stepped together, and arrays of all of them.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use numpy::{Element, IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use rhumb_bindings::BindingError;
use rhumb_bindings::rhumb_client::PipelineDepth;

use crate::errors::{FailedFork, exception_of, wrong_value};
use crate::number;
use crate::open_scene::{OpenScene, floats};
use crate::scene::PyScene;

/// Ticks between two looks at the signals of the process.
const TICKS_PER_LOOK: u32 = 16;

/// Steps each of these lockstep scenes by some ticks, on as many threads, and computes their views.
///
/// Raises the error of the first of them that has one, after all were stepped as far as they can be; numbers are their names.
#[pyfunction]
pub(crate) fn advance_scenes(
    py: Python<'_>,
    scenes: Vec<Py<PyScene>>,
    numbers: Vec<usize>,
    #[pyo3(from_py_with = number::whole::ticks)] ticks: u32,
    #[pyo3(from_py_with = number::whole::threads)] threads: u32,
) -> PyResult<()> {
    if ticks == 0 {
        return Err(wrong_value(py, "ticks", ticks, "at least 1"));
    }
    if threads == 0 {
        return Err(wrong_value(py, "threads", threads, "at least 1"));
    }
    let stepped: Vec<SteppedFork<'_>> = scenes
        .iter()
        .map(|scene| SteppedFork::new(scene.get()))
        .collect();
    let mut left = ticks;
    while left > 0 {
        let now = left.min(TICKS_PER_LOOK);
        py.detach(|| advance_each(&stepped, now, threads as usize));
        left -= now;
        py.check_signals()?;
    }
    let failures = stepped.iter().zip(numbers);
    let mut failures = failures.filter_map(|(stepped, number)| Some((number, stepped.failure()?)));
    match failures.next() {
        None => Ok(()),
        Some((number, error)) => {
            let others = failures.count();
            Err(exception_of(
                py,
                &error,
                Some(&FailedFork { number, others }),
            ))
        }
    }
}

/// A scene, and what went wrong in it.
struct SteppedFork<'a> {
    scene: &'a PyScene,
    outcome: Mutex<Outcome>,
}

#[derive(Default)]
struct Outcome {
    /// After it, the scene is not stepped.
    failed: Option<BindingError>,
    refused: Option<BindingError>,
}

impl<'a> SteppedFork<'a> {
    fn new(scene: &'a PyScene) -> Self {
        let outcome = Mutex::default();
        Self { scene, outcome }
    }

    fn advance(&self, ticks: u32) {
        let mut outcome = self.outcome.lock().unwrap_or_else(PoisonError::into_inner);
        let Outcome { failed, refused } = &mut *outcome;
        if failed.is_some() {
            return;
        }
        let advanced = self.scene.locked(|opened| {
            opened.expire();
            let mut each = (0..ticks).map(|_| {
                let scene = &mut opened.scene;
                scene.advance_through(PipelineDepth::LOCKSTEP, refused)
            });
            each.try_for_each(|advanced| advanced.map(drop))
        });
        *failed = advanced.err();
    }

    fn failure(&self) -> Option<BindingError> {
        let mut outcome = self.outcome.lock().unwrap_or_else(PoisonError::into_inner);
        outcome.failed.take().or_else(|| outcome.refused.take())
    }
}

/// Steps scenes on this thread and on others, each of which takes the next one that is left.
fn advance_each(scenes: &[SteppedFork<'_>], ticks: u32, threads: usize) {
    let next = AtomicUsize::new(0);
    let run = || {
        while let Some(scene) = scenes.get(next.fetch_add(1, Ordering::Relaxed)) {
            scene.advance(ticks);
        }
    };
    std::thread::scope(|scope| {
        for number in 1..threads.min(scenes.len()) {
            let thread = std::thread::Builder::new().name(format!("rhumb-forks-{number}"));
            // This thread does the work of one that cannot start.
            if thread.spawn_scoped(scope, run).is_err() {
                break;
            }
        }
        run();
    });
}

/// The numbers of all bodies in all of these scenes, in one row.
///
/// what: "positions", "rotations", "linear_velocities" or "angular_velocities". Raises InvalidError if the scenes do not have
/// the same bodies.
#[pyfunction]
pub(crate) fn numbers_of_scenes<'py>(
    py: Python<'py>,
    scenes: Vec<Py<PyScene>>,
    what: &str,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let numbers: fn(&mut OpenScene) -> &[f32] = match what {
        "positions" => |opened| floats(opened.scene.positions()),
        "rotations" => |opened| floats(opened.scene.rotations()),
        "linear_velocities" => |opened| floats(opened.scene.linear_velocities()),
        "angular_velocities" => |opened| floats(opened.scene.angular_velocities()),
        _ => {
            let words = "positions, rotations, linear_velocities or angular_velocities";
            return Err(wrong_value(py, "what", what, words));
        }
    };
    of_scenes(py, &scenes, numbers)
}

/// Which bodies of all of these scenes rest, in one row.
///
/// Raises InvalidError if the scenes do not have the same bodies.
#[pyfunction]
pub(crate) fn resting_of_scenes<'py>(
    py: Python<'py>,
    scenes: Vec<Py<PyScene>>,
) -> PyResult<Bound<'py, PyArray1<bool>>> {
    of_scenes(py, &scenes, |opened| opened.scene.resting())
}

fn of_scenes<'py, T: Element + Copy>(
    py: Python<'py>,
    scenes: &[Py<PyScene>],
    of_scene: impl Fn(&mut OpenScene) -> &[T],
) -> PyResult<Bound<'py, PyArray1<T>>> {
    let mut bodies = Vec::new();
    let mut all = Vec::new();
    for (place, scene) in scenes.iter().enumerate() {
        scene.get().with(py, |opened| {
            let own = opened.scene.bodies();
            if place == 0 {
                bodies.extend_from_slice(own);
            } else if own != bodies {
                return Err(BindingError::Argument {
                    argument: "scenes",
                    needed: "scenes with the same bodies: read the arrays of single ones where bodies were added or removed",
                });
            }
            let values = of_scene(opened);
            if place == 0 {
                all.reserve_exact(values.len() * scenes.len());
            }
            all.extend_from_slice(values);
            Ok(())
        })?;
    }
    let all = all.into_pyarray(py);
    all.try_readwrite()?.make_nonwriteable();
    Ok(all)
}
