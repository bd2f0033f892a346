//! Errors as exceptions of `rhumb.errors`, one class for each kind.

use std::fmt::Display;

use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::scene::Invalid;
use rhumb_bindings::{BindingError, Coordinates, ErrorKind, packed_id};

/// The exception of an error.
pub(crate) fn exception(py: Python<'_>, error: &BindingError) -> PyErr {
    exception_of(py, error, None)
}

/// A fork that has an error, and the number of those after it that have one too.
pub(crate) struct FailedFork {
    pub(crate) number: usize,
    pub(crate) others: usize,
}

impl FailedFork {
    fn text(&self, error: &BindingError) -> String {
        let Self { number, others } = self;
        match others {
            0 => format!("fork {number}: {error}"),
            1 => format!("fork {number}: {error} (1 fork more has an error)"),
            _ => format!("fork {number}: {error} ({others} forks more have errors)"),
        }
    }
}

/// The exception of an error, in a fork if there is one.
pub(crate) fn exception_of(
    py: Python<'_>,
    error: &BindingError,
    fork: Option<&FailedFork>,
) -> PyErr {
    let text = fork.map_or_else(|| error.to_string(), |fork| fork.text(error));
    if let BindingError::Refused { kept, left_out } = error {
        let word = |id: &BodyId| packed_id(*id);
        let rows = kept.iter().map(|record| {
            let body = record.body.as_ref().map(word);
            (record.number, body, record.reason, record.text.clone())
        });
        let rows: Vec<_> = rows.collect();
        return match class(py, error.kind()) {
            Ok(class) => PyErr::from_type(class, (text, rows, *left_out)),
            Err(missing) => missing,
        };
    }
    let class = match error {
        BindingError::NotInView(_) => named(py, "NotInViewError"),
        _ => class(py, error.kind()),
    };
    match class {
        Ok(class) => PyErr::from_type(class, text),
        Err(missing) => missing,
    }
}

/// The exception of a wrong argument.
pub(crate) fn wrong(py: Python<'_>, argument: &'static str, needed: &'static str) -> PyErr {
    exception(py, &BindingError::Argument { argument, needed })
}

/// The exception of a wrong value of an argument.
pub(crate) fn wrong_value(
    py: Python<'_>,
    argument: &'static str,
    found: impl Display,
    needed: impl Display,
) -> PyErr {
    exception(py, &BindingError::value(argument, found, needed))
}

/// Refuses at once what is wrong in all coordinates: the unit of a length is that of a scene, which is not known yet.
pub(crate) fn check_in_any(
    py: Python<'_>,
    check: impl Fn(Coordinates) -> Result<(), Invalid>,
) -> PyResult<()> {
    let mut each = Coordinates::EACH.into_iter().map(check);
    let first = each.next().unwrap_or(Ok(()));
    match first {
        Err(invalid) if each.all(|checked| checked.is_err()) => Err(exception(py, &invalid.into())),
        _ => Ok(()),
    }
}

fn class(py: Python<'_>, kind: ErrorKind) -> PyResult<Bound<'_, PyType>> {
    let name = match kind {
        ErrorKind::Invalid | ErrorKind::Null | ErrorKind::TooSmall => "InvalidError",
        ErrorKind::Closed => "ClosedError",
        ErrorKind::Busy => "BusyError",
        ErrorKind::Connect => "ConnectError",
        ErrorKind::Denied => "DeniedError",
        ErrorKind::Refused => "RefusedError",
        ErrorKind::Timeout => "Timeout",
        ErrorKind::Ended => "EndedError",
        ErrorKind::SceneGone => "SceneGoneError",
        ErrorKind::Fault => "FaultError",
    };
    named(py, name)
}

fn named<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyType>> {
    static MODULE: PyOnceLock<Py<PyModule>> = PyOnceLock::new();
    let module = MODULE.get_or_try_init(py, || py.import("rhumb.errors").map(Bound::unbind))?;
    Ok(module.bind(py).getattr(name)?.cast_into::<PyType>()?)
}
