//! Native module of the Python package `rhumb`: classes over the shared scene.
//!
//! The stubs in `python/rhumb/_native.pyi` are its documentation. Invariants:
//!
//! - A call that waits for the server releases the interpreter's lock.
//! - An array that was given out never changes: a later frame fills another one, or one that is out of use.
//! - Two threads in calls of one scene are an error of the second one, at once.

mod arguments;
mod connection;
mod errors;
mod event;
mod query;
mod scene;
mod shape;
mod snapshot;

use pyo3::prelude::*;

#[pymodule(name = "_native")]
fn native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<connection::Connection>()?;
    module.add_class::<scene::Scene>()?;
    module.add_class::<shape::Shape>()?;
    module.add_class::<event::Event>()?;
    module.add_class::<query::Query>()?;
    module.add_class::<query::Hit>()?;
    module.add_function(wrap_pyfunction!(connection::connect, module)?)
}
