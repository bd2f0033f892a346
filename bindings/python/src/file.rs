//! Scenes outside a server: robots and scenes from files, and checkpoints.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use rhumb_bindings::rhumb_client::Checkpoint;
use rhumb_bindings::{Base, FileSettings, LoadParams, LoadedFile, OwnContacts, packed_id};

use crate::arguments::{COORDINATES, one_of, rotation, vector};
use crate::errors::exception;
use crate::number::{real, within};

const BASES: [(&str, Base); 3] = [
    ("file", Base::AsFile),
    ("fixed", Base::Fixed),
    ("free", Base::Free),
];

const OWN_CONTACTS: [(&str, OwnContacts); 2] =
    [("file", OwnContacts::AsFile), ("all", OwnContacts::All)];

/// A file that was added to a scene; Scene.load makes it.
///
/// A name that the file has twice, or not at all, has a number here.
#[pyclass(frozen, name = "Loaded", module = "rhumb")]
pub(crate) struct PyLoaded(pub(crate) LoadedFile);

#[pymethods]
impl PyLoaded {
    /// The file's own name of its robot or scene.
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    /// The id of each body by its name in the file; those that others hold come after them.
    #[getter]
    fn bodies<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let bodies = PyDict::new(py);
        for body in &self.0.bodies {
            bodies.set_item(&body.name, packed_id(body.id))?;
        }
        Ok(bodies)
    }

    /// The number of each joint by its name in the file.
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let joints = PyDict::new(py);
        for joint in &self.0.joints {
            joints.set_item(&joint.name, joint.id.0)?;
        }
        Ok(joints)
    }

    /// By the name of a body: position and rotation of the file's frame of it, from its centre of mass and in its axes.
    #[getter]
    fn frames<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let frames = PyDict::new(py);
        for body in &self.0.bodies {
            let [x, y, z] = body.frame_position.to_array();
            let [qx, qy, qz, qw] = body.frame_rotation.to_array();
            frames.set_item(&body.name, ((x, y, z), (qx, qy, qz, qw)))?;
        }
        Ok(frames)
    }

    /// A sentence for each thing that the file says and the scene has not, or has by something near to it.
    #[getter]
    fn left_out(&self) -> Vec<&str> {
        self.0.left_out.iter().map(String::as_str).collect()
    }

    fn __repr__(&self) -> String {
        let LoadedFile {
            name,
            bodies,
            joints,
            left_out,
        } = &self.0;
        format!(
            "<rhumb.Loaded {name:?}, {} bodies, {} joints, {} notes>",
            bodies.len(),
            joints.len(),
            left_out.len()
        )
    }
}

/// The options of a file, from the keywords of a call.
pub(crate) fn params(
    py: Python<'_>,
    position: Option<&Bound<'_, PyAny>>,
    keywords: Option<&Bound<'_, PyDict>>,
) -> PyResult<LoadParams> {
    let mut params = LoadParams::default();
    if let Some(position) = position {
        params.position = vector(position, "position")?;
    }
    for (key, value) in keywords.into_iter().flatten() {
        let key: String = key.extract()?;
        let word = || -> PyResult<String> { value.extract() };
        match key.as_str() {
            "rotation" if value.is_none() => {}
            "rotation" => params.rotation = rotation(&value, "rotation")?,
            "base" => params.base = one_of(py, &BASES, &word()?, "base")?,
            "own_contacts" => {
                params.own_contacts = one_of(py, &OWN_CONTACTS, &word()?, "own_contacts")?;
            }
            "packages" => {
                let folders: Vec<PathBuf> = value.extract()?;
                let folders = folders.iter().map(|folder| folder.to_string_lossy());
                params.packages = folders.map(String::from).collect();
            }
            "density" => params.density = real(&value, "density")?,
            "group" => params.group = within(&value, "group", value.extract(), "0 to 31")?,
            "first_joint" => {
                let needed = "a number of 32 bits that is not negative";
                params.first_joint = within(&value, "first_joint", value.extract(), needed)?;
            }
            _ => {
                let text = format!("{key} is no keyword of a file");
                return Err(PyTypeError::new_err(text));
            }
        }
    }
    Ok(params)
}

/// Gravity, ticks per second (None: no whole number) and substeps that a file asks of a new scene.
#[pyfunction]
#[pyo3(signature = (file, coordinates = "rhumb", **keywords))]
pub(crate) fn file_settings(
    py: Python<'_>,
    file: PathBuf,
    coordinates: &str,
    keywords: Option<&Bound<'_, PyDict>>,
) -> PyResult<([f32; 3], Option<u32>, u32)> {
    let coordinates = one_of(py, &COORDINATES, coordinates, "coordinates")?;
    let params = params(py, None, keywords)?;
    let read = py.detach(|| FileSettings::read(&file.to_string_lossy(), coordinates, &params));
    let settings = read.map_err(|error| exception(py, &error))?;
    Ok((
        settings.gravity.to_array(),
        settings.ticks_per_second,
        settings.substeps,
    ))
}

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
