//! Native module of the Python package `rhumb`: classes over the shared scene.
//!
//! The stubs in `python/rhumb/_native.pyi` are its documentation. Invariants:
//!
//! - A call that waits for the server releases the interpreter's lock.
//! - An array that was given out never changes: a later frame fills another one, or one that is out of use.
//! - Two threads in calls of one scene are an error of the second one, at once.
#![warn(clippy::undocumented_unsafe_blocks)]

mod answers;
mod arguments;
mod body;
mod cells;
mod connection;
mod errors;
mod file;
mod forks;
mod generated;
mod number;
mod open_scene;
mod scene;

use pyo3::prelude::*;

#[pymodule(name = "_native")]
fn native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<connection::PyConnection>()?;
    module.add_class::<connection::PyLocalServer>()?;
    module.add_class::<file::PyCheckpoint>()?;
    module.add_class::<scene::PyScene>()?;
    module.add_class::<body::PyShape>()?;
    module.add_class::<body::PyJoint>()?;
    module.add_class::<generated::PyCharacter>()?;
    module.add_class::<generated::PyWheel>()?;
    module.add_class::<generated::PyWheelInput>()?;
    module.add_class::<answers::PyEvent>()?;
    module.add_class::<answers::PyContact>()?;
    module.add_class::<answers::PyRequest>()?;
    module.add_class::<file::PyLoaded>()?;
    module.add_class::<answers::PyQuery>()?;
    module.add_class::<answers::PyHit>()?;
    module.add_function(wrap_pyfunction!(connection::connect, module)?)?;
    module.add_function(wrap_pyfunction!(file::file_settings, module)?)?;
    module.add_function(wrap_pyfunction!(connection::local, module)?)?;
    module.add_function(wrap_pyfunction!(forks::advance_scenes, module)?)?;
    module.add_function(wrap_pyfunction!(forks::numbers_of_scenes, module)?)?;
    module.add_function(wrap_pyfunction!(forks::resting_of_scenes, module)?)?;
    module.add_function(wrap_pyfunction!(connection::serve, module)?)
}
