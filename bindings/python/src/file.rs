//! Robots and scenes from files: what they become, and how they are read.

use std::path::PathBuf;

use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
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

/// What a file became in a scene; Scene.load makes it.
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
