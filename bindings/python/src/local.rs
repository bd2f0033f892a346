//! Servers in the interpreter's own process, with sockets and without.

use std::sync::Arc;
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::rhumb_client::LocalServer;
use rhumb_bindings::{OwnServer, Reach, ServedScenes};

use crate::arguments::seconds;
use crate::checkpoint::PyCheckpoint;
use crate::connection::PyConnection;
use crate::errors::exception;
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
        let origin = OwnServer::Local(self.server.clone());
        Ok(PyConnection::new(
            "this process".to_owned(),
            opened,
            Some(origin),
        ))
    }

    /// Makes a scene that continues from a checkpoint, to be joined by its name.
    ///
    /// Bodies keep their ids. The scene has no members at first: it ends if none joins for ten minutes.
    fn restore(&self, py: Python<'_>, scene: &str, checkpoint: &PyCheckpoint) -> PyResult<()> {
        let restored = py.detach(|| self.server.restore(scene, &checkpoint.0));
        restored.map_err(|error| exception(py, &error.into()))
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
    let server = LocalServer::new();
    let opened = server.connect();
    let origin = Some(OwnServer::Local(server));
    let connection = PyConnection::new("this process".to_owned(), opened, origin);
    Bound::new(py, connection)?.call_method("join", (scene,), options)
}

/// Longest wait for a server of this process.
const TIMEOUT: Duration = Duration::from_secs(5);

/// A scene in this process that others join, on a server of its own: no program to start, no fingerprint to copy.
///
/// Scene.address is the one text by which other processes connect: rhumb.connect(scene.address).join("main"). It is printed
/// too, unless quiet. rhumb.view(scene) shows the scene in a browser.
///
/// listen: IP address and port of the server; port 0 is a free one. open_to_network: whether the address may be one that
/// other machines reach. There are no tokens: each client may do everything. The rest is as of Connection.join. The
/// server has threads of its own and ends with the scene, for every member.
#[pyfunction]
#[pyo3(
    signature = (scene = "main", *, listen = "127.0.0.1:0", open_to_network = false, quiet = false, **options),
    text_signature = "(scene='main', *, listen='127.0.0.1:0', open_to_network=False, quiet=False, coordinates='rhumb', \
        condition='create or join', tolerance=0.05, \
        stepping='lockstep', ticks_per_second=60, substeps=4, publish_interval=1, gravity=None, sleep=None, \
        delay_ticks=0.0, lead_ticks=0.0, whole_ticks=False, smooth=True, refusals='raise', resume_within=None)"
)]
pub(crate) fn serve<'py>(
    py: Python<'py>,
    scene: &str,
    listen: &str,
    open_to_network: bool,
    quiet: bool,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let reach = match open_to_network {
        true => Reach::Network,
        false => Reach::ThisMachine,
    };
    let started = py.detach(|| {
        let served = ServedScenes::start(listen, reach)?;
        let opened = served.connect(TIMEOUT)?;
        Ok((served, opened))
    });
    let (served, opened) = started.map_err(|error| exception(py, &error))?;
    let address = served.address();
    let origin = Some(OwnServer::Served(Arc::new(served)));
    let connection = PyConnection::new(format!("{address:?}"), opened, origin);
    let joined = Bound::new(py, connection)?.call_method("join", (scene,), options)?;
    if !quiet {
        let said = format!("rhumb.connect(\"{address}\").join(\"{scene}\") joins this scene");
        py.import("builtins")?.call_method1("print", (said,))?;
    }
    Ok(joined)
}
