//! Servers in the interpreter's own process.

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::rhumb_client::LocalServer;

use crate::arguments::seconds;
use crate::connection::PyConnection;
use crate::number;

/// A physics server in this process, without sockets. It ends with the last of its clients and of the references to it.
///
/// own_thread: whether it steps on a thread of its own, so that a free-running scene moves on between calls; without it, it
/// steps within the calls of its clients. Clients on several threads take turns then: each waits while another one's call
/// steps, and other threads of the interpreter run meanwhile.
#[pyclass(frozen, name = "LocalServer", module = "rhumb")]
pub(crate) struct PyLocalServer {
    server: LocalServer,
    own_thread: bool,
}

#[pymethods]
impl PyLocalServer {
    #[new]
    #[pyo3(signature = (*, own_thread = false))]
    fn new(own_thread: bool) -> PyResult<Self> {
        let server = match own_thread {
            true => LocalServer::spawn()?,
            false => LocalServer::new(),
        };
        Ok(Self { server, own_thread })
    }

    /// A connection of one more client, which joins a scene. The time limit, in seconds, holds for every later call that waits.
    #[pyo3(signature = (*, timeout = 5.0))]
    fn connect(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::double::timeout)] timeout: f64,
    ) -> PyResult<PyConnection> {
        let timeout = seconds(py, timeout, "timeout")?;
        // Another client's call may be inside the server.
        let opened = py.detach(|| self.server.connect());
        let opened = opened.timeout(timeout);
        Ok(PyConnection::new("this process".to_owned(), opened))
    }

    fn __repr__(&self) -> String {
        format!("LocalServer(own_thread={})", python(self.own_thread))
    }
}

/// As Python writes it.
const fn python(value: bool) -> &'static str {
    match value {
        true => "True",
        false => "False",
    }
}

/// A scene in this process, on a server of its own: no program to start, no sockets, no fingerprint.
///
/// The options are those of Connection.join. The server ends with the scene. It steps within the scene's calls, so that a
/// free-running scene moves on only while it is polled. LocalServer has several clients of one scene, and a thread.
#[pyfunction]
#[pyo3(
    signature = (scene = "main", **options),
    text_signature = "(scene='main', *, coordinates='rhumb', condition='create or join', tolerance=0.05, \
        stepping='lockstep', ticks_per_second=60, substeps=4, publish_interval=1, gravity=None, sleep=None, \
        delay_ticks=0.0, lead_ticks=0.0, whole_ticks=False, smooth=True, refusals='raise', resume_within=None)"
)]
pub(crate) fn local<'py>(
    py: Python<'py>,
    scene: &str,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let opened = LocalServer::new().connect();
    let connection = PyConnection::new("this process".to_owned(), opened);
    Bound::new(py, connection)?.call_method("join", (scene,), options)
}
