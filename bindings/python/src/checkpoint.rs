//! Checkpoints: scenes as bytes, from which scenes continue.

use std::hash::{DefaultHasher, Hash, Hasher};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use rhumb_bindings::rhumb_client::Checkpoint;

use crate::errors::exception;

/// A scene at a moment, with all that decides its further run; Scene.save makes it, and restore makes scenes of it.
///
/// bytes(checkpoint) is a file of it, and Checkpoint(data) reads that: what is damaged, or of another version of rhumb, is
/// refused. The checksum finds damage and no malice: read files of those whose programs you would run.
#[pyclass(frozen, eq, name = "Checkpoint", module = "rhumb")]
#[derive(PartialEq)]
pub(crate) struct PyCheckpoint(pub(crate) Checkpoint);

#[pymethods]
impl PyCheckpoint {
    #[new]
    fn new(py: Python<'_>, data: &[u8]) -> PyResult<Self> {
        let read = py.detach(|| Checkpoint::from_bytes(data));
        read.map(Self).map_err(|error| exception(py, &error.into()))
    }

    /// The tick of the scene.
    #[getter]
    fn tick(&self) -> u64 {
        self.0.tick().value()
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let bytes = py.detach(|| self.0.to_bytes());
        PyBytes::new(py, &bytes)
    }

    fn __reduce__<'py>(
        this: &Bound<'py, Self>,
    ) -> PyResult<(Bound<'py, PyAny>, (Bound<'py, PyBytes>,))> {
        let data = this.get().__bytes__(this.py());
        Ok((this.get_type().into_any(), (data,)))
    }

    fn __hash__(&self) -> u64 {
        let mut hasher = DefaultHasher::new();
        (self.tick(), self.0.digest()).hash(&mut hasher);
        hasher.finish()
    }

    fn __repr__(&self) -> String {
        format!("<rhumb.Checkpoint of tick {}>", self.tick())
    }
}
