//! A scene that is open, its arrays for Python, and its statistics.
//!
//! Arrays are filled once per frame, and then never changed. Reading one again, slicing it and handing it on copies
//! nothing. An array that Python still holds keeps its frame; one that Python has let go is filled anew, so that a loop
//! allocates nothing.

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyTuple};
use rhumb_bindings::RemoteScene;
use rhumb_bindings::rhumb_client::Statistics;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};

/// A scene that is open, and its arrays.
pub(crate) struct OpenScene {
    pub(crate) scene: RemoteScene,
    pub(crate) bodies: ViewArray<u64>,
    pub(crate) changed: ViewArray<u32>,
    pub(crate) removed: ViewArray<u64>,
    pub(crate) positions: ViewArray<f32>,
    pub(crate) rotations: ViewArray<f32>,
    pub(crate) linear: ViewArray<f32>,
    pub(crate) angular: ViewArray<f32>,
    pub(crate) resting: ViewArray<bool>,
    /// Computed whenever it is read.
    pub(crate) bounds: ViewArray<f32>,
}

impl OpenScene {
    pub(crate) const fn new(scene: RemoteScene) -> Self {
        Self {
            scene,
            bodies: ViewArray::new(),
            changed: ViewArray::new(),
            removed: ViewArray::new(),
            positions: ViewArray::new(),
            rotations: ViewArray::new(),
            linear: ViewArray::new(),
            angular: ViewArray::new(),
            resting: ViewArray::new(),
            bounds: ViewArray::new(),
        }
    }

    /// Marks the arrays as old: the view is about to be computed anew.
    pub(crate) const fn expire(&mut self) {
        self.bodies.expire();
        self.changed.expire();
        self.removed.expire();
        self.positions.expire();
        self.rotations.expire();
        self.linear.expire();
        self.angular.expire();
        self.resting.expire();
        self.bounds.expire();
    }
}

/// Arrays of one kind: the newest first.
pub(crate) struct ViewArray<T> {
    kept: Vec<Py<PyArrayDyn<T>>>,
    /// True if the first array is that of the present view.
    is_current: bool,
}

/// One array is being read while the one before is still held: `positions` of a loop's last round.
const KEPT: usize = 2;

impl<T: Element + Copy> ViewArray<T> {
    const fn new() -> Self {
        Self {
            kept: Vec::new(),
            is_current: false,
        }
    }

    /// Tells that the view was computed anew.
    pub(crate) const fn expire(&mut self) {
        self.is_current = false;
    }

    /// The array of the present view: `width` numbers a body, or a row of bodies if it is `None`.
    pub(crate) fn get<'py>(
        &mut self,
        py: Python<'py>,
        width: Option<usize>,
        values: &[T],
    ) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
        if self.is_current
            && let Some(array) = self.kept.first()
        {
            return Ok(array.bind(py).clone());
        }
        let count = values.len() / width.unwrap_or(1);
        let shape = [count, width.unwrap_or(1)];
        let shape = &shape[..1 + usize::from(width.is_some())];
        let is_free = |array: &Py<PyArrayDyn<T>>| {
            // The only reference is the one kept here: no variable, no slice, no view of Python's can see it change.
            // SAFETY: a `Py` points to a live object, and the interpreter's lock is held.
            let references = unsafe { pyo3::ffi::Py_REFCNT(array.as_ptr()) };
            references == 1 && array.bind(py).shape() == shape
        };
        let array = match self.kept.iter().position(is_free) {
            Some(place) => self.kept.remove(place).into_bound(py),
            None => new_array(py, shape)?,
        };
        // SAFETY: the array was made here with this shape, in C order, and owns its memory; nothing else refers to it, and
        // the interpreter's lock is held.
        unsafe { std::slice::from_raw_parts_mut(array.data(), values.len()) }
            .copy_from_slice(values);
        array.call_method1("setflags", (false,))?;
        self.kept.insert(0, array.clone().unbind());
        self.kept.truncate(KEPT);
        self.is_current = true;
        Ok(array)
    }
}

/// A new array in C order, of the class that refuses `None` as a place.
fn new_array<'py, T: Element>(
    py: Python<'py>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    static CLASS: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let class = CLASS.get_or_try_init(py, || {
        let module = py.import("rhumb.arrays")?;
        module.getattr("BodyArray").map(Bound::unbind)
    })?;
    let shape = PyTuple::new(py, shape)?;
    let array = class.bind(py).call1((shape, numpy::dtype::<T>(py)))?;
    Ok(array.cast_into::<PyArrayDyn<T>>()?)
}

/// Vectors or quaternions as floats.
pub(crate) fn floats<T: Floats>(values: &[T]) -> &[f32] {
    let count = size_of_val(values) / size_of::<f32>();
    // SAFETY: glam's vectors and quaternions are three or four floats in memory, without a gap and initialised.
    unsafe { std::slice::from_raw_parts(values.as_ptr().cast::<f32>(), count) }
}

/// Types that are nothing but floats in memory.
pub(crate) trait Floats {}

impl Floats for Vec3 {}
impl Floats for Quat {}

/// Statistics since the client connected.
pub(crate) fn dictionary<'py>(py: Python<'py>, now: &Statistics) -> PyResult<Bound<'py, PyDict>> {
    let statistics = PyDict::new(py);
    statistics.set_item("sent_bytes", now.wire.sent_bytes)?;
    statistics.set_item("received_bytes", now.wire.received_bytes)?;
    statistics.set_item("updates", now.stream.updates)?;
    statistics.set_item("complete_tick", now.complete.value())?;
    let upstream = PyDict::new(py);
    upstream.set_item("updates", now.upstream.updates)?;
    upstream.set_item("packets", now.upstream.packets)?;
    upstream.set_item("bytes", now.upstream.bytes)?;
    statistics.set_item("upstream", upstream)?;
    statistics.set_item("behind_ticks", now.behind_ticks)?;
    statistics.set_item("events_left_out", now.events_left_out)?;
    statistics.set_item("contacts_left_out", now.contacts_left_out)?;
    Ok(statistics)
}
